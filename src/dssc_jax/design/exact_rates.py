"""Whether a controller sees a disturbance at once, in an exact y' that no sensor gives."""

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
"""Values of y' that a controller is given to see whether it takes y'."""


def exact_rates(study: Study) -> tuple[str, ...]:
    """Channels whose y' contains a disturbance and reaches the controller unchanged.

    Such a controller sees the disturbance at once, which flatters the loop unless y' is measured.

    Args:
        study: The study; uncertain numbers have their median values.
    """
    loop = study.loop
    template = jax.tree.map(lambda leaf: leaf if np.ndim(leaf) else nominal(leaf), study.template)
    channels = len(loop.channels)
    zeros: Signals = (0.0,) * channels
    plant = loop.mimo_plant
    is_acting = np.array([model != NO_DISTURBANCE for model in (*loop.disturbance, *loop.inputs)])
    if not is_acting.any():
        return ()
    exact_channels = []
    with jax.enable_x64(True):
        state = plant.init(template.plant)

        def rates(disturbances: jax.Array) -> jax.Array:
            at_commands, at_inputs = tuple(disturbances[:channels]), tuple(disturbances[channels:])
            measurements = plant.measure(template.plant, state, PlantInput(zeros, at_commands, None, at_inputs))
            return jnp.stack([jnp.asarray(measurement.y_dot, jnp.float64) for measurement in measurements])

        slopes = np.asarray(jax.jacfwd(rates)(jnp.zeros(len(is_acting))))
    for i, name in enumerate(loop.channels):
        is_exact = not template.differentiator[i] and shows_rate(study, template, i)
        if is_exact and np.any(slopes[i, is_acting] != 0.0) and takes_rate(study, template, i):
            exact_channels.append(name)
    return tuple(exact_channels)


def shows_rate(study: Study, template: LoopParams, channel: int) -> bool:
    """Whether a channel's sensor passes y' on unchanged: by trial, a jump of y' arrives at once and in full."""
    sensor, params = study.loop.sensor[channel], template.sensor[channel]
    key = jax.random.key(0)
    with arithmetic(study.config.loop.precision):
        state = sensor.init(params, Measurement(0.0, 0.0), key)
        for rate in RATES:
            _, sensor_output = sensor.step(params, state, Measurement(0.0, rate), key, 0.0, study.loop.sample_time)
            if float(sensor_output.y_dot) != rate:
                return False
    return True


def takes_rate(study: Study, template: LoopParams, channel: int) -> bool:
    """Whether a channel's controller takes y', by its declaration or by trial.

    If it does, its first two samples differ for some of the rates tried.
    """
    controller = study.loop.controller[channel]
    if controller.takes_rate is not None:
        return controller.takes_rate
    gains = template.controller[channel]
    dt = study.loop.sample_time
    origin = ReferencePoint(0.0, 0.0, 0.0)
    signals = (0.0,) * int(controller.takes(gains))

    def two_samples(rate: float) -> list[Scalar]:
        measurement = Measurement(0.0, rate, signals)
        state, command, _ = controller.step(gains, controller.init(gains, measurement, origin), measurement, origin, dt)
        _, second_command, _ = controller.step(gains, state, measurement, origin, dt)
        return [float(leaf) for leaf in jax.tree.leaves((state, command, second_command))]

    with arithmetic(study.config.loop.precision):  # native code has one
        at_rest = two_samples(0.0)
        return any(two_samples(rate) != at_rest for rate in RATES)


def rate_warning(study: Study) -> str | None:
    """One sentence, if a controller sees a disturbance at once in an exact y'."""
    channels = exact_rates(study)
    if not channels:
        return None
    place = f" in {', '.join(channels)}" if any(channels) else ""
    return (
        f"y' contains the disturbance itself{place}, and an exact y' shows it at once, which flatters "
        "the loop; if y' is not measured, add a [differentiator], and if it is, a [sensor]"
    )
