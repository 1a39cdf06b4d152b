"""Estimation on board of a plant: at each sample it gives the controllers an estimate in place of the true state."""

from collections.abc import Callable
from typing import NamedTuple

import jax

from dssc_jax.core.signals import Params, Scalar, State


class Estimation(NamedTuple):
    """Sensors and an estimator that are part of a plant.

    The error of the estimate is part of the plant's state, and constant between two samples. Between the samples, the
    software on board sees the true state plus this error. ``memory`` is the state of sensors and estimator.

    Args:
        is_enabled: ``(params) -> bool``: whether the parameters select an estimator.
        start: ``(params, state, key) -> (state, memory)`` at t = 0.
        step: ``(params, state, memory, key, k, dt) -> (state, memory)`` at sample k > 0.
        estimated_state: ``(params, state) -> state`` as the controllers see it.
    """

    is_enabled: Callable[[Params], bool]
    start: Callable[[Params, State, jax.Array], tuple[State, State]]
    step: Callable[[Params, State, State, jax.Array, Scalar, float], tuple[State, State]]
    estimated_state: Callable[[Params, State], State]
