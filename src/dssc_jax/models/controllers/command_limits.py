"""Limits ``low`` and ``high`` of a controller's command, which several laws have in common.

In units, u stands for the unit of the command.
"""

from collections.abc import Callable

import jax.numpy as jnp

from dssc_jax.core.contracts import Controller
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Params, Scalar
from dssc_jax.core.smoothness import SMOOTH, Smoothness, piecewise

LOW = Quantity("u", "lower limit of the command", less_than="high")
HIGH = Quantity("u", "upper limit of the command")


def within_limits(v: Scalar, low: Scalar | None, high: Scalar | None) -> Scalar:
    """The command within its limits [u]; None: no limit on this side.

    Args:
        v: The command before its limits [u].
        low: Lower limit [u], or None.
        high: Upper limit [u], or None.
    """
    v = v if low is None else jnp.maximum(v, low)
    return v if high is None else jnp.minimum(v, high)


def tracking_rate(proportional: Scalar, integral: Scalar, tracking: Scalar | None, dt: Scalar) -> Scalar:
    """1/T_t [1/s], at most 1/T_s; without a time constant k_i/k_p, or 1/T_s for pure integral control.

    Anti-windup moves the integral at this rate times (u - v), the limited command minus the command before its limits.

    Args:
        proportional: k_p.
        integral: k_i.
        tracking: Time constant T_t of the anti-windup [s]; None: it follows from the gains.
        dt: T_s [s].
    """
    if tracking is not None:
        return 1.0 / jnp.maximum(tracking, dt)
    ratio = integral / jnp.where(proportional > 0.0, proportional, 1.0)
    return jnp.where(proportional > 0.0, jnp.minimum(ratio, 1.0 / dt), 1.0 / dt)


def smooth_within_limits(init: Callable, step: Callable) -> Callable[[Params], Smoothness]:
    """Make the function that declares where a law with limits of its command has a derivative.

    Args:
        init: The law's first state, as in its contract.
        step: The law's sample, as in its contract.

    Returns:
        The function from gains with ``low`` and ``high`` to their declaration. Without limits the law is smooth. With
        them it is piecewise smooth, and the same law without limits is linearised at a limit.
    """

    def without_limits(gains: Params) -> tuple[Controller, Params]:
        """The same law without limits, and its gains."""
        return Controller(type(gains), init, step), gains._replace(low=None, high=None)

    def smoothness(gains: Params) -> Smoothness:
        """Where the law with these gains has a derivative."""
        if gains.low is None and gains.high is None:
            return SMOOTH
        return piecewise("the limits low and high of its command; there it counts as within them", without_limits)

    return smoothness
