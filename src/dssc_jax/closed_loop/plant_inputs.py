"""The input of the plant: commands through the unmodelled dynamics, disturbances, wind and events."""

import jax

from dssc_jax.closed_loop.control import measure
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.core.signals import PlantInput, Scalar, Signals, State, tracking_error


def actuate(loop: Loop, params: LoopParams, unmodelled: tuple[State, ...], commands: Signals) -> Signals:
    """The commands that reach the plant: outputs of each channel's unmodelled dynamics in their present states.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        unmodelled: States of the unmodelled dynamics.
        commands: Commands of the controllers.
    """
    reaching = []
    for i, model in enumerate(loop.unmodelled):
        reaching.append(model.output(params.unmodelled[i], unmodelled[i], commands[i]))
    return tuple(reaching)


def receive_command(
    loop: Loop, params: LoopParams, key: jax.Array, unmodelled: State, i: int, command: Scalar, k: Scalar
) -> State:
    """The state of channel i's unmodelled dynamics once they have received the command of sample k.

    Only dynamics that act once per sample, such as a computer's delay or quantiser, change their state here.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        key: The draw's random key.
        unmodelled: The state before the sample.
        i: Index of the channel.
        command: The command of sample k.
        k: Index of the sample.
    """
    sample_key = loop.key_at(key, "unmodelled", loop.channels[i], k + 1)
    return loop.unmodelled[i].sample(params.unmodelled[i], unmodelled, command, sample_key, loop.sample_time)


def plant_input(
    loop: Loop,
    params: LoopParams,
    input_states: tuple[State, ...],
    wind: State,
    plant: State,
    actuation: Signals,
    t: Scalar,
    condition: State = None,
) -> PlantInput[Signals]:
    """The plant's input at a stage of the integrator, with disturbances that may depend on the plant's state there.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        input_states: State of the disturbance of each channel, then of each named input.
        wind: State of the wind.
        plant: State of the plant at the stage.
        actuation: The commands that reach the plant.
        t: Time of the stage [s].
        condition: The vehicle's condition after events; None: no event has happened.
    """
    references = loop.mimo_reference.at(params.reference, t)
    measurements = measure(loop, params, plant, references)
    disturbances = []
    for i, model in enumerate(loop.disturbance):
        sigma = tracking_error(measurements[i], references[i], params.controller[i].l0).sigma
        disturbances.append(model.value(params.disturbance[i], input_states[i], measurements[i], sigma, t))
    # disturbances at named inputs belong to no channel: they get the signals of the first
    first_sigma = tracking_error(measurements[0], references[0], params.controller[0].l0).sigma
    inputs = []
    for model, p, state in zip(loop.inputs, params.inputs, input_states[len(loop.disturbance) :], strict=True):
        inputs.append(model.value(p, state, measurements[0], first_sigma, t))
    wind_velocity = loop.wind.value(params.wind, wind, t)
    return PlantInput(actuation, tuple(disturbances), wind_velocity, tuple(inputs), condition)
