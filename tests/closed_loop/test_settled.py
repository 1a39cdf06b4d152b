"""Draws that are over once they have settled: what they keep, and that nobody else sees it."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.closed_loop.metrics.streaming import Scope
from dssc_jax.study.available_metrics import PACKAGE_METRICS

RULE = {"error": 0.02, "hold": 0.5, "after": 1.0}
LOOP = {
    "name": "settling",
    "draws": 40,
    "loop": {"duration": 12.0, "sample_time": 0.01},
    "plant": {"kind": "normal_form", "k_p": {"uniform": [0.6, 1.4]}, "initial": [{"uniform": [0.5, 2.0]}, 0.0]},
    "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.5, "k_i": 0.5},
    "metrics": {"names": ["error_rms", "error_max", "command_tv"]},
    "requirement": [{"metric": "error_max", "after": 1.0, "max": 0.8}],
}


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(LOOP).override({"loop.settled": RULE})


@pytest.fixture(scope="module")
def result(study):
    return dj.run(study).dataset


def by_hand(error, rule, sample_time):
    """Samples that are flown, from the errors of a run to the end."""
    calm = 0
    for k, e in enumerate(error):
        calm = calm + 1 if k >= round(rule["after"] / sample_time) and abs(e) <= rule["error"] else 0
        if calm == round(rule["hold"] / sample_time):
            return k + 1
    return len(error)


def test_a_draw_ends_when_it_has_settled_and_keeps_its_metrics(study, result):
    """Against trajectories of the study without the rule."""
    plain = dj.Study.from_table(LOOP)
    for draw in range(6):
        error = dj.simulate(plain, draw)["e"].values
        flown = by_hand(error, RULE, 0.01)
        assert flown < len(error)
        assert result["settled_at"].values[draw] == pytest.approx(0.01 * flown)
        assert result["error_rms"].values[draw] == pytest.approx(np.sqrt(np.mean(error[:flown] ** 2)), rel=1e-12)


def test_they_end_at_different_times_and_as_successes(result):
    ended = result["settled_at"].values
    assert np.ptp(ended[np.isfinite(ended)]) > 1.0
    assert np.all(np.isnan(result["failed_at"].values))
    worst = result["error_max_after_1"].values
    np.testing.assert_array_equal(result["outcome"].values > 0, worst > 0.8)
    assert 0 < np.sum(worst > 0.8) < len(worst)


@pytest.mark.parametrize("tile", [1, 32])
def test_nobody_sees_who_flies_beside_it(study, result, tile):
    found = dj.run(study, tile=tile).dataset
    for name in result.data_vars:
        np.testing.assert_array_equal(found[name], result[name], err_msg=name)


def test_a_trajectory_stops_there_and_replays(study, result):
    trajectory = dj.simulate(study, 3)
    settled = float(result["settled_at"][3])
    assert trajectory.attrs["settled_at"] == pytest.approx(settled)
    flown = np.isfinite(trajectory["e"].values)
    assert trajectory["t"].values[flown].max() == pytest.approx(settled - 0.01)
    assert dj.replay(dj.run(study), 3).attrs["deviation"] < 1e-9


def test_a_rule_that_nothing_meets_changes_nothing():
    endless = dj.Study.from_table(LOOP).override({"loop.settled": {**RULE, "error": 1e-12}})
    plain, found = dj.run(dj.Study.from_table(LOOP)).dataset, dj.run(endless).dataset
    assert np.all(np.isnan(found["settled_at"]))
    for name in plain.data_vars:
        np.testing.assert_allclose(found[name], plain[name], rtol=1e-13, err_msg=name)


@pytest.mark.parametrize(
    ("rule", "error"),
    [
        ({**RULE, "after": 0.5}, r"loop\.settled\.after: must be >= 1 s, where the window of error_max_after_1 begins"),
        ({**RULE, "hold": 0.001}, r"hold must be >= sample_time = 0\.01 s, got 0\.001"),
        ({**RULE, "error": 0.0}, r"loop\.settled\.error.*greater than 0|loop\.settled\.error.*> 0"),
        ({"error": 0.1}, r"loop\.settled\.hold"),
        ({**RULE, "holds": 1.0}, r"loop\.settled\.holds.*did you mean 'hold'"),
    ],
)
def test_bad_rules_are_told(rule, error):
    with pytest.raises(dj.ConfigError, match=error):
        dj.Study.from_table(LOOP).override({"loop.settled": rule})


def test_every_metric_of_a_settled_draw_is_that_of_a_run_that_ends_there(study):
    """Also those that count the samples of their window."""
    judged_elsewhere = {"settling_time_percent"}  # it is refused
    names = sorted(name for name, metric in PACKAGE_METRICS.items() if metric.scope is Scope.CHANNEL)
    names = [name for name in names if name not in judged_elsewhere]
    several = study.override({"metrics": {"names": names}, "requirement": [], "draws": 1, "plant.k_p": 1.0})
    several = several.override({"plant.initial": [1.0, 0.0]})
    settled = dj.run(several).dataset
    duration = float(settled["settled_at"][0])
    shorter = several.override({"loop.settled": {**RULE, "error": 1e-12}, "loop.duration": round(duration, 2)})
    expected = dj.run(shorter).dataset
    found = [name for name in names if name in settled]
    assert {"growth_rate", "error_rms", "command_tv"} <= set(found)
    for name in found:
        np.testing.assert_allclose(settled[name], expected[name], rtol=1e-9, atol=1e-12, err_msg=name)


SETTLING = {**LOOP, "metrics": {"names": ["settling_time"]}, "requirement": []}


@pytest.mark.parametrize("band", [0.01, 0.02, 0.05])
def test_a_draw_does_not_end_outside_of_a_settling_band(band):
    """Within the band, settling times are those of the whole run; outside, they would be infinite."""
    study = dj.Study.from_table({**SETTLING, "metrics": {"names": ["settling_time"], "settling_band": band}})
    if band < RULE["error"]:
        with pytest.raises(dj.ConfigError, match=r"loop\.settled\.error: must be <= 0\.01, the band of settling_time"):
            study.override({"loop.settled": RULE})
        return
    long_hold = {**RULE, "hold": 2.0}  # no draw leaves the band again
    settled = dj.run(study.override({"loop.settled": long_hold})).dataset["settling_time"].values
    assert np.isfinite(settled).all()
    np.testing.assert_allclose(settled, dj.run(study).dataset["settling_time"].values, rtol=1e-12)


def test_a_band_that_is_a_share_of_the_step_is_refused():
    study = dj.Study.from_table({**SETTLING, "reference": {"kind": "step", "size": 1.0, "at": 0.0}})
    study = study.override({"metrics.names": ["settling_time_percent"]})
    with pytest.raises(dj.ConfigError, match="a share of the draw's own step"):
        study.override({"loop.settled": RULE})


def test_an_envelope_after_the_end_of_draws_is_refused():
    """Draws that have settled would meet it without being flown."""
    study = dj.Study.from_table(LOOP)
    envelope = {"signal": "e", "upper": [[0.5, 0.1], [6.0, 0.1]]}
    with pytest.raises(dj.ConfigError, match=r"envelope\.0: bounds 'e' up to 6 s"):
        study.override({"loop.settled": RULE, "envelope": [envelope]})
    assert study.override({"loop.settled": {**RULE, "after": 6.0}, "envelope": [envelope]}).requirements
    with pytest.raises(dj.ConfigError, match=r"envelope\.0: begins at 12\.5 s, after the last sample at 11\.99 s"):
        study.override({"envelope": [{"signal": "e", "upper": [[12.5, 0.1], [13.0, 0.1]]}]})


def test_a_window_that_begins_between_samples_has_a_sample():
    """The rule counts from the same sample as the window, also where it holds for one sample."""
    rule = {"error": 5.0, "hold": 0.01, "after": 1.004}
    study = dj.Study.from_table(LOOP).override({"requirement.0.after": 1.004, "loop.settled": rule})
    dataset = dj.run(study).dataset
    assert (dataset["error_max_after_1.004"].values > 0.0).all()
    np.testing.assert_allclose(dataset["settled_at"].values, 1.02)


def test_a_hold_between_samples_lasts_for_whole_ones():
    """It is not shorter than stated."""
    for hold, ended in ((0.01, 1.01), (0.014, 1.02), (0.016, 1.02), (0.02, 1.02)):
        rule = {"error": 5.0, "hold": hold, "after": 1.0}
        dataset = dj.run(dj.Study.from_table(LOOP).override({"loop.settled": rule, "draws": 4})).dataset
        np.testing.assert_allclose(dataset["settled_at"].values, ended)


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"reference": {"kind": "step", "at": 3.0, "size": 1.0}}, "reference.at"),
        ({"disturbance": {"kind": "step", "value": 0.1, "at": {"uniform": [0.0, 2.0]}}}, "disturbance.at"),
        (
            {"disturbance": {"kind": "step", "value": 0.1, "at": 0.5}, "sweep": {"disturbance.at": [0.5, 4.0]}},
            "disturb",
        ),
    ],
)
def test_nothing_begins_after_a_draw_may_have_settled(changes, name):
    """A draw ended before the step that would have failed it, and passed."""
    table = LOOP | changes
    dj.Study.from_table(table)
    with pytest.raises(dj.ConfigError, match=rf"loop.settled.after: must be >= \d.* since {name}.* something begins"):
        dj.Study.from_table(table | {"loop": LOOP["loop"] | {"settled": RULE}})
    late = table | {"loop": LOOP["loop"] | {"settled": RULE | {"after": 5.0}}}
    assert dj.Study.from_table(late).loop.settled.after == 5.0
