"""What exchangeable flights say of the next one and of the draws: ranks by permutations, counts against SciPy."""

import numpy as np
import pytest
from scipy import stats

from dssc_jax.statistics import clopper_pearson
from dssc_jax.statistics.conformal import (
    MOST_FLIGHTS,
    beyond_p_value,
    beyond_tails,
    conformal_rank,
    flights_to_confirm,
    flights_to_refute,
    least_flights,
    line_rank,
)


@pytest.mark.parametrize(("flights", "probability"), [(9, 0.9), (19, 0.95), (40, 0.9), (30, 0.5)])
def test_each_of_n_plus_one_flights_in_turn(flights, probability):
    """Each in turn is the next one: at least the stated share of them lies within the limit of the others."""
    numbers = np.random.default_rng(1).pareto(0.3, flights + 1)  # without a mean
    rank = conformal_rank(flights, probability)
    inside = [numbers[i] <= np.sort(np.delete(numbers, i))[rank - 1] for i in range(flights + 1)]
    assert np.mean(inside) >= probability
    assert np.mean(inside) < probability + 1.0 / flights


def test_fewest_flights():
    for probability in (0.5, 0.8, 0.9, 0.95, 0.99):
        flights = least_flights(probability)
        assert conformal_rank(flights, probability) == flights
        assert conformal_rank(flights - 1, probability) is None


def test_the_number_beyond_the_line_of_the_draws():
    """Flights and draws of one law: the p-value is at most x with a probability of at most x."""
    rng = np.random.default_rng(2)
    draws, flights = 99, 12
    p_values = []
    for _ in range(4000):
        line = np.sort(rng.standard_normal(draws))[draws - line_rank(draws)]
        beyond = int(np.count_nonzero(rng.standard_normal(flights) > line))
        p_values.append(beyond_p_value(beyond, flights, draws))
    for level in (0.01, 0.05, 0.2):
        assert np.mean(np.array(p_values) <= level) <= level + 3.0 * np.sqrt(level / 4000)
    with pytest.raises(ValueError, match="at least 19 draws"):
        beyond_p_value(0, 5, 18)


def test_tails_are_those_of_scipy():
    rank = line_rank(199)
    for flights in (1, 7, 100, MOST_FLIGHTS):
        expected = stats.betabinom(flights, rank, 200 - rank).sf(np.arange(flights + 1) - 1)
        np.testing.assert_allclose(beyond_tails(199)[flights - 1, : flights + 1], expected, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("share", [0.3, 0.5])
def test_flights_that_refute(share):
    """One flight less refutes too rarely."""
    flights = flights_to_refute(share, 499)

    def power(count):
        counts = range(count + 1)
        critical = next((x for x in counts if beyond_p_value(x, count, 499) <= 0.05), count + 1)
        return stats.binom(count, share).sf(critical - 1)

    assert power(flights) >= 0.95
    assert max(power(count) for count in range(1, flights)) < 0.95


def test_flights_that_confirm():
    """If the study is right, the interval ends below the share in 95 % of all cases."""
    flights = flights_to_confirm(0.2, 999)
    law = stats.betabinom(flights, line_rank(999), 1000 - line_rank(999))
    counts = law.rvs(20_000, random_state=3)
    assert np.mean(clopper_pearson(counts, np.full(20_000, flights))[:, 1] <= 0.2) > 0.94
    assert flights_to_confirm(0.051, 999) is None
    assert flights_to_refute(0.05, 999) is None
