"""State feedback with integral action about an operating point (y_0, u_0, s_0), by default 0:

    u = u_0 - k_1 (y - y_m) - k_2 (y' - y_m') - k (s - s_0) + f (y_m - y_0) - k_i int (y - y_m) dt.

Without measured signals s the controller feeds back y and y', which the class (5)-(8) measures; for n = 2 this is the
plant's whole state. With ``measures = "state"``, s is the whole state of a linear plant of any order. The PID
controller has the same limits and the same anti-windup.

In units, y stands for the unit of the plant's output, and u for the unit of its command.

References:
    K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed. (2021), section 7.4.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Controller
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import difference, dot, is_zero
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry, single
from dssc_jax.core.signals import Command, Measurement, ReferencePoint, Scalar
from dssc_jax.models.controllers.command_limits import (
    HIGH,
    LOW,
    smooth_within_limits,
    tracking_rate,
    within_limits,
)
from dssc_jax.models.controllers.nominal import L0
from dssc_jax.models.controllers.operating_point import (
    RESTING_COMMAND,
    RESTING_OUTPUT,
    RESTING_SIGNALS,
    deviations,
    require_resting,
)


class FeedbackGains(NamedTuple):
    """Gains of the state feedback, limits of u, and the operating point about which it acts.

    ``l0`` defines sigma of the metrics; the controller does not use it.
    """

    k_1: Annotated[Scalar, Quantity("u/y", "gain k_1 of the output", at_least=0.0)] = 0.0
    k_2: Annotated[Scalar, Quantity("u s/y", "gain k_2 of the output's derivative", at_least=0.0)] = 0.0
    k_i: Annotated[Scalar, Quantity("u/(y s)", "integral gain k_i", at_least=0.0)] = 0.0
    low: Annotated[Scalar | None, LOW] = None
    high: Annotated[Scalar | None, HIGH] = None
    tracking: Annotated[Scalar | None, Quantity("s", "time constant T_t of the anti-windup", above=0.0)] = None
    signals: Annotated[tuple[Scalar, ...], Quantity("SI", "gain k of each measured signal")] = ()
    feedforward: Annotated[Scalar, Quantity("u/y", "gain f of the desired output y_m - y_0")] = 0.0
    resting_output: Annotated[Scalar, RESTING_OUTPUT] = 0.0
    resting_command: Annotated[Scalar, RESTING_COMMAND] = 0.0
    resting_signals: Annotated[tuple[Scalar, ...], RESTING_SIGNALS] = ()
    l0: Annotated[Scalar, L0] = 1.0


class FeedbackState(NamedTuple):
    """The integral part of the command [u]."""

    integral: Scalar


class FeedbackInfo(NamedTuple):
    """What the controller reports at each sample: the integral part of the command."""

    integral: Annotated[Scalar, Quantity("u", "integral term of u")]


def init(gains: FeedbackGains, measurement: Measurement, reference: ReferencePoint) -> FeedbackState:
    """The state at the first sample: the integral part of the command is 0.

    The controller does not use the first measurement and reference.
    """
    return FeedbackState(0.0)


def proportional_part(gains: FeedbackGains, measurement: Measurement, reference: ReferencePoint) -> Scalar:
    """-(u - its integral part): k_1 (y - y_m) + k_2 (y' - y_m') + k (s - s_0) - f (y_m - y_0) - u_0.

    The command is its integral part minus this number. A term that is known to be 0 before tracing is left out of the
    program.
    """
    total = gains.k_1 * (measurement.y - reference.y) + gains.k_2 * (measurement.y_dot - reference.y_dot)
    if gains.signals:
        total = total + dot(gains.signals, deviations(measurement.signals, gains.resting_signals))
    if not is_zero(gains.feedforward):
        total = total - gains.feedforward * difference(reference.y, gains.resting_output)
    return difference(total, gains.resting_command)


def step(
    gains: FeedbackGains, state: FeedbackState, measurement: Measurement, reference: ReferencePoint, dt: Scalar
) -> tuple[FeedbackState, Command, FeedbackInfo]:
    """One sample of the state feedback; the integral takes the error of this sample from the next one on.

    ``v`` is the command before its limits, and ``u`` the command. At a limit the difference u - v moves the integral
    back, so that the integral does not wind up.
    """
    error = measurement.y - reference.y
    v = state.integral - proportional_part(gains, measurement, reference)
    u = within_limits(v, gains.low, gains.high)
    integral = state.integral - dt * gains.k_i * error
    if gains.low is not None or gains.high is not None:
        integral = integral + dt * tracking_rate(gains.k_1, gains.k_i, gains.tracking, dt) * (u - v)
    return FeedbackState(integral), Command(robust=u, nominal=0.0), FeedbackInfo(state.integral)


def transfer(
    gains: FeedbackGains, measurement: Measurement, reference: ReferencePoint, command: Scalar, dt: Scalar
) -> FeedbackState:
    """The integral part that leaves the command as it is; 0 without integral action.

    With integral action, and within the limits, the first step from the returned state gives the command, for a
    bumpless start. ``dt`` is not used, because the integral part of a sample does not include its own error.
    """
    needed = command + proportional_part(gains, measurement, reference)
    return FeedbackState(jnp.where(gains.k_i > 0.0, needed, 0.0))


def prepare(gains: FeedbackGains) -> FeedbackGains:
    """The gains themselves, which must feed something back, with fitting lengths.

    Raises:
        ConfigError: A condition does not hold.
    """
    require_resting(gains.resting_signals, len(gains.signals))
    if is_zero(gains.k_1) and is_zero(gains.k_2) and not gains.signals:
        raise ConfigError("k_1", "must not be zero with k_2 and without signals: nothing would be fed back")
    return gains


STATE_FEEDBACK: Entry = single(
    Controller(
        gains=FeedbackGains,
        init=init,
        step=step,
        prepare=prepare,
        transfer=transfer,
        smooth=smooth_within_limits(init, step),
        takes=lambda gains: len(gains.signals),
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
