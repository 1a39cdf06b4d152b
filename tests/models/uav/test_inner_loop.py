"""Inner loops: exact linearisation, transfer functions, feed-forward, bounds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from scipy.spatial.transform import Rotation

from dssc_jax.core.signals import PlantInput
from dssc_jax.core.vectors import Quaternion, Vec3
from dssc_jax.models.uav.inner_loops.article import (
    AttitudeReference,
    Euler,
    InnerGains,
    Integrals,
    ThrustRule,
    demand,
    euler_rates,
    moment_for,
    trig_of,
)
from dssc_jax.models.uav.inner_loops.sampled import Craft
from dssc_jax.models.uav.plant import UAV, UavParams
from dssc_jax.models.uav.vehicle import GRAVITY, HEXACOPTER, QUADROTOR

INERTIA = np.array([0.44, 0.61, 0.74])
MASS = 10.9
ZERO = Vec3(0.0, 0.0, 0.0)


def quaternion_of(rotation):
    x, y, z, w = rotation.as_quat()
    return Quaternion(w, x, y, z)


def test_moment_gives_the_requested_euler_accelerations():
    """The second derivative of SciPy's Euler angles along the turning body, by Richardson's central differences."""
    rng = np.random.default_rng(2)
    worst, without = 0.0, 0.0
    for _ in range(10):
        psi, theta, phi = rng.uniform(-1.0, 1.0, 3) * [3.0, 1.0, 1.0]
        at = Rotation.from_euler("ZYX", [psi, theta, phi])
        omega, desired = rng.normal(size=3), 5.0 * rng.normal(size=3)
        trig = trig_of(quaternion_of(at).matrix())
        turning = euler_rates(trig, Vec3(*omega))
        moment = np.array(moment_for(Vec3(*INERTIA), trig, Vec3(*omega), turning, Euler(*desired)))

        def accelerations(moment, at=at, omega=omega):
            omega_dot = (moment - np.cross(omega, INERTIA * omega)) / INERTIA

            def second(h):
                # the t^3 term that the exponent lacks is odd: it cancels in the second difference up to O(h^2)
                angles = [
                    (at * Rotation.from_rotvec(omega * t + 0.5 * omega_dot * t * t)).as_euler("ZYX")[::-1]
                    for t in (-h, 0.0, h)
                ]
                ahead, delayed = (np.angle(np.exp(1j * (angles[i] - angles[1]))) for i in (2, 0))
                return (ahead + delayed) / h**2

            return (4.0 * second(1e-3) - second(2e-3)) / 3.0

        worst = max(worst, np.abs(accelerations(moment) - desired).max())
        plain = moment - np.cross(omega, INERTIA * omega)
        without = max(without, np.abs(accelerations(plain) - desired).max())
    print(f"\neuler'' against the request: {worst:.1e}; without Omega x J Omega: {without:.1e}")
    assert worst < 1e-6
    assert without > 1e-2


def linearised(gains, yaw, vehicle=QUADROTOR):
    """(A, B, C) at hover from the four commands to (v_x, v_y, v_z, psi'); no drag, which inner loops do not know."""
    vehicle = vehicle._replace(structure_drag=(0.0, 0.0, 0.0), propeller_drag=0.0)
    params = UAV.prepare(UavParams(vehicle, inner_loop=gains, yaw=yaw))
    state, unravel = ravel_pytree(jax.tree.map(jnp.float64, UAV.init(params)))

    def slope(x, u):
        return ravel_pytree(UAV.derivative(params, unravel(x), PlantInput(tuple(u), (0.0,) * 4, ZERO), 0.0))[0]

    def rates(x):
        return jnp.stack([m.y_dot for m in UAV.measure(params, unravel(x), None)])

    u = jnp.zeros(4)
    return jax.jacfwd(slope)(state, u), jax.jacfwd(slope, argnums=1)(state, u), jax.jacfwd(rates)(state)


VARIANTS = {
    "plain": InnerGains(),
    "norm": InnerGains(thrust=ThrustRule.NORM),
    "feed_forward": InnerGains(attitude=AttitudeReference.RATE_FEED_FORWARD),
    "integral": InnerGains(kp_velocity=0.3, kd_velocity=0.8, kp_yaw=0.5, kd_yaw=1.4, kp_attitude=50.0),
}


@pytest.mark.parametrize("name", VARIANTS)
@pytest.mark.parametrize(("yaw", "vehicle"), [(0.0, QUADROTOR), (0.7, HEXACOPTER)], ids=["quadrotor", "hexacopter"])
def test_transfer_functions_at_hover(name, yaw, vehicle):
    """psi: (s + 0.2)/(s^2 + s + 0.2). z: 1/(s + 1). x, y: T/(s + T), T the tilt loop; about 1/(s + 1) below it.

    Feed-forward knows v' = g theta but not u', which is held: theta_d' = -k_d theta adds to the stiffness, and slow
    commands see 0.8/(s + 0.8).
    """
    gains = VARIANTS[name]
    a, b, c = map(np.array, linearised(gains, yaw, vehicle))
    stiff, damp = gains.kp_attitude, gains.kd_attitude
    fed = damp * gains.kd_velocity if name == "feed_forward" else 0.0
    worst, low = 0.0, 0.0
    for s in (0.01j, 0.1j, 0.7j, 1.0 + 2.0j, 5.0j, 30.0j):
        found = c @ np.linalg.solve(s * np.eye(len(a)) - a, b)
        tilt = stiff / (s * s + damp * s + stiff + fed)
        loop = gains.kd_velocity + gains.kp_velocity / s
        yaw_loop = gains.kd_yaw + gains.kp_yaw / s
        across = loop * tilt / (s + loop * tilt)
        desired = np.diag([across, across, loop / (s + loop), yaw_loop / (s + yaw_loop)])
        worst = max(worst, np.abs(found - desired).max())
        if name != "integral":
            assert abs(found[2, 2] - 1.0 / (s + 1.0)) < 1e-11
            assert abs(found[3, 3] - (s + 0.2) / (s * s + s + 0.2)) < 1e-11
            if abs(s) <= 0.1:
                slow = 0.8 if name == "feed_forward" else 1.0
                low = max(low, *(abs(found[i, i] * (s / slow + 1.0) - 1.0) for i in (0, 1)))
    print(f"\n{name}: transfer functions {worst:.1e}; x, y against the first order below 0.1 rad/s: {low:.1e}")
    assert worst < 1e-11
    assert low < 0.01


def tilt_of(desired, psi):
    """(phi_d, theta_d) as model.md prints them; the third of ``wanted`` holds g."""
    x, y, z = desired
    theta = np.arctan((x * np.cos(psi) + y * np.sin(psi)) / z)
    return np.array([np.arctan(np.cos(theta) * (x * np.sin(psi) - y * np.cos(psi)) / z), theta])


def inner(gains, angles, omega, velocity, integral, command, yaw_integral=0.1, yaw_command=-0.2):
    at = Rotation.from_euler("ZYX", angles[::-1])
    integrals = Integrals(Vec3(*integral), yaw_integral)
    return demand(
        gains,
        Craft(MASS, Vec3(*INERTIA), allocation=(), moments=(), rotor_limit=0.0),
        Vec3(*velocity),
        quaternion_of(at).matrix(),
        Vec3(*omega),
        integrals,
        Vec3(*command),
        yaw_command,
    )


def asked(found, angles, omega):
    """Euler accelerations that a moment stands for, through a W written here."""
    phi, theta, _ = angles
    w = np.array(
        [
            [1.0, 0.0, -np.sin(theta)],
            [0.0, np.cos(phi), np.sin(phi) * np.cos(theta)],
            [0.0, -np.sin(phi), np.cos(phi) * np.cos(theta)],
        ]
    )
    rates = np.linalg.solve(w, omega)
    h = 1e-6

    def matrix(p, t):
        return np.array(
            [
                [1.0, 0.0, -np.sin(t)],
                [0.0, np.cos(p), np.sin(p) * np.cos(t)],
                [0.0, -np.sin(p), np.cos(p) * np.cos(t)],
            ]
        )

    w_dot = (
        (matrix(phi + h * rates[0], theta + h * rates[1]) - matrix(phi - h * rates[0], theta - h * rates[1])) / 2 / h
    )
    angular = (np.array(found.moment) - np.cross(omega, INERTIA * omega)) / INERTIA
    return np.linalg.solve(w, angular - w_dot @ rates), rates


@pytest.mark.parametrize("rule", ThrustRule)
@pytest.mark.parametrize("falling", [False, True])
def test_feed_forward_is_the_derivative_of_the_tilt(rule, falling):
    """phi_d', theta_d' from the moments with and without feed-forward, against differences along the model's motion."""
    rng = np.random.default_rng(7)
    worst, size = 0.0, 0.0
    for _ in range(8):
        angles, omega = rng.uniform(-0.5, 0.5, 3) * [1.0, 1.0, 6.0], rng.normal(size=3)
        velocity, integral, command = rng.normal(size=3), 0.5 * rng.normal(size=3), 2.0 * rng.normal(size=3)
        command[2] += -40.0 if falling else 0.0
        gains = InnerGains(kp_velocity=0.3, kd_velocity=0.8, thrust=rule)
        ahead = gains._replace(attitude=AttitudeReference.RATE_FEED_FORWARD)
        plain = inner(gains, angles, omega, velocity, integral, command)
        fed = inner(ahead, angles, omega, velocity, integral, command)
        assert bool(plain.bounded) is falling
        without, rates = asked(plain, angles, omega)
        with_it, _ = asked(fed, angles, omega)
        found = (with_it - without)[:2] / gains.kd_attitude
        body_z = Rotation.from_euler("ZYX", angles[::-1]).as_matrix()[:, 2]
        acceleration = float(plain.thrust) / MASS * body_z - np.array([0.0, 0.0, GRAVITY])

        def tilt(t, a=acceleration, v=velocity, i=integral, u=command, psi=angles[2], psi_dot=rates[2]):
            desired = 0.8 * (u - v - a * t) + 0.3 * (i + (u - v) * t) + np.array([0.0, 0.0, GRAVITY])
            desired[2] = max(desired[2], 0.1 * GRAVITY)
            return tilt_of(desired, psi + psi_dot * t)

        h = 1e-4
        numerical = (8.0 * (tilt(h) - tilt(-h)) - (tilt(2 * h) - tilt(-2 * h))) / (12.0 * h)
        worst, size = max(worst, np.abs(found - numerical).max()), max(size, np.abs(numerical).max())
        # what is asked without it, as printed
        phi_d, theta_d = tilt(0.0)
        printed = [
            60.0 * (phi_d - angles[0]) - 15.0 * rates[0],
            60.0 * (theta_d - angles[1]) - 15.0 * rates[1],
            (-0.2 - rates[2]) + 0.2 * 0.1,
        ]
        np.testing.assert_allclose(without, printed, atol=1e-8)
    print(f"\n{rule}, falling {falling}: phi_d', theta_d' {worst:.1e} of up to {size:.1f}")
    assert worst < 1e-8
    assert size > 0.1


def test_thrust_rules_and_their_bound():
    """M (a_z + g)/(cos phi cos theta), or M |a + g e3|; a_z + g is kept above g/10, and said so."""
    angles, zero = (0.3, -0.2, 0.9), np.zeros(3)
    cosines = np.cos(0.3) * np.cos(0.2)
    for command in ([1.0, -2.0, 0.5], [1.0, -2.0, -8.8], [1.0, -2.0, -8.9], [1.0, -2.0, -60.0]):
        lift = max(command[2] + GRAVITY, 0.1 * GRAVITY)
        by_projection = inner(InnerGains(), angles, zero, zero, zero, command)
        by_norm = inner(InnerGains(thrust=ThrustRule.NORM), angles, zero, zero, zero, command)
        assert float(by_projection.thrust) == pytest.approx(MASS * lift / cosines, rel=1e-13)
        assert float(by_norm.thrust) == pytest.approx(MASS * np.linalg.norm([1.0, -2.0, lift]), rel=1e-13)
        assert bool(by_projection.bounded) is bool(by_norm.bounded) is (command[2] + GRAVITY < 0.1 * GRAVITY)
        np.testing.assert_allclose(by_projection.integrals.velocity, command, rtol=1e-15)
