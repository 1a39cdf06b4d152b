"""Rotors anywhere: force and moment against NumPy, the circle as the short form, allocation, PX4's desaturation."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import nominal
from dssc_jax.core.signals import PlantInput
from dssc_jax.core.vectors import Vec3
from dssc_jax.design.certification import NotCovered
from dssc_jax.models.uav.aerodynamics import drag
from dssc_jax.models.uav.allocation import allocate, pseudo_inverse, wrench_matrix
from dssc_jax.models.uav.desaturation import Desaturation, desaturated, scales_of
from dssc_jax.models.uav.plant import UAV, UavParams
from dssc_jax.models.uav.rotors import RotorMotion, rotor_torque, wrench
from dssc_jax.models.uav.vehicle import HEXACOPTER, QUADROTOR, Rotor, Vehicle
from dssc_jax.proofs.coverage import problem_of

UNIT = np.eye(3)


def as_rotors(vehicle: Vehicle) -> tuple[Rotor, ...]:
    """The rotors of a circle, one by one."""
    x, y = vehicle.directions()
    return tuple(
        Rotor((vehicle.arm * a, vehicle.arm * b, 0.0), direction=s) for a, b, s in zip(x, y, vehicle.spins, strict=True)
    )


def some_rotors(rng, count, tilt=0.3, lengths=1.0):
    rotors = []
    for i in range(count):
        place = tuple(rng.uniform(-0.4, 0.4, 3).tolist())
        axis = tuple((lengths * np.array([*rng.uniform(-tilt, tilt, 2), 1.0])).tolist())
        k, c = rng.uniform(0.5, 2.0) * 1e-3, rng.uniform(0.01, 0.03)
        rotors.append(Rotor(place, axis, (-1.0) ** i, k, c))
    return tuple(rotors)


def numpy_effects(rotors):
    """Force and moment per thrust, by NumPy: columns (F, M)."""
    columns = []
    for rotor in rotors:
        a = np.array(rotor.axis) / np.linalg.norm(rotor.axis)
        columns.append([*a, *(np.cross(rotor.position, a) + rotor.direction * rotor.torque_coefficient * a)])
    return np.array(columns).T


def test_force_and_moment_are_those_of_numpy():
    rng = np.random.default_rng(3)
    for lengths in (1.0, 7.5):
        vehicle = HEXACOPTER._replace(rotor=some_rotors(rng, 6, lengths=lengths))
        f = rng.uniform(1.0, 9.0, 6)
        found = wrench(vehicle, tuple(f))
        expected = numpy_effects(vehicle.rotor) @ f
        np.testing.assert_allclose([*found.across, found.thrust, *found.moment], expected, rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(wrench_matrix(vehicle), numpy_effects(vehicle.rotor), rtol=1e-13, atol=1e-15)


def test_drag_and_gyroscopic_torque_are_those_of_numpy():
    """Sums over rotors of -k w_i (v_r + Omega x p_i) and -h' - Omega x h, h = I_z sum -s_i w_i a_i."""
    rng = np.random.default_rng(4)
    vehicle = HEXACOPTER._replace(rotor=some_rotors(rng, 6), propeller_drag=3e-3, rotor_inertia_z=2e-3)
    w, dw, omega, v = rng.uniform(100, 300, 6), rng.normal(size=6), rng.normal(size=3), rng.normal(size=3)
    air = drag(vehicle, jax.tree.map(float, QUAT.matrix()), Vec3(*omega), Vec3(*v), tuple(w))
    force = -np.array(vehicle.structure_drag) * v * np.linalg.norm(v)
    torque = np.zeros(3)
    h, dh = np.zeros(3), np.zeros(3)
    for rotor, wi, dwi in zip(vehicle.rotor, w, dw, strict=True):
        part = -3e-3 * wi * (v + np.cross(omega, rotor.position))
        force, torque = force + part, torque + np.cross(rotor.position, part)
        a = np.array(rotor.axis) / np.linalg.norm(rotor.axis)
        h, dh = h - 2e-3 * rotor.direction * wi * a, dh - 2e-3 * rotor.direction * dwi * a
    np.testing.assert_allclose(air.force, force, rtol=1e-12)
    np.testing.assert_allclose(air.torque, torque, rtol=1e-12)
    gyroscopic = rotor_torque(vehicle, Vec3(*omega), RotorMotion(tuple(w), tuple(dw)))
    np.testing.assert_allclose(gyroscopic, -dh - np.cross(omega, h), rtol=1e-12)


QUAT = UAV.init(UAV.prepare(UavParams(QUADROTOR))).attitude


@pytest.mark.parametrize("base", [QUADROTOR, HEXACOPTER], ids=["quadrotor", "hexacopter"])
@pytest.mark.parametrize("lag", [None, 0.05], ids=["no_lag", "lag"])
def test_a_circle_is_the_short_form(base, lag):
    """Derivative and allocation of the listed circle equal those of the short form to 1e-12."""
    base = base._replace(motor_lag=lag, rotor_inertia_z=2e-3, propeller_drag=1e-3)
    short = UAV.prepare(UavParams(base, velocity=(1.0, -2.0, 0.5)))
    full = UAV.prepare(UavParams(base._replace(rotor=as_rotors(base)), velocity=(1.0, -2.0, 0.5)))
    np.testing.assert_allclose(full.allocation, short.allocation, rtol=1e-13, atol=1e-15)
    drive = PlantInput((2.0, -1.0, 0.5, 0.2), (0.0,) * 4, Vec3(3.0, 1.0, -1.0))
    state = UAV.init(short)._replace(rate=Vec3(0.3, -0.2, 0.1))
    slopes = [UAV.derivative(params, state, drive, 0.0) for params in (short, full)]
    for a, b in zip(*map(jax.tree.leaves, slopes), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(UAV.init(full).speeds, UAV.init(short).speeds, rtol=1e-14)


@pytest.mark.parametrize("count", [4, 6, 8])
def test_allocation_gives_thrust_and_moments_with_the_least_side_force(count):
    """Net thrust and moments are exact; with six or more tilted rotors the side force is zero: PX4's pseudo-inverse."""
    rng = np.random.default_rng(count)
    vehicle = HEXACOPTER._replace(rotor=some_rotors(rng, count))
    inverse = np.array(pseudo_inverse(vehicle))
    matrix = numpy_effects(vehicle.rotor)
    np.testing.assert_allclose(matrix[2:] @ inverse, np.eye(4), atol=1e-9)
    if count >= 6:
        wanted = np.vstack([np.zeros((2, 4)), np.eye(4)])
        np.testing.assert_allclose(inverse, np.linalg.pinv(matrix) @ wanted, atol=1e-8 * np.abs(inverse).max())
    else:
        assert np.abs(matrix[:2] @ inverse).max() > 1e-3


def px4(inverse, command, limit, mode):
    """PX4's algorithm in its own terms: normalised columns, actuators from 0 to 1, axes forward, right, down."""
    mix = np.array(inverse)[:, [1, 2, 3, 0]] * [1.0, -1.0, -1.0, -1.0] / limit
    scale = np.ones(4)
    parts = [np.sqrt((mix[:, j] ** 2).sum() / (np.sum(np.abs(mix[:, j]) > 1e-9) / 2)) for j in (0, 1)]
    scale[:2], scale[2], scale[3] = max(parts), mix[:, 2].max(), np.abs(mix[:, 3]).mean()
    mix, c = mix / scale, np.array([command[1], -command[2], -command[3], -command[0]]) * scale
    roll, pitch, yaw, thrust = mix.T

    def gain(v, sp, top):
        k = [0.0]
        for vi, si in zip(v, sp, strict=True):
            if abs(vi) >= 0.2 and si < 0.0:
                k.append(-si / vi)
            if abs(vi) >= 0.2 and si > top:
                k.append((top - si) / vi)
        return min(k) + max(k)

    def along(v, sp, top=1.0, reduce_only=False):
        k = gain(v, sp, top)
        if reduce_only and k < 0.0:
            return sp
        sp = sp + k * v
        return sp + 0.5 * gain(v, sp, top) * v

    sp = mix @ (c if mode == 2 else c * [1.0, 1.0, 0.0, 1.0])
    if mode == 2:
        return limit * along(yaw, along(thrust, sp))
    sp = along(thrust, sp, reduce_only=mode == 0)
    if mode == 0:
        sp = along(pitch, along(roll, sp))
    return limit * along(thrust, along(yaw, sp + yaw * c[2], top=1.15), reduce_only=True)


MODES = (Desaturation.AIRMODE_DISABLED, Desaturation.AIRMODE_ROLL_PITCH, Desaturation.AIRMODE_ROLL_PITCH_YAW)


@pytest.mark.parametrize("mode", range(3))
@pytest.mark.parametrize("shape", ["circle", "tilted"])
def test_desaturation_is_px4s(mode, shape):
    """1,000 commands far beyond the limits, against the algorithm restated in PX4's own units and axes."""
    rng = np.random.default_rng(8 + mode)
    vehicle = HEXACOPTER._replace(torque_coefficient=0.02)
    if shape == "tilted":
        rotors = some_rotors(rng, 8, 0.2)
        vehicle = vehicle._replace(rotor=tuple(rotor._replace(torque_coefficient=0.02) for rotor in rotors))
    inverse, limit = pseudo_inverse(vehicle), 30.0
    moments = rng.normal(size=(1000, 3)) * [8.0, 8.0, 2.0]
    thrusts = rng.uniform(5.0, 150.0, 1000)
    program = jax.vmap(lambda f, m: jnp.stack(desaturated(inverse, f, Vec3(*m), limit, MODES[mode])))
    with jax.enable_x64(True):
        found = np.array(program(thrusts, moments))
    expected = np.array([px4(inverse, [f, *m], limit, mode) for f, m in zip(thrusts, moments, strict=True)])
    plain = np.array([np.array(inverse) @ [f, *m] for f, m in zip(thrusts, moments, strict=True)])
    both = np.concatenate([plain, plain - np.outer(moments[:, 2], np.array(inverse)[:, 3])], axis=1)
    beyond = (both < 0.0).any(axis=1) | (both > limit).any(axis=1)  # PX4 desaturates what yaw alone would keep inside
    assert beyond.mean() > 0.2
    np.testing.assert_allclose(found, expected, atol=1e-9 * limit)
    np.testing.assert_allclose(found[~beyond], plain[~beyond], atol=1e-9 * limit)


def test_desaturation_keeps_roll_and_pitch_before_yaw():
    """A yaw demand beyond the limits costs yaw alone, where clipping each thrust disturbs roll, pitch or lift."""
    vehicle = QUADROTOR._replace(torque_coefficient=0.02)
    inverse, limit = pseudo_inverse(vehicle), vehicle.thrust_limit
    wanted = (vehicle.mass * 9.81, Vec3(1.0, 0.5, 3.0))
    clipped = wrench(vehicle, allocate(inverse, *wanted, limit).commanded)
    kept = wrench(vehicle, allocate(inverse, *wanted, limit, Desaturation.AIRMODE_DISABLED).commanded)
    assert abs(clipped.moment.x - 1.0) + abs(clipped.moment.y - 0.5) > 0.1
    assert float(kept.moment.x) == pytest.approx(1.0)
    assert float(kept.moment.y) == pytest.approx(0.5)
    assert 0.0 < float(kept.moment.z) < 3.0


COAXIAL = [
    {"position": [x, y, z], "direction": s * (1.0 if z > 0 else -1.0)}
    for x, y, s in ((0.3, 0.3, 1.0), (-0.3, 0.3, -1.0), (-0.3, -0.3, 1.0), (0.3, -0.3, -1.0))
    for z in (0.03, -0.03)
]
STUDY = {
    "name": "anywhere",
    "draws": 4,
    "loop": {"duration": 30.0, "sample_time": 0.01},
    "plant": {
        "kind": "uav",
        "vehicle": {"torque_coefficient": 0.02, "rotor": COAXIAL, "kind": "m600_quadrotor"},
        "desaturation": "airmode_disabled",
    },
    "controller": {"kind": "pi", "l0": 0.5, "k_p": 1.0, "k_i": 0.02},
    "reference": {"kind": "hover", "position": [0.5, -0.3, 0.2]},
    "requirement": [{"metric": "position_error_max", "after": 25.0, "max": 0.2}],
}


def test_a_coaxial_study_flies_and_a_law_of_one_rotor_draws():
    study = dj.Study.from_table(STUDY).override(
        {"plant.vehicle.rotor.3.thrust_coefficient": {"uniform": [0.0023, 0.0025]}}
    )
    assert "plant.vehicle.rotor.3.thrust_coefficient" in study.laws
    result = dj.run(study)
    assert not result.failed.any()
    believed = study.template.plant.believed_coefficients
    assert len(believed) == 8
    assert believed[3] == nominal(study.laws["plant.vehicle.rotor.3.thrust_coefficient"])
    drawn = result.dataset["position_error_rms"].values
    assert len(set(drawn.tolist())) == 4  # the allocation believes the median, the draw differs


def test_indices_override_rotors_of_a_list():
    with pytest.raises(ConfigError, match="no index of an item"):
        dj.Study.from_table(STUDY | {"plant": {"kind": "uav", "vehicle": {"rotor": {"9": {"direction": -1.0}}}}})


def test_a_proof_refuses_rotors_anywhere_by_name():
    table = STUDY | {"plant": STUDY["plant"] | {"desaturation": "clip"}}
    hover = {"kind": "bounded", "speed": 2.0}
    functions = {"kind": "square_root", "kappa_o": 23.0, "kappa_m": 1.1, "delta_o": 1.0, "delta_m": 1.0, "tau_av": 0.03}
    dssc = {"kind": "dssc", "l0": 0.75, "rho": 3.0, "functions": functions, "predictor_start": "matched"}
    study = dj.Study.from_table(table | {"wind": hover, "controller": dssc})
    with pytest.raises(NotCovered, match=r"\[\[plant.vehicle.rotor\]\] places the rotors anywhere"):
        problem_of(study)
    circle = {"kind": "uav", "desaturation": "airmode_disabled"}
    with pytest.raises(NotCovered, match="desaturation"):
        problem_of(dj.Study.from_table(table | {"wind": hover, "controller": dssc, "plant": circle}))


BAD = {
    "few": ([{"position": [0.1, 0.1, 0.0]}] * 3, "four rotors at least"),
    "place": ([{"position": [0.1, 0.1]}] * 4, "three values"),
    "axis": ([{"position": [0.1, 0.1, 0.0], "axis": [0.0, 0.0, 0.0]}] * 4, "must not be zero"),
    "sign": ([{"position": [0.1, 0.1, 0.0], "direction": 0.5}] * 4, "must be 1 or -1"),
    "yaw": ([{"position": [math.cos(i), math.sin(i), 0.0]} for i in (0.0, 1.6, 3.1, 4.7)], "rank 3"),
    "unknown": ([{"position": [0.1, 0.1, 0.0], "spin": 1.0}] * 4, "spin"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_rotors_are_refused_with_their_place(name):
    rotors, rule = BAD[name]
    with pytest.raises(ConfigError, match=rule) as refusal:
        dj.Study.from_table(STUDY | {"plant": {"kind": "uav", "vehicle": {"rotor": rotors, "torque_coefficient": 0.1}}})
    assert "plant.vehicle.rotor" in str(refusal.value)


def test_scales_of_columns_are_those_of_px4():
    """Uneven rotors: yaw takes the largest entry about the axis that points down, roll and pitch share one scale."""
    roll, pitch, yaw = [0.5, -0.5, 0.0], [0.2, 0.2, -0.4], [0.1, 0.2, -0.3]
    scales = scales_of([(1.0, *entries) for entries in zip(roll, pitch, yaw, strict=True)])
    assert scales.yaw == 0.3
    assert scales.turning == pytest.approx(max((0.5 / (2 / 2)) ** 0.5, (0.24 / (3 / 2)) ** 0.5))
