"""Outputs that are later than the study predicts: the delay is told, and 20 flights without one tell none."""

import re

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.late_outputs import choices_of, delay_doubts, late_output
from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.log_sampling import sampled_log
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.prediction import prediction
from dssc_jax.flight_logs.fit.refusals import Unexplained, explain
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from tests.flight_logs.fit.test_fit import DT, linear, output

SAMPLES = 400
NAMES = ("plant.k_p", "plant.a_p")


def flight(seed, late=0, correlated=False):
    """Commands and noisy outputs of a plant with k_p = 1.1 and a_p = 0.8, the outputs some samples late."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.normal(size=80), 5)
    u = np.concatenate([np.zeros(late), u])[:SAMPLES]
    y = output(1.1, 0.8, np.concatenate([u, np.zeros(40)]), (0.5, 0.0))
    y = np.interp(np.arange(SAMPLES) - late, np.arange(len(y)), y)
    noise = 0.005 * random.normal(size=SAMPLES)
    if correlated:
        for k in range(1, SAMPLES):
            noise[k] += 0.9 * noise[k - 1]
    time = DT * np.arange(SAMPLES)
    return FlightLog("flight", {"y": Column(time, y + noise), "u_total": Column(time, u)}, 0.0)


@pytest.fixture(scope="module")
def predictions():
    """The compiled simulation of the numbers, which all flights share."""
    return {NAMES: prediction(linear(), NAMES, SAMPLES)}


def told(log, predictions):
    fitted = fit_log(linear(), log, NAMES, predictions)
    return [doubt.text for doubt in fitted.doubts if re.search("than (the study predicts|it is logged)", doubt.text)]


@pytest.mark.parametrize("correlated", [False, True])
def test_flights_without_a_delay_tell_none(predictions, correlated):
    """10 with white noise, and 10 with noise over 0.2 s."""
    for seed in range(10):
        assert told(flight(seed, correlated=correlated), predictions) == []


@pytest.mark.parametrize("late", [3, 5])
def test_a_delay_is_told_with_its_size(predictions, late):
    for seed in range(3):
        (text,) = told(flight(seed, late), predictions)
        assert text.startswith("y is ")
        delay, _, deviation = text.split()[2:5]
        assert abs(float(delay) - late * DT) < 4.0 * float(deviation)
        assert float(deviation) < DT
        assert " s later than the study predicts for the logged commands, or these are as much earlier" in text
        assert "`timestamp_sample` of PX4" in text
        assert "plant." in text


def test_a_delay_that_explains_a_part_only_says_what_remains(predictions):
    """Outputs that are 0.08 s late, and a wave that the study lacks."""
    log = flight(2, 4)
    y = log.columns["y"]
    assert "remain with it" not in told(log, predictions)[0]
    wave = y._replace(value=y.value + 0.02 * np.sin(5.0 * y.time))
    (text,) = told(log._replace(columns={**log.columns, "y": wave}), predictions)
    share, size = re.search(r"But (\S+) % of the residual of y remain with it, (\S+) m rms", text).groups()
    assert 0.012 < float(size) < 0.018
    assert 10.0 < float(share) < 90.0
    assert "another one is likely" in text


def test_the_delay_is_the_shift_of_least_residual(predictions):
    """Of SciPy's plant at the true numbers."""
    log = flight(4, 6)
    study = linear()
    problem = FitProblem(study, NAMES, predictions[NAMES], sampled_log(study, log))
    x = (np.array([1.1, 0.8]) - problem.medians) / problem.widths
    equations = problem.normal_equations(x)
    found = late_output(problem, Minimum(x, equations, 1))
    y, u = log.columns["y"].value, log.columns["u_total"].value
    predicted = output(1.1, 0.8, u)
    rest = [np.sum((y[60 + shift : 340 + shift] - predicted[60:340]) ** 2) for shift in range(-20, 21)]
    assert found.time == pytest.approx((np.argmin(rest) - 20) * DT, abs=DT)
    assert found.shifted[0] < found.unshifted[0]
    assert found.shifted[0] == pytest.approx(0.005, rel=0.2)
    assert found.matters(DT)
    assert not found.matters(1.0)


def test_a_short_log_asks_for_no_shift(predictions):
    """Without readings at the ends there are too few."""
    log = flight(0)
    study = linear(loop={"duration": 0.44, "sample_time": DT})
    short = FitProblem(study, NAMES, prediction(study, NAMES, 22), sampled_log(study, log))
    x = np.zeros(2)
    assert late_output(short, Minimum(x, short.normal_equations(x), 1)) is None


def test_a_refusal_tells_the_delay(predictions):
    """A fifth of the command's period: no numbers within reach explain it, and the shift does."""
    time = DT * np.arange(SAMPLES)
    y = output(1.1, 0.8, 6.0 * np.sin(4.0 * time)) + 0.005 * np.random.default_rng(1).normal(size=SAMPLES)
    late = np.interp(time - 0.3, time, y)
    columns = {"y": Column(time, late), "u_total": Column(time, 6.0 * np.sin(4.0 * time))}
    laws = {"k_p": {"uniform": [1.05, 1.15]}, "a_p": {"truncated_normal": [0.8, 0.05, 0.6, 1.0]}}
    narrow = linear(plant={"kind": "normal_form", "initial": [0.5, 0.0], **laws})
    with pytest.raises(Unexplained, match=r"at most 10 % is accepted.* y is 0\.(29|30?)\d* .*s later than the study"):
        fit_log(narrow, FlightLog("flight", columns, 0.0), NAMES, predictions)


@pytest.mark.parametrize("late", [0, 6])
def test_a_search_that_ended_early_tells_a_delay_by_one_simulation(predictions, late):
    log = flight(4, late)
    study = linear()
    problem = FitProblem(study, NAMES, predictions[NAMES], sampled_log(study, log))
    problem.count.simulations = problem.count.limits.simulations
    x = (np.array([1.0, 0.9]) - problem.medians) / problem.widths
    minimum = Minimum(x, problem.normal_equations(x), 1)
    texts = [doubt.text for doubt in delay_doubts(problem, minimum, explain(problem, x))]
    if late == 0:
        assert texts == []
        return
    (text,) = texts
    assert text.startswith("with y ")
    assert " s earlier, " in text
    assert float(text.split()[2]) == pytest.approx(6 * DT, abs=2 * DT)
    assert "the search has ended too early" in text


def test_outputs_of_a_topic_may_be_late_together():
    assert choices_of((0,)) == [(0,)]
    assert choices_of((1, 3)) == [(1, 3), (1,), (3,)]
    assert (0, 1, 2) in choices_of((0, 1, 2, 3))
    assert len(choices_of((0, 1, 2, 3))) == 9
