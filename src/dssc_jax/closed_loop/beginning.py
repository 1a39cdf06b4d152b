"""The states of plant and controllers before the first sample, where native code with a state outside of JAX starts."""

import jax
import jax.numpy as jnp

from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.core.numerics import as_arrays
from dssc_jax.core.signals import State
from dssc_jax.core.vectors import Vec3
from dssc_jax.models.wind import NO_WIND


def first_wind(loop: Loop, params: LoopParams) -> Vec3 | None:
    """The mean wind at t = 0 [m/s], in which a plant that can settle starts; None if the study has no wind."""
    return None if loop.wind is NO_WIND else loop.wind.at_start(params.wind, loop.sample_time)


def begin_plant(loop: Loop, params: LoopParams, key: jax.Array) -> State:
    """The plant's state at t = 0; a plant that can settle starts in equilibrium with the mean wind.

    A plant with a state outside of JAX, such as an FMU, starts its own instance for this draw.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key; only a plant with a state outside of JAX uses it, to tell its instances apart.
    """
    state = loop.plant.init(params.plant)
    wind = first_wind(loop, params)
    if loop.plant.settle is not None and wind is not None:
        state = loop.plant.settle(params.plant, state, wind)
    state = as_arrays(state)
    if loop.plant.begin is None:  # all of its state is in JAX
        return state
    lane = jax.random.bits(loop.key(key, "plant"), dtype=jnp.uint32)  # a word that tells this draw from all others
    steps_of_flight = loop.steps * loop.substeps
    return as_arrays(loop.plant.begin(params.plant, state, lane, steps_of_flight))


def begin_controller(loop: Loop, params: LoopParams, key: jax.Array, i: int, state: State) -> State:
    """The state of channel i's controller before its first step.

    A controller with a state outside of JAX, such as an FMU, starts its own instance for this draw.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        i: Index of the channel.
        state: The state that the controller's ``init`` returned.
    """
    begin = loop.controller[i].begin
    if begin is None:  # all of its state is in JAX
        return state
    # a word that tells this draw from all others
    lane = jax.random.bits(loop.key(key, "controller", loop.channels[i]), dtype=jnp.uint32)
    return begin(params.controller[i], state, lane, loop.steps)
