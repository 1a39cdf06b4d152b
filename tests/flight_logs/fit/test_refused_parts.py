"""Parts that a study lacks, where they leave so much that the fit is refused: named, with their true sizes."""

import re

import numpy as np
import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.refusals import Unexplained, largest_text
from dssc_jax.flight_logs.fit.search_limits import SearchLimits
from tests.flight_logs.fit.test_fit import DT, linear, log_of
from tests.flight_logs.fit.test_missing_parts import commands_of, flown, no_force

NOISE = 0.001


def refusal(flown_commands, logged, **options):
    """The message that refuses the fit of a flight with other commands than the logged ones."""
    with pytest.raises(Unexplained) as problem:
        fit_log(linear(), log_of(flown(no_force, 1, flown_commands), logged), **options)
    return str(problem.value)


def remaining(text):
    """The residual that the named part leaves [m rms]."""
    return float(re.search(r"leaves (\S+) m rms", text)[1])


@pytest.mark.parametrize("simulations", [2000, 60])
def test_a_large_constant_force_is_named_however_the_search_ended(simulations):
    """The minimum without it is far from the flight's numbers, and looks like another unit of length."""
    u = commands_of(1)
    text = refusal(u + 2.0, u, limits=SearchLimits(simulations))
    assert float(re.search(r"A constant force \((\S+) m/s, as of a steady wind\)", text)[1]) == pytest.approx(2.0, 0.01)
    assert remaining(text) < 1.1 * NOISE
    assert "feet" not in text


def test_a_large_force_that_begins_in_flight_is_named_with_its_time():
    u = commands_of(1)
    text = refusal(u - 4.0 * (DT * np.arange(len(u)) >= 2.0), u)
    size, begin = re.search(r"A constant force \((\S+) m/s, as of a wind\) that begins at (\S+) ± \S+ s", text).groups()
    assert float(size) == pytest.approx(-4.0, 0.01)
    assert float(begin) == pytest.approx(2.0, abs=DT)
    assert remaining(text) < 1.2 * NOISE


def test_a_refusal_says_when_the_residual_is_largest():
    """A y that another vehicle has for a second."""
    u = commands_of(1)
    y = flown(no_force, 1, u)
    is_wrong = (DT * np.arange(len(u)) >= 3.0) & (DT * np.arange(len(u)) < 4.0 - 1e-9)
    with pytest.raises(Unexplained) as problem:
        fit_log(linear(), log_of(np.where(is_wrong, y + 30.0 * np.std(y), y), u))
    words = re.search(
        r"largest at (\S+) s of the study \(at least half as large from (\S+) s to (\S+) s\)", str(problem.value)
    )
    time, begin, end = map(float, words.groups())
    assert 3.0 <= begin <= time <= end < 4.0
    assert end - begin > 0.9


def test_a_single_large_reading_has_a_time_alone():
    residual = np.array([0.1, 0.2, -3.0, 0.2])
    assert largest_text(np.arange(4.0), residual) == "largest at 2 s of the study"


@pytest.mark.parametrize("scale", [0.0, 1e-200])
def test_an_output_of_0_is_not_what_the_study_predicts(scale):
    """Its rounding is not 0."""
    u = commands_of(1)
    with pytest.raises(Unexplained, match="the study does not describe this flight"):
        fit_log(linear(), log_of(scale * flown(no_force, 1, u), u))


@pytest.mark.parametrize(("scales", "name"), [((1e200, 1.0), "y"), ((1.0, 1e150), "u_total")])
def test_a_size_beyond_all_units_is_named(scales, name):
    u = commands_of(1)
    with pytest.raises(ConfigError, match=f"has {name} up to .* beyond 1e\\+100: compare its column"):
        fit_log(linear(), log_of(scales[0] * flown(no_force, 1, u), scales[1] * u))


def test_a_force_beside_no_command_at_all_is_named():
    """The study's vehicle rests, whatever its numbers, so that nothing tells the size of a force or of a speed."""
    u = np.zeros(400)
    text = refusal(u + 2.0, u)
    assert "constant force (" in text
    assert remaining(text) < 1.1 * NOISE
