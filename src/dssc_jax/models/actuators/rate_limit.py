"""A rate limit in series with the plant input."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Moments, Unmodelled
from dssc_jax.core.numerics import saturate
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import piecewise


class RateLimitParams(NamedTuple):
    """Parameters of a rate limit; an infinite rate makes it an ideal actuator."""

    rate: Annotated[Scalar, Quantity("u/s", "largest slope of the plant input", above=0.0)]


def step(params: RateLimitParams, state: tuple[Scalar], command: Scalar, dt: Scalar) -> tuple[Scalar]:
    """The state after dt with a constant command u: the exact solution of z' = rate sgn(u - z)."""
    (z,) = state
    return (z + saturate(command - z, params.rate * dt),)


def follow(params: RateLimitParams, state: tuple[Scalar], start: Scalar, end: Scalar, dt: Scalar) -> tuple[Scalar]:
    """The state after dt with a command that goes in a straight line from start to end: the exact solution.

    The output moves towards the command at the largest rate. Once it has reached the command, it moves with it, or
    falls behind it if the command is faster.
    """
    (z,) = state
    slope = (end - start) / dt
    gap = start - z
    reach = params.rate * dt
    closing = jnp.where(gap > 0.0, params.rate - slope, params.rate + slope)
    is_met = jnp.abs(gap) < closing * dt
    meeting = jnp.where(is_met, jnp.abs(gap) / jnp.where(is_met, closing, 1.0), 0.0)
    delayed = start + slope * meeting + saturate(slope, params.rate) * (dt - meeting)
    return (jnp.where(is_met, delayed, jnp.where(gap > 0.0, z + reach, z - reach)),)


def moments(params: RateLimitParams, state: tuple[Scalar], command: Scalar, dt: Scalar) -> Moments:
    """Moments over dt of the output, a ramp that reaches the command after the share s of dt and then stays there.

    With d the total change over dt, the mean is the final value less s d/2. The line with the same first moment rises
    by s (3 - 2 s) d.
    """
    (z,) = state
    reach = params.rate * dt
    change = saturate(command - z, reach)
    share = jnp.abs(change) / reach
    return Moments(z + change * (1.0 - 0.5 * share), change * share * (3.0 - 2.0 * share))


def without_rate_limit(params: RateLimitParams) -> tuple[Unmodelled, RateLimitParams]:
    """The substitute for slopes below the limit: an infinite rate, so that the output is the command."""
    return RATE_LIMIT, RateLimitParams(jnp.inf)


RATE_LIMIT = Unmodelled(
    RateLimitParams,
    init=lambda params: (0.0,),
    step=step,
    output=lambda params, state, command: state[0],
    moments=moments,
    follow=follow,
    smooth=piecewise(
        "its largest slope; there it counts as slower than that, and follows the command", without_rate_limit
    ),
)
