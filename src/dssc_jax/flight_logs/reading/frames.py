"""Conversion from PX4's axes to the model's: the fields that a topic of a log has in addition to its own.

PX4's local frame is north, east, down (NED), and its body axes point forward, right, down (FRD). The model's inertial
frame has z up; waypoints make it east, north, up (ENU), see :mod:`dssc_jax.models.references.waypoints`. Its body axes
point forward, left, up (FLU), and its Euler angles are R = R_z(psi) R_y(theta) R_x(phi), body to inertial. Hence

    R = [[0, 1, 0], [1, 0, 0], [0, 0, -1]] R_PX4 diag(1, -1, -1)

    phi = phi_PX4,   theta = -theta_PX4,   psi = pi/2 - psi_PX4

Sources: PX4 user guide, "Frames and coordinate systems"; B. L. Stevens, F. L. Lewis, E. N. Johnson, Aircraft Control
and Simulation, 3rd ed., 2016, section 1.3 (quaternion to rotation matrix and Euler angles).
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeAlias

import numpy as np

MICROSECOND = 1e-6  # s
Fields: TypeAlias = Mapping[str, np.ndarray]
"""The fields of a topic by name, each of shape (messages,)."""


class DerivedField(NamedTuple):
    """A field in the model's axes.

    Args:
        name: Name of the field in the topic.
        unit: Unit of the field.
        needs: The topic's own fields from which the field is computed.
        of: Function from the values of the needed fields to the values of the field.
    """

    name: str
    unit: str
    needs: tuple[str, ...]
    of: Callable[..., np.ndarray]


def identity(values: np.ndarray) -> np.ndarray:
    """Leave values as they are."""
    return values


def negative(values: np.ndarray) -> np.ndarray:
    """Change the sign of values."""
    return -values


def yaw_of_heading(heading: np.ndarray) -> np.ndarray:
    """psi in (-pi, pi], counterclockwise from east, from PX4's heading clockwise from north, both in rad."""
    return np.arctan2(np.cos(heading), np.sin(heading))


def roll_of(w: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """phi [rad] from PX4's quaternion w, x, y, z, which rotates FRD to NED."""
    return np.arctan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))


def pitch_of(w: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """theta [rad] from PX4's quaternion w, x, y, z, which rotates FRD to NED."""
    return -np.arcsin(np.clip(2.0 * (w * y - x * z), -1.0, 1.0))


def yaw_of(w: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """psi in (-pi, pi] [rad] from PX4's quaternion w, x, y, z, which rotates FRD to NED."""
    return yaw_of_heading(np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)))


def yaw_rate_of(w: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray, stamp: np.ndarray) -> np.ndarray:
    """psi' [rad/s] by differences of psi over the times of the messages; NaN if there is one message only.

    Args:
        w: Real part of PX4's quaternion, which rotates FRD to NED, shape (messages,), as all arguments.
        x: First imaginary part.
        y: Second imaginary part.
        z: Third imaginary part.
        stamp: Times of the messages [us].
    """
    if len(stamp) < 2:
        return np.full(len(stamp), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.gradient(np.unwrap(yaw_of(w, x, y, z)), MICROSECOND * stamp)


def local_vector_fields(
    names: tuple[str, str, str], unit: str, north_east_down: tuple[str, str, str]
) -> list[DerivedField]:
    """The fields of a vector of PX4's local frame as east, north and up.

    Args:
        names: Names of the east, north and up components.
        unit: Unit of the components.
        north_east_down: The topic's fields with the north, east and down components.
    """
    north, east, down = north_east_down
    sources = ((east, identity), (north, identity), (down, negative))
    return [DerivedField(name, unit, (field,), of) for name, (field, of) in zip(names, sources, strict=True)]


def body_rate_fields(forward_right_down: tuple[str, str, str]) -> list[DerivedField]:
    """The fields of a rate about forward, right and down as p, q and r about forward, left and up."""
    sources = zip("pqr", forward_right_down, (identity, negative, negative), strict=True)
    return [DerivedField(name, "rad/s", (field,), of) for name, field, of in sources]


def attitude_fields(quaternion: str) -> list[DerivedField]:
    """The fields of a quaternion as Euler angles, and psi'."""
    needs = tuple(f"{quaternion}[{i}]" for i in range(4))
    angles = (("phi", roll_of), ("theta", pitch_of), ("psi", yaw_of))
    fields = [DerivedField(name, "rad", needs, of) for name, of in angles]
    return [*fields, DerivedField("psi_dot", "rad/s", (*needs, "timestamp"), yaw_rate_of)]


def components(name: str) -> tuple[str, str, str]:
    """The names of the three elements of a topic's array field."""
    return f"{name}[0]", f"{name}[1]", f"{name}[2]"


PLACE = ("east", "north", "up")
SPEED = ("v_east", "v_north", "v_up")
DERIVED = {
    "vehicle_local_position": (
        *local_vector_fields(PLACE, "m", ("x", "y", "z")),
        *local_vector_fields(SPEED, "m/s", ("vx", "vy", "vz")),
        DerivedField("psi", "rad", ("heading",), yaw_of_heading),
    ),
    "vehicle_local_position_setpoint": (
        *local_vector_fields(PLACE, "m", ("x", "y", "z")),
        *local_vector_fields(SPEED, "m/s", ("vx", "vy", "vz")),
        DerivedField("psi", "rad", ("yaw",), yaw_of_heading),
        DerivedField("psi_dot", "rad/s", ("yawspeed",), negative),
    ),
    "trajectory_setpoint": (
        *local_vector_fields(PLACE, "m", components("position")),
        *local_vector_fields(SPEED, "m/s", components("velocity")),
        DerivedField("psi", "rad", ("yaw",), yaw_of_heading),
        DerivedField("psi_dot", "rad/s", ("yawspeed",), negative),
    ),
    "vehicle_attitude": tuple(attitude_fields("q")),
    "vehicle_attitude_setpoint": tuple(attitude_fields("q_d")),
    "vehicle_angular_velocity": tuple(body_rate_fields(components("xyz"))),
    "vehicle_rates_setpoint": tuple(body_rate_fields(("roll", "pitch", "yaw"))),
}
"""What each topic has in the model's axes, where it has the fields that this follows from."""
GROUND_TRUTH = "_groundtruth"
"""Suffix of a simulator's topics, whose fields are those of the estimate."""


def derived_fields(topic: str, columns: Fields) -> dict[str, DerivedField]:
    """The fields in the model's axes that a topic with given columns has in addition to its own, by name.

    A field that the topic itself has under the same name is left out.

    Args:
        topic: Name of the topic, without instance.
        columns: The topic's own fields.
    """
    derived = {}
    for field in DERIVED.get(topic.removesuffix(GROUND_TRUTH), ()):
        if field.name not in columns and all(name in columns for name in field.needs):
            derived[field.name] = field
    return derived


def field_values(topic: str, columns: Fields, name: str) -> np.ndarray | None:
    """A field of a topic, its own or one in the model's axes, as float64; None if the topic lacks it.

    Example:
        >>> down = {"x": np.zeros(1), "y": np.ones(1), "z": np.array([-2.0])}
        >>> [float(field_values("vehicle_local_position", down, name)[0]) for name in ("east", "north", "up")]
        [1.0, 0.0, 2.0]
    """
    with np.errstate(invalid="ignore"):  # a signalling NaN of a damaged log
        if name in columns:
            return columns[name].astype(float)
        field = derived_fields(topic, columns).get(name)
        return None if field is None else field.of(*(columns[source].astype(float) for source in field.needs))


PX4_COLUMNS: dict[str, dict[str, tuple[str, ...]]] = {
    axis: {
        "y": (f"vehicle_local_position.{place}",),
        "y_dot": (f"vehicle_local_position.{speed}",),
        "y_ref": (f"vehicle_local_position_setpoint.{place}", f"trajectory_setpoint.{place}"),
        "y_ref_dot": (f"trajectory_setpoint.{speed}",),
        "u_total": (f"vehicle_local_position_setpoint.{speed}",),
    }
    for axis, place, speed in zip("xyz", PLACE, SPEED, strict=True)
} | {
    "psi": {
        "y": ("vehicle_attitude.psi", "vehicle_local_position.psi"),
        "y_dot": ("vehicle_attitude.psi_dot",),
        "y_ref": ("vehicle_local_position_setpoint.psi", "trajectory_setpoint.psi"),
        "y_ref_dot": ("vehicle_local_position_setpoint.psi_dot", "trajectory_setpoint.psi_dot"),
        "u_total": ("vehicle_rates_setpoint.r",),
    }
}
"""The columns of a multirotor's channels in a ULog, the first that the log has.

u_total is the velocity setpoint of PX4's position controller; that of psi is the rate about body z which PX4's attitude
controller sets, psi' of a level vehicle.
"""
