"""The PID controller with filtered derivative, set-point weights, limits and anti-windup by back-calculation.

    v  = k_p (b y_m - y) + I + D,  u = v clipped to [low, high]
    I' = k_i (y_m - y) + (u - v)/T_t
    D  = k_d s/(T_f s + 1) (c y_m - y)

D takes the slope of c y_m - y from one sample to the next, and so amplifies the noise of y. D does not use y', neither
a measured one nor one from a differentiator. A derivative part on y' is in ``state_feedback``.

The integral is sampled by forward Euler, so that I does not depend on the present command. The derivative is sampled by
backward Euler, which is stable for every T_f >= 0.

In units, y stands for the unit of the plant's output, and u for the unit of its command.

References:
    K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed. (2021), sections 11.4 and 11.5.
    K. J. Astrom, T. Hagglund, Advanced PID Control (2006), sections 3.5 and 13.4.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Controller
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

DERIVATIVE_GAIN = "derivative gain, on the slope of c y_m - y from sample to sample, not on a measured y'"


class PidGains(NamedTuple):
    """Gains of the PID controller.

    Without ``tracking``, the time constant T_t of the anti-windup is k_p/k_i, the integral time. ``l0`` defines sigma
    of the metrics; the controller does not use it.
    """

    k_p: Annotated[Scalar, Quantity("u/y", "proportional gain", at_least=0.0)]
    k_i: Annotated[Scalar, Quantity("u/(y s)", "integral gain", at_least=0.0)] = 0.0
    k_d: Annotated[Scalar, Quantity("u s/y", DERIVATIVE_GAIN, at_least=0.0)] = 0.0
    filter: Annotated[Scalar, Quantity("s", "time constant T_f of the derivative's filter", at_least=0.0)] = 0.0
    proportional_weight: Annotated[Scalar, Quantity("1", "set-point weight b of the proportional part")] = 1.0
    derivative_weight: Annotated[Scalar, Quantity("1", "set-point weight c of the derivative part")] = 0.0
    low: Annotated[Scalar | None, LOW] = None
    high: Annotated[Scalar | None, HIGH] = None
    tracking: Annotated[Scalar | None, Quantity("s", "time constant T_t of the anti-windup", above=0.0)] = None
    l0: Annotated[Scalar, L0] = 1.0


class PidState(NamedTuple):
    """Integral part and derivative part of the command [u], and ``weighted`` = c y_m - y at the last sample [y]."""

    integral: Scalar
    derivative: Scalar
    weighted: Scalar


class PidInfo(NamedTuple):
    """The three parts of the command before its limits."""

    proportional: Annotated[Scalar, Quantity("u", "proportional term of u")]
    integral: Annotated[Scalar, Quantity("u", "integral term of u")]
    derivative: Annotated[Scalar, Quantity("u", "derivative term of u")]


def init(gains: PidGains, measurement: Measurement, reference: ReferencePoint) -> PidState:
    """No integral, and a derivative at rest.

    The controller therefore begins as if reference and measurement had been constant before the first sample.
    """
    weighted = gains.derivative_weight * reference.y - measurement.y
    return PidState(integral=0.0, derivative=0.0, weighted=weighted)


def step(
    gains: PidGains, state: PidState, measurement: Measurement, reference: ReferencePoint, dt: Scalar
) -> tuple[PidState, Command, PidInfo]:
    """One sample of the PID controller.

    ``v`` is the command before its limits. ``weighted`` is c y_m - y, whose change since the last sample drives the
    filtered derivative. The integral includes the error of this sample from the next sample on. With limits it also
    includes u - v, the anti-windup.
    """
    proportional = gains.k_p * (gains.proportional_weight * reference.y - measurement.y)
    weighted = gains.derivative_weight * reference.y - measurement.y
    change = gains.k_d * (weighted - state.weighted)
    derivative = (gains.filter * state.derivative + change) / (gains.filter + dt)
    v = proportional + state.integral + derivative
    u = within_limits(v, gains.low, gains.high)
    integral = state.integral + dt * gains.k_i * (reference.y - measurement.y)
    if gains.low is not None or gains.high is not None:
        integral = integral + dt * tracking_rate(gains.k_p, gains.k_i, gains.tracking, dt) * (u - v)
    info = PidInfo(proportional, state.integral, derivative)
    return PidState(integral, derivative, weighted), Command(robust=u, nominal=0.0), info


def transfer(
    gains: PidGains, measurement: Measurement, reference: ReferencePoint, command: Scalar, dt: Scalar
) -> PidState:
    """The integral part that leaves the command as it is, with the derivative at rest; 0 without integral action.

    With integral action, and within the limits, the first step from the returned state gives the command, for a
    bumpless start. ``dt`` is not used, because the integral part of a sample does not include its own error.
    """
    proportional = gains.k_p * (gains.proportional_weight * reference.y - measurement.y)
    integral = jnp.where(gains.k_i > 0.0, command - proportional, 0.0)
    return init(gains, measurement, reference)._replace(integral=integral)


PID: Entry = single(
    Controller(
        gains=PidGains,
        init=init,
        step=step,
        transfer=transfer,
        smooth=smooth_within_limits(init, step),
        tunable=("k_p", "k_i"),
        info=PidInfo,
    ),
    "PID with filtered derivative, set-point weights, limits and anti-windup",
    k_p=2.0,
    k_i=1.0,
    k_d=0.1,
    filter=0.02,
    derivative_weight=0.3,
    low=-0.5,
    high=0.7,
)
