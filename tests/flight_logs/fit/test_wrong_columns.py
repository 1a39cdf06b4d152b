"""Logs with the error in the column of y, or with exchanged columns: a refusal names them, and no other one does."""

from types import SimpleNamespace

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.log_sampling import sampled_log
from dssc_jax.flight_logs.fit.minima import minimise
from dssc_jax.flight_logs.fit.refusals import FitRefused, Unexplained
from dssc_jax.flight_logs.fit.wrong_columns import column_doubts, errors_as_outputs
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from tests.flight_logs.fit.test_fit import DT, linear, output

TIME = DT * np.arange(400)
REFERENCE = 0.5 * np.sin(np.pi * TIME)
RANDOM = np.random.default_rng(8)
U = np.repeat(RANDOM.normal(size=40), 10)
Y = output(1.1, 0.8, U) + 0.01 * RANDOM.normal(size=400)


@pytest.fixture(scope="module")
def predictions():
    """Compiled predictions, which all flights share."""
    return {}


def log_with(**columns):
    """A log of columns by signal."""
    return FlightLog("flight", {name: Column(TIME, values) for name, values in columns.items()}, 0.0)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"y": REFERENCE - Y, "u_total": U}, "the column of y seems to hold the error y_ref - y: with that"),
        ({"y": Y - REFERENCE, "u_total": U}, "the column of y seems to hold the error y - y_ref: with that"),
        (  # the flight had another reference than the study
            {"y": U + 1.0 - Y, "u_total": U, "y_ref": U + 1.0},
            "the column of y seems to hold the error y_ref - y: with that",
        ),
        ({"y": U, "u_total": Y}, "exchanged, y in that of u_total and u_total in that of y: with that"),
        (
            {"y": U, "u_total": REFERENCE, "y_ref": Y},
            "exchanged, y in that of y_ref and u_total in that of y: with that",
        ),
    ],
)
def test_columns_that_describe_the_flight_are_named(predictions, columns, words):
    with pytest.raises(FitRefused) as refusal:
        fit_log(linear(), log_with(**columns), predictions=predictions)
    assert words in str(refusal.value)
    assert "Correct the columns" in str(refusal.value)


@pytest.mark.parametrize("other", [np.cumsum(0.05 * RANDOM.normal(size=400)), 2.0 * np.sin(3.0 * TIME)])
def test_a_flight_that_the_study_does_not_describe_has_its_own_columns(predictions, other):
    with pytest.raises(Unexplained) as refusal:
        fit_log(linear(), log_with(y=Y + other, u_total=U, y_ref=REFERENCE), predictions=predictions)
    assert "seems to hold" not in str(refusal.value)
    assert "exchanged" not in str(refusal.value)


def positions(mass, commands):
    """Positions that are integrals of the commands over a mass, shape (4, samples)."""
    return np.cumsum(DT * commands, axis=1) / mass


@pytest.mark.parametrize("wrong", ["", "y", "u_total"])
def test_exchanged_channels_are_named(wrong):
    """Two of the four channels of a vehicle move, by a prediction in closed form."""
    study = dj.Study.load("studies/uav_robustness.toml").without_sweep()
    study = study.override({"loop.duration": 8.0, "loop.sample_time": DT, "requirement": []})
    commands = np.vstack([RANDOM.normal(size=(2, 40)).repeat(10, axis=1), np.zeros((2, 400))])
    outputs = positions(10.9, commands) + 0.001 * RANDOM.normal(size=(4, 400))
    exchanged = [1, 0, 2, 3]
    logged = {"y": outputs[exchanged] if wrong == "y" else outputs}
    logged["u_total"] = commands[exchanged] if wrong == "u_total" else commands
    columns = {}
    for signal, rows in logged.items():
        columns |= {f"{name}_{signal}": Column(TIME, row) for name, row in zip(study.loop.channels, rows, strict=True)}

    def predict(values, commands, forces=None):
        predicted = positions(values[0], commands)
        return predicted, -predicted[None] / values[0]

    log = sampled_log(study, FlightLog("flight", columns, 0.0))
    problem = FitProblem(study, ("plant.vehicle.mass",), predict, log)
    told = [doubt.text for doubt in column_doubts(problem, minimise(problem, np.zeros(1)))]
    if not wrong:
        assert told == []
        return
    assert len(told) == 1
    assert told[0].startswith("x_y and y_y, or x_u_total and y_u_total, seem to have each other's column: with that")


def test_a_reference_without_values_in_the_flight_says_nothing():
    problem = SimpleNamespace(
        log=SimpleNamespace(signals=[{"y_ref": np.full(5, np.nan)}], references=[np.zeros(5)]),
        study=SimpleNamespace(loop=SimpleNamespace(channels=("",))),
    )
    assert list(errors_as_outputs(problem, 0)) == []


def flight_in_wind(wind, begin):
    """A log of x'' = (u + d - x')/0.2 with a constant d from a sample on, where u is 0.95 (y_ref - y)."""
    random = np.random.default_rng(4)
    y_ref = 2.0 * (np.arange(750) % 500 >= 250)
    decay = np.exp(-DT / 0.2)
    x, v = 0.0, 0.0
    rows = []
    for sample, reference in enumerate(y_ref):
        y, y_dot = x + 0.01 * random.normal(), v + 0.02 * random.normal()
        u = 0.95 * (reference - y)
        rows.append((y, y_dot, reference, u))
        end = u + wind * (sample >= begin)
        x += DT * end + 0.2 * (1.0 - decay) * (v - end)
        v = end + decay * (v - end)
    signals = dict(zip(("y", "y_dot", "y_ref", "u_total"), np.transpose(rows), strict=True))
    return FlightLog("flight", {name: Column(DT * np.arange(750), row) for name, row in signals.items()}, 0.0)


def test_a_command_that_the_controller_gives_clears_the_columns():
    """A measured velocity in place of the command describes this flight, but the wind that begins in it does, too."""
    lag = {"uniform": [0.1, 0.6]}
    study = dj.Study.from_table(
        {
            "name": "velocity_commands",
            "loop": {"duration": 15.0, "sample_time": DT},
            "parameters": {"lag": lag},
            "plant": {"kind": "normal_form", "k_p": "=1/lag", "a_p": "=1/lag"},
            "reference": {"kind": "pulses", "size": 2.0, "period": 10.0, "width": 5.0, "at": 5.0},
            "controller": {"kind": "pid", "k_p": 0.95},
        }
    )
    with pytest.raises(Unexplained, match=r"begins at 7\.\d+ ± \S+ s of the study, which the study lacks") as refusal:
        fit_log(study, flight_in_wind(0.4, 350))
    assert "exchanged" not in str(refusal.value)
