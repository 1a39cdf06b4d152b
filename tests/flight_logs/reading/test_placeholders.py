"""Numbers that stand for missing values: which are found, and which signals have none."""

import numpy as np
import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.reading.placeholders import placeholder
from dssc_jax.flight_logs.reading.reader import read_log

ROWS = np.arange(600)


def noisy(seed=0):
    random = np.random.default_rng(seed)
    return np.where(ROWS < 300, 0.0, 2.0) + 0.02 * random.normal(size=600)


@pytest.mark.parametrize("value", [-9999.0, 9999.0, -999.0, 32767.0, -1e6, 0.0])
def test_a_repeated_number_far_from_all_others_is_found(value):
    values = noisy() + (500.0 if value == 0.0 else 0.0)
    values[[3, 40, 41, 300, 599]] = value
    values[77] = np.nan
    assert placeholder(values, True) == (value, 5)
    is_customary = value not in (-1e6, 0.0)
    assert (placeholder(values, False) is not None) == is_customary


@pytest.mark.parametrize("seed", range(10))
def test_signals_that_jump_rest_or_meet_a_limit_have_none(seed):
    random = np.random.default_rng(seed)
    command = 0.05 * random.normal(size=600)
    limited = command.copy()
    limited[100:120] = limited[300:310] = 12.0  # without a value between
    limited[120:130] = -12.0
    level = np.where((ROWS // 100) % 2 == 1, 999.0, 0.0)  # of a reference
    at_rest = np.where(ROWS < 50, 0.0, 1000.0 + random.normal(size=600))  # a rare log of a fast start
    for values, is_output in (
        (noisy(seed), True),
        (limited, False),
        (level, True),
        (level, False),
        (at_rest, True),
        (np.clip(30.0 * np.sin(0.05 * ROWS), -1.0, 1.0), True),
        (np.round(noisy(seed), 1), True),
        (np.full(600, -9999.0), True),
        (np.full(600, np.nan), True),
    ):
        assert placeholder(values, is_output) is None
    outlier = noisy(seed)
    outlier[[5, 90]] = -70.5, 70.0  # a fit tells these
    assert placeholder(outlier, True) is None
    outlier[40] = -9999.0  # a customary number is one also if it stands there once
    assert placeholder(outlier, True) == (-9999.0, 1)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_an_output_that_drops_to_zero_again_and_again(noise):
    """Also where zero lies within the range of the other readings, and some of them are near it."""
    values = np.sin(0.02 * ROWS) + noise * np.random.default_rng(1).normal(size=600)
    assert placeholder(values, True) is None
    values[20:600:34] = 0.0
    assert placeholder(values, True) == (0.0, int(np.count_nonzero(values == 0.0)))
    assert placeholder(values, False) is None
    values = np.round(values, 3)
    assert placeholder(values, True)[0] == 0.0


def test_an_output_that_drops_to_zero_for_a_few_readings():
    """Three times for four readings; a plateau that is longer, or of another value each time, is none."""
    values = 2.0 + np.sin(0.02 * ROWS)
    for begin in (100, 250, 430):
        values[begin : begin + 4] = 0.0
    assert placeholder(values, True) == (0.0, 12)
    values[430:434] = 0.1
    assert placeholder(values, True) is None
    pulses = 2.0 + np.sin(0.02 * ROWS)
    for begin in (100, 250, 430):
        pulses[begin : begin + 8] = 0.5
    assert placeholder(pulses, True) is None
    values[430:450] = 0.0
    assert placeholder(values, True) is None


def test_a_log_with_such_a_number_is_refused(tmp_path):
    values = noisy()
    values[::30] = -9999.0
    rows = "\n".join(f"{0.02 * row:.2f},{value:.6g},{0.1 * value:.6g}" for row, value in zip(ROWS, values, strict=True))
    path = tmp_path / "log.csv"
    path.write_text(f"t,y,u_total\n{rows}\n")
    table = {"signals": {"y": {"column": "y", "scale": 0.01}}}
    text = r"y: holds -9999 at 20 readings, far from the others: leave such cells empty"
    with pytest.raises(ConfigError, match=text):
        read_log(path, table=table)
