"""The estimator on board of a plant: its start, its steps, and the measurements that the controllers take from it."""

import jax

from dssc_jax.closed_loop.beginning import first_wind
from dssc_jax.closed_loop.control import measure
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.core.estimation import Estimation
from dssc_jax.core.signals import Measurements, PlantInput, ReferencePoints, Scalar, Signals, State


def estimation_of(loop: Loop, params: LoopParams) -> Estimation | None:
    """The plant's sensors and estimator on board if its parameters enable them, else None.

    With None, the controllers see the true state.
    """
    estimation = loop.mimo_plant.estimation
    return estimation if estimation is not None and estimation.is_enabled(params.plant) else None


def start_estimate(loop: Loop, params: LoopParams, key: jax.Array, plant: State) -> tuple[State, State]:
    """The plant's state with the error of the first estimate, and the estimator's memory at t = 0.

    The plant's sampled software on board starts a second time here: it has started from the true state, and must start
    from the estimate.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        plant: The true state of the plant.

    Returns:
        The plant's state and the memory; without an estimator the state as it is, and ().
    """
    estimation = estimation_of(loop, params)
    if estimation is None:
        return plant, ()  # no memory
    plant, memory = estimation.start(params.plant, plant, loop.key_at(key, "estimator", "", 0))
    software = loop.mimo_plant.software
    if software is not None and software.period(params.plant) is not None:
        estimated_plant = estimation.estimated_state(params.plant, plant)
        plant = software.holding(plant, software.start(params.plant, estimated_plant, first_wind(loop, params)))
    return plant, memory


def next_estimate(
    loop: Loop, params: LoopParams, key: jax.Array, plant: State, memory: State, k: Scalar
) -> tuple[State, State]:
    """The states of plant and estimator at sample k, after the estimator's step; unchanged without an estimator.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        plant: State of the plant, which contains the error of the estimate.
        memory: Memory of the estimator before its step.
        k: Index of the sample.

    Returns:
        The plant's state with the new error, and the new memory.
    """
    estimation = estimation_of(loop, params)
    if estimation is None:
        return plant, memory
    return estimation.step(params.plant, plant, memory, loop.key_at(key, "estimator", "", k), k, loop.sample_time)


def measurements_for_sensors(
    loop: Loop,
    params: LoopParams,
    plant: State,
    references: ReferencePoints,
    drive: PlantInput[Signals],
    exact: Measurements,
) -> Measurements:
    """The inputs of the channels' sensors: outputs of the estimated state, or ``exact`` without an estimator.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        plant: The plant's state, with the error of the estimate.
        references: The desired outputs.
        drive: The plant's input just before the sample.
        exact: Outputs of the true state.
    """
    estimation = estimation_of(loop, params)
    if estimation is None:
        return exact
    return measure(loop, params, estimation.estimated_state(params.plant, plant), references, drive)
