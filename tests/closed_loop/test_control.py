"""Angles between plant and controller: a loop around a wrapped heading is the loop around a continuous one."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.closed_loop.control import transfer_control
from dssc_jax.closed_loop.sample import control
from dssc_jax.core.numerics import arithmetic, turned_near
from dssc_jax.core.signals import Measurement, ReferencePoint
from dssc_jax.models.controllers import CONTROLLERS
from tests.angles import heading
from tests.test_programs import CONTROLLER_TABLES
from tests.tolerances import COMPILER, ROUNDING

SENSORS = {
    "ideal": {"kind": "ideal"},
    "jitter": {"kind": "noisy", "jitter": 0.004},
    "noise": {"kind": "noisy", "jitter": 0.004, "position_std": 0.001, "velocity_std": 0.002, "delay_samples": 2},
    "lag": {"kind": "lag", "mu": 0.05},
}
DIFFERENTIATORS = {
    "none": {"kind": "none"},
    "lead": {"kind": "lead_filter", "tau_f": 0.02},
    "levant": {"kind": "levant", "lipschitz": 20.0},
}
PID = {"kind": "pid", "k_p": 4.0, "k_i": 1.0, "k_d": 1.0, "filter": 0.01}
SIGNALS = ("e", "sigma", "sigma_measured", "u_total")


def flights(wrapped, continuous):
    """Trajectories of the wrapped plant and of the continuous one."""
    return [dj.simulate(dj.Study.from_table(table)) for table in (wrapped, continuous)]


def departure(first, second):
    """Largest difference of the signals, relative to the largest value of each."""
    return max(float(np.max(np.abs(first[name] - second[name])) / np.max(np.abs(second[name]))) for name in SIGNALS)


@pytest.mark.parametrize(
    ("sensor", "differentiator"),
    [("ideal", "lead"), ("jitter", "none"), ("noise", "lead"), ("lag", "none"), ("lag", "levant")],
)
def test_a_step_of_more_than_half_a_turn(sensor, differentiator):
    """3.5 rad ahead is 2.78 rad back; nothing in the loop sees a turn of the angle."""
    parts = {"sensor": SENSORS[sensor], "differentiator": DIFFERENTIATORS[differentiator]}
    size = 3.5
    wrapped = heading(reference={"kind": "step", "size": size, "at": 1.0}, **parts)
    shorter = {"kind": "step", "size": size - 2.0 * math.pi, "at": 1.0}
    first, second = flights(wrapped, heading("CONTINUOUS", reference=shorter, **parts))
    assert departure(first, second) < COMPILER
    assert float(np.max(np.abs(first["sigma"]))) == pytest.approx(0.5 * (2.0 * math.pi - size), rel=0.2)
    assert float(np.max(np.abs(first["sigma_measured"] - first["sigma"]))) < 0.35


@pytest.mark.parametrize("sensor", ["ideal", "lag"])
def test_a_measured_angle_sees_no_turn_of_its_reference(sensor):
    """Before its sensor and in its reading it is the angle of the continuous plant."""
    parts = {"sensor": {"measures": ["y"], "y": SENSORS[sensor]}}
    wrapped = heading(reference={"kind": "step", "size": 3.5, "at": 1.0}, **parts)
    shorter = {"kind": "step", "size": 3.5 - 2.0 * math.pi, "at": 1.0}
    first, second = flights(wrapped, heading("CONTINUOUS", reference=shorter, **parts))
    np.testing.assert_allclose(first["measured_y"], second["measured_y"], atol=1e-9)
    assert float(first["measured_y"][-1]) < -1.0


def test_a_measured_angle_begins_in_the_turn_of_the_channels_reading():
    """The reference lies in another turn than the reading of the flight computer."""
    reference = {"kind": "step", "size": 4.0, "at": 0.0}
    run = dj.simulate(dj.Study.from_table(heading(start=3.8, reference=reference, sensor={"measures": ["y"]})))
    np.testing.assert_array_equal(run["measured_y"], run["y_measured"])
    assert float(run["measured_y"][0]) == pytest.approx(3.8 - 2.0 * math.pi)


@pytest.mark.parametrize("controller", [heading()["controller"], PID], ids=["pi", "pid"])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_turning_through_pi(controller, direction):
    """Both sides of the principal value: the heading crosses pi, or -pi, with every part that has a memory."""
    parts = {"sensor": SENSORS["lag"], "differentiator": DIFFERENTIATORS["lead"], "controller": controller}
    start = 3.0 * direction
    ramp = {"kind": "ramp", "slope": 2.0 * direction, "offset": start}
    first, second = flights(
        heading(start=start, reference=ramp, **parts), heading("CONTINUOUS", start=start, reference=ramp, **parts)
    )
    assert departure(first, second) < COMPILER
    assert np.array_equal(np.sign(first["y"]), np.sign(second["y"]))  # what is shown lies near the reference


def test_a_pid_sees_no_jump_of_its_measurement():
    """The reference steps by more than half a turn; the derivative of the measurement takes no part in it."""
    step = {"kind": "step", "size": 3.5, "at": 1.0}
    first, second = flights(
        heading(controller=PID, reference=step),
        heading("CONTINUOUS", controller=PID, reference=step | {"size": 3.5 - 2.0 * math.pi}),
    )
    assert departure(first, second) < COMPILER
    at = int(np.searchsorted(first["t"].values, 1.0 - 1e-9))
    assert abs(float(first["derivative"][at])) < 1e-6


def test_the_vehicle_turns_the_short_way():
    """Yaw step of 3.5 rad with noise, jitter and a lead filter: the true sigma is 1.39 rad/s."""
    table = dj.Study.load("paper_case1").table
    table = {**table, "loop": {"duration": 1.5, "sample_time": 0.005}, "wind": {"kind": "none"}}
    table["plant"] = {**table["plant"], "yaw": 0.0, "position": [0.0, 0.0, 10.0]}
    table["reference"] = {**table["reference"], "psi": {"kind": "step", "size": 3.5, "at": 1.0}}
    table["controller"] = {**table["controller"], "psi": {**table["controller"]["psi"], "l0": 0.5}}
    table["sensor"] = {"kind": "ideal", "psi": {"kind": "noisy", "jitter": 0.004, "position_std": 0.001}}
    table["differentiator"] = {"kind": "none", "psi": {"kind": "lead_filter", "tau_f": 0.02}}
    table.pop("requirement")
    run = dj.simulate(dj.Study.from_table(table))
    assert float(np.max(np.abs(run["psi_sigma"]))) == pytest.approx(1.39, abs=0.01)
    assert float(np.max(np.abs(run["psi_sigma_measured"]))) == pytest.approx(1.39, abs=0.1)
    assert float(np.max(np.abs(run["psi_u_total"]))) < 0.6


@pytest.mark.parametrize("psi", [-3.1, 3.1, -math.pi, math.pi, 0.0, 2.9, 3.1 + 8.0 * math.pi])
@pytest.mark.parametrize("desired", [3.1, -3.1, math.pi, 0.3, -3.1 - 4.0 * math.pi])
def test_turned_near(psi, desired):
    with arithmetic():
        close = float(turned_near(psi, desired))
    assert abs(close - desired) <= math.pi * (1.0 + ROUNDING)
    assert np.exp(1j * close) == pytest.approx(np.exp(1j * psi), abs=1e-13)
    if abs(psi - desired) < math.pi:
        assert close == psi


def carrying_controllers():
    """Every kind of controller in every sampled form, and smoothed signs."""
    for table in CONTROLLER_TABLES:
        entry = CONTROLLERS[table["kind"]]
        smooth = table.get("functions", {}).get("kind") == "approx_sta_2"
        widths = [{}, {"sign_width": 0.2}] if smooth else [{}]
        for option in entry.members:
            chosen = {entry.option: option.value} if entry.option else {}
            for width in widths:
                row = table.get("functions", {}).get("kind", "")
                yield pytest.param({**table, **chosen, **width}, id=f"{table['kind']}-{row}-{option}-{len(width)}")


@pytest.mark.parametrize("table", [*carrying_controllers()])
def test_a_transferred_state_gives_the_command(table):
    """Found in closed form; tested by the controller's own step."""
    study = dj.Study.from_table(
        {
            "name": "carried",
            "loop": {"duration": 1.0, "sample_time": 0.01},
            "plant": {"kind": "normal_form"},
            "controller": {"l0": 1.0, **table},
            "differentiator": {"kind": "lead_filter", "tau_f": 0.02},
        }
    )
    with arithmetic():
        params = study.params({})
        reading, reference = Measurement(0.13, 0.0), ReferencePoint(0.1, 0.02, -0.1)
        if study.loop.controller[0].transfer is None:
            assert table["kind"] in ("smc", "discrete_transfer_function", "discrete_state_space")
            assert transfer_control(study.loop, params, 0, reading, reference, 0.3) is None
            return
        for expected in (0.3, -0.25):
            state = transfer_control(study.loop, params, 0, reading, reference, jnp.asarray(expected))
            _, controlled = control(study.loop, params, 0, state, reading, reference)
            assert float(controlled.command.total) == pytest.approx(expected, abs=1e-10)
