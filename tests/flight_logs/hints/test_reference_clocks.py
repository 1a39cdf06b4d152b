"""Logged references that are the study's by another clock, and references that are others."""

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.hints.reference_clocks import shortest_number
from dssc_jax.flight_logs.hints.references import other_reference_text
from dssc_jax.flight_logs.reading.columns import TimeSource
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from dssc_jax.flight_logs.replay import replay_log
from tests.flight_logs.fit.test_fit import DT, linear, log_of, output

TIME = DT * np.arange(400)
PULSES = {"kind": "pulses", "size": 0.7, "period": 3.0, "width": 1.5, "at": 0.4}


def pulses(time):
    """The reference of the study at times."""
    return np.where((time >= 0.4 - 1e-9) & (np.mod(time - 0.4 + 1e-9, 3.0) < 1.5), 0.7, 0.0)


def log_of_reference(time, reference, **changes):
    log = FlightLog("flight", {"y_ref": Column(time, reference)}, float(time[0]))
    return log._replace(**changes)


def hints_of(log, reference=PULSES):
    return replay_log(linear(reference=reference), log, commands=False).hints


@pytest.mark.parametrize("stretch", [1.02, 0.97, 1.08, 0.92])
@pytest.mark.parametrize("begin", [0.0, 37.4])
def test_a_clock_that_runs_too_fast_or_slow_is_told_by_the_reference_alone(stretch, begin):
    """Without a rate, nothing else contradicts it: gains and time constants take it."""
    for reference, values in ((PULSES, pulses(TIME)), (linear().table["reference"], 0.5 * np.sin(np.pi * TIME))):
        hints = hints_of(log_of_reference(begin + stretch * TIME, values), reference)
        speed = "fast" if stretch > 1.0 else "slow"
        text = hints.shifts["y_ref"].text
        assert text.startswith(f"is the study's with times x {stretch:g}: the log's clock is ")
        assert f"{max(stretch, 1.0 / stretch):.4g} times too {speed}" in text
        assert text.endswith(f'scale the times (time = {{ column = "t", scale = {1.0 / stretch:.4g} }})')
        assert hints.others == {}


def test_the_scale_removes_the_stretch():
    """Of a log in milliseconds that begins before the study."""
    scale = 1e-3
    time = 1.02 * np.concatenate([DT * np.arange(-100, 0), TIME])
    log = log_of_reference(time + 10.0, pulses(time / 1.02), start=10.0, clock=TimeSource("ms", scale))
    text = hints_of(log).shifts["y_ref"].text
    assert text.endswith('scale the times (time = { column = "ms", scale = 0.0009804 } and start = 9.80392)')
    mended = log_of_reference((time + 10.0) / 1.02, pulses(time / 1.02), start=10.0 / 1.02)
    assert hints_of(mended).all() == {}


def test_another_reference_is_told_with_what_it_means():
    random = np.random.default_rng(4)
    others = (
        np.where(TIME > 3.3, 0.4, -0.2),
        0.5 * np.cos(2.3 * TIME),
        0.3 * random.normal(size=400),
        5.0 + 0.0 * TIME,
    )
    for values in others:
        hints = hints_of(log_of_reference(TIME, values))
        assert hints.shifts == {}
        assert hints.others["y_ref"].text.startswith("differs from the study's by ")
        assert "The draws follow the study's reference" in hints.others["y_ref"].text


def test_the_same_reference_is_not():
    """To a log's resolution, with an edge a sample late, held between rare values, or at jittered times."""
    random = np.random.default_rng(4)
    edge = pulses(TIME)
    edge[20] = 0.0
    jitter = np.maximum.accumulate(TIME + 1e-3 * random.normal(size=400))
    for time, values in ((TIME, np.round(pulses(TIME), 3)), (TIME, edge), (TIME[::5], pulses(TIME[::5]))):
        assert hints_of(log_of_reference(time, values)).all() == {}
    assert hints_of(log_of_reference(jitter, pulses(TIME), start=0.0)).all() == {}
    assert hints_of(log_of_reference(TIME, np.ones(400)), {"kind": "step", "size": 1.0}).all() == {}


def test_a_stretch_has_as_few_decimals_as_the_times_tell():
    assert shortest_number(1.0189, 1.0211) == 1.02
    assert shortest_number(0.96, 0.98) == 0.97
    assert shortest_number(1.02341, 1.02343) == 1.02342


def test_a_late_reference_does_not_move_a_fit_of_logged_commands():
    """So the hint does not ask for another start alone, which would move output and commands."""
    random = np.random.default_rng(8)
    u = np.repeat(random.normal(size=40), 10)
    y = output(1.1, 0.8, u) + 0.01 * random.normal(size=400)
    log = log_of(y, u)
    late = log._replace(columns=log.columns | {"y_ref": Column(TIME, pulses(TIME - 0.2))})
    study = linear(reference=PULSES)
    assert replay_log(study, late, commands=False).hints.shifts["y_ref"].text == (
        "is the study's, 0.2 s later: if y and the command are as late, set start to 0.2 s; if not, only its topic is "
        "late, and a fit of logged commands does not use it"
    )
    np.testing.assert_array_equal(fit_log(study, late).estimates, fit_log(study, log).estimates)


def test_a_reference_that_rests_may_be_a_little_beside_the_study():
    """Beside a channel that moves by metres, a millimetre is none."""
    logged = np.full(100, 0.001)
    resting = np.zeros(100)
    assert other_reference_text(logged, resting, 2.0, "m") == ""
    assert "differs from the study's by 0.001 m rms" in other_reference_text(logged, resting, 0.0, "m")
    assert "differs from the study's by 0.1 m rms" in other_reference_text(100.0 * logged, resting, 2.0, "m")
