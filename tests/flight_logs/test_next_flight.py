"""A set for the next flight, and what flights say of the study: on flights of the study, and of another one."""

import json

import numpy as np
import pandas as pd
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.flight_logs.hints.references import study_references
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from dssc_jax.flight_logs.replay import curves_of_draws
from dssc_jax.statistics.exchangeable import Yardstick
from dssc_jax.study.tables import to_toml
from tests.flight_code.test_code import table

DT = 0.01
SAMPLES = 300
FLIGHTS = 30


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table({**table({"kind": "pi", "k_p": 1.0, "k_i": 0.5}), "draws": 200})


@pytest.fixture(scope="module")
def logs(study):
    """Logs of draws that the comparison does not take."""
    time = DT * np.arange(SAMPLES)
    more = study.override({"draws": study.config.draws + FLIGHTS + 60})
    logs = []
    for curves in list(curves_of_draws(more, SAMPLES))[study.config.draws :]:
        columns = {"y": Column(time, np.array(curves[0].y)), "u_total": Column(time, np.array(curves[0].u_total))}
        logs.append(FlightLog(f"flight {len(logs)}", columns, 0.0))
    return logs


@pytest.fixture(scope="module")
def found(study, logs):
    return dj.next_flight(study, logs[:FLIGHTS])


def test_new_flights_lie_in_the_band(found, logs):
    """All signals at all times together, as often as stated."""
    data = found.dataset
    inside = []
    for log in logs[FLIGHTS:]:
        values = np.array([log.columns[name].value for name in data["signal"].values])
        inside.append(np.all((data["lower"].values <= values) & (values <= data["upper"].values)))
    assert np.mean(inside) > 0.75  # 0.9 less four standard deviations of a mean of 60, and of the band itself
    answer = found.answer
    assert answer.rank == 28
    assert answer.least_flights == 9
    outside = np.count_nonzero(data["departure"].values > answer.departure)
    assert outside == FLIGHTS - answer.rank


def test_a_flight_that_is_given_twice_is_refused(study, logs):
    with pytest.raises(dj.ConfigError, match="'flight 3' and 'copy' hold the same flight"):
        dj.next_flight(study, [*logs[:5], logs[3]._replace(name="copy")])


def test_limits_of_metrics(study, found, logs):
    reference = study_references(study, SAMPLES)[0, 0]
    errors = np.array([np.abs(log.columns["y"].value - reference).max() for log in logs[:FLIGHTS]])
    limit = found.answer.metrics["error_max"]
    assert limit.limit == pytest.approx(np.sort(errors)[27])
    assert limit.largest == pytest.approx(errors.max())
    assert 0.0 <= limit.draws_beyond < 0.4


def test_flights_of_the_study_do_not_refute_it(found):
    test = found.answer.study_test
    assert not test.refuted
    assert test.share_interval[0] <= test.beyond / FLIGHTS <= test.share_interval[1]
    assert "do not refute the study" in found.headline


def test_flights_of_another_study_refute_it(study, logs):
    """Their output has an offset; the set of the next flight is right all the same."""
    moved = []
    for log in logs[:12]:
        y = log.columns["y"]
        moved.append(FlightLog(log.name, {**log.columns, "y": Column(y.time, y.value + 1.0)}, 0.0))
    found = dj.next_flight(study, moved)
    test = found.answer.study_test
    assert test.beyond == 12
    assert test.refuted
    assert test.flights_to_refute["0.5"] <= 12
    assert found.answer.departure is not None


def test_a_log_that_disagrees_with_the_study_is_named(study, logs):
    reference = study_references(study, SAMPLES)[0, 0]
    opposite = Column(logs[3].columns["y"].time, -reference)
    wrong = logs[3]._replace(name="flipped", columns=logs[3].columns | {"y_ref": opposite})
    answer = dj.next_flight(study, [*logs[:3], wrong]).answer
    (warning,) = answer.warnings
    assert (warning.log, warning.signal) == ("flipped", "y_ref")
    assert warning.text == "y_ref is the study's with the opposite sign"
    assert answer.warned
    assert not dj.next_flight(study, logs[:3]).answer.warned
    assert len(answer.study_test.logs_beyond) == answer.study_test.beyond


def test_too_few_flights_have_no_set(study, logs):
    found = dj.next_flight(study, logs[:5])
    assert found.answer.departure is None
    assert np.isnan(found.dataset["upper"].values).all()
    assert "needs 9" in found.headline


def test_what_a_log_lacks_is_left_out_of_all(study, logs):
    """One has no command, and another one misses a second of its output."""
    y = logs[0].columns["y"]
    gap = (y.time < 1.0) | (y.time > 2.0)
    first = FlightLog("first", {"y": y}, 0.0)
    second = FlightLog("second", {**logs[1].columns, "y": Column(y.time[gap], logs[1].columns["y"].value[gap])}, 0.0)
    found = dj.next_flight(study, [first, second, *logs[2:10]])
    assert list(found.dataset["signal"].values) == ["y"]
    missing = np.isnan(found.dataset["highest"].values[0])
    np.testing.assert_array_equal(missing, ~gap)


def test_a_departure_by_hand():
    yardstick = Yardstick.of(np.array([[[0.0, 5.0]], [[1.0, 5.0]], [[3.0, 5.0]]]))
    np.testing.assert_allclose(yardstick.middle, [[1.0, 5.0]])
    assert yardstick.spread[0, 0] == 1.0  # the median of 1, 0, 2
    known = np.array([[True, False]])
    assert yardstick.largest_departure(np.array([[4.5, 99.0]]), known) == 3.5
    assert yardstick.largest_departure(np.array([[np.nan, 0.0]]), known) == np.inf
    same = Yardstick.of(np.array([[[1.0, 2.0]], [[1.0, 2.0]]]))
    assert np.isnan(same.spread).all()


def test_what_is_refused(study, logs):
    for arguments, options, told in (
        ((study, logs), {"probability": 1.0}, "probability: must lie in"),
        ((study, []), {}, "at least one flight"),
        ((study.override({"draws": 20}), logs), {}, "must be at least 38"),
        ((study.override({"sampling": "lhs"}), logs), {}, "needs independent draws"),
        (
            (study, [FlightLog("empty", {"y_dot": logs[0].columns["y"]}, 50.0)]),
            {},
            "has no output and no command in the study's 3 s",
        ),
    ):
        with pytest.raises(dj.ConfigError, match=told):
            dj.next_flight(*arguments, **options)


def test_the_command_line(tmp_path, monkeypatch, capsys, logs):
    monkeypatch.chdir(tmp_path)

    names = []
    for index, log in enumerate(logs[:5]):
        names.append(f"{index}.csv")
        columns = {"t": log.columns["y"].time, **{name: column.value for name, column in log.columns.items()}}
        pd.DataFrame(columns).to_csv(tmp_path / names[-1], index=False)
    study = dj.Study.from_table({**table({"kind": "pi", "k_p": 1.0, "k_i": 0.5}), "draws": 60})
    (tmp_path / "s.toml").write_text(to_toml(study.table))
    arguments = ["compare-log", "s.toml", *names, "--probability", "0.8", "--out", "n"]
    assert guarded([*arguments, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["flights"] == 5
    assert answer["rank"] == 5
    assert guarded(arguments) == 0
    told = capsys.readouterr().out
    assert "the next flight departs by at most" in told
    assert "flights that refute the study" in told
    assert "are compared up to there only" not in told
    columns = {"t": logs[5].columns["y"].time, **{name: column.value for name, column in logs[5].columns.items()}}
    pd.DataFrame(columns)[: SAMPLES // 2].to_csv(tmp_path / "short.csv", index=False)
    shortened = ["compare-log", "s.toml", *names, "short.csv", "--probability", "0.8", "--out", "m"]
    assert guarded(shortened) == 0
    assert "short.csv ends after 1.49 s, and all flights are compared up to there only" in capsys.readouterr().err
    assert guarded(["report", "n"]) == 0
    assert "What logged flights say of the next one" in (tmp_path / "n" / "report.html").read_text()
    capsys.readouterr()
    assert guarded(["compare-log", "s.toml", names[0], "--probability", "0.8"]) == 2
    assert "--probability: has no meaning with a single log" in capsys.readouterr().err
    assert guarded(["compare-log", "s.toml", *names, "--fit"]) == 2
    assert "--fit: has no meaning with several logs" in capsys.readouterr().err
