"""A pure delay of a real number of controller samples, in series with the plant input.

In units, u stands for the unit of the command.
"""

from typing import Annotated, NamedTuple

import jax

from dssc_jax.core.contracts import Timing, Unmodelled
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import delay_weights, dot
from dssc_jax.core.quantities import Quantity, extent
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import SMOOTH

MOST_SAMPLES = 200  # the state holds one scalar for each sample of delay, and copies all of them at every sample


class DelayParams(NamedTuple):
    """Parameters of a delay: the delay itself, and the number of commands in memory."""

    samples: Annotated[Scalar, Quantity("1", "delay, in controller samples", at_least=0.0)]
    memory: Annotated[
        float,
        Quantity(
            "1",
            "longest delay, in samples; each is a state of the linearised loop, so the least that suffices is fastest",
            at_least=1.0,
            at_most=MOST_SAMPLES,
            law=False,
        ),
    ] = 20.0


class DelayState(NamedTuple):
    """Memory of a delay.

    Args:
        commands: The present command and the ``memory`` commands before it, newest first [u].
        delayed: The plant's input during the present sample [u].
    """

    commands: tuple[Scalar, ...]
    delayed: Scalar


def prepare(params: DelayParams) -> DelayParams:
    """The parameters themselves, if the memory is a whole number of samples and holds the longest delay.

    Raises:
        ConfigError: The memory is not whole, or too short for a value of the delay's law.
    """
    if not float(params.memory).is_integer():
        raise ConfigError("memory", f"must be a whole number of samples, got {params.memory:g}")
    _, longest = extent(params.samples)
    if longest > params.memory:
        raise ConfigError("samples", f"must be <= memory = {params.memory:g}, got up to {longest:g}")
    return params


def init(params: DelayParams) -> DelayState:
    """The state at t = 0: all earlier commands were zero."""
    return DelayState(commands=(0.0,) * (int(params.memory) + 1), delayed=0.0)


def sample(params: DelayParams, state: DelayState, command: Scalar, key: jax.Array, dt: Scalar) -> DelayState:
    """The memory after a new command, with the delayed command that the plant gets until the next one.

    A delay of n + f samples, n whole and 0 <= f < 1, switches within the sample from the command of n + 1 samples ago
    to the command of n samples ago. The plant gets the mean of these two, with the weights f and 1 - f. ``key`` and
    ``dt`` are arguments of every actuator; a delay does not use them.
    """
    commands = (command, *state.commands[:-1])  # the oldest command leaves the memory
    return DelayState(commands, dot(delay_weights(params.samples, len(commands)), commands))


def has_fraction(params: DelayParams) -> bool:
    """Whether the delay may include a part of a sample, so that the plant's input is a mean over the sample.

    A delay with a law counts as one that may, because its values are not all whole.
    """
    shortest, longest = extent(params.samples)
    return shortest != longest or not shortest.is_integer()


DELAY = Unmodelled(
    DelayParams,
    init,
    step=lambda params, state, command, dt: state,
    output=lambda params, state, command: state.delayed,
    prepare=prepare,
    sample=sample,
    held=True,
    smooth=SMOOTH,
    timing=Timing.INVARIANT,
    superposes=True,
    averages=has_fraction,
)
