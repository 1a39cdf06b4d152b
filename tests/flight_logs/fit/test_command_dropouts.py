"""Commands that a log repeats or misses for a few samples: told with their times; limits and slow commands are not."""

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.command_dropouts import possible_dropouts
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.reading.reader import Column
from tests.flight_logs.fit.test_fit import DT, linear, log_of, output

TIME = DT * np.arange(400)
COMMAND = np.sin(5.0 * TIME) + 0.5 * np.sin(1.7 * TIME)
BEGINS = (60, 100, 160, 230, 310)  # the first sample of each dropout
LENGTH = 5


@pytest.fixture(scope="module")
def predictions():
    """Compiled predictions, which all flights share."""
    return {}


def flown(command, seed=3, noise=0.002):
    """The output of known numbers, with noise."""
    return output(1.1, 0.8, command) + noise * np.random.default_rng(seed).normal(size=400)


def with_dropouts(command, value=None):
    """The command with its last value, or another one, in each dropout."""
    logged = command.copy()
    for begin in BEGINS:
        logged[begin : begin + LENGTH] = command[begin - 1] if value is None else value
    return logged


def told(log, predictions):
    """The warnings of dropouts."""
    doubts = fit_log(linear(), log, predictions=predictions).doubts
    return [doubt.text for doubt in doubts if "is missing or repeats its last value" in doubt.text]


def test_repeated_commands_are_told_with_their_times(predictions):
    log = log_of(flown(COMMAND), with_dropouts(COMMAND))
    (text,) = told(log, predictions)
    assert text.startswith("u_total is missing or repeats its last value from ")
    assert "and at 2 more times of the study" in text
    begins = [float(part.split()[0]) for part in text.split(" from ")[1:4]]
    assert set(np.round(begins, 6)) <= {round(begin * DT, 6) for begin in BEGINS}
    assert "the residual falls, that of y from " in text


def test_missing_rows_are_told(predictions):
    """Three commands in a row are missing, and the outputs go on; more of them are refused."""
    is_missing = np.zeros(400, bool)
    for begin in range(20, 380, 12):
        is_missing[begin : begin + 3] = True
    log = log_of(flown(COMMAND, noise=0.0005))
    command = Column(TIME[~is_missing], COMMAND[~is_missing])
    assert len(told(log._replace(columns=log.columns | {"u_total": command}), predictions)) == 1


@pytest.mark.parametrize(
    "command",
    [
        COMMAND,
        np.clip(COMMAND, -0.8, 0.8),  # rests at its limits
        with_dropouts(COMMAND),  # a controller that flew what it repeats
        np.repeat(COMMAND[::5], 5),  # a slow controller
        np.round(COMMAND, 1),  # a coarse scale
    ],
)
@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_commands_that_flew_as_they_are_logged_tell_nothing(predictions, command, noise):
    assert told(log_of(flown(command, noise=noise), command), predictions) == []


def test_a_command_at_its_limit_is_no_dropout():
    command = np.array([0.0, 1.0, 1.0, 0.5, 0.5, 0.2, -1.0, -1.0, 0.0, 0.3, 0.4, 0.6])
    (span,) = possible_dropouts(command)
    assert (span.begin, span.end) == (4, 5)
    assert span.change == pytest.approx(0.3)
