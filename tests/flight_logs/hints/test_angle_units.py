"""Angles of a log in degrees, which look like any angle once they are within half a turn of the reference."""

import numpy as np
import pytest

from dssc_jax.flight_logs.hints.angle_units import is_in_degrees

REFERENCE = 0.5 * np.sin(np.linspace(0.0, 6.0, 300))


@pytest.mark.parametrize("turns", [0.0, 1.0])
def test_degrees_are_told_from_radians(turns):
    flown = REFERENCE + 0.1 * np.sin(np.linspace(0.0, 40.0, 300))
    assert is_in_degrees(np.degrees(flown) + 360.0 * turns, REFERENCE)
    assert not is_in_degrees(flown + 2.0 * np.pi * turns, REFERENCE)


def test_other_angles_are_not_in_degrees():
    random = np.random.default_rng(0)
    assert not is_in_degrees(random.uniform(-180.0, 180.0, 300), REFERENCE)  # another signal
    assert not is_in_degrees(REFERENCE + 3.0, REFERENCE)  # another frame
    assert not is_in_degrees(np.full(300, np.nan), REFERENCE)
