"""Section V's studies run, and the numbers behind the claims are finite on short runs."""

import re

import numpy as np
import pytest
import xarray as xr

import dssc_jax as dj
from benchmarks.paper import claims, loops, signals

NAMES = ("paper_case1", "paper_case2", "paper_field_test", "uav_robustness")
SHORT = 1.0  # s
NUMBER = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?")


@pytest.fixture(scope="module")
def runs():
    """Each study for a second; whole flights are what the documentation shows."""
    short = {"loop.duration": SHORT, "requirement": []}
    return {name: dj.simulate(loops.load(name).override(short)) for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_study_simulates(name, runs):
    assert runs[name].attrs["outcome_meaning"] == "ok"
    assert all(np.isfinite(column).all() for column in runs[name].values())


def test_case_2_takes_each_axis_of_the_article():
    starts = {axis: loops.case_2(axis).template.plant.initial[0] for axis in loops.AXES}
    assert starts == {"x": 40.0, "y": 10.0, "z": 10.0, "psi": np.pi / 4}
    assert [loops.case_2(axis).template.disturbance[0].value for axis in loops.AXES] == [-0.8, 0.8, 0.2, 0.1]


def test_fast_part_of_a_known_signal():
    t = np.arange(0.0, 40.0, 0.005)
    signal = 3.0 + 0.1 * t + 0.2 * np.sin(2.0 * np.pi * 2.0 * t)
    run = xr.Dataset({"u": (("t",), signal)}, coords={"t": t})
    assert signals.fast_part(run, "u", 5.0, 35.0) == pytest.approx(0.2 / np.sqrt(2.0), rel=0.01)


def test_both_models(runs):
    full, simple = runs["paper_case1"], loops.simplified(SHORT)
    found = [*claims.before_disturbance(full, simple, 0.2, 0.8), claims.functions_rise(full, simple, 0.5, 0.4)]
    require_finite(found)


def test_comparison():
    runs = loops.four(duration=SHORT)
    for axis in loops.AXES:
        largest = {name: float(abs(run[f"{axis}_u"]).max()) for name, run in runs.items()}
        assert max(largest["STA clipped"], largest["DSSC"]) <= loops.RHO[axis]
        assert len(set(largest.values())) >= 3, "each run is one of its own"
    require_finite([*claims.oscillation(runs, 0.2), *claims.advantage(runs, "short", 0.2)])
    require_finite([claims.alike({"DSSC": runs["DSSC"], "STA": runs["STA clipped"]}, 100.0, start=0.2)])


def test_field_test(runs):
    short = {"loop.duration": SHORT, "requirement": [], "controller": loops.FIELD_STA}
    flight = {"DSSC": runs["paper_field_test"], "STA": dj.simulate(loops.load("paper_field_test").override(short))}
    require_finite([claims.efforts([flight], "short", 0.2)])


def require_finite(found):
    for claim in found:
        numbers = [float(number) for number in NUMBER.findall(claim.measured)]
        assert "nan" not in claim.measured
        assert "inf" not in claim.measured
        assert numbers or claim.measured == "flies to the end"
        assert claim.verdict
