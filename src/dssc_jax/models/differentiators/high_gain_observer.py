"""A high-gain observer of y and y'.

Reference:
    H. K. Khalil, L. Praly, "High-gain observers in nonlinear feedback control", Int. J. Robust and Nonlinear
    Control 24 (2014).
"""

from typing import Annotated, NamedTuple

from dssc_jax.core.contracts import Differentiator
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Measurement, Scalar
from dssc_jax.core.smoothness import SMOOTH

EPSILON = Quantity("s", "time constant epsilon of the high-gain observer", above=0.0)
ALPHA_1 = Quantity("1", "alpha_1 of the high-gain observer", above=0.0)
ALPHA_2 = Quantity("1", "alpha_2 of the high-gain observer", above=0.0)


class HighGainParams(NamedTuple):
    """Time constant and gains of the observer x1' = x2 + (alpha_1/epsilon)(y - x1), x2' = (alpha_2/epsilon^2)(y - x1).

    x1 estimates y, and x2 estimates y'. The transfer function from y to x2 is
    s/((epsilon s)^2/alpha_2 + (alpha_1/alpha_2) epsilon s + 1). The default gains, which are assumed, give it the
    double pole -1/epsilon.
    """

    epsilon: Annotated[Scalar, EPSILON]
    alpha1: Annotated[Scalar, ALPHA_1] = 2.0
    alpha2: Annotated[Scalar, ALPHA_2] = 1.0


class HighGainState(NamedTuple):
    """The observer's estimates x1 of y [y] and x2 of y' [y/s]."""

    x1: Scalar
    x2: Scalar


def high_gain_init(params: HighGainParams, measurement: Measurement) -> HighGainState:
    """The observer at the first measurement: at y, with velocity zero.

    The velocity of the measurement is ignored.
    """
    return HighGainState(measurement.y, 0.0)


def high_gain_step(
    params: HighGainParams, state: HighGainState, measurement: Measurement, dt: Scalar
) -> tuple[HighGainState, Measurement]:
    """Backward Euler, solved for the innovation y - x1+; tends to the backward difference for dt >> epsilon.

    The equation is multiplied by epsilon^2, so that nothing is divided by a small epsilon; ``scaled`` is the innovation
    over epsilon^2.
    """
    first = dt * params.alpha1 * params.epsilon
    second = dt * dt * params.alpha2
    square = params.epsilon * params.epsilon
    scaled = (measurement.y - state.x1 - dt * state.x2) / (square + first + second)
    velocity = state.x2 + dt * params.alpha2 * scaled
    return HighGainState(measurement.y - square * scaled, velocity), Measurement(measurement.y, velocity)


HIGH_GAIN_OBSERVER = Differentiator(HighGainParams, high_gain_init, high_gain_step, smooth=SMOOTH)
