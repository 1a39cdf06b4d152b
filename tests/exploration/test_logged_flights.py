"""The card of logged flights on a study's page, and the options that bring them there."""

import numpy as np
import pandas as pd
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.exploration.study_page import StudyPage
from dssc_jax.flight_logs.hints.references import study_references
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from dssc_jax.flight_logs.replay import curves_of_draws
from dssc_jax.statistics.conformal import flights_to_confirm, flights_to_refute
from dssc_jax.study.tables import to_toml

SAMPLES = 300
DT = 0.02
PAGE_DRAWS = 120
FLIGHTS = 12


@pytest.fixture(scope="module")
def logs(explored):
    """Logs of draws that the page does not take."""
    time = DT * np.arange(SAMPLES)
    more = explored.override({"draws": PAGE_DRAWS + FLIGHTS})
    logs = []
    for curves in list(curves_of_draws(more, SAMPLES))[PAGE_DRAWS:]:
        logs.append(FlightLog(f"flight {len(logs)}", {"y": Column(time, np.array(curves[0].y))}, 0.0))
    return logs


@pytest.fixture(scope="module")
def files(logs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    names = []
    for log in logs[:2]:
        column = log.columns["y"]
        names.append(str(folder / f"{log.name}.csv"))
        pd.DataFrame({"t": column.time, "height": column.value}).to_csv(names[-1], index=False)
    return names


def test_the_next_flight_on_request(live, explored, logs):
    """The limits are ranks of the flights; a move clears the answer, and other laws are refuted by the same flights."""
    page = StudyPage(live, logs=logs)
    assert "The next flight" in [getattr(part, "title", "") for part in page.view[1]]
    assert page.flights.answer.object == ""
    page.flights.compare.clicks += 1
    told = page.flights.answer.object
    assert "12 flights do not refute the study" in told
    assert "with a probability of at least 90 %" in told
    assert "<svg" in told
    compared = PAGE_DRAWS // 2
    assert f"<td>{flights_to_refute(0.5, compared)}</td><td>{flights_to_confirm(0.5, compared)}</td>" in told
    desired = study_references(explored, SAMPLES)[0, 0]
    errors = np.sort([np.abs(log.columns["y"].value - desired).max() for log in logs])
    assert f">{errors[11]:.4g}<" in told  # 0.9 (12 + 1), rounded up, is 12
    page.flights.probability.value = 0.5
    page.flights.compare.clicks += 1
    told = page.flights.answer.object
    assert "with a probability of at least 50 %" in told
    assert f">{errors[6]:.4g}<" in told
    page.move({"unmodelled.mu": 0.2})
    assert page.flights.answer.object == ""
    page.flights.compare.clicks += 1
    assert "12 flights refute the study" in page.flights.answer.object


def test_what_is_refused_is_told(live, logs):
    page = StudyPage(live, logs=logs)
    for value in (0.0, None):
        page.flights.probability.value = value
        page.flights.compare.clicks += 1
        assert "probability: must lie in (0, 1)" in page.status.object
    assert page.flights.answer.object == ""


def test_too_few_flights(live, logs):
    page = StudyPage(live, logs=logs[:3])
    page.flights.compare.clicks += 1
    assert "a set for the next one with 90 % needs 9" in page.flights.answer.object
    assert "<td>too few flights</td>" in page.flights.answer.object


def test_a_single_log(explored, logs):
    """Its p-value among the draws, as `compare_log` gives it."""
    page = dj.explore(explored, draws=40, logs=logs[:1])
    assert page.flights.title == "The logged flight"
    page.flights.compare.clicks += 1
    assert dj.compare_log(page.now.study, logs[0]).headline in page.flights.answer.object


def test_a_page_without_logs(live):
    assert StudyPage(live).flights is None


def test_the_command_line(explored, files, tmp_path, monkeypatch, capsys):
    """Logs are read with the options of `compare-log`; what has no meaning is refused."""
    shown = []
    monkeypatch.setattr("dssc_jax.cli.commands.explore.page_server", lambda make, *_: shown.append(make()) or Server())
    study = tmp_path / "s.toml"
    study.write_text(to_toml(explored.table))
    asked = ["explore", str(study), "--draws", "40", "--no-browser"]
    read = ["--log", files[0], "--log", files[1], "--column", "y=height", "--start", "0"]
    assert guarded([*asked, *read]) == 0
    (page,) = shown
    assert [log.name for log in page.flights.logs] == ["flight 0.csv", "flight 1.csv"]
    page.flights.compare.clicks += 1
    page.wait(60)
    page.close()
    assert "2 flights do not refute the study" in page.flights.answer.object
    capsys.readouterr()
    dj.run(explored, tmp_path / "result", check=False)
    for arguments, told in (
        ([*asked, "--log", files[0]], "map a column to at least one of y, u_total"),
        ([*asked, "--start", "0"], "--start: has no meaning without --log"),
        (["explore", str(tmp_path / "result"), "--log", files[0]], "--log: has no meaning with a result"),
    ):
        assert guarded(arguments) == 2
        assert told in " ".join(capsys.readouterr().err.split())
    with pytest.raises(dj.ConfigError, match="a result has its own"):
        dj.explore(dj.load(tmp_path / "result"), logs=page.flights.logs)


class Server:
    """A server that ends at once."""

    url = "http://127.0.0.1/"

    def serve(self):
        """Serve nobody."""
