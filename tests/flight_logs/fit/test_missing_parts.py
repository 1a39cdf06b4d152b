"""Parts that a study lacks: small ones move its numbers and hardly show in the residual."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dssc_jax.console.flight import untried_lines
from dssc_jax.flight_logs.fit import part_doubts
from dssc_jax.flight_logs.fit.actuated_commands import actuated_commands
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.flown_course import Flight, slope_half_width, slopes
from dssc_jax.flight_logs.fit.missing_parts import (
    STEADY_WIND,
    delayed,
    fading,
    friction,
    lacking_parts,
    quadratic_drag,
)
from dssc_jax.flight_logs.fit.refusals import Unexplained
from dssc_jax.study.actuators import acting_elements
from tests.flight_logs.fit.test_fit import DT, linear, log_of

FINE = 20  # steps of integration in a sample
K_P = 1.1
A_P = 0.8
LAG = 0.05
STD = 0.1
GUST = {"kind": "filtered_noise", "std": STD, "correlation_time": 1.0}


def no_force(speed):
    """No force at any speed."""
    return 0.0


def drag(speed):
    """A small force that grows with the square of the speed."""
    return -0.05 * speed * abs(speed)


def dry_friction(speed):
    """A small force of constant size."""
    return -0.03 * np.tanh(speed / 0.005)


def commands_of(seed):
    """Commands that jump every tenth sample."""
    return np.repeat(np.random.default_rng(seed).normal(size=40), 10)


def flown(force, seed, u, gain: float | np.ndarray = K_P, gust=0.0):
    """The log of x'' = -A_P x' + gain u + force(x') with a command at each fine step, by the midpoint rule.

    Args:
        force: Speed -> force.
        seed: Of the noise.
        u: Commands at the samples, or at all fine steps, shape (n,) or (n, FINE).
        gain: Gain at each sample.
        gust: Standard deviation of a gust of 1 s.
    """
    random = np.random.default_rng(seed)
    samples = len(u)
    gains = np.broadcast_to(gain, samples)
    fine_commands = np.broadcast_to(np.reshape(u, (samples, -1)), (samples, FINE))
    y, v = 0.5, 0.0
    outputs = []
    step = DT / FINE
    decay = np.exp(-DT)
    acting_gust = gust * random.normal()
    for row in range(samples):
        outputs.append(y)
        for command in fine_commands[row]:
            push = gains[row] * command + acting_gust
            middle = v + 0.5 * step * (-A_P * v + push + force(v))
            y += step * middle
            v += step * (-A_P * middle + push + force(middle))
        acting_gust = decay * acting_gust + gust * np.sqrt(1.0 - decay**2) * random.normal()
    return np.array(outputs) + 0.001 * random.normal(size=samples)


def behind_lag(u):
    """The output of a lag at all fine steps, by steps of Euler, shape (n, FINE)."""
    state = 0.0
    rows = []
    for command in np.repeat(u, FINE):
        state += DT / FINE / LAG * (command - state)
        rows.append(state)
    return np.reshape(rows, (len(u), FINE))


@pytest.fixture(scope="module")
def predictions():
    """Compiled predictions, which all flights share."""
    return {}


def told(fitted):
    """The warnings of parts."""
    return [doubt for doubt in fitted.doubts if "would explain part of the residual of y" in doubt.text]


def improved(fitted, text):
    """How much of the error of the named number is left with the part."""
    better = float(text.split(" is about ")[1].split()[0])
    number = fitted.names.index(text.split("with it, ")[1].split()[0])
    truth = (K_P, A_P)[number]
    return abs(better - truth) / abs(fitted.estimates[number] - truth)


@pytest.mark.parametrize(("force", "word"), [(drag, "drag"), (dry_friction, "friction")])
def test_a_small_force_against_the_speed_is_told_with_the_damping_that_it_hides(predictions, force, word):
    u = commands_of(1)
    fitted = fit_log(linear(), log_of(flown(force, 1, u), u), predictions=predictions)
    assert abs(fitted.estimates[1] - A_P) > 5.0 * fitted.deviations[1]
    (doubt,) = told(fitted)
    assert doubt.code == "missing-force"
    assert f"({word}, " in doubt.text
    assert improved(fitted, doubt.text) < 0.3


def test_a_steady_wind_is_told_as_a_constant_force(predictions):
    u = commands_of(6)
    fitted = fit_log(linear(), log_of(flown(lambda speed: 0.02, 6, u), u), predictions=predictions)
    (doubt,) = told(fitted)
    assert doubt.code == "missing-force"
    size = float(doubt.text.split("a constant force (")[1].split()[0])
    assert abs(size - 0.02 / K_P) < 0.002
    assert improved(fitted, doubt.text) < 0.3
    study = linear(disturbance={"kind": "constant", "value": {"uniform": [-0.1, 0.1]}})
    assert STEADY_WIND not in lacking_parts(study)
    assert STEADY_WIND in lacking_parts(linear(disturbance=GUST))


def test_a_dead_zone_and_a_limited_rate_are_told_with_their_sizes(predictions):
    u = commands_of(7)
    behind_zone = flown(no_force, 7, u - np.clip(u, -0.1, 0.1))
    (doubt,) = told(fit_log(linear(), log_of(behind_zone, u), predictions=predictions))
    assert doubt.code == "missing-dead-zone"
    assert abs(float(doubt.text.split("less than ")[1].split()[0]) - 0.1) < 0.005
    state = 0.0
    rows = []
    for command in np.repeat(u, FINE):
        state += np.clip(command - state, -20.0 * DT / FINE, 20.0 * DT / FINE)
        rows.append(state)
    fitted = fit_log(linear(), log_of(flown(no_force, 7, np.reshape(rows, (len(u), FINE))), u), predictions=predictions)
    (doubt,) = told(fitted)
    assert doubt.code == "missing-limit"
    assert abs(float(doubt.text.split("command to ")[1].split()[0]) - 20.0) < 1.0
    assert not any(doubt.code.startswith("delayed") for doubt in fitted.doubts)


@pytest.mark.parametrize("step", [0.2, 0.237])
def test_an_actuator_that_rounds_is_told_with_its_step(predictions, step):
    u = commands_of(8)
    rounded = flown(no_force, 8, step * np.round(u / step))
    (doubt,) = told(fit_log(linear(), log_of(rounded, u), predictions=predictions))
    assert doubt.code == "missing-rounding"
    assert abs(float(doubt.text.split("multiples of ")[1].split()[0]) - step) < 0.02 * step


def test_a_part_that_leaves_more_than_noise_proposes_no_estimate(predictions):
    """A gain that falls in steps is none of the parts; one that is linear in time resembles it."""
    u = commands_of(7)
    gains = K_P * np.repeat([1.0, 0.9, 0.8, 0.7], len(u) // 4)
    fitted = fit_log(linear(), log_of(flown(no_force, 7, u, gains), u), predictions=predictions)
    (doubt,) = told(fitted)
    assert " remain, where noise explains 0.00" in doubt.text
    assert " is about " not in doubt.text


@pytest.mark.parametrize("seed", range(3))
def test_a_flight_without_such_a_part_has_no_warning(predictions, seed):
    u = commands_of(seed)
    assert fit_log(linear(), log_of(flown(no_force, seed, u), u), predictions=predictions).doubts == ()


def test_a_lag_is_told_in_place_of_a_delay_or_friction(predictions):
    u = commands_of(2)
    fitted = fit_log(linear(), log_of(flown(no_force, 2, behind_lag(u)), u), predictions=predictions)
    (doubt,) = told(fitted)
    assert doubt.code == "missing-lag"
    assert abs(float(doubt.text.split("actuator of ")[1].split()[0]) - LAG) < 0.1 * LAG
    assert improved(fitted, doubt.text) < 0.3
    assert not any(doubt.code.startswith("delayed") for doubt in fitted.doubts)


def test_a_delay_is_no_lag(predictions):
    u = commands_of(2)
    late = np.concatenate([u[:1], u[:-1]])
    fitted = fit_log(linear(), log_of(flown(no_force, 2, late), u), predictions=predictions)
    codes = [doubt.code for doubt in fitted.doubts]
    assert "missing-lag" not in codes
    assert any(code.startswith("delayed") for code in codes)


def test_causes_that_are_nearly_as_likely_are_named_together(predictions, monkeypatch):
    monkeypatch.setattr(part_doubts, "STRONG_EVIDENCE", 1e9)
    u = commands_of(2)
    fitted = fit_log(linear(), log_of(flown(no_force, 2, behind_lag(u)), u), predictions=predictions)
    (doubt,) = told(fitted)
    assert doubt.code == "missing-lag"
    assert "s late explains it nearly as well, with a plant." in doubt.text
    assert any(doubt.code.startswith("delayed") for doubt in fitted.doubts)


def test_a_limit_of_the_command_is_told_with_its_level(predictions):
    u = commands_of(3)
    level = 0.8 * np.abs(u).max()
    fitted = fit_log(linear(), log_of(flown(no_force, 3, np.clip(u, -level, level)), u), predictions=predictions)
    (doubt,) = told(fitted)
    assert doubt.code == "missing-limit"
    assert abs(float(doubt.text.split("command to ")[1].split()[0]) - level) < 0.02 * level
    assert improved(fitted, doubt.text) < 0.3


def test_a_gain_that_falls_is_told_with_that_at_the_first_sample(predictions):
    u = commands_of(4)
    gains = K_P * np.linspace(1.0, 0.9, len(u))
    fitted = fit_log(linear(), log_of(flown(no_force, 4, u, gains), u), predictions=predictions)
    (doubt,) = told(fitted)
    assert doubt.code == "changing-gain"
    assert abs(float(doubt.text.split("falls by ")[1].split()[0]) - 10.0) < 1.0
    assert improved(fitted, doubt.text) < 0.3


def gusty_codes(share):
    """The codes of the parts that are told of a flight in a gust that the study declares.

    Args:
        share: The limit of the commands, as a share of the largest one.
    """
    study = linear(disturbance=GUST, sensor={"kind": "noisy", "position_std": 0.001})
    u = commands_of(5)[:240]
    level = share * np.abs(u).max()
    log = log_of(flown(no_force, 5, np.clip(u, -level, level), gust=STD), u)
    return [doubt.code for doubt in told(fit_log(study, log))]


def test_declared_gusts_hide_no_limit():
    """The residual is what the gusts did; the fit's own weighting shows the limit beside them."""
    assert gusty_codes(0.85) == ["missing-limit"]


def test_a_refusal_in_gusts_names_the_limit():
    with pytest.raises(Unexplained, match="limits the command to"):
        gusty_codes(0.7)


@pytest.mark.long
def test_declared_gusts_are_no_part():
    assert gusty_codes(1.0) == []


def test_an_answer_says_that_parts_were_not_tried(predictions):
    u = commands_of(0)
    fitted = fit_log(linear(), log_of(flown(no_force, 0, u), u), predictions=predictions)
    assert fitted.summary()["untried_parts"] == ""
    assert untried_lines("") == []
    vehicle = SimpleNamespace(loop=SimpleNamespace(channels=("x", "y")))
    reason = replace(fitted, study=vehicle).untried_parts
    assert reason == "the study has several channels"
    assert untried_lines(reason)[0].startswith("not tried, because the study has several channels: parts that it may")
    assert replace(fitted, stopped=True).untried_parts == "the search was stopped"


def test_the_speed_of_friction_in_gusts_is_that_which_the_log_shows():
    times = DT * np.arange(200)
    smooth = np.sin(times)
    np.testing.assert_allclose(slopes(smooth, 3)[3:-3] / DT, np.cos(times)[3:-3], atol=2e-3)
    assert slope_half_width(0.0, DT, 0.1) == 1
    assert slope_half_width(1.0, DT, 0.0) > 1000  # of a vehicle that rests
    half_width = slope_half_width(0.002, DT, 0.01)
    noise = 0.002 * np.random.default_rng(0).normal(size=20000)
    assert np.std(slopes(noise, half_width) / DT) < 0.0102


def test_the_forces_act_against_the_speed():
    speed = np.array([-2.0, 0.0, 1.0])
    np.testing.assert_allclose(quadratic_drag(speed), [4.0, 0.0, -1.0])
    np.testing.assert_allclose(friction(speed), [1.0, 0.0, -1.0], atol=1e-3)


def test_the_gain_and_a_delay_change_the_commands():
    flight = Flight(np.array([1.0, -2.0, 3.0]), np.zeros(3), DT)
    np.testing.assert_allclose(fading(flight, 0.2), [1.0, -1.8, 2.4])
    np.testing.assert_allclose(delayed(flight.commands, 1.5), [1.0, 1.0, -0.5])


@pytest.mark.parametrize(
    ("table", "slope"),
    [
        ({"kind": "lag", "mu": LAG}, lambda z, u: (u - z) / LAG),
        ({"kind": "rate_limit", "rate": 20.0}, lambda z, u: 20.0 * np.clip((u - z) / 1e-9, -1.0, 1.0)),
    ],
)
def test_commands_behind_an_actuator_are_the_means_of_its_output(table, slope):
    """By Euler's method with 20,000 steps in a sample."""
    ((element, params),) = elements_of(linear(unmodelled=table))
    commands = np.array([1.0, -2.0, 3.0, 3.0])
    steps = 20_000
    state = 0.0
    for command, mean in zip(commands, actuated_commands(element.model, params, commands, DT), strict=True):
        total = 0.0
        for _ in range(steps):
            change = DT / steps * slope(state, command)
            if abs(change) > abs(command - state):
                change = command - state
            total += (state + 0.5 * change) / steps
            state += change
        np.testing.assert_allclose(mean, total, rtol=1e-4)


def elements_of(study):
    """The actuators of a study with their parameters."""
    return acting_elements(study.table, study.config)


def test_commands_behind_a_limit_and_a_dead_zone():
    commands = np.array([1.0, -2.0, 3.0])
    ((limit, params),) = elements_of(linear(unmodelled={"kind": "saturation", "limit": 1.5}))
    np.testing.assert_allclose(actuated_commands(limit.model, params, commands, DT), [1.0, -1.5, 1.5])
    ((zone, params),) = elements_of(linear(unmodelled={"kind": "dead_zone", "half_width": 0.4}))
    np.testing.assert_allclose(actuated_commands(zone.model, params, commands, DT), [0.6, -1.6, 2.6])


def test_a_study_with_a_part_gets_no_second_one():
    codes = [part.code for part in lacking_parts(linear())]
    forces = ["missing-force"] * 3
    limits = ["missing-limit", "missing-limit", "missing-dead-zone", "missing-rounding"]
    assert codes == [*forces, "missing-lag", "filtered-output", *limits, "changing-gain"]
    with_lag = linear(unmodelled={"kind": "lag", "mu": 0.05})
    assert "missing-lag" not in [part.code for part in lacking_parts(with_lag)]
    chain = [
        {"kind": "saturation", "limit": 2.0},
        {"kind": "lag", "mu": 0.05},
        {"kind": "rate_limit", "rate": 20.0},
        {"kind": "dead_zone", "half_width": 0.1},
        {"kind": "quantisation", "resolution": 0.1},
    ]
    codes = [part.code for part in lacking_parts(linear(actuator=chain))]
    assert codes == [*forces, "filtered-output", "changing-gain"]
