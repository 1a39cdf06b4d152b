"""Commands that are lost at random on their way to the actuator, which then holds the last one that arrived.

In units, u stands for the unit of the command.
"""

from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.contracts import Unmodelled
from dssc_jax.core.numerics import is_zero, uniforms
from dssc_jax.core.quantities import Quantity, extent
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import SMOOTH, Smoothness, not_smooth


class LostCommandParams(NamedTuple):
    """The probability of a loss, independent from sample to sample."""

    probability: Annotated[Scalar, Quantity("1", "probability that a command is lost", at_least=0.0, below=1.0)]


def sample(
    params: LostCommandParams, state: tuple[Scalar], command: Scalar, key: jax.Array, dt: Scalar
) -> tuple[Scalar]:
    """The plant input [u] until the next sample: the command if it arrives, else the last command that arrived.

    The plant input is 0 until the first command has arrived. The state is the plant input alone. ``key`` decides at
    random whether the command arrives; ``dt`` is not used.
    """
    if is_zero(params.probability):
        return (command,)
    (number,) = uniforms(key, 1)
    is_received = number >= params.probability
    return (jnp.where(is_received, command, state[0]),)


def smoothness(params: LostCommandParams) -> Smoothness:
    """Declare where the actuator has a derivative: everywhere if no command can be lost, else nowhere."""
    _, largest_probability = extent(params.probability)
    if largest_probability > 0.0:
        return not_smooth("loses commands at random, so that no derivative holds from sample to sample; leave it out")
    return SMOOTH


LOST_COMMAND = Unmodelled(
    LostCommandParams,
    init=lambda params: (0.0,),
    step=lambda params, state, command, dt: state,
    output=lambda params, state, command: state[0],
    sample=sample,
    held=True,
    smooth=smoothness,
)
