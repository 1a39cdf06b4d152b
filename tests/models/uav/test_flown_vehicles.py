"""Presets and PX4's airframes in flight: hover, a step, a circle with a yaw rate, against theory to 1 %.

The airframes are restated as places and KM; sources are PX4's files of the same number.
"""

import math
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.integrators import INTEGRATORS, Integrator
from dssc_jax.core.signals import PlantInput
from dssc_jax.core.vectors import Vec3
from dssc_jax.engine.plain import plain_options
from dssc_jax.models.uav.airframe import read_airframe
from dssc_jax.models.uav.desaturation import Desaturation
from dssc_jax.models.uav.parameters import Believed
from dssc_jax.models.uav.plant import UAV
from dssc_jax.models.uav.presets import VEHICLES
from dssc_jax.models.uav.vehicle import Rotor, RotorCoefficients

DT, SECONDS = 0.01, 34.0
RADIUS, PERIOD, TURN = 2.0, 6.0, 0.3
G = 9.81


def px4(places, moments, **parameters):
    """An airframe script."""
    lines = [f"param set-default CA_ROTOR_COUNT {len(places)}"]
    for i, (place, moment) in enumerate(zip(places, moments, strict=True)):
        lines += [f"param set-default CA_ROTOR{i}_P{c} {v}" for c, v in zip("XYZ", place, strict=False)]
        lines.append(f"param set-default CA_ROTOR{i}_KM {moment}")
    return "\n".join(lines + [f"param set-default {name} {value}" for name, value in parameters.items()])


def tilted(text, angle):
    """The script with each rotor leaning sideways, alternately."""
    lines = []
    for i in range(6):
        x, y = math.cos(math.pi * i / 3), math.sin(math.pi * i / 3)
        side = (-1) ** i * math.sin(angle)
        lines += [
            f"param set CA_ROTOR{i}_A{c} {v}"
            for c, v in zip("XYZ", (-side * y, side * x, -math.cos(angle)), strict=True)
        ]
    return "\n".join([text, *lines])


X = [(1, 1), (-1, -1), (1, -1), (-1, 1)]
HEX = [(math.cos(math.pi * i / 3), math.sin(math.pi * i / 3)) for i in range(6)]
SIGNS = (0.05, 0.05, -0.05, -0.05)
ALTERNATING = (0.05, -0.05) * 3
OCTO = [(x, y, z) for z in (0, -0.05) for x, y in ((0.5, 0.5), (0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5))]
AIRFRAMES = {
    "x500 (4001_gz_x500)": (
        px4([(0.13, 0.22), (-0.13, -0.20), (0.13, -0.22), (-0.13, 0.20)], SIGNS, MPC_THR_HOVER=0.6), 2.064, None
    ),
    "iris (10015)": (px4([(0.1515, 0.245), (-0.1515, -0.1875), (0.1515, -0.245), (-0.1515, 0.1875)], SIGNS), 1.5, None),
    "quadx (10040, SIH)": (px4(X, SIGNS, SIH_VEHICLE_TYPE=0), None, None),
    "hexa (10044, SIH)": (
        px4([(0.866, 0.5), (0, 1), (-0.866, 0.5), (-0.866, -0.5), (0, -1), (0.866, -0.5)], ALTERNATING,
            SIH_VEHICLE_TYPE=4),
        None, None,
    ),
    "typhoon (6011)": (
        px4([(0, 1), (0, -1), (0.866025, -0.5), (-0.866025, 0.5), (0.866025, 0.5), (-0.866025, -0.5)],
            (-0.05, 0.05, -0.05, 0.05, 0.05, -0.05), MC_ROLL_P=9, MPC_XY_VEL_P_ACC=3, MPC_XY_VEL_I_ACC=0),
        2.0, 0.24,
    ),
    "generic 250 (4050)": (px4(X, SIGNS, MC_ROLL_P=8), 0.75, 0.0884),
    "crazyflie (4901)": (px4([(1, 1), (-1, 1), (-1, -1), (1, -1)], ALTERNATING[:4], MC_AIRMODE=1), 0.027, 0.0325),
    "s500 (4014)": (px4(X, SIGNS), 1.3, 0.177),
    "coaxial (octo)": (px4(OCTO, (0.05, -0.05, 0.05, -0.05, -0.05, 0.05, -0.05, 0.05)), 3.0, None),
    "tilted (hexa, 20 deg)": (tilted(px4([(0.4 * x, 0.4 * y) for x, y in HEX], ALTERNATING), 0.35), 3.0, None),
    "plus (quad)": (px4([(0, 1), (0, -1), (1, 0), (-1, 0)], (0.05, 0.05, -0.05, -0.05)), 1.5, 0.25),
}  # fmt: skip


def fly(params, circle):
    """Position, tilt, sum of thrusts, yaw rate and velocity of a flight; the circle with a yaw rate, or a step of x."""
    state = jax.tree.map(lambda x: jnp.asarray(x, float), UAV.init(params))
    w = 2.0 * math.pi / PERIOD

    def command(position, t):
        c, s = jnp.cos(w * t), jnp.sin(w * t)
        want = [(RADIUS * s, RADIUS * w * c, -RADIUS * w * w * s), (RADIUS * c, -RADIUS * w * s, -RADIUS * w * w * c)]
        x, y = (d + a + 0.3 * (p - q) for (p, d, a), q in zip(want, position[:2], strict=True))
        x = jnp.where(circle, x, 0.3 * (1.0 - position.x))
        return (x, jnp.where(circle, y, -0.3 * position.y), -0.3 * position.z, jnp.where(circle, TURN, 0.0))

    def step(state, k):
        t = k * DT
        drive = PlantInput(command(state.position, t), (0.0,) * 4, Vec3(0.0, 0.0, 0.0))

        def slope(at, half):
            return UAV.derivative(params, at, drive, t)

        state = UAV.project(params, INTEGRATORS[Integrator.RK4](slope, state, DT, UAV.velocities))
        info = UAV.monitor(params, state, drive)
        rate = UAV.measure(params, state, drive)[3].y_dot
        return state, jnp.stack([*state.position, info.tilt, sum(info.rotor), rate, *state.velocity])

    return jax.lax.scan(step, state, jnp.arange(int(SECONDS / DT)))[1]


def check(params, step, circle):
    """Deviations of hover after a step, and of the circle, from theory."""
    vehicle = params.vehicle
    weight = vehicle.mass * G
    x, y, z, tilt, lift, *_ = step.T
    worst = [abs(x[-1] - 1.0), abs(y[-1]), abs(z[-1]), abs(lift[-1] / lifted(vehicle, weight) - 1.0), tilt[-1]]
    x, y, _, tilt, lift, _, *v = circle[-int(PERIOD / DT) :].T
    radius, speed = np.hypot(x, y).mean(), np.hypot(v[0], v[1]).mean()
    inward = vehicle.mass * speed**2 / radius
    hover = sum(np.sqrt(weight / vehicle.rotors / np.array(vehicle.thrust_coefficients)))
    against = vehicle.propeller_drag * hover * speed + vehicle.structure_drag[0] * speed**2
    side = math.hypot(inward, against)
    force = math.hypot(side, weight)
    worst += [tilt.mean() / math.atan2(side, weight) - 1.0, lift.mean() / lifted(vehicle, force) - 1.0]
    seen = 2.0 * math.pi / (2.0 * math.pi / PERIOD - TURN)  # period of the flight as the turning body sees it [s]
    rate = circle[-2 * round(seen / DT) :, 5]
    worst += [rate.mean() / TURN - 1.0, tilt.std() / tilt.mean(), speed * PERIOD / (2 * math.pi * radius) - 1.0]
    return np.abs(worst)


def lifted(vehicle, force):
    """Sum of the rotors' thrusts for a net thrust: more than it where rotors lean."""
    axes = [rotor.unit_axis.z for rotor in vehicle.rotor] or [1.0]
    return force / (sum(axes) / len(axes))


def prepared(vehicle, **entries):
    """Parameters of a study's plant."""
    table = {
        "name": "flown",
        "loop": {"duration": 1.0, "sample_time": 0.01},
        "plant": {"kind": "uav", "vehicle": vehicle, "inner_loop": {"kd_yaw": 2.0, "kp_yaw": 1.0}} | entries,
        "controller": {"kind": "pi", "l0": 0.5, "k_p": 1.0, "k_i": 0.02},
    }
    return dj.Study.from_table(table).template.plant


def alike(params):
    """The same vehicle with every rotor in the list, so that vehicles with equally many share a compiled flight."""
    vehicle = params.vehicle
    x, y = vehicle.directions()
    circle = [Rotor((vehicle.arm * a, vehicle.arm * b, 0.0), direction=s) for a, b, s in zip(x, y, vehicle.spins)]  # noqa: B905
    full = zip(vehicle.rotor or circle, vehicle.thrust_coefficients, vehicle.torque_coefficients, strict=True)
    rotors = tuple(r._replace(thrust_coefficient=k, torque_coefficient=c) for r, k, c in full)
    limit, lag = vehicle.thrust_limit, vehicle.motor_lag or 0.02
    listed = vehicle._replace(rotor=rotors, rotor_angles=(), spins=(), max_thrust=limit, motor_lag=lag)
    believed = Believed(*params.believed)._replace(thrust_coefficient=None)
    listed = listed._replace(rotor_coefficients=RotorCoefficients.ACTUAL)  # those of a PX4 file are nominal
    plain = params._replace(vehicle=listed, desaturation=Desaturation.CLIP, believed=believed, allocation=())
    return UAV.prepare(plain)


PRESETS = [name for name in VEHICLES if name not in ("m600_quadrotor", "m600_hexacopter")]


@cache
def flown():
    """Every vehicle after both flights: its parameters and its deviations."""
    vehicles = {name: prepared(name) for name in PRESETS}
    for name, (text, mass, arm) in AIRFRAMES.items():
        airframe = read_airframe(text, mass, arm)
        gains = {"kd_yaw": 2.0, "kp_yaw": 1.0} | airframe.plant.get("inner_loop", {})
        vehicles[name] = prepared(airframe.vehicle, **airframe.plant | {"inner_loop": gains})
    by_count = {}
    for name, params in vehicles.items():
        by_count.setdefault(params.vehicle.rotors, {})[name] = alike(params)
    program = jax.jit(jax.vmap(fly), compiler_options=plain_options())
    found = {}
    for group in by_count.values():
        params = [p for p in group.values() for _ in range(2)]
        stacked = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf, float) for leaf in leaves]), *params)
        flights = np.array(program(stacked, jnp.array([False, True] * len(group))))
        for i, (name, p) in enumerate(group.items()):
            found[name] = p, check(p, flights[2 * i], flights[2 * i + 1])
    return found


@pytest.mark.parametrize("name", [*PRESETS, *AIRFRAMES])
def test_vehicles_fly_as_theory_says(name):
    _, deviations = flown()[name]
    print(f"\n{name}: {np.round(deviations, 5)}")
    assert deviations.max() < 0.01


@pytest.mark.parametrize("name", [name for name, (_, mass, _) in AIRFRAMES.items() if mass is not None])
def test_without_a_mass_an_airframe_is_refused(name):
    text, _, arm = AIRFRAMES[name]
    with pytest.raises(ConfigError, match="SIH_MASS"):
        read_airframe(text, None, arm)


def test_the_omnicopter_is_refused_by_name():
    with pytest.raises(ConfigError, match="reversible rotors") as refusal:
        read_airframe(px4([(0.1, 0.1)] * 8, (0.05,) * 8, CA_R_REV=255), 1.0)
    assert refusal.value.where == "CA_R_REV"


def test_gains_and_airmode_are_read():
    plant = read_airframe(AIRFRAMES["typhoon (6011)"][0], 2.0, 0.24).plant
    assert plant["inner_loop"] == {"kd_velocity": 3.0, "kp_velocity": 0.0, "kp_attitude": 324.0, "kd_attitude": 36.0}
    assert read_airframe(AIRFRAMES["crazyflie (4901)"][0], 0.027, 0.03).plant == {"desaturation": "airmode_roll_pitch"}


def test_a_log_gives_its_parameters(tmp_path, capsys, monkeypatch):
    """A ULog written byte by byte: its definitions hold the parameters."""
    pytest.importorskip("pyulog")
    parameters = {"CA_ROTOR_COUNT": 4.0, "SIH_MASS": 0.9, "MC_AIRMODE": 2.0}
    for i, ((x, y), moment) in enumerate(zip(X, SIGNS, strict=True)):
        parameters |= {f"CA_ROTOR{i}_PX": 0.1 * x, f"CA_ROTOR{i}_PY": 0.1 * y, f"CA_ROTOR{i}_KM": moment}
    content = b"ULog\x01\x12\x35\x01" + (0).to_bytes(8, "little")
    content += (40).to_bytes(2, "little") + b"B" + bytes(40)
    for name, value in parameters.items():
        key = f"float {name}".encode()
        message = bytes([len(key)]) + key + np.float32(value).tobytes()
        content += len(message).to_bytes(2, "little") + b"P" + message
    (tmp_path / "flight.ulg").write_bytes(content)
    monkeypatch.chdir(tmp_path)
    assert guarded(["airframe", "flight.ulg"]) == 0
    printed = capsys.readouterr().out
    assert "mass = 0.9\n" in printed  # a float32, with the fewest digits
    assert 'desaturation = "airmode_roll_pitch_yaw"' in printed
    (tmp_path / "bad.ulg").write_bytes(b"nothing")
    assert guarded(["airframe", "bad.ulg"]) == 2
