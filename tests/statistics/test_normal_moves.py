"""The worst case over sets of draws when the scores are moved or widened, against sets that attain it and others."""

import math

import numpy as np
import pytest
from scipy import stats

from dssc_jax.statistics.normal_moves import largest_distance, largest_width, worst_when_moved, worst_when_widened


@pytest.mark.parametrize("p", [1e-4, 0.05, 0.4])
@pytest.mark.parametrize("distance", [-0.7, 0.0, 0.4, 2.0])
def test_a_half_space_attains_the_bound_of_a_move(p, distance):
    edge = stats.norm.isf(p)
    assert worst_when_moved(p, distance) == pytest.approx(stats.norm.sf(edge - distance), rel=1e-12)


@pytest.mark.parametrize("numbers", [1, 3, 12])
@pytest.mark.parametrize("width", [1.0, 1.1, 1.6])
def test_the_outside_of_a_ball_attains_the_bound_of_widening(numbers, width):
    edge = stats.chi2.isf(0.02, numbers)
    expected = stats.chi2.sf(edge / width**2, numbers)
    assert worst_when_widened(0.02, width, numbers) == pytest.approx(expected, rel=1e-10)


def test_no_interval_of_one_number_is_worse():
    """10,000 random unions of two intervals, moved and widened by random amounts."""
    rng = np.random.default_rng(8)
    ends = np.sort(rng.normal(0.0, 1.6, (10_000, 4)), axis=1)
    moves = rng.normal(0.0, 1.0, 10_000)
    widths = np.exp(rng.exponential(0.3, 10_000))
    for (a, b, c, d), move, width in zip(ends, moves, widths, strict=True):

        def probability(location, scale, ends=(a, b, c, d)):
            levels = stats.norm._cdf((np.array(ends) - location) / scale)
            return float(levels[1] - levels[0] + levels[3] - levels[2])

        p = probability(0.0, 1.0)
        moved = probability(move, 1.0)
        assert worst_when_moved(p, -abs(move)) - 1e-12 <= moved <= worst_when_moved(p, abs(move)) + 1e-12
        assert probability(0.0, width) <= worst_when_widened(p, width, 1) + 1e-12


@pytest.mark.parametrize("numbers", [1, 4])
def test_the_inverses(numbers):
    distance = largest_distance(0.01, 0.05)
    assert worst_when_moved(0.01, distance) == pytest.approx(0.05, rel=1e-12)
    width = largest_width(0.01, 0.05, numbers)
    assert worst_when_widened(0.01, width, numbers) == pytest.approx(0.05, rel=1e-9)
    assert largest_distance(0.06, 0.05) == 0.0
    assert largest_width(0.06, 0.05, numbers) == 1.0
    assert largest_distance(0.0, 0.05) == largest_width(0.0, 0.05, numbers) == math.inf


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match="p must lie"):
        worst_when_moved(1.5, 0.1)
    with pytest.raises(ValueError, match="width must be"):
        worst_when_widened(0.5, 0.9, 2)
