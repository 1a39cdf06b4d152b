"""Test signals as desired outputs, with their first two derivatives: step, ramp, pulse train, chirp, multisine.

A step and a pulse train have no derivatives at their edges. There, y_m' and y_m'' are those on the right: a controller
that uses them sees a change of y_m and no impulse.

References:
    L. Ljung, System Identification: Theory for the User, 2nd ed. (1999), section 13.3 (chirps and multisines).
    M. R. Schroeder, Synthesis of low-peak-factor signals and binary sequences with low autocorrelation, IEEE Trans.
    Information Theory 16 (1970).
"""

import math
from enum import StrEnum
from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Reference
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity, extent
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import ReferencePoint, Scalar

AT = Quantity("s", "time at which it begins", at_least=0.0)
BASELINE = Quantity("y", "value before it begins")
FREQUENCY = "Hz"


def reached(t: Scalar, at: Scalar) -> Scalar:
    """Whether t >= at, up to the rounding of t = k T_s."""
    return t >= at - 4.0 * jnp.finfo(jnp.result_type(float)).eps * jnp.abs(t)


class StepReferenceParams(NamedTuple):
    """y_m = offset before ``at``, and offset + size from then on."""

    size: Annotated[Scalar, Quantity("y", "size of the step")]
    at: Annotated[Scalar, AT] = 0.0
    offset: Annotated[Scalar, BASELINE] = 0.0


def step_at(params: StepReferenceParams, t: Scalar) -> ReferencePoint:
    """The step at t."""
    return ReferencePoint(params.offset + jnp.where(reached(t, params.at), params.size, 0.0), 0.0, 0.0)


class RampParams(NamedTuple):
    """A ramp from ``at``, for ``rise`` seconds; without ``rise``, it does not end."""

    slope: Annotated[Scalar, Quantity("y/s", "slope")]
    at: Annotated[Scalar, AT] = 0.0
    rise: Annotated[Scalar | None, Quantity("s", "duration of the ramp", above=0.0)] = None
    offset: Annotated[Scalar, BASELINE] = 0.0


def ramp_at(params: RampParams, t: Scalar) -> ReferencePoint:
    """The ramp at t."""
    elapsed = jnp.maximum(t - params.at, 0.0)
    rising = reached(t, params.at)
    if params.rise is not None:
        rising = rising & jnp.logical_not(reached(t, params.at + params.rise))
        elapsed = jnp.minimum(elapsed, params.rise)
    return ReferencePoint(params.offset + params.slope * elapsed, jnp.where(rising, params.slope, 0.0), 0.0)


class PulseParams(NamedTuple):
    """A train of rectangular pulses from ``at``, each ``width`` long, one every ``period``."""

    size: Annotated[Scalar, Quantity("y", "size of a pulse")]
    period: Annotated[Scalar, Quantity("s", "time from one pulse to the next", above=0.0)]
    width: Annotated[Scalar, Quantity("s", "duration of a pulse", above=0.0)]
    at: Annotated[Scalar, AT] = 0.0
    offset: Annotated[Scalar, BASELINE] = 0.0


def pulse_at(params: PulseParams, t: Scalar) -> ReferencePoint:
    """The pulse train at t."""
    rounding = 8.0 * jnp.finfo(jnp.result_type(float)).eps * jnp.abs(t)
    elapsed = t - params.at + rounding
    phase = elapsed - params.period * jnp.floor(elapsed / params.period)
    on = (elapsed >= 0.0) & (phase < params.width)
    return ReferencePoint(params.offset + jnp.where(on, params.size, 0.0), 0.0, 0.0)


def prepare_pulse(params: PulseParams) -> PulseParams:
    """Require that a pulse ends before the next one begins.

    Raises:
        ConfigError: it does not.
    """
    widest, shortest = extent(params.width)[1], extent(params.period)[0]
    if not widest < shortest:
        raise ConfigError("width", f"must be below the period, got up to {widest:g} s and a period of {shortest:g} s")
    return params


class Spacing(StrEnum):
    """How a chirp's frequency moves from its first to its last value."""

    LINEAR = "linear"
    LOGARITHMIC = "logarithmic"


class ChirpParams(NamedTuple):
    """amplitude sin(phase) from ``at``; after ``duration`` the last frequency is kept."""

    amplitude: Annotated[Scalar, Quantity("y", "amplitude")]
    start: Annotated[Scalar, Quantity(FREQUENCY, "first frequency", above=0.0)]
    end: Annotated[Scalar, Quantity(FREQUENCY, "last frequency", above=0.0)]
    duration: Annotated[Scalar, Quantity("s", "time from the first to the last frequency", above=0.0)]
    at: Annotated[Scalar, AT] = 0.0
    offset: Annotated[Scalar, BASELINE] = 0.0


class Phase(NamedTuple):
    """Phase [rad], angular frequency [rad/s] and its rate [rad/s^2]."""

    angle: Scalar
    rate: Scalar
    sweep: Scalar


def linear_phase(params: ChirpParams, elapsed: Scalar) -> Phase:
    """The phase of a frequency that grows by equal amounts in equal times."""
    slope = (params.end - params.start) / params.duration
    turn = 2.0 * math.pi
    return Phase(
        turn * elapsed * (params.start + 0.5 * slope * elapsed), turn * (params.start + slope * elapsed), turn * slope
    )


def logarithmic_phase(params: ChirpParams, elapsed: Scalar) -> Phase:
    """The phase of a frequency that grows by equal factors in equal times; (e^x - 1)/x is 1 + x/2 near x = 0."""
    growth = jnp.log(params.end / params.start) / params.duration
    exponent = growth * elapsed
    small = jnp.abs(exponent) < 1e-6
    mean = jnp.where(small, 1.0 + 0.5 * exponent, jnp.expm1(exponent) / jnp.where(small, 1.0, exponent))
    rate = 2.0 * math.pi * params.start * jnp.exp(exponent)
    return Phase(2.0 * math.pi * params.start * elapsed * mean, rate, growth * rate)


def chirp(spacing: Spacing) -> Reference:
    """The chirp whose frequency moves in the given way."""
    moving = linear_phase if spacing is Spacing.LINEAR else logarithmic_phase

    def at(params: ChirpParams, t: Scalar) -> ReferencePoint:
        elapsed = jnp.maximum(t - params.at, 0.0)
        within = jnp.minimum(elapsed, params.duration)
        angle, rate, sweep = moving(params, within)
        angle = angle + 2.0 * math.pi * params.end * (elapsed - within)
        on = jnp.where(reached(t, params.at), params.amplitude, 0.0)
        sweep = jnp.where(elapsed < params.duration, sweep, 0.0)
        sine, cosine = on * jnp.sin(angle), on * jnp.cos(angle)
        return ReferencePoint(params.offset + sine, rate * cosine, sweep * cosine - rate * rate * sine)

    return Reference(ChirpParams, at)


class MultisineParams(NamedTuple):
    """The sum of a_k sin(2 pi f_k t + phi_k). Without phases, Schroeder's keep the peak low for equal amplitudes."""

    amplitudes: Annotated[tuple[Scalar, ...], Quantity("y", "amplitude of each sine")]
    frequencies: Annotated[tuple[Scalar, ...], Quantity(FREQUENCY, "frequency of each sine", above=0.0)]
    phases: Annotated[tuple[Scalar, ...] | None, Quantity("rad", "phase of each sine")] = None
    offset: Annotated[Scalar, Quantity("y", "mean value")] = 0.0


def multisine_at(params: MultisineParams, t: Scalar) -> ReferencePoint:
    """The multisine at t."""
    y, y_dot, y_ddot = params.offset, 0.0, 0.0
    assert params.phases is not None  # prepare has set them
    for amplitude, frequency, phase in zip(params.amplitudes, params.frequencies, params.phases, strict=True):
        rate = 2.0 * math.pi * frequency
        angle = rate * t + phase
        swing = amplitude * jnp.sin(angle)
        y, y_dot, y_ddot = y + swing, y_dot + amplitude * rate * jnp.cos(angle), y_ddot - rate * rate * swing
    return ReferencePoint(y, y_dot, y_ddot)


def prepare_multisine(params: MultisineParams) -> MultisineParams:
    """Require lists of one length, and set Schroeder's phases -k (k - 1) pi/n if none are given.

    Raises:
        ConfigError: the lists are empty, or of different lengths.
    """
    count = len(params.amplitudes)
    phases = params.phases
    if phases is None:
        phases = tuple(-math.pi * ((k * (k - 1)) % (2 * count)) / count for k in range(1, count + 1))
    for name, values in (("frequencies", params.frequencies), ("phases", phases)):
        if not count or len(values) != count:
            raise ConfigError(name, f"must hold one number for each of the amplitudes, {count}, got {len(values)}")
    return params._replace(phases=phases)


STEP_REFERENCE = Reference(StepReferenceParams, step_at)
RAMP_REFERENCE = Reference(RampParams, ramp_at)
PULSES = Reference(PulseParams, pulse_at, prepare_pulse)
MULTISINE = Reference(MultisineParams, multisine_at, prepare_multisine)
CHIRP = Entry(
    {spacing: chirp(spacing) for spacing in Spacing},
    "a sine whose frequency moves from one value to another",
    "spacing",
    Spacing.LOGARITHMIC,
)
