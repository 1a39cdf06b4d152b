"""The flight in three dimensions: marks of failures, and what the browser projects, against NumPy."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.engine.batching import join_batches
from dssc_jax.exploration.figures import TICK_TEXT
from dssc_jax.exploration.flight_page import flight_html
from dssc_jax.exploration.flight_view import VIEW, FlightView, failure_sample, recorded_flights
from dssc_jax.exploration.live import ATTITUDE, LiveRun, has_vehicle, recorded_signals
from dssc_jax.runs.recorded_draws import RecordedDraws, SignalKey
from tests.browser import BROWSER, needs_browser

STUDY = """
name = "fly"
draws = 6
loop = { duration = 1.0, sample_time = 0.01 }
reference = { kind = "hover", position = [1.0, -0.5, 10.5] }
controller = { kind = "pi", l0 = 0.5, k_p = 0.8, k_i = 0.2 }
[plant]
kind = "uav"
position = [{ uniform = [0.0, 1.0] }, 0.0, 10.0]
vehicle = { kind = "m600_quadrotor", motor_lag = 0.05 }
[[requirement]]
metric = "position_error_max"
max = 0.9
"""


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """The study's file, and a run of it."""
    path = tmp_path_factory.mktemp("flight") / "fly.toml"
    path.write_text(STUDY)
    study = dj.Study.load(path)
    program = RecordedDraws(study, {}, recorded_signals(study), lanes=16)
    results = join_batches(list(program.batches(study, np.arange(6))))
    return path, LiveRun(study, results, {}, program.times)


def test_which_studies_fly(flown):
    _, run = flown
    assert has_vehicle(run.study)
    assert set(ATTITUDE) <= set(recorded_signals(run.study))
    motor = dj.Study.load("motor")
    assert not has_vehicle(motor)
    with pytest.raises(dj.ConfigError, match="no study of a vehicle"):
        flight_html(motor)


def test_recorded_flights_fail_and_are_marked_as_the_draws_of_a_run(flown):
    """The single draws come from another program."""
    _, run = flown
    again = recorded_flights(run.study, [dj.simulate(run.study, draw) for draw in range(6)])
    np.testing.assert_array_equal(again.failed, run.failed)
    assert [failure_sample(again, draw) for draw in range(6)] == [failure_sample(run, draw) for draw in range(6)]
    np.testing.assert_allclose(again.signal("theta"), run.signal("theta"), rtol=1e-6, atol=1e-9)


def test_marks_stand_where_a_failure_was_certain(flown):
    """A draw is marked at the first sample at which its violation is certain, found here from its signals."""
    _, run = flown
    view = FlightView()
    view.show(run, 2)
    assert 0 < run.failed.sum() < 6
    errors = np.sqrt(sum(run.signal(f"{axis}_e") ** 2 for axis in "xyz"))
    for draw in range(6):
        beyond = np.flatnonzero(errors[draw] > 0.9)
        expected = int(beyond[0]) if beyond.size else -1
        assert view.tracks.data["mark"][draw] == expected
        np.testing.assert_allclose(view.tracks.data["z"][draw], run.signal("z_y")[draw], rtol=1e-6)
    np.testing.assert_array_equal(view.selected_flight.data["theta"], run.results[SignalKey("theta")][2])
    assert "draw 2" in view.title.text


def test_a_draw_that_ends_is_marked_there(flown):
    """Its place is unknown afterwards."""
    _, run = flown
    results = {name: values.copy() for name, values in run.results.items()}
    results["outcome"][0] = 1
    results["failed_at"][0] = run.times[40]
    for axis in "xyz":
        results[SignalKey(f"{axis}_y")][0, 40:] = np.nan
    results[run.study.requirements[0].violation_name][0] = run.times[60]
    view = FlightView()
    view.show(LiveRun(run.study, results, {}, run.times), 0)
    assert view.tracks.data["mark"][0] == 39


def test_the_options_of_the_command(flown, tmp_path, capsys):
    path, _ = flown
    assert guarded(["simulate", str(path), "--ghosts", "3"]) == 2
    assert "--flight" in capsys.readouterr().err
    assert (
        guarded(
            ["simulate", str(path), "--draw", "5", "--ghosts", "2", "--flight", str(tmp_path / "a.html"), "--no-check"]
        )
        == 0
    )
    text = (tmp_path / "a.html").read_text()
    assert "3 flights; draw 5" in text
    assert "http-equiv" in text


READ = """
() => {
  const models = [...Bokeh.documents[0]._all_models.values()]
  const slider = models.find(m => m.type == "Slider")
  const figure = models.find(m => m.type == "Figure")
  const lines = figure.renderers.map(r => r.data_source.data)
  return {time: slider.value, ghosts: lines[1], marks: lines[5], flown: lines[4], craft: lines[6]}
}
"""
MOVE = """
(time) => { [...Bokeh.documents[0]._all_models.values()].find(m => m.type == "Slider").value = time }
"""


def tick_texts(page, ticks):
    """The texts of an axis with given ticks."""
    return [page.evaluate(f"([tick, ticks]) => {{ {TICK_TEXT} }}", [tick, list(ticks)]) for tick in ticks]


@needs_browser
def test_what_the_browser_projects(flown, tmp_path):
    """The path of the chosen draw up to the slider's time, by NumPy: two rows of a rotation of the camera."""
    sync_api = pytest.importorskip("playwright.sync_api")
    path, run = flown
    (tmp_path / "flight.html").write_text(flight_html(dj.Study.load(path), 0, 5))
    with sync_api.sync_playwright() as tool:
        browser = tool.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        page = browser.new_page()
        wrong = []
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto((tmp_path / "flight.html").as_uri())
        page.get_by_text("Drag turns the view").wait_for(timeout=120_000)
        page.wait_for_function(f"({READ})().flown.across.length > 1", timeout=120_000)
        whole = page.evaluate(READ)
        page.evaluate(MOVE, 0.5)
        half = page.evaluate(READ)
        texts = {
            ticks: tick_texts(page, ticks) for ticks in ((0.0, 2e-6, 4e-6), (-0.5, 0.25), (0.0, 12e6), (10.0, 10.5))
        }
        browser.close()
    assert wrong == []
    assert texts[0.0, 2e-6, 4e-6] == ["0", "2\u00b710\u207b\u2076", "4\u00b710\u207b\u2076"]
    assert texts[-0.5, 0.25] == ["\u22120.5", "0.25"]
    assert texts[0.0, 12e6] == ["0", "1.2\u00b710\u2077"]
    assert texts[10.0, 10.5] == ["10", "10.5"]
    azimuth, elevation = VIEW["azimuth"], VIEW["elevation"]
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    across = np.cross([0.0, 0.0, 1.0], towards) / np.cos(elevation)
    upward = np.cross(towards, across)
    places = np.stack([run.signal(f"{axis}_y") for axis in "xyz"], axis=-1)
    low, high = np.quantile(places.reshape(-1, 3), [0.02, 0.98], axis=0)
    centred = places - 0.5 * (low + high)
    np.testing.assert_allclose(whole["flown"]["across"], centred[0] @ across, atol=1e-4)
    np.testing.assert_allclose(whole["flown"]["upward"], centred[0] @ upward, atol=1e-4)
    assert len(whole["ghosts"]["across"]) == 6
    np.testing.assert_allclose(whole["ghosts"]["upward"][4], centred[4] @ upward, atol=1e-4)
    assert len(whole["marks"]["across"]) == run.failed.sum()
    count = int(np.searchsorted(run.times, 0.5 + 1e-9))
    assert half["time"] == 0.5
    np.testing.assert_allclose(half["flown"]["across"], centred[0, :count] @ across, atol=1e-4)
    forward, up = half["craft"]["across"][2], half["craft"]["upward"][3]
    assert forward[1] - forward[0] > 0.0  # the nose points east, seen from the south-east
    assert up[1] - up[0] > 0.0
