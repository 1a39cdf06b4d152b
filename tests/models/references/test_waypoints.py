"""The curve through the waypoints: geodesy against published numbers, motion against its bounds and its own spline."""

import itertools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

from dssc_jax.core.errors import ConfigError
from dssc_jax.models.references.waypoints import SOCCER_FIELD, WaypointParams, at, curve, ecef, enu
from dssc_jax.study.components import parse_params

A, B = 6378137.0, 6356752.314245  # TR8350.2, tables 3.1 and 3.3; B to the micrometre
E2 = 1.0 - (B / A) ** 2
NAMES = ("x", "y", "z", "psi")


def local(east_north_up, speed=2.0, acceleration=1.0, latitude=-22.86, longitude=-43.23, yaw_deg=None):
    """Waypoints at about these metres, by the radii of curvature."""
    east, north, up = np.transpose(np.asarray(east_north_up, float))
    sine = np.sin(np.radians(latitude))
    across = A / np.sqrt(1 - E2 * sine**2)
    along = across * (1 - E2) / (1 - E2 * sine**2)
    return WaypointParams(
        tuple(latitude + np.degrees(north / along)),
        tuple(longitude + np.degrees(east / (across * np.cos(np.radians(latitude))))),
        tuple(up),
        speed,
        acceleration,
        yaw_deg,
    )


def scattered(seed):
    """A random path with a mean turn of any size."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.uniform(-1.0, 1.0, 10))
    legs = rng.uniform(5.0, 40.0, 10)[:, None] * np.column_stack([np.cos(heading), np.sin(heading), 0.1 * heading])
    return local(np.concatenate([np.zeros((1, 3)), np.cumsum(legs, axis=0)]), speed=1.5, acceleration=0.7)


PATHS = {
    "soccer": SOCCER_FIELD,
    "straight": local([(0, 0, 5), (30, 40, 5)]),
    "up": local([(0, 0, 0), (0, 0, 20), (5, 0, 25)], speed=1.0),
    "barely": local([(0, 0, 5), (10, 0, 5)], speed=2.3, acceleration=1.0),
    "brisk": local([(0, 0, 5), (50, 0, 5), (50, 50, 5)], speed=5.0, acceleration=50.0),
    "slow": local([(0, 0, 5), (50, 0, 5), (50, 50, 5)], speed=0.001),
    "far": local([(0, 0, 5), (4000, 0, 50), (4000, 4000, 5)], speed=15.0),
    "tiny": local([(0, 0, 0), (0.3, 0, 0), (0.3, 0.3, 0)], speed=0.2),
    **{f"random {seed}": scattered(seed) for seed in range(2)},
}


@pytest.fixture(scope="module")
def curves():
    return {name: curve(params) for name, params in PATHS.items()}


@pytest.fixture(scope="module")
def samples(curves):
    """Times from before the start to after the end; values, slopes and second derivatives of shape (4, count)."""
    return {name: sampled(found) for name, found in curves.items()}


EVALUATE = jax.jit(jax.vmap(at, in_axes=(None, 0)))


def sampled(found):
    t = np.linspace(-1e-3, 1.001, 50001) * float(found.duration)
    points = np.asarray(EVALUATE(found, t))
    return t, points[:, 0], points[:, 1], points[:, 2]


def test_ellipsoid():
    """Semi-axes on the equator and at the poles; the prime vertical radius at 45 degrees."""
    at_pole = ecef(np.radians([0.0, 90.0, -90.0]), np.radians([90.0, 0.0, 0.0]), np.array([0.0, 100.0, 0.0]))
    expected = [[0, A, 0], [0, 0, B + 100.0], [0, 0, -B]]
    np.testing.assert_allclose(at_pole, expected, atol=1e-6)
    across = A / np.sqrt(1 - E2 / 2)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(
        ecef(*np.array([np.pi / 4, 0.0, 7.0])), [(across + 7) * half, 0, (across * (1 - E2) + 7) * half], atol=1e-6
    )


@pytest.mark.parametrize("latitude", [-22.86, 0.0, 51.5, 89.0])
def test_enu_of_near_points(latitude):
    """Odd parts are the arcs of the two radii of curvature, even parts the ground's curvature, to third order."""
    d = 60.0
    steps = [(0, 0, 5), (d, 0, 0), (-d, 0, 0), (0, d, 0), (0, -d, 0), (0, 0, 9)]
    params = local(steps, latitude=latitude, longitude=179.9999)
    longitude = tuple((np.array(params.longitude_deg) + 180) % 360 - 180)  # over the date line
    origin, east, west, north, south, height = enu(params._replace(longitude_deg=longitude))
    np.testing.assert_allclose(origin, [0, 0, 5], atol=1e-8)
    np.testing.assert_allclose(height, [0, 0, 9], atol=1e-8)
    np.testing.assert_allclose((east - west) / 2, [d, 0, 0], atol=1e-5)
    np.testing.assert_allclose((north - south) / 2, [0, d, 0], atol=1e-5)
    sine, tangent = np.sin(np.radians(latitude)), np.tan(np.radians(latitude))
    across = A / np.sqrt(1 - E2 * sine**2)
    along = across * (1 - E2) / (1 - E2 * sine**2)
    np.testing.assert_allclose((east + west) / 2, [0, d**2 * tangent / (2 * across), -(d**2) / (2 * across)], atol=1e-6)
    np.testing.assert_allclose(((north + south) / 2)[2], -(d**2) / (2 * along), atol=1e-6)


def test_distances_survive_the_rotation():
    latitude, longitude, altitude = SOCCER_FIELD[:3]
    target = ecef(np.radians(latitude), np.radians(longitude), np.array(altitude))
    legs = np.linalg.norm(np.diff(target, axis=0), axis=1)
    np.testing.assert_allclose(np.linalg.norm(np.diff(enu(SOCCER_FIELD), axis=0), axis=1), legs, atol=1e-8)


@pytest.mark.parametrize("name", sorted(PATHS.keys() - {"far"}))
def test_passes_the_waypoints_in_order(name, samples):
    params, (_, y, _, _) = PATHS[name], samples[name]
    yaw = np.unwrap(np.radians(params.yaw_deg or [0.0] * len(params.altitude)))
    k = 0
    for point, psi in zip(enu(params), yaw, strict=True):
        close = np.flatnonzero(np.linalg.norm(y[:3, k:].T - point, axis=1) < 0.01)
        assert close.size
        k += close[0] + 1
        assert y[3, k] == pytest.approx(psi, abs=1e-3)


@pytest.mark.parametrize("name", PATHS)
def test_twice_continuously_differentiable(name, curves, samples):
    """Each segment ends where the next begins, with slope and bend. Rounding of y over step^2 is what remains."""
    table = curves[name].coefficients
    size = np.abs(table[..., 0]).max()
    order = np.arange(6)
    for k in range(3):
        weight = np.prod([order - j for j in range(k)], axis=0) if k else np.ones(6)
        end, start = table[:-1] @ weight, table[1:, :, k] * max(k, 1)
        np.testing.assert_allclose(end, start, rtol=0, atol=500 * np.finfo(float).eps * size)
    t, y, y_dot, y_ddot = samples[name]
    dt = t[1] - t[0]
    for low, high in ((y, y_dot), (y_dot, y_ddot)):  # the trapezoid leaves what the next derivative does within dt
        gap = np.diff(low) - dt * (high[:, 1:] + high[:, :-1]) / 2
        assert np.abs(gap).max() <= dt * np.abs(np.diff(high)).max() + 1e-12 * size


def test_derivatives_are_those_of_the_value(curves):
    found = curves["soccer"]
    t = np.concatenate([np.linspace(-3.0, found.duration + 3.0, 1001), found.step * np.arange(50) + 1e-5])

    def pair(found, t):
        return jnp.stack([jnp.stack(p[:2]) for p in at(found, t)])

    points = np.asarray(EVALUATE(found, t))
    derivatives = jax.jit(jax.vmap(jax.jacfwd(pair, argnums=1), in_axes=(None, 0), out_axes=2))(found, t)
    np.testing.assert_allclose(derivatives[:, 0], points[:, 1], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(derivatives[:, 1], points[:, 2], rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("name", PATHS)
def test_bounds_are_kept_and_reached(name, samples):
    params, (_, _, y_dot, y_ddot) = PATHS[name], samples[name]
    speed = np.linalg.norm(y_dot[:3], axis=0)
    assert speed.max() <= params.speed
    assert speed.max() >= 0.999 * params.speed
    along = np.abs(np.sum(y_dot[:3] * y_ddot[:3], axis=0)) / np.maximum(speed, 1e-30)
    assert along.max() <= params.acceleration
    assert np.linalg.norm(y_ddot[:3], axis=0).max() <= np.hypot(params.acceleration, 0.5 * 9.80665)


@pytest.mark.parametrize("name", PATHS)
def test_rests_at_both_ends_for_ever(name, curves):
    found = curves[name]
    points, yaw = enu(PATHS[name]), PATHS[name].yaw_deg or (0.0,)
    end = found.duration
    for times, i in (((-1e3, -1e-9, 0.0), 0), ((end + 1e-9, end + 1, 1e6), -1)):
        motion = np.asarray(EVALUATE(found, np.array(times)))  # shape (4, 3, times)
        np.testing.assert_allclose(motion[:, 0].T, [[*points[i], np.radians(yaw[i])]] * 3, atol=1e-8)
        np.testing.assert_array_equal(motion[:, 1:], 0.0)


@pytest.mark.parametrize("name", ["soccer", "random 0"])
def test_follows_scipys_spline(name, curves):
    """Cruising, the way is linear in time: the arc by adaptive quadrature says where on its spline the curve is."""
    params, found = PATHS[name], curves[name]
    points = enu(params)
    yaw = np.radians(params.yaw_deg or [0.0] * len(points))
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    path = CubicSpline(chord, np.column_stack([points, yaw]), bc_type="natural")
    tangent = path.derivative()

    def arc(start, end):
        return quad(lambda u: np.linalg.norm(tangent(u)[:3]), start, end, epsabs=1e-10, limit=200)[0]

    legs = np.concatenate([[0.0], np.cumsum([arc(*ends) for ends in itertools.pairwise(chord)])])
    ramp = 1.875 * params.speed / params.acceleration
    scale = found.duration / (legs[-1] / params.speed + ramp)
    assert 1.0 <= scale < 1.0 + 2e-5
    u = np.random.default_rng(0).uniform(0.1, 0.9, 20) * chord[-1]
    leg = np.searchsorted(chord, u) - 1
    way = legs[leg] + [arc(*ends) for ends in zip(chord[leg], u, strict=True)]
    motion = np.asarray(EVALUATE(found, scale * (way / params.speed + ramp / 2)))
    np.testing.assert_allclose(motion[:, 0].T, path(u), atol=1e-8)
    rate = params.speed / scale * tangent(u) / np.linalg.norm(tangent(u)[:, :3], axis=1, keepdims=True)
    np.testing.assert_allclose(motion[:, 1].T, rate, atol=1e-5)
    ramping = np.asarray(EVALUATE(found, scale * ramp * np.linspace(0.05, 1.0, 20)))
    x = np.linspace(0.05, 1.0, 20)
    smooth = params.speed / scale * x**3 * (10 - 15 * x + 6 * x**2)
    np.testing.assert_allclose(np.linalg.norm(ramping[:3, 1], axis=0), smooth, atol=1e-5)


def test_soccer_field_holds_its_path(samples):
    _, y, y_dot, _ = samples["soccer"]
    assert 12 <= len(SOCCER_FIELD.altitude) <= 15
    assert np.ptp(y[0]) < 105.0
    assert np.ptp(y[1]) < 68.0
    assert 4.9 < y[2].min() < y[2].max() < 8.1
    assert np.abs(y_dot[3]).max() < 0.5


def test_yaw_turns_the_shorter_way():
    found = curve(local([(0, 0, 5), (20, 0, 5), (40, 0, 5)], yaw_deg=(170.0, -170.0, -150.0)))
    _, y, _, _ = sampled(found)
    np.testing.assert_allclose(np.degrees(y[3, [0, -1]]), [170.0, 210.0], atol=1e-9)
    assert np.abs(np.diff(y[3])).max() < 1e-3


def test_single_precision(curves):
    """The table is stored in float64; t decides. 126 s in float32 is known to 4e-6 s, 1.5e-5 m of the way."""
    found = curves["soccer"]
    t = np.linspace(0.0, 130.0, 4001)
    exact = np.asarray(EVALUATE(found, t))
    with jax.numpy_dtype_promotion("strict"):
        single = jax.tree.map(np.asarray, EVALUATE(found, t.astype(np.float32)))
    assert all(x.dtype == np.float32 for x in jax.tree.leaves(single))
    np.testing.assert_allclose(np.asarray(single), exact, atol=1e-4)
    with jax.enable_x64(False):
        plain = jax.jit(lambda t: at(found, t))(50.0)
        assert all(x.dtype == np.float32 for x in jax.tree.leaves(plain))
        np.testing.assert_allclose(np.asarray(plain), np.asarray(at(found, 50.0)), atol=1e-6)


def test_any_way_of_calling_is_the_same(curves):
    found = curves["soccer"]
    plain = at(found, 33.3)
    for second in (
        jax.jit(lambda t: at(found, t))(33.3),
        jax.jit(at)(found, 33.3),
        jax.tree.map(lambda x: x[1], jax.vmap(lambda t: at(found, t))(jnp.array([0.0, 33.3]))),
        at(found._replace(coefficients=jnp.asarray(found.coefficients)), jnp.asarray(33.3)),
    ):
        np.testing.assert_allclose(np.asarray(second), np.asarray(plain), rtol=1e-12, atol=1e-12)
    assert np.asarray(at(found, 33)).shape == (4, 3)


SQUARE = local([(0, 0, 5), (20, 0, 5), (20, 20, 5), (0, 20, 5)])


def changed(values, i, value):
    return (*values[:i], value, *values[i + 1 :])


BAD = {
    "one": ({"latitude_deg": (1.0,), "longitude_deg": (1.0,), "altitude": (1.0,)}, "latitude_deg", "got 1"),
    "lengths": ({"altitude": (1.0, 2.0)}, "altitude", "must hold 4 numbers, as latitude_deg does, got 2"),
    "yaw": ({"yaw_deg": (0.0,)}, "yaw_deg", "must hold 4 numbers"),
    "latitude": ({"latitude_deg": changed(SQUARE.latitude_deg, 2, 90.5)}, "latitude_deg.2", "<= 90, got 90.5"),
    "longitude": ({"longitude_deg": changed(SQUARE.longitude_deg, 1, -181.0)}, "longitude_deg.1", ">= -180, got -181"),
    "nan": ({"latitude_deg": changed(SQUARE.latitude_deg, 0, float("nan"))}, "latitude_deg.0", "got nan"),
    "infinite yaw": ({"yaw_deg": (0.0, float("inf"), 0.0, 0.0)}, "yaw_deg.1", "must be finite, got inf"),
    "infinite speed": ({"speed": float("inf")}, "speed", "must be finite"),
    "speed": ({"speed": 0.0}, "speed", "must be > 0, got 0"),
    "acceleration": ({"acceleration": -1.0}, "acceleration", "must be > 0, got -1"),
    "sign": ({"latitude_deg": changed(SQUARE.latitude_deg, 3, 22.86)}, "latitude_deg.3", "within 10 km of waypoint 0"),
    "repeated": (
        {k: changed(getattr(SQUARE, k), 2, getattr(SQUARE, k)[1]) for k in ("latitude_deg", "longitude_deg")},
        "latitude_deg.2",
        "waypoint 2 repeats waypoint 1",
    ),
    "back": (
        local([(0, 0, 5), (20, 0, 5), (0, 0, 5)])._asdict(),
        "latitude_deg.1",
        "back on itself at waypoint 1",
    ),
    "bend": ({"speed": 8.0, "acceleration": 9.0}, "speed", "across the path near waypoint"),
    "short": ({"acceleration": 0.05}, "speed", "is too short to reach it and stop at 0.05 m/s^2"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line(case):
    changes, location, rule = BAD[case]
    with pytest.raises(ConfigError) as error:
        curve(SQUARE._replace(**changes))
    assert error.value.where == location
    assert rule in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("case", ["bend", "short"])
def test_the_speed_that_would_do_does(case):
    params = SQUARE._replace(**BAD[case][0])
    with pytest.raises(ConfigError) as error:
        curve(params)
    allowed = float(re.findall(r"at most ([\d.]+) m/s", str(error.value))[0])
    curve(params._replace(speed=allowed))
    with pytest.raises(ConfigError):
        curve(params._replace(speed=1.02 * allowed))


def test_a_table_becomes_the_parameters():
    table = {k: list(v) if isinstance(v, tuple) else v for k, v in SQUARE._asdict().items() if v is not None}
    assert parse_params(table, WaypointParams)[0] == SQUARE
    with pytest.raises(ConfigError, match=r"latitude_deg: WGS 84 latitude \[deg\] must be <= 90, got 99"):
        parse_params({**table, "latitude_deg": [99.0]}, WaypointParams)
