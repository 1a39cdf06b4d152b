"""Live runs against the ordinary run, NumPy and SciPy."""

import numpy as np
import pytest
from scipy import stats

import dssc_jax as dj
from dssc_jax.exploration.live import FAN_LEVELS, LiveStudy
from dssc_jax.exploration.worker import Worker
from dssc_jax.runs.recorded_draws import SignalKey


def positions(live, **moved):
    """The start, with some sliders elsewhere; a double underscore stands for a dot."""
    names = {name.replace("__", "."): value for name, value in moved.items()}
    return {
        slider: names.get(slider.name, slider.start) if not slider.part else slider.start for slider in live.sliders
    }


def test_a_live_run_is_the_ordinary_run(live):
    """Every metric, outcome and drawn value, at the start and elsewhere."""
    for point in (live.start, positions(live, unmodelled__mu=0.06, controller__rho=4.0)):
        run = live.run(point)
        result = dj.run(run.study)
        np.testing.assert_array_equal(run.results["outcome"], result.dataset["outcome"].values)
        np.testing.assert_allclose(run.results["error_max"], result.dataset["error_max"].values, rtol=1e-6)
        np.testing.assert_array_equal(run.values["plant.k_p"], result.dataset["plant.k_p"].values)
        point = result.summary()["points"][0]
        assert (run.probability, list(run.interval)) == (point["probability"], point["interval"])


def test_signals_are_those_of_a_single_draw(live):
    run = live.run(positions(live, unmodelled__mu=0.05))
    draw = int(run.order[0])
    alone = dj.simulate(run.study, draw=draw)
    for name in ("y", "e", "u_total"):
        sampled = alone[name].sel(t=run.times, method="nearest").values
        np.testing.assert_allclose(run.signal(name)[draw], sampled, rtol=1e-6, atol=1e-9)


def test_fan_and_interval(live):
    run = live.first_run
    fan = run.fan("e")
    np.testing.assert_array_equal(fan.running, run.failed.size)
    expected = np.quantile(run.signal("e"), FAN_LEVELS, axis=0, method="lower")
    np.testing.assert_array_equal(fan.values, expected)
    exact = stats.binomtest(int(run.failed.sum()), run.failed.size).proportion_ci(0.95, "exact")
    np.testing.assert_allclose(run.interval, exact, rtol=1e-9)


def test_draws_that_end_leave_the_fan(explored):
    """A loop that is unstable in some draws: the fan is of those that still run, and the first to end is the worst."""
    wild = explored.override({"plant.a_p": {"uniform": [-400.0, 1.0]}})
    run = LiveStudy(wild, ["controller.rho"], draws=40).first_run
    assert 0 < run.ended_early < 40
    fan = run.fan("y")
    assert fan.running[0] == 40
    assert fan.running[-1] == 40 - np.count_nonzero(run.results["failed_at"] <= run.times[-1])
    assert np.isnan(run.results[SignalKey("y")]).sum() == (40 - fan.running).sum()
    assert run.order[0] == np.nanargmin(run.results["failed_at"])


def test_another_sample_time_is_compiled_again(live):
    said = []
    run = live.run(positions(live, loop__sample_time=0.04), progress=said.append)
    assert said[0] == "compiling"
    assert run.study.loop.sample_time == 0.04
    np.testing.assert_array_equal(run.results["outcome"], dj.run(run.study).dataset["outcome"].values)
    live.run(positions(live, loop__sample_time=0.04), progress=(said := []).append)
    assert "compiling" not in said


def test_a_stale_run_stops_between_batches(live):
    assert live.run(live.start, stale=lambda: True) is None


def test_designs_keep_their_number_of_draws(explored):
    sobol = explored.override({"sampling": "sobol", "draws": 64})
    run = LiveStudy(sobol, ["controller.rho"]).first_run
    assert run.failed.size == 64
    assert "replicates" in run.statement or "Sobol" in run.statement


def test_the_newest_request_counts():
    """Of requests that come while one runs, the last one alone is served, and the running one learns of it."""
    from threading import Event

    worker, begun, go, served = Worker(), Event(), Event(), []

    def slow(stale):
        begun.set()
        go.wait(10)
        served.append(("slow", stale()))

    worker.submit(slow)
    assert begun.wait(10)
    for name in ("second", "third"):
        worker.submit(lambda stale, name=name: served.append((name, stale())))
    go.set()
    assert worker.wait(10)
    assert served == [("slow", True), ("third", False)]
    worker.close()
    worker.submit(lambda stale: pytest.fail("closed"))
    assert worker.wait(10)


def test_a_worker_serves_on_after_an_exception(monkeypatch):
    """The exception is reported as one of any thread."""
    reported, served = [], []
    monkeypatch.setattr("threading.excepthook", reported.append)
    worker = Worker()
    worker.submit(lambda stale: 1 / 0)
    assert worker.wait(10)
    assert [report.exc_type for report in reported] == [ZeroDivisionError]
    worker.submit(lambda stale: served.append(stale()))
    assert worker.wait(10)
    assert served == [False]
    worker.close()


def test_no_draws_are_refused(explored):
    """0 draws are not the usual number."""
    with pytest.raises(dj.ConfigError, match=r"draws: .* got 0"):
        LiveStudy(explored, draws=0)
