"""Commands that a log lacks at single samples: the fit estimates them, and tells where."""

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.freed_commands import free_spans
from dssc_jax.flight_logs.fit.log_sampling import sampled_log
from dssc_jax.flight_logs.reading.reader import Column
from tests.flight_logs.fit.test_fit import DT, linear, log_of
from tests.flight_logs.fit.test_missing_parts import A_P, K_P, flown

TIME = DT * np.arange(400)


@pytest.fixture(scope="module")
def predictions():
    """Compiled predictions, which all flights share."""
    return {}


def noisy_command(seed):
    """A command with what a controller makes of noise, which no line between its neighbours tells."""
    random = np.random.default_rng(seed)
    return np.sin(1.5 * TIME) + 2.0 * random.normal(size=400)


def with_lost_commands(log, command, seed, count):
    """The log without the commands at some samples."""
    rows = np.random.default_rng(seed).choice(np.arange(10, 390), count, replace=False)
    is_logged = ~np.isin(np.arange(400), rows)
    return log._replace(columns=log.columns | {"u_total": Column(TIME[is_logged], command[is_logged])})


def no_force(speed):
    """No force."""
    return 0.0


def large_drag(speed):
    """Drag that the study lacks."""
    return -1.0 * speed * abs(speed)


def codes(fitted):
    """The codes of its warnings."""
    return [doubt.code for doubt in fitted.doubts]


@pytest.mark.parametrize("seed", range(4))
def test_lost_commands_are_estimated_and_told(predictions, seed):
    u = noisy_command(seed)
    log = with_lost_commands(log_of(flown(no_force, seed, u), u), u, seed + 10, 12)
    fitted = fit_log(linear(), log, predictions=predictions)
    assert "command-dropouts" in codes(fitted)
    assert "large-residual" not in codes(fitted)
    (text,) = (doubt.text for doubt in fitted.doubts if doubt.code == "command-dropouts")
    assert text.startswith("u_total is missing or repeats its last value from ")
    assert "with a free one in each of these spans the residual falls, that of y from " in text
    assert np.all(np.abs(fitted.estimates - [K_P, A_P]) < 4.0 * fitted.deviations)
    complete = fit_log(linear(), log_of(flown(no_force, seed, u), u), predictions=predictions)
    assert np.all(fitted.deviations > 0.9 * complete.deviations)


@pytest.mark.parametrize("seed", range(3))
def test_lost_commands_do_not_explain_a_force(predictions, seed):
    u = noisy_command(seed) + np.repeat(np.random.default_rng(seed).normal(size=8), 50)
    log = with_lost_commands(log_of(flown(large_drag, seed, u), u), u, seed + 10, 12)
    fitted = fit_log(linear(), log, predictions=predictions)
    assert not any("with a free one in each" in doubt.text for doubt in fitted.doubts)


def test_many_lost_commands_are_not_free():
    u = noisy_command(0)
    log = with_lost_commands(log_of(flown(no_force, 0, u), u), u, 1, 60)
    assert free_spans(sampled_log(linear(), log)) == []
