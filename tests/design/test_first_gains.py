"""First gains for plants of one's own: in their units, at the bandwidth that was asked for, and stable."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.design.first_gains import first_gains, plant_at_start
from tests.study.test_signals import held

INDUCTANCE, CAPACITY, SUPPLY, LOAD = 1e-5, 1e-4, 12.0, 2.0
T_S = 2e-6
BANDWIDTH = 6e4


def buck(controller=None, **changes):
    """A buck converter: volts from a duty ratio."""
    a = [[0.0, -1.0 / INDUCTANCE], [1.0 / CAPACITY, -1.0 / (LOAD * CAPACITY)]]
    table = {
        "name": "buck",
        "loop": {"duration": 4e-3, "sample_time": T_S},
        "plant": {"kind": "state_space", "a": a, "b": [SUPPLY / INDUCTANCE, 0.0], "c": [0.0, 1.0]},
        "units": {"output": "V", "command": "1"},
        "reference": {"kind": "step", "size": 3.3},
        "disturbance": {"kind": "step", "value": 0.05, "at": 1e-3},
        "controller": controller or {"kind": "pid", "k_p": 0.1},
    }
    return dj.Study.from_table({**table, **changes})


@pytest.mark.parametrize("kind", ["pid", "lqg", "ssc"])
def test_a_buck_converter_follows_its_reference(kind):
    found = first_gains(buck(), kind, BANDWIDTH, 1.0)
    run = dj.simulate(buck(found.table))
    assert run.attrs["outcome_meaning"] == "ok"
    assert abs(float(run["e"][-1])) < 0.02
    assert float(np.max(np.abs(run["u"]))) <= 1.0 + 1e-12
    assert not found.radius >= 1.0


def test_the_pid_loop_crosses_one_at_the_bandwidth_with_its_phase_margin():
    found = first_gains(buck(), "pid", BANDWIDTH)
    law = found.table
    a, b, c = plant_at_start(buck())
    transition, columns = held(a, b[:, None], T_S)
    z = np.exp(1j * BANDWIDTH * T_S)
    plant = c @ np.linalg.solve(z * np.eye(2) - transition, columns[:, 0])
    s = 1j * BANDWIDTH
    loop = plant * (law["k_p"] + law["k_i"] / s + law["k_d"] * s / (law["filter"] * s + 1.0))
    assert abs(loop) == pytest.approx(1.0, rel=2e-3)
    assert np.degrees(np.angle(loop)) == pytest.approx(-120.0, abs=0.2)


def test_the_largest_pole_is_that_of_the_loops_own_step():
    """Free decay of the simulated loop, late, against the largest pole."""
    found = first_gains(buck(), "pid", BANDWIDTH)
    study = buck(found.table, reference={"kind": "zero"}, disturbance={"kind": "none"})
    run = dj.simulate(study.override({"plant.x0": [0.0, 1.0]}))
    y = np.abs(run["y"].values)
    assert (y[1500] / y[1000]) ** (1.0 / 500.0) == pytest.approx(found.radius, rel=1e-4)


def test_without_a_bandwidth_the_first_that_works_is_taken():
    found = first_gains(buck(), "pid")
    assert found.bandwidth == pytest.approx(0.025 * np.pi / T_S)


@pytest.mark.parametrize(
    ("kind", "bandwidth", "limit", "message"),
    [
        ("dssc", BANDWIDTH, 1.0, "must be one of pid, lqg, ssc"),
        ("pid", 1e7, None, "must be > 0 and <="),
        ("pid", 2e5, None, "needs a phase lead"),
        ("ssc", BANDWIDTH, None, "is required for 'ssc'"),
    ],
)
def test_what_cannot_be_designed_gets_its_line(kind, bandwidth, limit, message):
    with pytest.raises(ConfigError, match=message):
        first_gains(buck(), kind, bandwidth, limit)


def test_a_plant_with_the_other_sign_is_refused():
    with pytest.raises(ConfigError, match=r"turn the command's sign|is not stable"):
        first_gains(buck().override({"plant.b": [-SUPPLY / INDUCTANCE, 0.0]}), "pid", BANDWIDTH)
