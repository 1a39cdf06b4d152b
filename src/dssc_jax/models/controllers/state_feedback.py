"""State feedback with integral action, u = -k_1 (y - y_m) - k_2 (y' - y_m') - k_i int (y - y_m) dt.

The state is (y, y'), what the class (5)-(8) measures; with n = 2 it is the plant's whole state. Limits and anti-windup
are those of the PID controller.

References:
    K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed. (2021), section 7.4.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Controller
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry, single
from dssc_jax.core.signals import Command, Measurement, ReferencePoint, Scalar
from dssc_jax.models.controllers.nominal import L0
from dssc_jax.models.controllers.pid import HIGH, LOW, limited_smoothness, require_order, tracking_rate, within_limits


class FeedbackGains(NamedTuple):
    """Gains of the state feedback; ``l0`` defines sigma of the metrics and is not used by the controller."""

    k_1: Annotated[Scalar, Quantity("u/y", "gain k_1 of the output", at_least=0.0)]
    k_2: Annotated[Scalar, Quantity("u s/y", "gain k_2 of the output's derivative", at_least=0.0)]
    k_i: Annotated[Scalar, Quantity("u/(y s)", "integral gain k_i", at_least=0.0)] = 0.0
    low: Annotated[Scalar | None, LOW] = None
    high: Annotated[Scalar | None, HIGH] = None
    tracking: Annotated[Scalar | None, Quantity("s", "time constant T_t of the anti-windup", above=0.0)] = None
    l0: Annotated[Scalar, L0] = 1.0


class FeedbackState(NamedTuple):
    """The integral part of the command."""

    integral: Scalar


class FeedbackInfo(NamedTuple):
    """The integral part of the command."""

    integral: Annotated[Scalar, Quantity("u", "integral term of u")]


def init(gains: FeedbackGains, measurement: Measurement, reference: ReferencePoint) -> FeedbackState:
    """No integral."""
    return FeedbackState(0.0)


def step(
    gains: FeedbackGains, state: FeedbackState, measurement: Measurement, reference: ReferencePoint, dt: Scalar
) -> tuple[FeedbackState, Command, FeedbackInfo]:
    """One sample of the state feedback; the integral takes the error of this sample from the next one on."""
    error = measurement.y - reference.y
    v = state.integral - gains.k_1 * error - gains.k_2 * (measurement.y_dot - reference.y_dot)
    u = within_limits(v, gains.low, gains.high)
    integral = state.integral - dt * gains.k_i * error
    if gains.low is not None or gains.high is not None:
        integral = integral + dt * tracking_rate(gains.k_1, gains.k_i, gains.tracking, dt) * (u - v)
    return FeedbackState(integral), Command(u, 0.0), FeedbackInfo(state.integral)


def transfer(
    gains: FeedbackGains, measurement: Measurement, reference: ReferencePoint, command: Scalar, dt: Scalar
) -> FeedbackState:
    """The integral part that leaves the command as it is; 0 without integral action."""
    error = measurement.y - reference.y
    needed = command + gains.k_1 * error + gains.k_2 * (measurement.y_dot - reference.y_dot)
    return FeedbackState(jnp.where(gains.k_i > 0.0, needed, 0.0))


def prepare(gains: FeedbackGains) -> FeedbackGains:
    """Require limits in order; raises ConfigError."""
    require_order(gains.low, gains.high)
    return gains


def feedback_within_limits(gains: FeedbackGains) -> tuple[Controller, FeedbackGains]:
    """The controller within its limits."""
    return Controller(FeedbackGains, init, step), gains._replace(low=None, high=None)


STATE_FEEDBACK: Entry = single(
    Controller(
        FeedbackGains,
        init,
        step,
        prepare,
        transfer,
        limited_smoothness(feedback_within_limits),
        tunable=("k_1", "k_2"),
        info=FeedbackInfo,
    ),
    "feedback of output and derivative, with integral action",
    k_1=2.0,
    k_2=1.0,
    k_i=0.5,
    low=-9.0,
    tracking=0.4,
)
