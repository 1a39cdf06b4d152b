"""A stored result against its lanes computed again."""

import json
import shutil

import numpy as np
import pytest
import zarr

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.compiled_lanes import LaneBatch
from dssc_jax.engine.reference import TOLERANCE, deviations, resting_metrics
from tests.conftest import UNCERTAIN
from tests.forging import redigested
from tests.results.test_durability import SMALL


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return dj.run(dj.Study.from_table(SMALL), tmp_path_factory.mktemp("results") / "small")


@pytest.fixture
def copied(whole, tmp_path):
    return shutil.copytree(whole.path, tmp_path / "copied")


def change(folder, name, factor):
    """Falsify a whole variable, digests and all."""
    array = zarr.open_group(folder / "data.zarr", mode="r+")[name]
    array[...] = (np.asarray(array) * factor).astype(array.dtype)
    redigested(folder)


def test_a_result_is_what_is_computed(whole):
    found = dj.verify(whole, draws=500, seed=1)
    assert (found.lanes, found.verdict, found.undecided, found.single_precision) == (144, "agrees", 0, None)
    assert found.verified
    assert found.deviation < 1e-11
    assert found.otherwise == []


def test_seeds_pick_lanes(whole):
    assert dj.verify(whole, draws=3, seed=1) == dj.verify(whole, draws=3, seed=1)
    assert dj.verify(whole, draws=3).seed != dj.verify(whole, draws=3).seed


@pytest.mark.parametrize(
    ("name", "factor", "code"), [("error_rms", 1 + 1e-11, 0), ("error_rms", 1 + 1e-6, 1), ("plant.k_p", 1.01, 1)]
)
def test_deviations_are_found(copied, capsys, name, factor, code):
    change(copied, name, factor)
    assert guarded(["verify", str(copied), "--json"]) == code
    found = json.loads(capsys.readouterr().out)
    assert found["deviation"] == pytest.approx(factor - 1, rel=0.1)
    assert found["worst"]["variable"] == name
    assert found["verified"] is (code == 0)
    assert found["worst"]["stored"] == pytest.approx(found["worst"]["computed"] * factor, rel=1e-10)
    assert guarded(["verify", str(copied), "--seed", "1"]) == code
    assert ("by more than rounding explains" in " ".join(capsys.readouterr().out.split())) is (code == 1)


def test_an_outcome_is_right_or_wrong(copied):
    change(copied, "outcome", 2)
    found = dj.verify(dj.load(copied), draws=200)
    assert not found.verified
    assert found.deviation == np.inf


def test_sizes_of_deviations(whole):
    nan, inf = np.nan, np.inf
    stored, computed = np.array([1.0, 0.0, nan, inf, -inf, nan]), np.array([1.0, 1e-12, nan, inf, inf, 1.0])
    found = deviations(whole.study, {"error_rms": 0.5}, {"error_rms": stored}, {"error_rms": computed})["error_rms"]
    np.testing.assert_allclose(found, [0.0, 2e-12, 0.0, 0.0, inf, inf])
    assert TOLERANCE[64] < TOLERANCE[32]


def test_rounding_may_move_a_settling_time_by_one_sample(uncertain):
    stored, sample = np.array([0.4, 0.4]), uncertain.loop.sample_time
    computed = stored + np.array([1.0, 3.0]) * sample
    found = deviations(uncertain, {"settling_time": 0.4}, {"settling_time": stored}, {"settling_time": computed})
    np.testing.assert_allclose(found["settling_time"], [0.0, 2.0 * sample / 0.4], rtol=1e-5)


def test_a_program_that_computes_something_else_is_found(monkeypatch):
    """What makes the result is wrong, and makes it wrong again: only another program can tell."""
    study = dj.Study.from_table(UNCERTAIN | {"sweep": {}, "disturbance": {"kind": "step", "value": 0.3, "at": 1.0}})
    start = LaneBatch.start
    monkeypatch.setattr(LaneBatch, "start", lambda own, values, index: start(own, wrong(values), index))
    result = dj.run(study)
    assert dj.verify(result, seed=1).verdict == "differs"
    assert dj.replay(result, 2).attrs["agreement"] == "differs"


def wrong(values):
    return {**values, "plant.k_p": 1.001 * values["plant.k_p"]}


COARSE = UNCERTAIN | {
    "sweep": {},
    "controller": UNCERTAIN["controller"]
    | {"functions": {"kind": "approx_sta_2", "kappa1": 60.0, "kappa2": 60.0, "delta": 0.1, "tau_av": 0.05}},
    "loop": {"duration": 40.0, "sample_time": 0.1},
}
"""Sampled so slowly that the loop neither settles nor diverges."""


def test_a_loop_that_amplifies_rounding_is_no_evidence():
    found = dj.verify(dj.run(dj.Study.from_table(COARSE)), seed=1)
    assert found.undecided > 0
    assert found.verdict in ("agrees", "undecided")


def test_single_precision_is_compared_with_double():
    found = dj.verify(dj.run(dj.Study.from_table(UNCERTAIN).override({"loop.precision": 32})), seed=1)
    assert found.verdict == "agrees"
    assert found.single_precision.outcomes == 0
    assert 1e-9 < found.single_precision.median < 1e-3


def test_bad_requests(whole, tmp_path, capsys):
    for options, message in ({"draws": 0}, "must be in 1"), ({"draws": 10**6}, "must be in 1"), ({"seed": -1}, ">= 0"):
        with pytest.raises(ConfigError, match=message):
            dj.verify(whole, **options)
    assert guarded(["verify", str(tmp_path)]) == 2
    assert "is not a results folder" in capsys.readouterr().err


def test_a_channel_at_rest_does_not_make_a_result_worthless(tmp_path):
    """Its errors are rounding of the other channels, 1e-16 rad, which any other program rounds otherwise."""
    table = {
        "name": "resting-yaw", "draws": 3, "loop": {"duration": 2.0, "sample_time": 0.02},
        "plant": {"kind": "uav", "vehicle": {"kind": "m600_hexacopter", "mass": {"uniform": [10.0, 12.0]}}},
        "reference": {"kind": "hover", "position": [0.0, 0.3, 1.0]},
        "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 0.3},
    }  # fmt: skip
    result = dj.run(dj.Study.from_table(table), tmp_path / "resting")
    resting = np.median(result.dataset["error_rms_psi"].values)
    assert 0.0 < resting < 1e-12
    found = dj.verify(result, draws=3)
    assert (found.verdict, found.undecided) == ("agrees", 0)
    change(result.path, "error_rms_y", 1 + 1e-6)
    assert dj.verify(dj.load(result.path), draws=3).verdict == "differs"


def test_a_small_metric_that_rounding_does_not_change_is_evidence():
    """Smallness alone excuses nothing: a charge of 1e-15 beside a voltage of 1 is no rounding."""
    study = dj.Study.from_table(UNCERTAIN)
    names = [measure.name for measure in study.measures][:2]
    sizes = {names[0]: 1.0, names[1]: 1e-15}
    quiet = dict.fromkeys(names, np.array([1e-13]))
    assert resting_metrics(study, sizes, quiet) == []
    for change_by_rounding in 0.01, 0.5:  # of a channel at rest, on processors that round otherwise
        assert resting_metrics(study, sizes, quiet | {names[1]: np.array([change_by_rounding])}) == [names[1]]
    assert resting_metrics(study, sizes | {names[1]: 1e-3}, quiet | {names[1]: np.array([0.5])}) == []
