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
from dssc_jax.models.uav.rotors import effect_of
from dssc_jax.models.uav.vehicle import Vehicle, check_vehicle

NEGLIGIBLE_ENTRY = 1e-12  # relative to the largest entry of a column
SMALLEST_VALUE = 1e-9
"""Singular values below this share of the largest one count as zero."""


class Thrusts(NamedTuple):
    """Commanded thrusts f_i [N], and whether any is at a limit."""

    commanded: tuple[Scalar, ...]
    limited: Scalar


def geometry(vehicle: Vehicle) -> np.ndarray:
    """The matrix from thrusts to (f, M_x, M_y, M_z), (4, n_r), nominal: laws at their medians."""
    if vehicle.rotor:
        return effects(vehicle)[[2, 3, 4, 5]]
    plain = vehicle._replace(arm=nominal(vehicle.arm), torque_coefficient=nominal(vehicle.torque_coefficient))
    x, y = plain.arm * np.array(plain.directions(), dtype=float)
    return np.stack([np.ones(vehicle.rotors), y, -x, np.asarray(plain.spins) * plain.torque_coefficient])


def effects(vehicle: Vehicle) -> np.ndarray:
    """The matrix from thrusts to force and moment of rotors anywhere, (6, n_r), nominal: laws at their medians."""
    coefficients = [nominal(value) for value in vehicle.torque_coefficients]
    columns = []
    for rotor, coefficient in zip(vehicle.rotor, coefficients, strict=True):
        place = tuple(map(nominal, rotor.position))
        axis = tuple(map(nominal, rotor.axis))
        columns.append(effect_of(rotor._replace(position=place, axis=axis), coefficient))
    return np.array(columns, dtype=float).T


def without_side_force(inverse: np.ndarray, vehicle: Vehicle) -> np.ndarray:
    """The inverse of the same net thrust and moments with the least force across body z, and then the least norm.

    Where the rotors can produce all six components of force and moment, this is the pseudo-inverse of all six with no
    side force wanted, as PX4 allocates.
    """
    if not vehicle.rotor:
        return inverse
    matrix = effects(vehicle)
    side = matrix[:2]
    if not side.any():
        return inverse
    _, values, rows = np.linalg.svd(matrix[2:])
    free = rows[int(np.sum(values > SMALLEST_VALUE * values[0])) :].T
    return inverse - free @ np.linalg.pinv(side @ free, rcond=SMALLEST_VALUE) @ side @ inverse


def pseudo_inverse(vehicle: Vehicle) -> tuple[tuple[float, ...], ...]:
    """Rows (f, M_x, M_y, M_z) -> f_i, one per rotor; raises ConfigError where they are not independent."""
    matrix = geometry(vehicle)
    require_independent_axes(vehicle, matrix)
    inverse = without_side_force(np.linalg.pinv(matrix), vehicle)
    inverse[np.abs(inverse) < NEGLIGIBLE_ENTRY * np.abs(inverse).max(axis=0)] = 0.0
    return tuple(tuple(float(value) for value in row) for row in inverse)


def flying_allocation(vehicle: Vehicle) -> tuple[tuple[float, ...], ...]:
    """The rows (f, M) -> f_i of a checked vehicle that can hover; raises ConfigError with what it cannot do."""
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

    ``desaturation`` says what is given up where a rotor would exceed its limits.
    """
    unlimited = [dot(row, (thrust, *moment)) for row in inverse]
    kept = unlimited if desaturation is Desaturation.CLIP else desaturated(inverse, thrust, moment, limit, desaturation)
    commanded = tuple(clip(f, 0.0, limit) for f in kept)
    limited = jnp.zeros((), dtype=bool)
    for f in unlimited:
        limited = limited | (f < 0.0) | (f > limit)
    return Thrusts(commanded, limited)
