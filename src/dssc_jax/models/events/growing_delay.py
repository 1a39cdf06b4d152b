"""A delay of the commands that grows from a time on.

In units, u stands for the unit of the command.
"""

import math
from typing import Annotated, NamedTuple

import jax

from dssc_jax.core.contracts import Unmodelled
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.events import AT, CommandEvent
from dssc_jax.core.numerics import clip, delay_weights, dot
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar

MOST_SAMPLES = 200  # the state holds one scalar for each sample of delay, as for the constant delay


class GrowingParams(NamedTuple):
    """The growth of a delay of the commands.

    The delay is ``rate`` times the time since the event, and at most ``memory`` samples.
    """

    at: Annotated[Scalar, AT]
    rate: Annotated[Scalar, Quantity("1", "growth of the delay, seconds a second", at_least=0.0)]
    memory: Annotated[
        float, Quantity("1", "longest delay, in samples", at_least=1.0, at_most=MOST_SAMPLES, law=False)
    ] = 20.0


class GrowingState(NamedTuple):
    """Memory of the delay.

    Args:
        t: Time of the next sample [s].
        commands: The present command and the ``memory`` commands before it, newest first [u].
        delayed: The command that reaches the plant during the present sample [u].
    """

    t: Scalar
    commands: tuple[Scalar, ...]
    delayed: Scalar


def prepare(params: GrowingParams) -> GrowingParams:
    """The parameters themselves, whose memory must be a whole number of samples.

    Raises:
        ConfigError: The memory is not whole.
    """
    if not float(params.memory).is_integer():
        raise ConfigError("memory", f"must be a whole number of samples, got {params.memory:g}")
    return params


def init(params: GrowingParams) -> GrowingState:
    """The state at t = 0: all earlier commands were zero."""
    return GrowingState(t=0.0, commands=(0.0,) * (int(params.memory) + 1), delayed=0.0)


def sample(params: GrowingParams, state: GrowingState, command: Scalar, key: jax.Array, dt: Scalar) -> GrowingState:
    """The memory after a new command, with the delayed command that the plant gets until the next one.

    A delay of n + f samples, n whole and 0 <= f < 1, switches within the sample from the command of n + 1 samples ago
    to the command of n samples ago. The plant gets the mean of these two, with the weights f and 1 - f. ``key`` is not
    used, because nothing is random.
    """
    commands = (command, *state.commands[:-1])  # the oldest command leaves the memory
    samples = clip(params.rate * (state.t - params.at) / dt, 0.0, params.memory)
    return GrowingState(state.t + dt, commands, dot(delay_weights(samples, len(commands)), commands))


GROWING_DELAY = CommandEvent(
    GrowingParams,
    Unmodelled(
        GrowingParams,
        init,
        step=lambda params, state, command, dt: state,
        output=lambda params, state, command: state.delayed,
        sample=sample,
        held=True,
    ),
    "the delay of the commands",
    prepare,
    last_change=lambda params: math.inf,  # with a small rate the delay grows for any length of time
)
