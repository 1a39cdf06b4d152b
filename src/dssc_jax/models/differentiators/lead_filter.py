"""A filtered derivative, s y/(tau_f s + 1)."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Differentiator
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Measurement, Scalar
from dssc_jax.core.smoothness import SMOOTH

TAU_F = Quantity("s", "time constant tau_f of the lead filter", above=0.0)


class LeadFilterParams(NamedTuple):
    """The time constant of the filter s/(tau_f s + 1), whose output for the input y estimates y'."""

    tau_f: Annotated[Scalar, TAU_F]


class LeadFilterState(NamedTuple):
    """The last sample of y [y], and the filter's output ``velocity`` v, the estimate of y' [y/s]."""

    y: Scalar
    velocity: Scalar


def lead_filter_init(params: LeadFilterParams, measurement: Measurement) -> LeadFilterState:
    """The filter at the first measurement: its output is zero, as if y had been constant before.

    The velocity of the measurement is ignored.
    """
    return LeadFilterState(measurement.y, 0.0)


def lead_filter_step(
    params: LeadFilterParams, state: LeadFilterState, measurement: Measurement, dt: Scalar
) -> tuple[LeadFilterState, Measurement]:
    """Exact solution of tau_f v' = y' - v over dt, for y linear between the samples.

    The filter's output v estimates y'. The exact solution moves v towards the slope of y by the share 1 -
    exp(-dt/tau_f).
    """
    share = -jnp.expm1(-dt / params.tau_f)
    slope = (measurement.y - state.y) / dt
    velocity = state.velocity + share * (slope - state.velocity)
    return LeadFilterState(measurement.y, velocity), Measurement(measurement.y, velocity)


LEAD_FILTER = Differentiator(LeadFilterParams, lead_filter_init, lead_filter_step, smooth=SMOOTH)
