"""Limits ``low`` and ``high`` of a controller's command, which several laws have in common."""

from collections.abc import Callable

import jax.numpy as jnp

from dssc_jax.core.contracts import Controller
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity, extent
from dssc_jax.core.signals import Params, Scalar
from dssc_jax.core.smoothness import SMOOTH, Smoothness, piecewise

LOW = Quantity("u", "lower limit of the command")
HIGH = Quantity("u", "upper limit of the command")


def within_limits(v: Scalar, low: Scalar | None, high: Scalar | None) -> Scalar:
    """The command within its limits [u]; None: no limit on this side."""
    v = v if low is None else jnp.maximum(v, low)
    return v if high is None else jnp.minimum(v, high)


def tracking_rate(proportional: Scalar, integral: Scalar, tracking: Scalar | None, dt: Scalar) -> Scalar:
    """1/T_t [1/s], at most 1/T_s; without a time constant k_i/k_p, or 1/T_s for pure integral control."""
    if tracking is not None:
        return 1.0 / jnp.maximum(tracking, dt)
    ratio = integral / jnp.where(proportional > 0.0, proportional, 1.0)
    return jnp.where(proportional > 0.0, jnp.minimum(ratio, 1.0 / dt), 1.0 / dt)


def require_order(low: Scalar | None, high: Scalar | None) -> None:
    """Require that a lower limit lies below an upper one.

    Raises:
        ConfigError: The limits, or what their laws reach, are not in order.
    """
    if low is None or high is None:
        return
    top = extent(low)[1]
    bottom = extent(high)[0]
    if not top < bottom:
        raise ConfigError("low", f"must be below high = {bottom:g}, got up to {top:g}")


def prepare_limits(gains: Params) -> Params:
    """Gains whose limits are in order; raises ConfigError."""
    require_order(gains.low, gains.high)
    return gains


def smooth_within_limits(init: Callable, step: Callable) -> Callable[[Params], Smoothness]:
    """The declaration of a law that is smooth between the limits of its command.

    Args:
        init: The law's first state, as in its contract.
        step: The law's sample, as in its contract.

    Returns:
        The function from gains with ``low`` and ``high`` to their declaration. Without limits the law is smooth. With
        them it is piecewise smooth, and the same law without limits is its substitute.
    """

    def without_limits(gains: Params) -> tuple[Controller, Params]:
        return Controller(type(gains), init, step), gains._replace(low=None, high=None)

    def smoothness(gains: Params) -> Smoothness:
        if gains.low is None and gains.high is None:
            return SMOOTH
        return piecewise("the limits low and high of its command; there it counts as within them", without_limits)

    return smoothness
