"""Interval arithmetic against numbers within the intervals."""

import numpy as np
import pytest

from dssc_jax.core.intervals import Interval, absolute


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(-1.0, 2.0, (0.0, 2.0)), (-3.0, 2.0, (0.0, 3.0)), (1.0, 2.0, (1.0, 2.0)), (-2.0, -1.0, (1.0, 2.0))],
)
def test_sizes_begin_at_0_where_both_signs_occur(low, high, expected):
    """The lower end was -1 for [-1, 2], so that the root of a size had no value there."""
    found = absolute(Interval(np.array(low), np.array(high), np.array(True)))
    inside = np.abs(np.linspace(low, high, 101))
    assert (float(found.low), float(found.high)) == expected
    assert inside.min() >= found.low
    assert inside.max() <= found.high
