"""What an allocation gives up where rotors would exceed their limits.

PX4's sequential desaturation moves the thrusts along the directions of net thrust, roll, pitch and yaw, one after the
other, until the rotors keep their limits or exceed them as little as possible. Yaw is given up first, then roll and
pitch. Net thrust is raised only in the modes of airmode.

Source: PX4's ControlAllocationSequentialDesaturation, versions 1.13 to 1.15, whose modes are those of MC_AIRMODE, and
the scale of the directions in ControlAllocationPseudoInverse. PX4's actuators range from 0 to 1, and its z points down.
"""

from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.numerics import dot
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3

WEAK = 0.2
"""A rotor with a smaller share in a direction, on PX4's scale, is not desaturated along it."""
YAW_MARGIN = 0.15
"""Share of the range of thrust beyond the upper limit that yaw may use before net thrust falls (MINIMUM_YAW_MARGIN)."""
NONZERO = 1e-3
"""Entries that PX4 counts as parts of a direction, relative to the largest one."""

ROUNDING_OF_ROTORS = 1e-9
"""Difference from a whole number of rotors that is rounding of the pseudo-inverse."""


@jax.tree_util.register_static
class Desaturation(StrEnum):
    """How thrusts are kept within their limits.

    ``clip`` clips each thrust by itself. The other modes are PX4's sequential desaturation with the modes of
    MC_AIRMODE. Their names tell the axes for which net thrust may be raised.
    """

    CLIP = "clip"
    AIRMODE_DISABLED = "airmode_disabled"
    AIRMODE_ROLL_PITCH = "airmode_roll_pitch"
    AIRMODE_ROLL_PITCH_YAW = "airmode_roll_pitch_yaw"


class Direction(NamedTuple):
    """A column of the allocation, along which thrusts are moved.

    Args:
        entries: Thrust of each rotor per unit of net thrust or moment.
        is_strong: Whether each rotor's entry is large enough for the rotor to be desaturated along the direction.
    """

    entries: tuple[float, ...]
    is_strong: tuple[bool, ...]


class Directions(NamedTuple):
    """The four columns of the allocation: the directions of net thrust, roll, pitch and yaw."""

    thrust: Direction
    roll: Direction
    pitch: Direction
    yaw: Direction


class Scales(NamedTuple):
    """PX4's scale of the columns of an allocation: the entry that counts as 1 in each column.

    Args:
        thrust: Mean size of the entries of net thrust that are not 0.
        turning: The scale of roll and of pitch: the larger of their :func:`scaled_rms` [1/m].
        yaw: The largest entry about the axis that points down [1/m].
    """

    thrust: float
    turning: float
    yaw: float


def scales_of(inverse: Sequence[Sequence[float]]) -> Scales:
    """The entry that PX4 counts as 1 in each column of an allocation; a much smaller entry counts as weak.

    Args:
        inverse: The allocation, shape (n_r, 4): row i gives the thrust f_i from (f, M_x, M_y, M_z), with z up.
    """
    thrust, roll, pitch, yaw = np.array(inverse, dtype=float).T
    shares = np.abs(thrust)
    return Scales(
        thrust=float(shares[shares > 0.0].mean()),
        turning=max(scaled_rms(roll), scaled_rms(pitch)),
        yaw=float((-yaw).max()),  # PX4's z points down
    )


def rotors_of_full_thrust(inverse: Sequence[Sequence[float]]) -> float:
    """The net thrust at which the rotors' mean thrust is the largest thrust of a rotor, divided by this largest thrust.

    PX4 normalises the thrust by it: the command 1 is this net thrust. The result is the number of rotors that lift;
    tilted rotors count with the cosine of their tilt. A result that is whole up to rounding is a whole number.

    Args:
        inverse: The allocation, shape (n_r, 4).

    Example:
        >>> rotors_of_full_thrust([(0.25, 1.0, -1.0, 5.0), (0.25, -1.0, 1.0, 5.0)] * 2)
        4.0
    """
    rotors = 1.0 / scales_of(inverse).thrust
    whole = float(round(rotors))
    return whole if abs(rotors - whole) < ROUNDING_OF_ROTORS else rotors


def directions_of(inverse: Sequence[Sequence[float]]) -> Directions:
    """The columns of an allocation, shape (n_r, 4), each with the rotors that are strong along it on PX4's scale."""
    scales = scales_of(inverse)
    directions = []
    columns = np.array(inverse, dtype=float).T
    scale_of_columns = (scales.thrust, scales.turning, scales.turning, scales.yaw)
    for column, scale in zip(columns, scale_of_columns, strict=True):
        least_entry = WEAK * scale if scale > 0.0 else WEAK
        is_strong = np.abs(column) >= least_entry
        directions.append(Direction(tuple(column.tolist()), tuple(is_strong.tolist())))
    return Directions(*directions)


def scaled_rms(column: np.ndarray) -> float:
    """sqrt(2) times the root mean square of a column of an allocation, over the rotors that take part in it.

    A rotor takes part if its entry is larger than ``NONZERO`` times the largest one.
    """
    size = np.abs(column)
    count = np.sum(size > NONZERO * size.max())
    return float(np.sqrt(np.sum(column**2) / (count / 2.0)))


def gain_along(direction: Direction, thrusts: Sequence[Scalar], limit: Scalar) -> Scalar:
    """The step along a direction that undoes as much as possible of what exceeds [0, limit].

    A rotor beyond a limit returns to this limit by the step (limit - thrust)/entry. The result is the sum of the most
    negative and the most positive of these steps, so that opposite demands of two rotors offset each other.

    Args:
        direction: The direction; rotors that are weak along it do not count.
        thrusts: Thrust of each rotor before the step [N].
        limit: Largest thrust of a rotor [N].
    """
    low: Scalar = 0.0
    high: Scalar = 0.0
    for f, entry, is_strong in zip(thrusts, direction.entries, direction.is_strong, strict=True):
        if not is_strong:
            continue
        excess = jnp.where(f < 0.0, -f, jnp.where(f > limit, limit - f, 0.0))
        low = jnp.minimum(low, excess / entry)
        high = jnp.maximum(high, excess / entry)
    return low + high


def moved(direction: Direction, thrusts: Sequence[Scalar], gain: Scalar) -> list[Scalar]:
    """The thrusts after a step along a direction.

    Args:
        direction: The direction.
        thrusts: Thrust of each rotor before the step [N].
        gain: Length of the step, in units of net thrust [N] or moment [N m].
    """
    return [f + gain * entry for f, entry in zip(thrusts, direction.entries, strict=True)]


def desaturated_along(direction: Direction, thrusts: Sequence[Scalar], limit: Scalar) -> list[Scalar]:
    """The thrusts after a step along a direction, and half a step towards what the first one left.

    The second step is half of the one that would undo the remaining excess. Arguments are as for :func:`gain_along`.
    """
    thrusts = moved(direction, thrusts, gain_along(direction, thrusts, limit))
    return moved(direction, thrusts, 0.5 * gain_along(direction, thrusts, limit))


def reduced_along(direction: Direction, thrusts: Sequence[Scalar], limit: Scalar) -> list[Scalar]:
    """As :func:`desaturated_along`, but nothing where the first step would raise the net thrust.

    The function is meant for the direction of net thrust alone, in which a positive step raises the net thrust.
    """
    gain = gain_along(direction, thrusts, limit)
    allowed = gain <= 0.0
    first = moved(direction, thrusts, jnp.where(allowed, gain, 0.0))
    second = 0.5 * gain_along(direction, first, limit)
    return moved(direction, first, jnp.where(allowed, second, 0.0))


def desaturated(
    inverse: Sequence[Sequence[float]], thrust: Scalar, moment: Vec3, limit: Scalar, mode: Desaturation
) -> list[Scalar]:
    """Thrusts for a wanted net thrust [N] and moment [N m], desaturated along the allocation's directions.

    Args:
        inverse: The allocation, shape (n_r, 4), plain numbers.
        thrust: Wanted net thrust [N].
        moment: Wanted moment [N m].
        limit: Largest thrust of a rotor [N].
        mode: Any mode but ``CLIP``.

    Returns:
        Thrusts that may still exceed the limits where no step along the directions helps.
    """
    along = directions_of(inverse)
    with_yaw = mode is Desaturation.AIRMODE_ROLL_PITCH_YAW
    turning = moment if with_yaw else Vec3(moment.x, moment.y, 0.0)
    # yaw joins last, so that it is given up first, except in the mode that raises net thrust for yaw, too
    thrusts: list[Scalar] = [dot(row, (thrust, *turning)) for row in inverse]
    if with_yaw:  # net thrust may rise for all axes
        thrusts = desaturated_along(along.thrust, thrusts, limit)
        return desaturated_along(along.yaw, thrusts, limit)
    if mode is Desaturation.AIRMODE_ROLL_PITCH:  # net thrust may rise for roll and pitch
        thrusts = desaturated_along(along.thrust, thrusts, limit)
    else:  # net thrust may only fall; roll and pitch give up what is left
        thrusts = reduced_along(along.thrust, thrusts, limit)
        thrusts = desaturated_along(along.roll, thrusts, limit)
        thrusts = desaturated_along(along.pitch, thrusts, limit)
    thrusts = moved(along.yaw, thrusts, moment.z)
    thrusts = desaturated_along(along.yaw, thrusts, limit * (1.0 + YAW_MARGIN))
    return reduced_along(along.thrust, thrusts, limit)
