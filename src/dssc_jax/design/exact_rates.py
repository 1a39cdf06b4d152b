"""Check whether a controller sees a disturbance at once, in an exact y' that no sensor gives."""

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.loop import LoopParams
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.quantities import nominal
from dssc_jax.core.signals import Measurement, PlantInput, ReferencePoint, Scalar, Signals
from dssc_jax.models.disturbances import NO_DISTURBANCE
from dssc_jax.study import Study

RATES = (1e-3, -1e-3, 1.0, -1.0, 1e3, -1e3)
"""Values of y' [unit of y/s] in the trials that show whether a sensor passes y' on and a controller takes it."""


def exact_rates(study: Study) -> tuple[str, ...]:
    """Names of the channels whose y' contains a disturbance and reaches the controller unchanged.

    Such a controller sees the disturbance at once. A real loop that does not measure y' performs worse.

    Args:
        study: The study; uncertain numbers have their median values.
    """
    loop = study.loop
    template = jax.tree.map(lambda leaf: leaf if np.ndim(leaf) else nominal(leaf), study.template)  # records: arrays
    is_acting = np.array([model != NO_DISTURBANCE for model in (*loop.disturbance, *loop.inputs)])
    if not is_acting.any():
        return ()
    slopes = rate_slopes(study, template)
    exact_channels = []
    for i, name in enumerate(loop.channels):
        has_no_differentiator = not template.differentiator[i]
        contains_disturbance = bool(np.any(slopes[i, is_acting] != 0.0))
        if (
            has_no_differentiator
            and shows_rate(study, template, i)
            and contains_disturbance
            and takes_rate(study, template, i)
        ):
            exact_channels.append(name)
    return tuple(exact_channels)


def rate_slopes(study: Study, template: LoopParams) -> np.ndarray:
    """Derivatives of the plant's y' with respect to the disturbances at the plant's start.

    Args:
        study: The study.
        template: Parameters of the loop, without laws.

    Returns:
        Matrix of shape (channels, channels + inputs); its columns belong to the disturbances at the commands, then to
        those at the named inputs.
    """
    loop = study.loop
    plant = loop.mimo_plant
    channel_count = len(loop.channels)
    zeros: Signals = (0.0,) * channel_count
    with jax.enable_x64(True):
        state = plant.init(template.plant)

        def rates(disturbances: jax.Array) -> jax.Array:
            """The y' of every channel, shape (channels,), with these disturbances and no command."""
            at_commands = tuple(disturbances[:channel_count])
            at_inputs = tuple(disturbances[channel_count:])
            drive: PlantInput[Signals] = PlantInput(zeros, disturbance=at_commands, wind=None, inputs=at_inputs)
            measurements = plant.measure(template.plant, state, drive)
            return jnp.stack([jnp.asarray(measurement.y_dot, jnp.float64) for measurement in measurements])

        return np.asarray(jax.jacfwd(rates)(jnp.zeros(channel_count + len(loop.inputs))))


def shows_rate(study: Study, template: LoopParams, channel: int) -> bool:
    """Whether a channel's sensor passes y' on unchanged: in a trial, it returns each jump of y' at once and exactly.

    Args:
        study: The study.
        template: Parameters of the loop, without laws.
        channel: Index of the channel.
    """
    sensor = study.loop.sensor[channel]
    params = template.sensor[channel]
    key = jax.random.key(0)
    with arithmetic(study.config.loop.precision):
        state = sensor.init(params, Measurement(0.0, 0.0), key)
        for rate in RATES:
            _, sensor_output = sensor.step(params, state, Measurement(0.0, rate), key, 0.0, study.loop.sample_time)
            if float(sensor_output.y_dot) != rate:
                return False
    return True


def takes_rate(study: Study, template: LoopParams, channel: int) -> bool:
    """Whether a channel's controller takes y', by its declaration or by a trial.

    The trial compares the states and commands of the first two samples at several values of y' with those at y' = 0.

    Args:
        study: The study.
        template: Parameters of the loop, without laws.
        channel: Index of the channel.
    """
    controller = study.loop.controller[channel]
    if controller.takes_rate is not None:
        return controller.takes_rate
    gains = template.controller[channel]
    dt = study.loop.sample_time
    origin = ReferencePoint(0.0, 0.0, 0.0)
    signals = (0.0,) * int(controller.takes(gains))

    def two_samples(rate: float) -> list[Scalar]:
        """State after the first sample, and commands of the first two samples, at a constant y'."""
        measurement = Measurement(0.0, rate, signals)
        state, command, _ = controller.step(gains, controller.init(gains, measurement, origin), measurement, origin, dt)
        _, second_command, _ = controller.step(gains, state, measurement, origin, dt)
        return [float(leaf) for leaf in jax.tree.leaves((state, command, second_command))]

    with arithmetic(study.config.loop.precision):  # native code takes numbers of one precision
        at_rest = two_samples(0.0)
        return any(two_samples(rate) != at_rest for rate in RATES)


def rate_warning(study: Study) -> str | None:
    """A warning in one sentence if a controller sees a disturbance at once in an exact y'; None otherwise."""
    channels = exact_rates(study)
    if not channels:
        return None
    has_one_channel = channels == ("",)
    place = "" if has_one_channel else f" in {', '.join(channels)}"
    return (
        f"y' contains the disturbance itself{place}, and an exact y' shows it at once, which flatters "
        "the loop; if y' is not measured, add a [differentiator], and if it is, a [sensor]"
    )
