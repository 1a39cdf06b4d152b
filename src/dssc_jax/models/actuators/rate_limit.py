"""A rate limit in series with the plant input.

In units, u stands for the unit of the command.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Moments, Unmodelled
from dssc_jax.core.numerics import saturate
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import piecewise


class RateLimitParams(NamedTuple):
    """The largest rate of the plant input; with an infinite rate the actuator is ideal."""

    rate: Annotated[Scalar, Quantity("u/s", "largest slope of the plant input", above=0.0)]


def step(params: RateLimitParams, state: tuple[Scalar], command: Scalar, dt: Scalar) -> tuple[Scalar]:
    """The output z [u] after dt [s] with a constant command u, by the exact solution of z' = rate sgn(u - z).

    Args:
        params: The largest rate.
        state: The output z at the start of the step, alone.
        command: The command u [u].
        dt: Length of the step [s].
    """
    (z,) = state
    return (z + saturate(command - z, params.rate * dt),)


def follow(params: RateLimitParams, state: tuple[Scalar], start: Scalar, end: Scalar, dt: Scalar) -> tuple[Scalar]:
    """The output z [u] after dt [s] with a command that goes in a straight line from start to end; exact.

    The output moves towards the command at the largest rate. If it meets the command within dt, it then moves with the
    command, or falls behind it if the command is faster.

    Args:
        params: The largest rate.
        state: The output at the start of the step, alone.
        start: Command at the start of the step [u].
        end: Command at its end [u].
        dt: Length of the step [s].
    """
    (z,) = state
    slope = (end - start) / dt
    gap = start - z
    reach = params.rate * dt
    closing_rate = jnp.where(gap > 0.0, params.rate - slope, params.rate + slope)  # rate at which the gap closes [u/s]
    is_met = jnp.abs(gap) < closing_rate * dt
    meeting_time = jnp.where(is_met, jnp.abs(gap) / jnp.where(is_met, closing_rate, 1.0), 0.0)
    after_meeting = start + slope * meeting_time + saturate(slope, params.rate) * (dt - meeting_time)
    without_meeting = jnp.where(gap > 0.0, z + reach, z - reach)
    return (jnp.where(is_met, after_meeting, without_meeting),)


def moments(params: RateLimitParams, state: tuple[Scalar], command: Scalar, dt: Scalar) -> Moments:
    """The straight line with the mean and the first moment of the output over dt [s], with a constant command.

    The output is a ramp that reaches the command after the share s of dt, and then stays there; s = 1 if it does not
    reach the command within dt. Let d be the change of the output over dt. The mean of the output is its final value
    less s d/2, and the straight line rises by s (3 - 2 s) d. Arguments are as for :func:`step`.
    """
    (z,) = state
    reach = params.rate * dt
    change = saturate(command - z, reach)
    share = jnp.abs(change) / reach
    return Moments(mean=z + change * (1.0 - 0.5 * share), rise=change * share * (3.0 - 2.0 * share))


def without_rate_limit(params: RateLimitParams) -> tuple[Unmodelled, RateLimitParams]:
    """The part that is linearised in place of the limit: an infinite rate, so that the output is the command.

    It stands for the actuator under commands that are slower than the limit.
    """
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
