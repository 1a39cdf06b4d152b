"""State that a part of the loop keeps outside of JAX, such as an instance of an FMU."""

from collections.abc import Callable
from typing import TypeAlias

from dssc_jax.core.signals import Params, Scalar, State

Begin: TypeAlias = Callable[[Params, State, Scalar, int], State]
"""``(params, state, lane, steps) -> state`` at t = 0, which binds the state of a part to an object outside of JAX.

``lane`` is a traced word that differs from draw to draw, ``steps`` the number of steps of the flight. The part keeps
its state in that object, so each step must be made once, in order. Analyses that make steps in another way refuse such
a part.
"""
