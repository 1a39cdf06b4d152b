"""Control authority: whether the rotors of a vehicle can command thrust, roll, pitch and yaw independently.

The matrix B maps the rotors' thrusts to net thrust and moments. A combination of these four that B' maps to zero is the
same for all thrusts, so the axes in it cannot be commanded independently. Rotors push one way only, so hover needs
positive thrusts from the pseudo-inverse, which allocates. A rotor at rest in hover could only increase its thrust, so
it would command in one direction only.
"""

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import nominal
from dssc_jax.models.uav.vehicle import GRAVITY, Vehicle

AXES = ("thrust", "roll", "pitch", "yaw")
SMALLEST_SHARE = 1e-9  # smallest share of the largest singular value, or of the weight, that is not rounding
SMALLEST_PART = 1e-6  # smallest entry of a combination of axes with which an axis takes part in it


def unchanged_combinations(matrix: np.ndarray) -> np.ndarray:
    """The combinations of net thrust and moments that no thrusts of the rotors can change.

    A combination is a vector of length 1 over (f, M_x, M_y, M_z); the result has the shape (4 - rank, 4). It is empty
    if the rotors command all four independently.

    Args:
        matrix: Matrix from thrusts to (f, M_x, M_y, M_z), shape (4, n_r); its rows are scaled to length 1.
    """
    sizes = np.linalg.norm(matrix, axis=1, keepdims=True)
    directions, values, _ = np.linalg.svd(matrix / np.where(sizes > 0.0, sizes, 1.0))
    rank = int(np.sum(values > SMALLEST_SHARE * values[0]))
    return directions[:, rank:].T


def dependent_axes(matrix: np.ndarray) -> list[str]:
    """Names of the axes that cannot be commanded independently of each other; one name: it cannot be commanded at all.

    Args:
        matrix: Matrix from thrusts to (f, M_x, M_y, M_z), shape (4, n_r).

    Example:
        >>> turning_alike = np.array([[1.0] * 4, [1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0], [0.05] * 4])
        >>> dependent_axes(turning_alike)
        ['thrust', 'yaw']
    """
    parts = np.abs(unchanged_combinations(matrix)).max(axis=0, initial=0.0)
    return [axis for axis, part in zip(AXES, parts, strict=True) if part > SMALLEST_PART]


def require_independent_axes(vehicle: Vehicle, matrix: np.ndarray) -> None:
    """Require rotors that can command thrust, roll, pitch and yaw independently.

    Args:
        vehicle: The vehicle.
        matrix: Nominal matrix from thrusts to (f, M_x, M_y, M_z), shape (4, n_r).

    Raises:
        ConfigError: The rotors cannot; the message names the axes and a remedy.
    """
    dependent = dependent_axes(matrix)
    if not dependent:
        return
    if len(dependent) == 1:
        lack = f"the rotors cannot command {dependent[0]}"
    else:
        lack = f"the rotors cannot command {', '.join(dependent[:-1])} and {dependent[-1]} independently of each other"
    lacks_yaw = "yaw" in dependent
    remedy = yaw_remedy(matrix) if lacks_yaw else "check the rotors' places, which must span both directions"
    rank = len(AXES) - len(unchanged_combinations(matrix))
    field = "spins" if lacks_yaw else "rotor_angles"
    raise ConfigError("rotor" if vehicle.rotor else field, f"{lack} (rank {rank} of 4): {remedy}")


def yaw_remedy(matrix: np.ndarray) -> str:
    """Advice for a vehicle that cannot command its yaw.

    Args:
        matrix: Matrix from thrusts to (f, M_x, M_y, M_z), shape (4, n_r).
    """
    yaw_moments = matrix[3]
    if not yaw_moments.any():
        return "no rotor has a moment about body z: give torque_coefficient, or tilt axes across the arms"
    if np.all(yaw_moments > 0.0) or np.all(yaw_moments < 0.0):
        return "all turn the same way: let half of them turn the other way, or tilt axes across the arms"
    return "check which rotors turn which way; on a circle neighbours turn opposite ways"


def require_hover(vehicle: Vehicle, allocation: np.ndarray) -> None:
    """Require that in hover every used rotor has a positive thrust within its limit.

    Args:
        vehicle: The vehicle; laws count with their medians.
        allocation: Nominal matrix from thrust and moments to the rotors' thrusts, shape (n_r, 4).

    Raises:
        ConfigError: A rotor would have to pull, or to exceed its limit.
    """
    weight = nominal(vehicle.mass) * GRAVITY
    thrusts = weight * allocation[:, 0]  # in hover: the weight for net thrust, and no moments
    field = "rotor" if vehicle.rotor else "rotor_angles"
    is_used = np.abs(allocation).max(axis=1) > SMALLEST_SHARE * np.abs(allocation).max()
    pulling_rotors = np.flatnonzero(is_used & (thrusts < SMALLEST_SHARE * weight))
    if pulling_rotors.size:
        hover_thrusts = np.where(np.abs(thrusts) < SMALLEST_SHARE * weight, 0.0, thrusts)
        thrusts_text = ", ".join(f"{hover_thrusts[i]:.3g} N of {field}.{i}" for i in pulling_rotors)
        remedy = pulling_remedy(vehicle, pulling_rotors)
        raise ConfigError(field, f"hover needs {thrusts_text}, and a rotor only pushes: {remedy}")
    limit = vehicle.nominal_thrust_limit
    excessive_rotors = np.flatnonzero(thrusts > limit * (1.0 + SMALLEST_SHARE))
    if excessive_rotors.size:
        thrusts_text = ", ".join(f"{thrusts[i]:.3g} N of {field}.{i}" for i in excessive_rotors)
        rule = f"hover needs {thrusts_text}, and a rotor's largest thrust is {limit:.3g} N"
        raise ConfigError("max_thrust", f"{rule}: give a larger one, or move the centre of mass between the rotors")


def pulling_remedy(vehicle: Vehicle, pulling: np.ndarray) -> str:
    """Advice for a vehicle whose hover needs negative thrusts of some rotors.

    Args:
        vehicle: The vehicle.
        pulling: Indices of these rotors.
    """
    downward = [i for i, rotor in enumerate(vehicle.rotor) if nominal(rotor.axis[2]) < 0.0]
    if len(downward) == vehicle.rotors:
        return "all axes point down; the axis of a rotor that lifts points up, also where it is mounted upside down"
    if set(downward) & set(pulling.tolist()):
        return "its axis points down; that of a rotor that lifts points up, also where it is mounted upside down"
    return "check the rotors' places around the centre of mass, and which way each of them turns"


def largest_accelerations(vehicle: Vehicle, inverse: np.ndarray) -> dict[str, float]:
    """The largest angular acceleration about each axis [rad/s^2] that is possible in hover in both directions.

    The keys are ``roll``, ``pitch`` and ``yaw``. Net thrust and the other two moments stay as in hover, and no rotor
    exceeds its limits.

    Args:
        vehicle: Mass, inertia and largest thrust; laws count with their medians.
        inverse: The allocation, shape (n_r, 4).
    """
    weight = nominal(vehicle.mass) * GRAVITY
    hover_thrusts = weight * inverse[:, 0]
    # what each rotor's thrust can both fall and rise by
    reserve = np.minimum(hover_thrusts, vehicle.nominal_thrust_limit - hover_thrusts)
    accelerations = {}
    body_inertia = [nominal(value) for value in vehicle.body_inertia]
    transverse = nominal(vehicle.rotor_inertia_xy)
    hub_inertia = [transverse, transverse, nominal(vehicle.rotor_inertia_z)]
    for place, axis in enumerate(AXES[1:]):  # without thrust, the first column of the allocation
        inertia = body_inertia[place] + vehicle.rotors * hub_inertia[place]
        column = np.abs(inverse[:, place + 1])
        is_used = column > SMALLEST_SHARE * column.max()
        accelerations[axis] = float(np.min(reserve[is_used] / column[is_used])) / inertia
    return accelerations
