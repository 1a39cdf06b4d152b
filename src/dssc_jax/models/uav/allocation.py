"""Control allocation: rotor thrusts from net thrust and moment by the pseudo-inverse of the geometry (Figure 1)."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from dssc_jax.core.numerics import clip, dot
from dssc_jax.core.quantities import nominal
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.models.uav.authority import require_hover, require_independent_axes
from dssc_jax.models.uav.desaturation import Desaturation, desaturated
from dssc_jax.models.uav.rotors import rotor_wrench
from dssc_jax.models.uav.vehicle import Vehicle, check_vehicle

NEGLIGIBLE_ENTRY = 1e-12  # relative to the largest entry of a column
SMALLEST_VALUE = 1e-9
"""Singular values below this share of the largest one count as zero."""


class Thrusts(NamedTuple):
    """Commanded thrusts f_i of the rotors [N], and whether a wanted thrust was beyond a limit (``limited``)."""

    commanded: tuple[Scalar, ...]
    limited: Scalar


def geometry(vehicle: Vehicle) -> np.ndarray:
    """The matrix from the rotors' thrusts to net thrust and moments (f, M_x, M_y, M_z), shape (4, n_r).

    The matrix is nominal: laws count with their medians.
    """
    if vehicle.rotor:
        return wrench_matrix(vehicle)[2:]  # without the two components of the force across body z
    plain = vehicle._replace(arm=nominal(vehicle.arm), torque_coefficient=nominal(vehicle.torque_coefficient))
    x, y = plain.arm * np.array(plain.directions(), dtype=float)
    return np.stack([np.ones(vehicle.rotors), y, -x, np.asarray(plain.spins) * plain.torque_coefficient])


def wrench_matrix(vehicle: Vehicle) -> np.ndarray:
    """The matrix from the thrusts of rotors anywhere to force and moment, shape (6, n_r).

    Its rows are F_x, F_y, F_z, M_x, M_y, M_z in body axes. The matrix is nominal: laws count with their medians.
    """
    coefficients = [nominal(value) for value in vehicle.torque_coefficients]
    columns = []
    for rotor, coefficient in zip(vehicle.rotor, coefficients, strict=True):
        place = tuple(map(nominal, rotor.position))
        axis = tuple(map(nominal, rotor.axis))
        columns.append(rotor_wrench(rotor._replace(position=place, axis=axis), coefficient))
    return np.array(columns, dtype=float).T


def without_side_force(inverse: np.ndarray, vehicle: Vehicle) -> np.ndarray:
    """The allocation with the same net thrust and moments that has the least force across body z.

    Thrusts that change neither net thrust nor moments are free, and are chosen to cancel the side force; of several
    such choices, the one with the least norm is taken. Where the rotors can produce all six components of force and
    moment, this is the pseudo-inverse of all six with no side force wanted, as PX4 allocates.

    Args:
        inverse: The pseudo-inverse of the matrix of :func:`geometry`, shape (n_r, 4).
        vehicle: The vehicle; rotors on a circle have no side force.
    """
    if not vehicle.rotor:
        return inverse
    matrix = wrench_matrix(vehicle)
    side_force = matrix[:2]  # the rows of F_x and F_y
    if not side_force.any():
        return inverse
    _, values, rows = np.linalg.svd(matrix[2:])
    rank = int(np.sum(values > SMALLEST_VALUE * values[0]))
    free = rows[rank:].T  # the thrusts that change neither net thrust nor moments
    return inverse - free @ np.linalg.pinv(side_force @ free, rcond=SMALLEST_VALUE) @ side_force @ inverse


def pseudo_inverse(vehicle: Vehicle) -> tuple[tuple[float, ...], ...]:
    """The nominal allocation, from net thrust and moments (f, M_x, M_y, M_z) to the rotors' thrusts, shape (n_r, 4).

    Each row belongs to a rotor. Entries that are 0 up to rounding are 0.

    Raises:
        ConfigError: The rotors cannot command thrust, roll, pitch and yaw independently.
    """
    matrix = geometry(vehicle)
    require_independent_axes(vehicle, matrix)
    inverse = without_side_force(np.linalg.pinv(matrix), vehicle)
    inverse[np.abs(inverse) < NEGLIGIBLE_ENTRY * np.abs(inverse).max(axis=0)] = 0.0
    return tuple(map(tuple, inverse.tolist()))


def flying_allocation(vehicle: Vehicle) -> tuple[tuple[float, ...], ...]:
    """The nominal allocation of :func:`pseudo_inverse` for a vehicle that must be able to fly.

    Raises:
        ConfigError: Fields of the vehicle contradict each other, or it cannot hover or command all axes.
    """
    check_vehicle(vehicle)
    allocation = pseudo_inverse(vehicle)
    require_hover(vehicle, np.array(allocation))
    return allocation


def allocate(
    inverse: tuple[tuple[float, ...], ...],
    thrust: Scalar,
    moment: Vec3,
    limit: Scalar,
    desaturation: Desaturation = Desaturation.CLIP,
) -> Thrusts:
    """Thrusts for the wanted net thrust [N] and moment [N m], each limited to [0, limit].

    Args:
        inverse: The allocation, shape (n_r, 4).
        thrust: Wanted net thrust [N].
        moment: Wanted moment, body axes [N m].
        limit: Largest thrust of a rotor [N].
        desaturation: What is given up where a rotor would exceed its limits.

    Returns:
        The thrusts, and whether a rotor would have exceeded a limit.
    """
    unlimited = [dot(row, (thrust, *moment)) for row in inverse]
    kept = unlimited if desaturation is Desaturation.CLIP else desaturated(inverse, thrust, moment, limit, desaturation)
    commanded = tuple(clip(f, 0.0, limit) for f in kept)
    limited = jnp.zeros((), dtype=bool)
    for f in unlimited:
        limited = limited | (f < 0.0) | (f > limit)
    return Thrusts(commanded, limited)
