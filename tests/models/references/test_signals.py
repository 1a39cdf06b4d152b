"""Test signals against scipy.signal, their own derivatives, and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal
from scipy.interpolate import CubicSpline

from dssc_jax.core.errors import ConfigError
from dssc_jax.models.references import REFERENCES
from dssc_jax.study.components import parse_component

T_S = 0.01
TIMES = np.arange(2000) * T_S
RECORD = {"time": [0.5, 1.0, 2.5, 3.0, 7.0], "value": [1.0, -2.0, 0.5, 0.5, 4.0]}
SMOOTH = [
    {"kind": "ramp", "slope": -2.0, "at": 1.005, "rise": 3.0, "offset": 1.0},
    {"kind": "chirp", "amplitude": 2.0, "start": 0.1, "end": 3.0, "duration": 9.0, "at": 1.0, "offset": 0.5},
    {"kind": "chirp", "spacing": "linear", "amplitude": 2.0, "start": 3.0, "end": 0.2, "duration": 9.0},
    {"kind": "chirp", "amplitude": 2.0, "start": 0.4, "end": 0.4, "duration": 9.0},
    {"kind": "multisine", "amplitudes": [1.0, 0.5], "frequencies": [0.3, 1.7], "phases": [0.2, 1.0], "offset": 3.0},
    {"kind": "record", "interpolation": "linear", **RECORD},
    {"kind": "record", "interpolation": "cubic", **RECORD},
]


def at(table, times=TIMES):
    component = parse_component(table, REFERENCES, "reference")
    return jax.vmap(lambda t: jnp.stack([jnp.asarray(x, float) for x in component.model.at(component.params, t)]))(
        jnp.asarray(times)
    ).T


def test_step():
    y, slope, bend = at({"kind": "step", "size": 3.0, "at": 0.3, "offset": -1.0})
    np.testing.assert_array_equal(y, np.where(np.arange(2000) >= 30, 2.0, -1.0))  # 30 T_s is not 0.3 in binary
    assert not np.any(slope)
    assert not np.any(bend)


def test_pulses_are_those_of_scipy():
    table = {"kind": "pulses", "size": 2.0, "period": 0.7, "width": 0.21, "at": 0.1, "offset": 0.5}
    y, *_ = at(table, TIMES + 0.5 * T_S)  # between the edges, where both must agree
    elapsed = TIMES + 0.5 * T_S - 0.1
    square = signal.square(2.0 * np.pi * elapsed / 0.7, duty=0.3)
    np.testing.assert_allclose(y, 0.5 + np.where(elapsed >= 0.0, 1.0 + square, 0.0), atol=1e-15)


@pytest.mark.parametrize("period", [0.1, 0.3, 0.7])
def test_each_pulse_begins_at_its_sample(period):
    """k T_s and multiples of the period differ by rounding."""
    y, *_ = at({"kind": "pulses", "size": 1.0, "period": period, "width": 0.05, "at": 0.3})
    every = round(period / T_S)
    index = np.arange(2000) - 30
    np.testing.assert_array_equal(y, (index >= 0) & (index % every < 5))


@pytest.mark.parametrize("spacing", ["linear", "logarithmic"])
def test_a_chirp_is_that_of_scipy(spacing):
    y, *_ = at({"kind": "chirp", "spacing": spacing, "amplitude": 2.0, "start": 0.1, "end": 3.0, "duration": 20.0})
    expected = signal.chirp(TIMES, 0.1, 20.0, 3.0, method=spacing, phi=-90.0)
    np.testing.assert_allclose(y, 2.0 * expected, atol=1e-12)


def test_a_chirp_keeps_its_last_frequency():
    y, slope, _ = at(SMOOTH[1], np.linspace(10.0, 20.0, 1001))
    np.testing.assert_allclose(np.hypot((y - 0.5), slope / (2.0 * np.pi * 3.0)), 2.0, rtol=1e-12)


def test_schroeders_phases_keep_the_peak_low():
    """About 1.7 times the rms for many equal sines; with equal phases the peak grows with their number."""
    count = 16
    frequencies = [0.05 * k for k in range(1, count + 1)]
    table = {"kind": "multisine", "amplitudes": [1.0] * count, "frequencies": frequencies}
    y, *_ = at(table)
    joint, *_ = at(table | {"phases": [0.5 * np.pi] * count})
    rms = np.sqrt(0.5 * count)
    assert np.abs(y).max() < 2.0 * rms
    assert np.abs(joint).max() == pytest.approx(count)


@pytest.mark.parametrize("table", SMOOTH)
def test_derivatives(table):
    """By central differences, away from corners."""
    step = 1e-5
    times = np.arange(0.013, 12.0, 0.217)
    _, slope, bend = at(table, times)
    ahead, delayed = at(table, times + step), at(table, times - step)
    np.testing.assert_allclose(slope, (ahead[0] - delayed[0]) / (2.0 * step), atol=1e-6)
    np.testing.assert_allclose(bend, (ahead[1] - delayed[1]) / (2.0 * step), atol=1e-4)


def test_a_record_passes_through_its_values():
    spline = CubicSpline(RECORD["time"], RECORD["value"], bc_type="natural")
    inside = (TIMES >= 0.5) & (TIMES <= 7.0)
    expected = {
        "linear": np.interp(TIMES, RECORD["time"], RECORD["value"]),
        "cubic": np.where(inside, spline(TIMES), np.where(TIMES < 0.5, 1.0, 4.0)),
        "hold": np.array(
            [RECORD["value"][max(0, int(np.sum(np.array(RECORD["time"]) <= t + 1e-9)) - 1)] for t in TIMES]
        ),
    }
    for rule, values in expected.items():
        np.testing.assert_allclose(at({"kind": "record", "interpolation": rule, **RECORD})[0], values, atol=1e-12)


def test_a_record_has_the_recorded_rate():
    """Its derivative is the rate between times of its own, whatever the slope of the values; the values stay."""
    rate = {"rate": [0.5, -1.0, 2.0], "rate_time": [0.25, 2.0, 5.0]}
    for rule in ("linear", "cubic", "hold"):
        table = {"kind": "record", "interpolation": rule, **RECORD}
        value, slope, bend = at({**table, **rate})
        np.testing.assert_array_equal(value, at(table)[0])
        follows = {"kind": "record", "interpolation": rule, "time": rate["rate_time"], "value": rate["rate"]}
        np.testing.assert_array_equal([slope, bend], at(follows)[:2])
    same_times = {"kind": "record", **RECORD, "rate": [0.0, 1.0, 2.0, 3.0, 4.0]}
    np.testing.assert_allclose(at(same_times)[1], np.interp(TIMES, RECORD["time"], same_times["rate"]), atol=1e-12)


@pytest.mark.parametrize(
    ("table", "complaint"),
    [
        ({"kind": "pulses", "size": 1.0, "period": 1.0, "width": 1.0}, "width: must be below the period"),
        ({"kind": "multisine", "amplitudes": [1.0], "frequencies": [1.0, 2.0]}, "frequencies: must hold one number"),
        ({"kind": "multisine", "amplitudes": [], "frequencies": []}, "must hold one number for each"),
        ({"kind": "chirp", "amplitude": 1.0, "start": 0.0, "end": 1.0, "duration": 1.0}, "first frequency"),
        ({"kind": "record", "time": [0.0, 2.0, 1.0], "value": [1.0, 2.0, 3.0]}, r"time.2: must be above .* 2 s, got 1"),
        ({"kind": "record", "time": [0.0, 2.0], "value": [1.0]}, "value: must hold as many numbers as time, 2, got 1"),
        ({"kind": "record", "time": [0.0], "value": [1.0]}, "must hold 2 to"),
        ({"kind": "record", "time": [0.0, {"uniform": [1, 2]}], "value": [1.0, 2.0]}, "must be a plain number"),
        ({"kind": "record", **RECORD, "rate": [1.0]}, "reference.rate: must hold as many numbers as time, 5, got 1"),
        ({"kind": "record", **RECORD, "rate_time": [1.0, 2.0]}, "rate_time: is the time of a rate, and there is no"),
        ({"kind": "record", **RECORD, "rate": [1, 2], "rate_time": [2, 1]}, r"rate.time.1: must be above"),
        ({"kind": "step", "size": 1.0, "ofset": 1.0}, "did you mean 'offset'"),
    ],
)
def test_bad_signals_are_refused(table, complaint):
    with pytest.raises(ConfigError, match=complaint):
        parse_component(table, REFERENCES, "reference")
