"""Delays and integrals of an inner loop at the first sample: the one that a flight has is told, and not the other."""

import re

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.flight_logs.fit.first_integrals import FreeIntegrals, StartsElsewhere
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.refusals import Unexplained
from dssc_jax.flight_logs.fit.shifts import Delay
from dssc_jax.flight_logs.reading.reader import Column, FlightLog

MASS = ("plant.vehicle.mass",)
STUDY = dj.Study.from_table(
    {
        "name": "hover",
        "draws": 1,
        "loop": {"duration": 4.0, "sample_time": 0.02, "substeps": 8},
        "plant": {
            "kind": "uav",
            "position": [0.0, 0.0, 2.0],
            "vehicle": {"kind": "x500", "mass": {"uniform": [1.9, 2.2]}},
            "believed": {"mass": 2.0},
            "inner_loop": {"kind": "article", "kp_velocity": 0.5, "kd_velocity": 2.0},
        },
        "reference": {
            "kind": "hover",
            "position": [0.0, 0.0, 2.0],
            "x": {"kind": "record", "time": [0.0, 0.5, 2.0], "value": [0.0, 2.0, 0.0], "interpolation": "hold"},
            "z": {"kind": "record", "time": [0.0, 1.0, 2.5], "value": [2.0, 3.0, 2.5], "interpolation": "hold"},
        },
        "controller": {"kind": "pid", "k_p": 0.95},
    }
)


def flight(late=0, integral=0.0):
    """The log of a vehicle of 2.1 kg with outputs that are some samples late, or another first integral of z."""
    changes = {"plant.vehicle.mass": 2.1, "plant.inner_loop.velocity_integral": [0.0, 0.0, integral]}
    run = dj.simulate(STUDY.override(changes))
    time = run["t"].values
    random = np.random.default_rng(4)
    columns = {}
    for channel in STUDY.loop.channels:
        y = run[f"{channel}_y"].values
        y = np.concatenate([np.full(late, y[0]), y[: len(y) - late]])
        columns[f"{channel}_y"] = Column(time, y + 0.005 * random.normal(size=len(y)))
        columns[f"{channel}_u_total"] = Column(time, run[f"{channel}_u_total"].values)
    return FlightLog("flight", columns, 0.0)


def test_late_outputs_of_a_vehicle_are_no_integrals():
    fitted = fit_log(STUDY, flight(late=4), MASS)
    (doubt,) = [doubt for doubt in fitted.doubts if doubt.code == "delayed-output"]
    found = re.search(r"are (\S+) ± (\S+) s later", doubt.text)
    assert found is not None, doubt.text
    assert abs(float(found[1]) - 0.08) < 2.0 * float(found[2])
    assert not any(other.code == "first-integrals" for other in fitted.doubts)


def test_integrals_of_a_vehicle_are_no_delay():
    with pytest.raises((StartsElsewhere, Unexplained)) as refusal:
        fit_log(STUDY, flight(integral=1.5), MASS)
    assert "velocity_integral.2 = 1." in str(refusal.value)
    assert "later than the study predicts" not in str(refusal.value)


@pytest.mark.parametrize(("shifted", "less"), [((0.01, 0.02), True), ((0.01, 0.008), False)])
def test_the_smaller_residual_tells_which(shifted, less):
    integrals = FreeIntegrals(
        names=("i",),
        values=np.ones(1),
        deviations=np.ones(1),
        p_value=0.0,
        moves={"m": 9.0},
        residuals={0: 0.01, 1: 0.02, 2: 0.01},
        falls={0: 0.1, 1: 1.0, 2: 0.1},
    )
    delay = Delay((0, 2), 0.1, 0.01, 0.0, {"m": 2.0}, {"m": 1.0}, (0.1, 0.1), shifted)
    assert integrals.leave_less_than(delay) == less
    assert integrals.explain_much


def test_integrals_that_explain_another_channel_are_not_less_than_a_delay():
    """The delay of one channel leaves nothing there; the integrals explain a little of it, and nothing elsewhere."""
    integrals = FreeIntegrals(("i",), np.ones(1), np.ones(1), 0.0, {"m": 9.0}, {0: 0.09, 1: 0.1}, {0: 0.9, 1: 1.0})
    assert not integrals.explain_much
    assert not integrals.leave_less_than(Delay((0,), 0.1, 0.01, 0.0, {}, {}, (0.1,), (0.01,)))
