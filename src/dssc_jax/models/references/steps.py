"""Steps, ramps and pulse trains as desired outputs.

A step and a pulse train have no derivatives at their edges. There y_m' and y_m'' are the derivatives on the right, so
that a controller sees a change of y_m and no impulse.

In units, y stands for the unit of the plant's output.
"""

import math
from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Reference
from dssc_jax.core.default_functions import rise_end, unchanging
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity, extent
from dssc_jax.core.signals import ReferencePoint, Scalar

AT = Quantity("s", "time at which it begins", at_least=0.0, begins=True)
BASELINE = Quantity("y", "value before it begins")


def has_reached(t: Scalar, at: Scalar) -> Scalar:
    """Whether t >= at [s], with a tolerance for the rounding of t = k T_s."""
    return t >= at - 4.0 * jnp.finfo(jnp.result_type(float)).eps * jnp.abs(t)


class StepReferenceParams(NamedTuple):
    """A step: y_m is ``offset`` before the time ``at``, and ``offset + size`` from then on."""

    size: Annotated[Scalar, Quantity("y", "size of the step")]
    at: Annotated[Scalar, AT] = 0.0
    offset: Annotated[Scalar, BASELINE] = 0.0


def step_at(params: StepReferenceParams, t: Scalar) -> ReferencePoint:
    """The step at t [s]; its derivatives are 0."""
    return ReferencePoint(params.offset + jnp.where(has_reached(t, params.at), params.size, 0.0), 0.0, 0.0)


class RampParams(NamedTuple):
    """A ramp that begins at the time ``at`` and lasts for ``rise``; without ``rise`` it does not end."""

    slope: Annotated[Scalar, Quantity("y/s", "slope")]
    at: Annotated[Scalar, AT] = 0.0
    rise: Annotated[Scalar | None, Quantity("s", "duration of the ramp", above=0.0)] = None
    offset: Annotated[Scalar, BASELINE] = 0.0


def ramp_at(params: RampParams, t: Scalar) -> ReferencePoint:
    """The ramp and its slope at t [s]; y_m'' is 0."""
    elapsed = jnp.maximum(t - params.at, 0.0)
    rising = has_reached(t, params.at)
    if params.rise is not None:
        rising = rising & jnp.logical_not(has_reached(t, params.at + params.rise))
        elapsed = jnp.minimum(elapsed, params.rise)
    return ReferencePoint(params.offset + params.slope * elapsed, jnp.where(rising, params.slope, 0.0), 0.0)


class PulseParams(NamedTuple):
    """A train of rectangular pulses from the time ``at`` on: one every ``period``, each ``width`` long."""

    size: Annotated[Scalar, Quantity("y", "size of a pulse")]
    period: Annotated[Scalar, Quantity("s", "time from one pulse to the next", above=0.0)]
    width: Annotated[Scalar, Quantity("s", "duration of a pulse", above=0.0)]
    at: Annotated[Scalar, AT] = 0.0
    offset: Annotated[Scalar, BASELINE] = 0.0


def pulse_at(params: PulseParams, t: Scalar) -> ReferencePoint:
    """The pulse train at t [s]; its derivatives are 0."""
    rounding = 8.0 * jnp.finfo(jnp.result_type(float)).eps * jnp.abs(t)  # of t = k T_s
    elapsed = t - params.at + rounding
    phase = elapsed - params.period * jnp.floor(elapsed / params.period)
    on = (elapsed >= 0.0) & (phase < params.width)
    return ReferencePoint(params.offset + jnp.where(on, params.size, 0.0), 0.0, 0.0)


def prepare_pulse(params: PulseParams) -> PulseParams:
    """The parameters themselves, whose pulses must end before the next ones begin.

    Raises:
        ConfigError: For some values of their laws, the width is not below the period.
    """
    _, widest = extent(params.width)
    shortest, _ = extent(params.period)
    if not widest < shortest:
        raise ConfigError("width", f"must be below the period, got up to {widest:g} s and a period of {shortest:g} s")
    return params


def step_level(params: StepReferenceParams) -> Scalar:
    """The level of the reference: its value after the step."""
    return params.offset + params.size


def ramp_level(params: RampParams) -> Scalar:
    """The level of the reference: its value after the ramp, or the value before it if the ramp does not end."""
    return params.offset + (0.0 if params.rise is None else params.slope * params.rise)


def pulse_level(params: PulseParams) -> Scalar:
    """The level of the reference: its value between the pulses."""
    return params.offset


STEP_REFERENCE = Reference(StepReferenceParams, step_at, level=step_level, last_change=unchanging)
RAMP_REFERENCE = Reference(RampParams, ramp_at, level=ramp_level, last_change=rise_end)
PULSES = Reference(PulseParams, pulse_at, prepare_pulse, level=pulse_level, last_change=lambda params: math.inf)
