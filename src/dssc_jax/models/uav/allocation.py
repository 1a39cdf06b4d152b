"""Control allocation: rotor thrusts from net thrust and moment by the pseudo-inverse of the geometry (Figure 1)."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import clip, dot
from dssc_jax.core.quantities import nominal
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.models.uav.vehicle import Vehicle

NEGLIGIBLE_ENTRY = 1e-12  # relative to the largest entry of a column


class Thrusts(NamedTuple):
    """Commanded thrusts f_i [N], and whether any is at a limit."""

    commanded: tuple[Scalar, ...]
    limited: Scalar


def geometry(vehicle: Vehicle) -> np.ndarray:
    """The matrix from thrusts to (f, M_x, M_y, M_z), (4, n_r), nominal: laws at their medians."""
    plain = vehicle._replace(arm=nominal(vehicle.arm), torque_coefficient=nominal(vehicle.torque_coefficient))
    x, y = plain.arm * np.array(plain.directions(), dtype=float)
    return np.stack([np.ones(vehicle.rotors), y, -x, np.asarray(plain.spins) * plain.torque_coefficient])


def pseudo_inverse(vehicle: Vehicle) -> tuple[tuple[float, ...], ...]:
    """Rows (f, M_x, M_y, M_z) -> f_i, one per rotor; raises ConfigError."""
    matrix = geometry(vehicle)
    scale = np.linalg.norm(matrix, axis=1, keepdims=True)
    rank = int(np.linalg.matrix_rank(matrix / scale, tol=1e-9))
    if rank < 4:
        raise ConfigError(
            "spins", f"rotor_angles and spins must span thrust and three moments (yaw included), got rank {rank} of 4"
        )
    inverse = np.linalg.pinv(matrix)
    inverse[np.abs(inverse) < NEGLIGIBLE_ENTRY * np.abs(inverse).max(axis=0)] = 0.0
    return tuple(tuple(float(value) for value in row) for row in inverse)


def allocate(inverse: tuple[tuple[float, ...], ...], thrust: Scalar, moment: Vec3, limit: Scalar) -> Thrusts:
    """Thrusts for the wanted net thrust [N] and moment [N m], each limited to [0, limit]."""
    unlimited = [dot(row, (thrust, *moment)) for row in inverse]
    commanded = tuple(clip(f, 0.0, limit) for f in unlimited)
    limited = jnp.zeros((), dtype=bool)
    for f in unlimited:
        limited = limited | (f < 0.0) | (f > limit)
    return Thrusts(commanded, limited)
