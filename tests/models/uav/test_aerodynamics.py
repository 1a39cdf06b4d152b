"""Falls against closed forms, and drag against the sums of Appendix A."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dssc_jax.core.integrators import rk4
from dssc_jax.core.vectors import Mat3, Vec3, quaternion_from_euler
from dssc_jax.models.uav.aerodynamics import drag
from dssc_jax.models.uav.rigid_body import BodyState, body_derivative
from dssc_jax.models.uav.vehicle import GRAVITY, QUADROTOR, alternating

ZERO = Vec3(0.0, 0.0, 0.0)


def fall(vehicle, speeds, duration, step, velocity=ZERO, turned=(0.0, 0.0, 0.0)):
    """Height lost and velocity after a fall without thrust: aerodynamics and rigid body, attitude held by no torque."""

    def derivative(state, _):
        rotation = state.attitude.matrix()
        air = drag(vehicle, rotation, state.rate, state.velocity, speeds)
        return body_derivative(state, vehicle.mass, vehicle.inertia, 0.0, air.force, ZERO, rotation)

    @jax.jit
    def run():
        first = BodyState(ZERO, velocity, quaternion_from_euler(*turned), ZERO)
        first = jax.tree.map(jnp.float64, first)
        end, _ = jax.lax.scan(lambda s, _: (rk4(derivative, s, step, ()), None), first, length=round(duration / step))
        return end

    return run()


def test_free_fall_is_a_parabola():
    vehicle = QUADROTOR._replace(structure_drag=(0.0, 0.0, 0.0))
    end = fall(vehicle, (0.0,) * 4, 3.0, 0.01, Vec3(2.0, -1.0, 4.0))
    expected = [6.0, -3.0, 12.0 - 0.5 * GRAVITY * 9.0, 2.0, -1.0, 4.0 - GRAVITY * 3.0]
    found = np.array([*end.position, *end.velocity])
    print(f"\nfree fall: {np.abs(found - expected).max():.1e}")
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize(("turned", "axis"), [((0.0, 0.0, 0.0), 2), ((0.5 * np.pi, 0.0, 0.0), 1)], ids=["flat", "side"])
def test_fall_against_structure_drag(turned, axis):
    """v = -v_t tanh(g t/v_t) and z = -(v_t^2/g) ln cosh(g t/v_t), v_t = (M g/K)^(1/2) of the falling axis."""
    vehicle = QUADROTOR._replace(structure_drag=(0.5, 0.4, 0.3))
    terminal = math.sqrt(vehicle.mass * GRAVITY / vehicle.structure_drag[axis])
    gaps = []
    for duration in (1.5, 40.0):
        end = fall(vehicle, (0.0,) * 4, duration, 0.01, turned=turned)
        v = -terminal * math.tanh(GRAVITY * duration / terminal)
        z = -(terminal**2) / GRAVITY * math.log(math.cosh(GRAVITY * duration / terminal))
        gaps += [abs(float(end.velocity.z) / v - 1.0), abs(float(end.position.z) / z - 1.0)]
    print(
        f"\nfall with drag: relative {max(gaps):.1e}; terminal speed {terminal:.3f} m/s, reached {end.velocity.z:.9f}"
    )
    assert max(gaps) < 1e-9
    assert float(end.velocity.z) == pytest.approx(-terminal, rel=1e-9)


def test_fall_against_propeller_drag():
    """Linear in v: v = -v_t (1 - exp(-t/tau)), tau = M/(K_Fdi sum |thetadot_i|), v_t = g tau."""
    vehicle = QUADROTOR._replace(structure_drag=(0.0, 0.0, 0.0), propeller_drag=0.02)
    speeds = (200.0, 150.0, 180.0, 230.0)
    tau = vehicle.mass / (vehicle.propeller_drag * sum(speeds))
    end = fall(vehicle, speeds, 2.0, 0.005)
    expected = -GRAVITY * tau * (1.0 - math.exp(-2.0 / tau))
    print(f"\npropeller drag: relative {abs(float(end.velocity.z) / expected - 1.0):.1e}")
    assert float(end.velocity.z) == pytest.approx(expected, rel=1e-9)


def test_drag_equals_the_sums_of_appendix_a():
    """Rotor by rotor in plain NumPy, for irregular rotor positions, speeds and attitudes."""
    rng = np.random.default_rng(4)
    worst = 0.0
    for trial in range(12):
        rotors = 4 + trial % 4
        vehicle = QUADROTOR._replace(
            rotor_angles=tuple(rng.uniform(-np.pi, np.pi, rotors)),
            spins=alternating(rotors),
            structure_drag=tuple(rng.uniform(0.01, 0.5, 3)),
            propeller_drag=rng.uniform(1e-6, 1e-2),
            arm=rng.uniform(0.2, 1.0),
        )
        at = Rotation.random(random_state=rng).as_matrix()
        omega, v_r, speeds = rng.normal(size=3), 10.0 * rng.normal(size=3), rng.uniform(50.0, 300.0, rotors)
        force = -at @ np.diag(vehicle.structure_drag) @ at.T @ v_r * np.linalg.norm(v_r)
        torque = np.zeros(3)
        for angle, speed in zip(vehicle.rotor_angles, speeds, strict=True):
            p = vehicle.arm * np.array([np.cos(angle), np.sin(angle), 0.0])
            f_i = -vehicle.propeller_drag * speed * (v_r + at @ np.cross(omega, p))
            force = force + f_i
            torque = torque + np.cross(p, at.T @ f_i)
        found = drag(vehicle, Mat3(*(Vec3(*row) for row in at)), Vec3(*omega), Vec3(*v_r), tuple(speeds))
        for got, expected in ((found.force, force), (found.torque, torque)):
            worst = max(worst, float(np.abs(np.array(got) - expected).max() / np.linalg.norm(expected)))
    print(f"\ndrag against Appendix A: {worst:.1e}")
    assert worst < 1e-13
