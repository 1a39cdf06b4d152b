"""State that a part of the loop keeps outside of JAX, such as an instance of an FMU."""

from collections.abc import Callable
from typing import TypeAlias

from dssc_jax.core.signals import Params, Scalar, State

Begin: TypeAlias = Callable[[Params, State, Scalar, int], State]
"""``(params, state, lane, steps) -> state`` at t = 0, which binds a part's state to an object outside of JAX.

``lane`` is a word that is traced for each draw, ``steps`` the number of steps of the flight. A part that has this keeps
its state in that object: each step must be made once, in order. What makes steps otherwise refuses the part by name.
"""
