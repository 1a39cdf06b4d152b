"""A chirp: a sine whose frequency moves from one value to another.

In units, y stands for the unit of the plant's output.

Reference:
    L. Ljung, System Identification: Theory for the User, 2nd ed. (1999), section 13.3.
"""

import math
from enum import StrEnum
from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Reference
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import ReferencePoint, Scalar
from dssc_jax.models.references.steps import AT, BASELINE, has_reached


class Spacing(StrEnum):
    """Whether a chirp's frequency changes by equal amounts or by equal factors in equal times."""

    LINEAR = "linear"
    LOGARITHMIC = "logarithmic"


class ChirpParams(NamedTuple):
    """A chirp y_m = offset + amplitude sin(phase), which begins at the time ``at``.

    The frequency moves from ``start`` to ``end`` within ``duration``, and then stays at ``end``.
    """

    amplitude: Annotated[Scalar, Quantity("y", "amplitude")]
    start: Annotated[Scalar, Quantity("Hz", "first frequency", above=0.0)]
    end: Annotated[Scalar, Quantity("Hz", "last frequency", above=0.0)]
    duration: Annotated[Scalar, Quantity("s", "time from the first to the last frequency", above=0.0)]
    at: Annotated[Scalar, AT] = 0.0
    offset: Annotated[Scalar, BASELINE] = 0.0


class Phase(NamedTuple):
    """Phase of a chirp and its derivatives: ``angle`` [rad], ``rate`` [rad/s] and ``sweep`` [rad/s^2]."""

    angle: Scalar
    rate: Scalar
    sweep: Scalar


def linear_sweep(params: ChirpParams, elapsed: Scalar) -> Phase:
    """The phase with a frequency that changes by equal amounts in equal times.

    Args:
        params: The chirp.
        elapsed: Time since the start of the chirp [s], at most its duration.
    """
    slope = (params.end - params.start) / params.duration
    angle = math.tau * elapsed * (params.start + 0.5 * slope * elapsed)
    rate = math.tau * (params.start + slope * elapsed)
    return Phase(angle, rate, math.tau * slope)


def logarithmic_sweep(params: ChirpParams, elapsed: Scalar) -> Phase:
    """The phase with a frequency that changes by equal factors in equal times.

    The frequency f_0 e^x with x = growth t has the mean f_0 (e^x - 1)/x over the time t. Near x = 0 numerator and
    denominator vanish, and 1 + x/2 stands for the quotient. Arguments are as for :func:`linear_sweep`.
    """
    growth = jnp.log(params.end / params.start) / params.duration
    exponent = growth * elapsed
    small = jnp.abs(exponent) < 1e-6
    mean = jnp.where(small, 1.0 + 0.5 * exponent, jnp.expm1(exponent) / jnp.where(small, 1.0, exponent))
    rate = math.tau * params.start * jnp.exp(exponent)
    return Phase(math.tau * params.start * elapsed * mean, rate, growth * rate)


def chirp(spacing: Spacing) -> Reference:
    """Make the chirp whose frequency changes by equal amounts or by equal factors in equal times."""
    sweep_phase = linear_sweep if spacing is Spacing.LINEAR else logarithmic_sweep

    def at(params: ChirpParams, t: Scalar) -> ReferencePoint:
        """The chirp and its derivatives at t [s]; before the chirp begins, the constant offset."""
        elapsed = jnp.maximum(t - params.at, 0.0)
        sweep_time = jnp.minimum(elapsed, params.duration)
        angle, rate, sweep = sweep_phase(params, sweep_time)
        angle = angle + math.tau * params.end * (elapsed - sweep_time)  # after the sweep, at the last frequency
        amplitude = jnp.where(has_reached(t, params.at), params.amplitude, 0.0)
        sweep = jnp.where(elapsed < params.duration, sweep, 0.0)
        sine = amplitude * jnp.sin(angle)
        cosine = amplitude * jnp.cos(angle)
        return ReferencePoint(params.offset + sine, rate * cosine, sweep * cosine - rate * rate * sine)

    return Reference(ChirpParams, at, level=lambda params: params.offset, last_change=lambda params: math.inf)


CHIRP = Entry(
    {spacing: chirp(spacing) for spacing in Spacing},
    "a sine whose frequency moves from one value to another",
    "spacing",
    Spacing.LOGARITHMIC,
    example={"amplitude": 0.1, "start": 0.5, "end": 2.0, "duration": 1.0},
)
