"""Backlash (play) in series with the plant input, as of a gear: the output moves when the gap is used up.

Each step solves the play implicitly. After a monotone change of the command, the output therefore equals that of the
play in continuous time, whatever the step, and it cannot chatter.

In units, u stands for the unit of the command.

Reference:
    M. Brokate, J. Sprekels, Hysteresis and Phase Transitions (1996), section 2.3.
"""

from typing import Annotated, NamedTuple

import jax

from dssc_jax.core.contracts import Timing, Unmodelled
from dssc_jax.core.numerics import clip
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import SMOOTH, not_smooth


class BacklashParams(NamedTuple):
    """The gap of a backlash; with a half-width of 0 the actuator is ideal."""

    half_width: Annotated[Scalar, Quantity("u", "half of the gap", at_least=0.0)]


def step(params: BacklashParams, state: tuple[Scalar], command: Scalar, dt: Scalar) -> tuple[Scalar]:
    """The output [u] after the command has moved: an edge of the gap pushes the output along, or the output stays.

    The state is the output alone. The result does not depend on the duration ``dt`` of the move.
    """
    (output,) = state
    return (clip(output, command - params.half_width, command + params.half_width),)


def sample(params: BacklashParams, state: tuple[Scalar], command: Scalar, key: jax.Array, dt: Scalar) -> tuple[Scalar]:
    """The output [u] just after a new command, which moves the output at once.

    ``key`` is not used, because nothing is random; ``dt`` is not used, because the move takes no time.
    """
    return step(params, state, command, dt)


def unit_gain(params: BacklashParams) -> tuple[Unmodelled, BacklashParams]:
    """The part that is linearised in place of the backlash: a gain of 1, with the same parameters.

    The gain 1 stands for a backlash whose signals are large compared with the gap.
    """
    return UNIT_GAIN, params


BACKLASH = Unmodelled(
    BacklashParams,
    init=lambda params: (0.0,),
    step=step,
    output=lambda params, state, command: state[0],
    sample=sample,
    held=True,
    smooth=not_smooth(
        "counts as its gain 1 for large motions; its describing function loses gain and lags by up to 90 degrees at "
        "small ones, so that the margins do not exclude an oscillation of the size of the gap",
        unit_gain,
    ),
    timing=Timing.INSTANT,
    follow=lambda params, state, start, end, dt: step(params, state, end, dt),
)
UNIT_GAIN = BACKLASH._replace(
    step=lambda params, state, command, dt: state,
    output=lambda params, state, command: command,
    sample=lambda params, state, command, key, dt: state,
    smooth=SMOOTH,
    continuous=True,
    follow=lambda params, state, start, end, dt: state,
)
