"""Whether a controller sees a disturbance at once, in an exact y' that no sensor gives."""

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.loop import LoopParams
from dssc_jax.core.adapters import quiet_inputs
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.quantities import nominal
from dssc_jax.core.signals import Measurement, PlantInput, ReferencePoint, Scalar, Signals
from dssc_jax.models.disturbances import NO_DISTURBANCE
from dssc_jax.study import Study

RATES = (1e-3, -1e-3, 1.0, -1.0, 1e3, -1e3)
"""Values of y' that a controller is given to see whether it takes y'."""


def exact_rates(study: Study) -> tuple[str, ...]:
    """Channels whose y' contains the disturbance itself and reaches the controller without sensor and differentiator.

    Args:
        study: The study; uncertain numbers have their median values.
    """
    loop = study.loop
    template = jax.tree.map(lambda leaf: leaf if np.ndim(leaf) else nominal(leaf), study.template)
    channels = len(loop.channels)
    zeros: Signals = (0.0,) * channels
    plant = loop.mimo_plant
    found = []
    with jax.enable_x64(True):
        state = plant.init(template.plant)

        def rates(disturbances: jax.Array) -> jax.Array:
            drive: PlantInput[Signals] = PlantInput(
                zeros, tuple(disturbances), None, quiet_inputs(plant, template.plant)
            )
            measurements = plant.measure(template.plant, state, drive)
            return jnp.stack([jnp.asarray(measurement.y_dot, jnp.float64) for measurement in measurements])

        slopes = jax.jacfwd(rates)(jnp.zeros(channels))
    for i, name in enumerate(loop.channels):
        exact = not template.sensor[i] and not template.differentiator[i]
        disturbed = [bool(slopes[i, j]) and loop.disturbance[j] != NO_DISTURBANCE for j in range(channels)]
        if exact and any(disturbed) and takes_rate(study, template, i):
            found.append(name)
    return tuple(found)


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
        measured = Measurement(0.0, rate, signals)
        state, command, _ = controller.step(gains, controller.init(gains, measured, origin), measured, origin, dt)
        _, following, _ = controller.step(gains, state, measured, origin, dt)
        return [float(leaf) for leaf in jax.tree.leaves((state, command, following))]

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
