"""Outputs beside the integrals of their logged derivatives: units, signs and clocks."""

import numpy as np
import pytest
import tomli_w

from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.hints.integrals import (
    are_exchanged,
    integral_drift,
    integral_factor,
    jumps_beside,
    unit_text,
)
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from dssc_jax.flight_logs.replay import replay_log
from tests.flight_logs.fit.test_fit import DT, linear

TIME = DT * np.arange(400)


def flight(seed=0, noise=0.005, y_scale=1.0, rate_scale=1.0, clock=1.0):
    """A sum of sines and its derivative, both with noise."""
    random = np.random.default_rng(seed)
    y = 0.5 * np.sin(np.pi * TIME) + 0.2 * np.cos(1.3 * TIME)
    rate = 0.5 * np.pi * np.cos(np.pi * TIME) - 0.26 * np.sin(1.3 * TIME)
    y, rate = (values + scale * random.normal(size=400) for values, scale in ((y, noise), (rate, 4.0 * noise)))
    return Column(clock * TIME, y_scale * y), Column(clock * TIME, rate_scale * rate)


@pytest.mark.parametrize("seed", range(20))
def test_the_factor_of_a_clean_log_is_one(seed):
    """Within the stated deviation, which is that of many logs."""
    factor = integral_factor(*flight(seed), -1.0, 100.0)
    assert factor is None or not factor.differs


@pytest.mark.parametrize(("clock", "y_scale"), [(1.03, 1.0), (0.97, 1.0), (1.0, 3.28084), (1.0, -1.0), (1.0, 0.5)])
def test_the_factor_is_that_of_unit_and_clock(clock, y_scale):
    """By construction: the integral over a clock that runs 1.03 times as fast is 1.03 times as large."""
    errors = []
    for seed in range(20):
        factor = integral_factor(*flight(seed, clock=clock, y_scale=y_scale), -1.0, 100.0)
        assert factor is not None
        assert factor.differs
        errors.append((factor.value - y_scale / clock) / factor.deviation)
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 2.0


@pytest.mark.parametrize("seed", range(5))
def test_columns_that_are_exchanged(seed):
    y, rate = flight(seed)
    assert are_exchanged(rate, y, -1.0, 100.0)
    assert not are_exchanged(y, rate, -1.0, 100.0)
    assert not are_exchanged(y, Column(rate.time, -rate.value), -1.0, 100.0)
    assert not are_exchanged(rate, y, -1.0, 0.2)  # too few values


def test_what_leaves_the_factor_open():
    assert integral_factor(*flight(noise=3.0, y_scale=2.0), -1.0, 100.0) is None
    y, rate = flight(y_scale=2.0)
    assert integral_factor(y, rate, -1.0, 0.2) is None  # too few values
    rare = Column(rate.time[::40], rate.value[::40])
    assert integral_factor(y, rare, -1.0, 100.0) is None
    fast = Column(TIME, np.sin(100.0 * TIME)), Column(TIME, 100.0 * np.cos(100.0 * TIME))
    assert integral_factor(*fast, -1.0, 100.0) is None  # three values a turn are no integral
    assert integral_factor(y, Column(TIME, np.zeros(400)), -1.0, 100.0) is None


def test_units_are_named_and_refuse_a_fit():
    assert unit_text(3.281, "m") == "times 3.281 (feet in place of metres)"
    assert unit_text(3.594, "m") == "times 3.6 (km/h in place of m/s)"
    assert unit_text(1.03, "m") == unit_text(57.3, "m") == ""
    for y_scale, rate_scale, told in (
        (3.28084, 1.0, "y is the integral of y_dot times 3.281"),
        (1.0, 100.0, "y_dot is the derivative of y times 100"),
        (-1.0, 1.0, "y is the integral of y_dot with the opposite sign"),
    ):
        y, rate = flight(y_scale=y_scale, rate_scale=rate_scale)
        log = FlightLog("flight", {"y": y, "y_dot": rate, "u_total": y}, 0.0)
        with pytest.raises(ConfigError, match=told):
            fit_log(linear(), log)
        assert any(warning.text.startswith(told) for warning in replay_log(linear(), log, False).warnings)


def test_a_sine_with_the_opposite_sign_is_not_called_exchanged():
    """Without its scale, a sine with the opposite sign and one that is exchanged with its slope are the same."""
    y, rate = np.sin(2.0 * TIME), 2.0 * np.cos(2.0 * TIME)
    for columns, told in (
        ((-y, rate), "is the integral of y_dot with the opposite sign"),
        ((rate, y), "looks exchanged"),
    ):
        named = {name: Column(TIME, values) for name, values in zip(("y", "y_dot"), columns, strict=True)}
        hints = replay_log(linear(), FlightLog("flight", named, 0.0), commands=False).hints
        assert hints.conversions["y"].text.startswith(told)


@pytest.mark.parametrize("seed", range(3))
def test_a_climb_with_the_opposite_sign_is_not_called_exchanged(seed):
    """One slow sway, with noise and a speed that reads 4 % too high: -y is the better integral of y_dot."""
    random = np.random.default_rng(seed)
    y = np.sin(1.2 * TIME) + 0.1 * np.sin(2.6 * TIME)
    rate = 1.25 * np.cos(1.2 * TIME) + 0.27 * np.cos(2.6 * TIME)
    for sign, told in ((-1.0, "is the integral of y_dot with the opposite sign"), (1.0, "")):
        columns = {"y": sign * y + 0.003 * random.normal(size=400), "y_dot": rate + 0.02 * random.normal(size=400)}
        log = FlightLog("climb", {name: Column(TIME, values) for name, values in columns.items()}, 0.0)
        conversions = replay_log(linear(), log, commands=False).hints.conversions
        assert [hint.text for hint in conversions.values()] == [told] * bool(told)


def test_a_copy_of_the_reference_is_told():
    """Of an output, or of its rate; a reference that rests is the output of a vehicle that rests."""
    y, rate = flight()
    for name in ("y", "y_dot"):
        logged = {"y": y, "y_dot": rate}
        log = FlightLog("flight", logged | {name.replace("y", "y_ref"): logged[name]}, 0.0)
        hints = replay_log(linear(), log, commands=False).hints
        assert hints.conversions[name].text == f"is a copy of {name.replace('y', 'y_ref')}, number by number"
    log = FlightLog("flight", {"y": y, "y_dot": rate, "u_total": rate}, 0.0)
    assert replay_log(linear(), log).hints.conversions["u_total"].text == "is a copy of y_dot, number by number"
    rest = Column(TIME, np.ones(400))
    log = FlightLog("flight", {"y": rest, "y_ref": rest}, 0.0)
    assert "copy" not in str(replay_log(linear(), log, commands=False).hints)


def test_a_clock_that_runs_too_fast_is_told():
    y, rate = flight(clock=1.03)
    hints = replay_log(linear(), FlightLog("flight", {"y": y, "y_dot": rate}, 0.0), commands=False).hints
    assert hints.factors["y"].text.startswith("changes by 0.97")
    assert "the log's clock is 1.028 times too fast" in hints.factors["y"].text
    assert not hints.conversions


def test_a_scale_of_the_rate_is_the_first_cause():
    """Its remedy comes with the clock and the output as the others."""
    for rate_scale, words in ((1.15, "y_dot is 1.1"), (0.9, "y_dot is 1.1")):
        y, rate = flight(rate_scale=rate_scale)
        log = FlightLog("flight", {"y": y, "y_dot": rate}, 0.0)
        text = replay_log(linear(), log, commands=False).hints.factors["y"].text
        cause = text.split(": ")[1]
        assert cause.startswith(f"most likely {words}")
        assert ("too large" in cause.split(",")[0]) == (rate_scale > 1.0)
        scale = float(text.split("a scale of ")[1].split()[0])
        assert scale * rate_scale == pytest.approx(1.0, abs=0.005)


@pytest.mark.parametrize("seed", range(20))
def test_a_bias_of_the_rate_is_a_drift_beside_its_integral(seed):
    """Noise, a wandering bias and a factor are none."""
    y, rate = flight(seed)
    assert integral_drift(y, rate, -1.0, 100.0) == 0.0
    for bias in (0.05, -0.3):
        biased = rate._replace(value=rate.value + bias)
        assert integral_drift(y, biased, -1.0, 100.0) == pytest.approx(-bias, abs=0.01)
    walk = np.cumsum(np.random.default_rng(seed).normal(size=400))
    assert integral_drift(y, rate._replace(value=rate.value + 0.01 * walk), -1.0, 100.0) == 0.0
    assert integral_drift(*flight(seed, rate_scale=1.15), -1.0, 100.0) == 0.0
    assert integral_drift(y, rate, -1.0, 0.2) == 0.0  # too few values


def test_a_drift_is_told_with_the_offset_that_takes_it_off():
    y, rate = flight()
    drifting = y._replace(value=y.value + 0.1 * TIME)
    hint = replay_log(linear(), FlightLog("flight", {"y": drifting, "y_dot": rate}, 0.0), False).hints.factors["y"]
    assert hint.code == "integral-drift"
    assert "y_dot has a bias of -0.1 m/s, or y drifts" in hint.text
    assert "give the column of y_dot an offset of 0.1" in hint.text
    declared = linear(sensor={"kind": "noisy", "velocity_bias": {"normal": [0.0, 0.1]}})
    assert not replay_log(declared, FlightLog("flight", {"y": drifting, "y_dot": rate}, 0.0), False).hints.factors
    mended = rate._replace(value=rate.value + 0.1)
    log = FlightLog("flight", {"y": drifting, "y_dot": mended}, 0.0)
    assert not replay_log(linear(), log, False).hints.factors


def test_a_jump_of_ten_times_the_noise_is_told_and_an_outlier_is_none():
    """It may be no larger than the noise allows for a single value, because it lasts."""
    for seed in range(20):
        y, rate = flight(seed, noise=0.01)
        shifted = Column(TIME, y.value - 0.1 * (np.arange(400) >= 150))
        (jump,) = jumps_beside(shifted, rate, -1.0, 100.0)
        assert abs(jump.time - TIME[150]) < 0.11
        assert jump.size == pytest.approx(-0.1, abs=0.03)
        assert jumps_beside(Column(TIME, y.value + 0.5 * (np.arange(400) == 150)), rate, -1.0, 100.0) == []


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_a_jump_that_the_rate_does_not_have_is_told(noise):
    y, rate = flight(noise=noise)
    assert jumps_beside(y, rate, -1.0, 100.0) == []
    shifted = Column(TIME, y.value + np.where(np.arange(400) < 150, 0.0, 0.5))
    (jump,) = jumps_beside(shifted, rate, -1.0, 100.0)
    assert jump.time == TIME[150]
    assert jump.size == pytest.approx(0.5, abs=0.05)
    hints = replay_log(linear(), FlightLog("flight", {"y": shifted, "y_dot": rate}, 0.0), commands=False).hints
    assert f"m at {TIME[150]:.4g} s of the log, and y_dot has no such peak" in hints.all()["y"].text
    assert not hints.factors
    kept = np.flatnonzero((TIME < 2.0) | (TIME > 4.0))  # two seconds are lost
    assert jumps_beside(Column(TIME[kept], y.value[kept]), Column(TIME[kept], rate.value[kept]), -1.0, 100.0) == []


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("scale", [1.0, 1000.0, -1.0])
def test_noise_and_units_are_no_jumps(seed, scale):
    assert jumps_beside(*flight(seed, y_scale=scale), -1.0, 100.0) == []


def test_several_logs_are_warned_of_one_by_one(tmp_path, capsys):
    paths = []
    for name, clock in (("right", 1.0), ("fast", 1.03)):
        y, rate = flight(clock=clock)
        rows = "\n".join(f"{t},{a},{b}" for t, a, b in zip(y.time, y.value, rate.value, strict=True))
        paths.append(tmp_path / f"{name}.csv")
        paths[-1].write_text(f"t,y,y_dot\n{rows}\n")
    study = tmp_path / "s.toml"
    study.write_text(tomli_w.dumps(linear(draws=39).table))
    out = str(tmp_path / "o")
    assert guarded(["compare-log", str(study), *map(str, paths), "--probability", "0.4", "--out", out]) == 0
    told = capsys.readouterr().out
    assert "warning: fast.csv: y changes by 0.97" in told
    assert "right.csv: y changes" not in told
