"""The field test's trajectory (Section V-C): a twice differentiable curve through georeferenced waypoints.

The host computes a table once: it converts WGS 84 to local east, north, up (ENU), fits a cubic spline through the
waypoints, plans a rest-to-rest motion along it at bounded speed, and stores the motion as quintics on equal time
steps. The simulation evaluates one row of the table at a time.

References:
    NIMA TR8350.2, Department of Defense World Geodetic System 1984, 3rd ed., 2000 (ellipsoid, geodetic to ECEF).
    P. D. Groves, Principles of GNSS ... Navigation Systems, 2nd ed., Artech House, 2013, chapter 2 (ECEF to ENU).
"""

import math
from typing import Annotated, NamedTuple, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial.polynomial import polyder
from scipy.interpolate import CubicSpline

from dssc_jax.core.contracts import Reference
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ReferencePoint, Scalar
from dssc_jax.models.references.waypoint_paths import (
    check_turns,
    nearest_waypoint,
    nonzero_path_speed,
    parameters_at_length,
    path_derivatives,
    path_grid,
)

SEMI_MAJOR_AXIS = 6378137.0  # a [m] of WGS 84 (TR8350.2, table 3.1)
FLATTENING = 1.0 / 298.257223563  # f of WGS 84 (TR8350.2, table 3.1)
STANDARD_GRAVITY = 9.80665  # g_n [m/s^2] (3rd CGPM, 1901)
LATERAL_LIMIT = 0.5 * STANDARD_GRAVITY  # greatest acceleration across the path [m/s^2]: a tilt of 27 degrees (assumed)
FRAME_RADIUS = 1e4  # reach of the local frame [m] (assumed): the ground is 8 m below the tangent plane there
SAME = 0.01  # consecutive waypoints nearer than this [m] count as one (assumed; the precision of RTK positioning)
SEGMENT_TIME = 0.02  # duration of a segment of the table [s]
FEWEST_SEGMENTS = 256
MOST_SEGMENTS = 65536
RAMP = 1.875  # peak slope of 10 x^3 - 15 x^4 + 6 x^5 on [0, 1]
STEPS_OF_A_RAMP = 8.0  # fewest segments of the table on which the speed may rise

LATITUDE = Quantity("deg", "WGS 84 latitude", at_least=-90.0, at_most=90.0, law=False)
LONGITUDE = Quantity("deg", "WGS 84 longitude", at_least=-180.0, at_most=180.0, law=False)
ALTITUDE = Quantity(
    "m", "height above the first point's ground", at_least=-FRAME_RADIUS, at_most=FRAME_RADIUS, law=False
)


class WaypointParams(NamedTuple):
    """Waypoints in the order of flight.

    The origin of x (east), y (north) and z (up) is the ground at the first waypoint. Yaw is measured from east towards
    north, as psi of the model and unlike a compass heading. It turns the shorter way from one waypoint to the next;
    without yaw, psi is 0. Heights are differences of ellipsoidal heights. The ground is assumed to lie on the
    ellipsoid; for each metre of the ground's true height above the ellipsoid, this shortens lengths by 1.6e-7.
    """

    latitude_deg: Annotated[tuple[Scalar, ...], LATITUDE]
    longitude_deg: Annotated[tuple[Scalar, ...], LONGITUDE]
    altitude: Annotated[tuple[Scalar, ...], ALTITUDE]
    speed: Annotated[Scalar, Quantity("m/s", "cruise speed, never exceeded", above=0.0, law=False)]
    acceleration: Annotated[Scalar, Quantity("m/s^2", "peak acceleration from and to rest", above=0.0, law=False)]
    yaw_deg: Annotated[tuple[Scalar, ...] | None, Quantity("deg", "yaw at the waypoints", law=False)] = None


class Curve(NamedTuple):
    """Position and yaw over time, twice continuously differentiable, at rest before 0 and after ``duration``.

    Args:
        step: Duration of a segment [s].
        coefficients: Shape (segments + 1, 4, 6): x, y, z [m] and psi [rad] in ascending powers of the time within
            the segment over ``step``; the last row is the last waypoint.
    """

    step: Scalar
    coefficients: jax.Array | np.ndarray

    @property
    def duration(self) -> Scalar:
        """Time of arrival [s]."""
        return self.step * (self.coefficients.shape[0] - 1)


def ecef(latitude: np.ndarray, longitude: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Convert geodetic coordinates to Earth-centred, Earth-fixed (ECEF) positions.

    Args:
        latitude: Latitudes [rad], any shape (...).
        longitude: Longitudes [rad], shape (...).
        height: Ellipsoidal heights [m], shape (...).

    Returns:
        Positions [m], shape (..., 3).
    """
    eccentricity2 = FLATTENING * (2.0 - FLATTENING)  # squared
    normal = SEMI_MAJOR_AXIS / np.sqrt(1.0 - eccentricity2 * np.sin(latitude) ** 2)  # prime vertical radius
    axis_distance = (normal + height) * np.cos(latitude)
    up = (normal * (1.0 - eccentricity2) + height) * np.sin(latitude)
    return np.stack([axis_distance * np.cos(longitude), axis_distance * np.sin(longitude), up], axis=-1)


def enu(params: WaypointParams) -> np.ndarray:
    """Convert the waypoints to east, north and up [m] in the tangent plane at the ground of the first, shape (n, 3)."""
    latitude = np.radians(np.asarray(params.latitude_deg, float))
    longitude = np.radians(np.asarray(params.longitude_deg, float))
    east = np.array([-np.sin(longitude[0]), np.cos(longitude[0]), 0.0])
    up = np.array([east[1] * np.cos(latitude[0]), -east[0] * np.cos(latitude[0]), np.sin(latitude[0])])
    origin = ecef(latitude[:1], longitude[:1], np.zeros(1))
    offset = ecef(latitude, longitude, np.asarray(params.altitude, float)) - origin
    return offset @ np.stack([east, np.cross(up, east), up], axis=-1)


def check_path(params: WaypointParams) -> None:
    """Check the waypoints: their numbers, that all are near the first one, and that consecutive ones differ.

    Raises:
        ConfigError: A condition does not hold.
    """
    check_numbers(params)
    points = enu(params)
    distances = np.linalg.norm(points, axis=1)  # from the ground at the first waypoint
    spacings = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if distances.max() > FRAME_RADIUS:
        i = int(distances.argmax())
        axis = "latitude_deg" if abs(points[i, 1]) > abs(points[i, 0]) else "longitude_deg"  # north or east
        reach = f"{FRAME_RADIUS / 1e3:g} km of waypoint 0, got {distances[i] / 1e3:.4g} km"
        raise ConfigError(f"{axis}.{i}", f"waypoint {i} must be within {reach}")
    if spacings.min() < SAME:
        i = int(spacings.argmin())
        raise ConfigError(f"latitude_deg.{i + 1}", f"waypoint {i + 1} repeats waypoint {i} ({spacings[i]:.2g} m away)")


def check_numbers(params: WaypointParams) -> None:
    """Require at least two waypoints, lists of one length, and finite numbers in their ranges.

    Raises:
        ConfigError: A list is too short or has another length, or a number is out of its range.
    """
    count = len(params.latitude_deg)
    if count < 2:
        raise ConfigError("latitude_deg", f"must hold at least two waypoints, got {count}")
    for name, hint in get_type_hints(WaypointParams, include_extras=True).items():
        values = getattr(params, name)
        (quantity,) = hint.__metadata__
        if values is None:
            continue
        if np.ndim(values) == 0:
            require_in_range(name, values, quantity)
            continue
        if len(values) != count:
            raise ConfigError(name, f"must hold {count} numbers, as latitude_deg does, got {len(values)}")
        for i, value in enumerate(values):
            require_in_range(f"{name}.{i}", value, quantity)


def require_in_range(name: str, value: float, quantity: Quantity) -> None:
    """Require that a number is finite and in the range of a quantity.

    Args:
        name: Place of the number, for the message.
        value: The number.
        quantity: Unit, meaning and range.

    Raises:
        ConfigError: The number is not.
    """
    violation = quantity.violated_by(value, value)  # a number is an interval whose ends are equal
    if violation is None and not math.isfinite(value):
        violation = "must be finite"
    if violation:
        raise ConfigError(name, f"{quantity.meaning} [{quantity.unit}] {violation}, got {value:g}")


def path_through(params: WaypointParams) -> CubicSpline:
    """Fit the path: a natural cubic spline of x, y, z [m] and psi [rad] through the waypoints.

    Its parameter u [m] is the length of the straight lines between the waypoints, from the first one on.
    """
    points = enu(params)
    yaw = np.zeros(len(points))
    if params.yaw_deg is not None:
        yaw = np.unwrap(np.radians(np.asarray(params.yaw_deg, float)))
    distances = np.linalg.norm(np.diff(points, axis=0), axis=1)
    chord = np.concatenate([[0.0], np.cumsum(distances)])
    return CubicSpline(chord, np.column_stack([points, yaw]), bc_type="natural")


def check_speed(params: WaypointParams, path: CubicSpline, u: np.ndarray, total: float) -> None:
    """Require a cruise speed for which the path is long and straight enough.

    Args:
        params: Speed and acceleration.
        path: The path.
        u: Parameters at which the curvature is taken, rising.
        total: Length of the path [m].

    Raises:
        ConfigError: The speed is too high for the path's length or for its turns.
    """
    slope = path(u, 1)[:, :3]
    bend = path(u, 2)[:, :3]
    curvature = np.linalg.norm(np.cross(slope, bend), axis=1) / nonzero_path_speed(path, u) ** 3
    peak = curvature.argmax()
    by_length = math.sqrt(total * params.acceleration / RAMP)  # highest speed that the path has room to reach and leave
    by_turn = math.sqrt(LATERAL_LIMIT / max(curvature[peak], 1e-12))  # highest speed in the sharpest turn
    if params.speed > by_turn:
        acceleration = params.speed**2 * curvature[peak] / STANDARD_GRAVITY
        waypoint = nearest_waypoint(path, float(u[peak]))
        rule = f"{acceleration:.3g} g across the path near waypoint {waypoint} (from 0), limit 0.5 g"
    elif params.speed > by_length:
        rule = f"the path of {total:.3g} m is too short to reach it and stop at {params.acceleration:g} m/s^2"
    else:
        return
    limit = 0.995 * min(by_turn, by_length)  # still below when rounded to three digits
    raise ConfigError("speed", f"must be at most {limit:.3g} m/s, got {params.speed:g}: {rule}")


def rest_to_rest(t: np.ndarray, total: float, speed: float, ramp: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the motion along a path from rest to rest: a ramp of the speed, cruise, and the same ramp down.

    The ramp is 10 x^3 - 15 x^4 + 6 x^5, so that the speed is twice continuously differentiable.

    Args:
        t: Times [s], shape (n,).
        total: Length of the path [m].
        speed: Cruise speed [m/s].
        ramp: Duration of a ramp [s].

    Returns:
        Distance [m], speed [m/s] and tangential acceleration [m/s^2] at each time, shape (n,) each.
    """
    duration = total / speed + ramp
    sooner = np.minimum(t, duration - t)  # time from the start or to the end: the motion is symmetric
    is_first_half = sooner == t
    x = np.clip(sooner / ramp, 0.0, 1.0)
    distance = speed * (ramp * x**4 * (2.5 - 3.0 * x + x**2) + np.maximum(sooner - ramp, 0.0))
    rate = speed * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    acceleration = speed / ramp * 30.0 * (x * (1.0 - x)) ** 2
    travelled = np.where(is_first_half, distance, total - distance)
    return travelled, rate, np.where(is_first_half, acceleration, -acceleration)


def quintics(y: np.ndarray, y_dot: np.ndarray, y_ddot: np.ndarray, step: float) -> np.ndarray:
    """Quintic Hermite polynomials between equidistant nodes, and a constant after the last node.

    Args:
        y: Values at the nodes, shape (n, 4).
        y_dot: First derivatives, shape (n, 4).
        y_ddot: Second derivatives, shape (n, 4).
        step: Time between two nodes [s].

    Returns:
        Coefficients in ascending powers of the time over ``step``, shape (n, 4, 6).
    """
    # powers 0 to 2 hold the start of a segment; powers 3 to 5 remove the mismatch at its end
    low = np.stack([y[:-1], step * y_dot[:-1], 0.5 * step**2 * y_ddot[:-1]], axis=-1)
    slope = step * y_dot[1:] - low @ [0.0, 1.0, 2.0]
    jump = y[1:] - low.sum(axis=-1)
    bend = step**2 * y_ddot[1:] - 2.0 * low[..., 2]
    mismatch = np.stack([jump, slope, bend], axis=-1)
    high = mismatch @ np.array([[10.0, -15.0, 6.0], [-4.0, 7.0, -3.0], [0.5, -1.0, 0.5]])
    hold = np.pad(y[-1:, :, None], ((0, 0), (0, 0), (0, 5)))
    return np.concatenate([np.concatenate([low, high], axis=-1), hold])


def slowed_step(step: float, coefficients: np.ndarray, params: WaypointParams) -> float:
    """Lengthen the time between two nodes so that the motion keeps its bounds between the nodes, too.

    Slowing a motion down by a factor divides its speed by the factor, and its acceleration by the factor's square.

    Args:
        step: Time between two nodes [s].
        coefficients: The motion, from :func:`quintics`.
        params: The bounds.

    Returns:
        A step [s] that is usually longer by a factor of 1 + 1e-5.
    """
    powers = np.vander(np.linspace(0.0, 1.0, 17), 5, increasing=True).T  # of 17 times in each segment, shape (5, 17)
    slope = polyder(coefficients[:, :3], axis=-1)
    velocity = slope @ powers / step
    acceleration = polyder(slope, axis=-1) @ powers[:4] / step**2
    speed = np.linalg.norm(velocity, axis=1)
    tangential = np.abs(np.sum(velocity * acceleration, axis=1)) / np.maximum(speed, np.finfo(float).tiny)
    root_ratio = math.sqrt(tangential.max() / float(params.acceleration))
    factor = max(1.0, speed.max() / float(params.speed), root_ratio)
    return float(step * (factor + 0.01 * (factor - 1.0) + 1e-5))  # a little more, for peaks between the 17 points


def curve(params: WaypointParams) -> Curve:
    """Compute the table of the motion along the path on the host, before tracing; :func:`at` evaluates it.

    The path gets a motion from rest to rest. Position and yaw at equal time steps make the table. Where the motion of
    the table exceeds the bounds between its nodes, all of it is slowed down at the end.

    Raises:
        ConfigError: Waypoints are too few, repeated or scattered, numbers are out of range, or the speed is impossible.
    """
    check_path(params)
    path = path_through(params)
    cruise = float(params.speed)
    grid, lengths = path_grid(path)
    total = lengths[-1]
    check_turns(path, grid)
    check_speed(params, path, grid, total)
    ramp = RAMP * cruise / float(params.acceleration)
    flight = total / cruise
    count = int(np.clip(math.ceil((flight + ramp) / SEGMENT_TIME), FEWEST_SEGMENTS, MOST_SEGMENTS))
    ramp = max(ramp, STEPS_OF_A_RAMP * (flight + ramp) / count)
    duration = flight + ramp
    distances, speed, acceleration = rest_to_rest(np.linspace(0.0, duration, count + 1), total, cruise, ramp)
    u = parameters_at_length(path, grid, lengths, distances)
    y_dot, y_ddot = path_derivatives(path, u, speed, acceleration)
    coefficients = quintics(path(u), y_dot, y_ddot, duration / count)
    return Curve(slowed_step(duration / count, coefficients, params), coefficients)


def at(curve: Curve, t: Scalar) -> tuple[ReferencePoint, ReferencePoint, ReferencePoint, ReferencePoint]:
    """The desired x, y, z [m] and psi [rad] at t [s], in the precision of t; psi is continuous and may pass +-pi.

    A Horner scheme evaluates the quintic of the segment in which t lies. Before 0 and after the last segment the first
    and the last waypoint hold.

    Args:
        curve: The table of the motion.
        t: Time [s].
    """
    dtype = jnp.result_type(t, float)
    step = jnp.asarray(curve.step, dtype)
    phase = jnp.clip(jnp.asarray(t, dtype) / step, 0, curve.coefficients.shape[0] - 1)
    x = phase - jnp.floor(phase)  # within the segment, in [0, 1)
    row = jnp.take(curve.coefficients, phase.astype(jnp.int32), axis=0, mode="clip").astype(dtype)
    value = slope = bend = jnp.zeros((4,), dtype)
    for power in reversed(range(6)):  # Horner's rule with its first two derivatives
        bend = bend * x + slope
        slope = slope * x + value
        value = value * x + row[:, power]
    east, north, up, psi = (ReferencePoint(value[i], slope[i] / step, 2.0 * bend[i] / step**2) for i in range(4))
    return east, north, up, psi


SOCCER_FIELD = WaypointParams(
    tuple(-22.86 + 1e-6 * n for n in (-200, -227, -182, 53, 288, 324, 288, 53, -164, -191, -128, 71, 233, 71, -146)),
    tuple(-43.23 + 1e-6 * n for n in (-400, 9, 380, 457, 360, -30, -400, -478, -342, -10, 302, 380, 243, -49, -361)),
    altitude=(5.0, 5.5, 6.0, 6.5, 7.0, 8.0, 7.5, 7.0, 6.5, 6.0, 5.5, 6.0, 6.5, 6.0, 5.0),
    speed=4.0,
    acceleration=1.0,
    yaw_deg=(0.0, 15.0, 45.0, 90.0, 75.0, 60.0, 30.0, 0.0, -30.0, -45.0, -30.0, 0.0, 30.0, 45.0, 0.0),
)
"""Invented waypoints, not the field test's: a lap of a 105 m by 68 m field, a smaller one, a diagonal, at 5 to 8 m."""

WAYPOINTS = Reference(WaypointParams, at, curve, last_change=lambda flown: float(flown.duration))
