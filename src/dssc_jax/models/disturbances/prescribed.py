"""Disturbances prescribed over time: constant, step, sine, spline.

In units, u stands for the unit of the command.
"""

import math
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.contracts import Disturbance, Variation
from dssc_jax.core.default_functions import stateless, unchanged, unchanging
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import cubic_spline, elapsed_share, spline_end
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Measurement, Params, Scalar, State
from dssc_jax.core.smoothness import SMOOTH

VALUE = Quantity("u", "value of d")


class ConstantParams(NamedTuple):
    """The value of a constant disturbance."""

    value: Annotated[Scalar, VALUE]


class StepParams(NamedTuple):
    """A step of height ``value`` at the time ``at``."""

    value: Annotated[Scalar, VALUE]
    at: Annotated[Scalar, Quantity("s", "time of the step", at_least=0.0, begins=True)] = 0.0


class SineDisturbanceParams(NamedTuple):
    """The sine d = amplitude sin(2 pi t/period + phase)."""

    amplitude: Annotated[Scalar, Quantity("u", "amplitude")]
    period: Annotated[Scalar, Quantity("s", "period", above=0.0)]
    phase: Annotated[Scalar, Quantity("rad", "phase")] = 0.0


class SplineParams(NamedTuple):
    """A cubic spline with knots ``interval`` apart, the first at the time ``at``.

    With the cubic B-spline B it is d = sum of knots[i] B((t - at)/interval - i), which can approximate any signal of
    bounded amplitude and slope. |d| is at most the largest |knot|, and |d'| at most the largest difference of
    consecutive knots divided by the interval. The spline begins at 0 two intervals before the first knot, and ends at 0
    two intervals after the last knot.
    """

    knots: Annotated[tuple[Scalar, ...], Quantity("u", "coefficient of the spline at a knot")]
    interval: Annotated[Scalar, Quantity("s", "time between two knots", above=0.0)]
    at: Annotated[Scalar, Quantity("s", "time of the first knot", begins=True)] = 0.0


def held_value(params: Params, state: Scalar, measurement: Measurement, sigma: Scalar, t: Scalar) -> Scalar:
    """The disturbance over the present sample [u], which the state holds.

    The other arguments are those of every disturbance; a held one does not need them.
    """
    return state


def step_mean(params: StepParams, state: Scalar, key: jax.Array, t: Scalar, dt: Scalar) -> Scalar:
    """Mean of the step over the sample [t, t + dt) [u], which the plant gets in place of a jump within the sample.

    The integral of the disturbance is therefore exact at all samples. ``state`` and ``key`` are not used, because the
    step neither remembers anything nor is random.
    """
    return params.value * elapsed_share(params.at, t, dt)


def sine_value(
    params: SineDisturbanceParams, state: State, measurement: Measurement, sigma: Scalar, t: Scalar
) -> Scalar:
    """The sine [u] at t [s].

    The sine depends on the time alone; the other arguments are those of every disturbance.
    """
    return params.amplitude * jnp.sin(2.0 * math.pi / params.period * t + params.phase)


def check_knots(params: SplineParams) -> SplineParams:
    """The parameters themselves, which must have at least one knot.

    Raises:
        ConfigError: There is no knot.
    """
    if not params.knots:
        raise ConfigError("knots", "needs at least one knot, got none")
    return params


def spline_value(params: SplineParams, state: tuple[()], measurement: Measurement, sigma: Scalar, t: Scalar) -> Scalar:
    """The spline [u] at t [s].

    The spline depends on the time alone; the other arguments are those of every disturbance.
    """
    return cubic_spline(params.knots, (t - params.at) / params.interval)


CONSTANT = Disturbance(
    ConstantParams,
    stateless,
    unchanged,
    lambda params, state, measurement, sigma, t: params.value,
    variation=Variation.HELD,
    smooth=SMOOTH,
    last_change=unchanging,
)
STEP = Disturbance(
    params=StepParams,
    init=lambda params, key: 0.0,
    step=step_mean,
    value=held_value,
    variation=Variation.HELD,
    smooth=SMOOTH,
    last_change=unchanging,
)
SINE_DISTURBANCE = Disturbance(
    params=SineDisturbanceParams,
    init=stateless,
    step=unchanged,
    value=sine_value,
    variation=Variation.TIME,
    smooth=SMOOTH,
    last_change=lambda params: params.period,
)
SPLINE = Disturbance(
    params=SplineParams,
    init=stateless,
    step=unchanged,
    value=spline_value,
    prepare=check_knots,
    variation=Variation.TIME,
    smooth=SMOOTH,
    last_change=lambda params: spline_end(params.at, params.interval, len(params.knots)),
)
