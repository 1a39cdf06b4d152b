"""Outputs that a log interpolates between rarer readings: found, taken at the readings, and told."""

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.reading.interpolated_outputs import bends
from dssc_jax.flight_logs.reading.reader import Column, read_log
from tests.flight_logs.fit.test_fit import linear, log_of, output

SAMPLES = np.arange(400)
NAMES = ("plant.k_p", "plant.a_p")


@pytest.fixture(scope="module")
def flight():
    """A command, and an output of known numbers with 1 cm of noise."""
    random = np.random.default_rng(8)
    u = np.repeat(random.normal(size=40), 10)
    return u, output(1.1, 0.8, u) + 0.01 * random.normal(size=400)


def interpolated(y, every, first=0.0):
    """Straight lines between readings that are some samples apart, as a table has them after resampling."""
    nodes = np.arange(first, 400.0, every)
    return np.interp(SAMPLES, nodes, np.interp(nodes, SAMPLES, y))


@pytest.mark.parametrize("every", [2, 5, 10])
@pytest.mark.parametrize("digits", [4, 8])
def test_readings_on_the_samples_are_found(flight, every, digits):
    """Also where the table has four digits after the point, and where single values are missing."""
    y = np.round(interpolated(flight[1], every), digits)
    y[[33, 181]] = np.nan
    assert np.flatnonzero(bends(y)).tolist() == [0]
    assert len(bends(y)) == every


@pytest.mark.parametrize(("every", "first", "places"), [(5, 0.4, 5), (2.5, 0.0, 5), (10.0 / 3.0, 0.0, 10)])
def test_readings_between_the_samples_are_found(flight, every, first, places):
    is_bend = bends(interpolated(flight[1], every, first))
    assert len(is_bend) == places
    assert np.count_nonzero(is_bend) == pytest.approx(places / every)


def switching(period):
    """The output of an integrator whose command switches, and drifts by a little."""
    u = np.where(SAMPLES % period < period // 2, 1.0, -1.0) + 1e-3 * np.sin(0.01 * SAMPLES)
    return np.cumsum(u)


def test_outputs_that_are_not_interpolated(flight):
    """Noisy, stepping, smooth, resting, coarse and switching ones, and responses to the same step again and again."""
    u, y = flight
    smooth = output(1.1, 0.8, u)
    steps = np.repeat(np.tile([0.0, 1.0], 10), 20)
    responses = np.convolve(steps, 0.4 * 0.6 ** np.arange(60))[:400]
    resting = np.where(SAMPLES < 60, y, y[60])
    held = np.repeat(np.random.default_rng(9).normal(size=40), 10)
    shapes = [
        y,
        y + held,
        y + 0.1 * held,
        smooth + 0.1 * held,
        smooth,
        resting,
        np.round(y, 1),
        np.sin(0.1 * SAMPLES),
        2.0 * SAMPLES,
        responses,
        np.zeros(400),
    ]
    for values in [*shapes, switching(2), switching(4), np.full(400, np.nan), y[:3], np.where(SAMPLES % 5, np.nan, y)]:
        assert bends(values).size == 0


def test_logs_of_px4_are_not_interpolated():
    """The positions of a simulated flight, ten a second."""
    table = {"signals": {"y": "vehicle_local_position.up", "y_dot": "vehicle_local_position.v_up"}}
    for column in read_log("docs/logs/sitl_takeoff.ulg", ("",), table).columns.values():
        assert bends(column.value).size == 0


def test_a_fit_takes_the_readings_and_tells(flight):
    u, y = flight
    lines = log_of(interpolated(y, 5), u)
    rare = log_of(y, u)
    rare = rare._replace(columns=rare.columns | {"y": Column(rare.columns["y"].time[::5], y[::5])})
    taken, expected = fit_log(linear(), lines, NAMES), fit_log(linear(), rare, NAMES)
    np.testing.assert_allclose(taken.estimates, expected.estimates, rtol=1e-6)
    np.testing.assert_allclose(taken.deviations, expected.deviations, rtol=1e-3)
    (doubt,) = [doubt for doubt in taken.doubts if "straight line" in doubt.text]
    assert doubt.signal == "y"
    assert "0.1 s apart: the log was interpolated" in doubt.text
    assert not any("straight line" in doubt.text for doubt in expected.doubts)
