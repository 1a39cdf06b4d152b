"""The whole plant at a point: hover is an equilibrium, and turned or mirrored states have turned or mirrored slopes."""

import math

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dssc_jax.core.signals import PlantInput
from dssc_jax.core.vectors import Quaternion, Vec3
from dssc_jax.models.uav.inner_loops.article import Integrals
from dssc_jax.models.uav.plant import UAV, UavParams, UavState
from dssc_jax.models.uav.vehicle import HEXACOPTER, QUADROTOR, Vehicle

ZERO = Vec3(0.0, 0.0, 0.0)


def prepared(vehicle, **changes):
    return UAV.prepare(UavParams(vehicle, **changes))


@pytest.mark.parametrize("vehicle", [QUADROTOR, HEXACOPTER], ids=["quadrotor", "hexacopter"])
@pytest.mark.parametrize("lag", [None, 0.05], ids=["no_lag", "motor_lag"])
@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.9])
def test_hover_is_an_equilibrium(vehicle, lag, yaw):
    """Every derivative vanishes to 1e-12 in still air without commands: position, velocity, attitude, rotors."""
    params = prepared(vehicle._replace(motor_lag=lag), position=(3.0, -2.0, 5.0), yaw=yaw)
    drive = PlantInput((0.0,) * 4, (0.0,) * 4, ZERO)
    slope = UAV.derivative(params, UAV.init(params), drive, 0.0)
    worst = max(float(abs(leaf)) for leaf in jax.tree.leaves(slope))
    print(f"\nhover: largest derivative {worst:.1e}")
    assert worst < 1e-12
    moved = UAV.derivative(params, UAV.init(params), drive._replace(wind=Vec3(1.0, 0.0, 0.0)), 0.0)
    assert max(float(abs(leaf)) for leaf in jax.tree.leaves(moved)) > 1e-4


def some_state(rng, speeds):
    rotation = Rotation.from_euler("ZYX", rng.uniform(-1.0, 1.0, 3) * [3.0, 0.6, 0.6]).as_quat()
    draws = [Vec3(*(scale * rng.normal(size=3))) for scale in (20.0, 5.0, 1.0, 0.3)]
    attitude = Quaternion(rotation[3], *rotation[:3])
    yaw_integral = rng.normal()
    return UavState(draws[0], draws[1], attitude, draws[2], Integrals(draws[3], yaw_integral), speeds)


def some_vehicle(rng, rotors, lag):
    base: Vehicle = QUADROTOR if rotors == 4 else HEXACOPTER
    return base._replace(
        body_inertia=(0.4, 0.55, 0.74),
        rotor_inertia_z=0.003,
        structure_drag=(0.03, 0.07, 0.015),
        propeller_drag=1e-3,
        motor_lag=lag,
        rotor_angles=tuple(np.array(base.rotor_angles) + 0.2 * rng.uniform(-1.0, 1.0, rotors)),
    )


def flat(state):
    return np.array([float(leaf) for leaf in jax.tree.leaves(state)])


def relative(found, expected):
    return float(np.max(np.abs(found - expected) / np.maximum(np.abs(expected), 1.0)))


CASES = pytest.mark.parametrize(("rotors", "lag"), [(4, None), (4, 0.05), (6, None), (6, 0.05)])


@CASES
def test_yaw_rotation_of_the_plant_rotates_its_derivative(rotors, lag):
    """Turned position, velocity, heading, integrals, commands and wind about z: every derivative turns with them."""
    rng = np.random.default_rng(rotors)
    worst = 0.0
    for angle in (0.4, 2.0, -3.0):
        params = prepared(some_vehicle(rng, rotors, lag))
        c, s = math.cos(angle), math.sin(angle)

        def turn(v, c=c, s=s):
            return Vec3(c * v.x - s * v.y, s * v.x + c * v.y, v.z)

        def turn_q(q, angle=angle):
            a, b = math.cos(0.5 * angle), math.sin(0.5 * angle)
            return Quaternion(a * q.w - b * q.z, a * q.x - b * q.y, a * q.y + b * q.x, a * q.z + b * q.w)

        def turn_state(x, turn=turn, turn_q=turn_q):
            integrals = Integrals(turn(x.inner.velocity), x.inner.yaw)
            return x._replace(
                position=turn(x.position), velocity=turn(x.velocity), attitude=turn_q(x.attitude), inner=integrals
            )

        state = some_state(rng, tuple(rng.uniform(80.0, 130.0, rotors)) if lag else ())
        command, disturbance, wind = (Vec3(*rng.normal(size=3)) for _ in range(3))
        plain = PlantInput((*command, 0.3), (*disturbance, -0.1), wind * 5.0)
        turned = PlantInput((*turn(command), 0.3), (*turn(disturbance), -0.1), turn(wind * 5.0))
        expected = turn_state(UAV.derivative(params, state, plain, 0.0))
        found = UAV.derivative(params, turn_state(state), turned, 0.0)
        worst = max(worst, relative(flat(found), flat(expected)))
    print(f"\nyaw equivariance, {rotors} rotors, lag {lag}: {worst:.1e}")
    assert worst < 1e-11


@CASES
def test_mirrored_plant_has_the_mirrored_derivative(rotors, lag):
    """y -> -y, psi -> -psi, rotor angles and spins -> their negatives: axial vectors with the other sign."""
    rng = np.random.default_rng(10 + rotors)
    worst = 0.0

    def polar(v):
        return Vec3(v.x, -v.y, v.z)

    def axial(v):
        return Vec3(-v.x, v.y, -v.z)

    def mirrored(x):
        return UavState(
            polar(x.position),
            polar(x.velocity),
            Quaternion(x.attitude.w, -x.attitude.x, x.attitude.y, -x.attitude.z),
            axial(x.rate),
            Integrals(polar(x.inner.velocity), -x.inner.yaw),
            x.speeds,
        )

    for _ in range(4):
        vehicle = some_vehicle(rng, rotors, lag)
        second = vehicle._replace(
            rotor_angles=tuple(-a for a in vehicle.rotor_angles), spins=tuple(-s for s in vehicle.spins)
        )
        state = some_state(rng, tuple(rng.uniform(80.0, 130.0, rotors)) if lag else ())
        command, wind = Vec3(*rng.normal(size=3)), Vec3(*(5.0 * rng.normal(size=3)))
        zero = (0.0,) * 4
        plain = UAV.derivative(prepared(vehicle), state, PlantInput((*command, 0.3), zero, wind), 0.0)
        drive = PlantInput((*polar(command), -0.3), zero, polar(wind))
        found = UAV.derivative(prepared(second), mirrored(state), drive, 0.0)
        worst = max(worst, relative(flat(found), flat(mirrored(plain))))
        same_spins = prepared(second._replace(spins=vehicle.spins))
        assert relative(flat(UAV.derivative(same_spins, mirrored(state), drive, 0.0)), flat(mirrored(plain))) > 1e-6
    print(f"\nmirror, {rotors} rotors, lag {lag}: {worst:.1e}")
    assert worst < 1e-12
