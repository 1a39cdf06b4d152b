import numpy as np
import pytest
from scipy import stats

from dssc_jax.statistics import quantile_interval, tolerance_limits, wilks_draws, wilks_order
from dssc_jax.statistics.order import quantile_ranks, wilks_confidence


def test_published_numbers_of_draws():
    assert [wilks_draws(0.95, order=k) for k in range(1, 6)] == [59, 93, 124, 153, 181]
    assert [wilks_draws(0.95, order=k, sides=2) for k in (1, 2, 3)] == [93, 153, 208]
    assert wilks_draws(0.99, 0.9) == 230


@pytest.mark.parametrize("sides", [1, 2])
@pytest.mark.parametrize("draws", [1, 58, 59, 92, 93, 500, 5000])
def test_the_order_is_the_highest_that_so_many_draws_bear(draws, sides):
    order = wilks_order(draws, 0.95, sides=sides)
    assert order == 0 or wilks_confidence(draws, 0.95, order, sides) >= 0.95
    assert wilks_confidence(draws, 0.95, order + 1, sides) < 0.95


def test_coverage_of_quantile_intervals_is_at_least_nominal():
    """Exactly: the ranks enclose the quantile when the number of draws below it lies between them."""
    for n, p in [(10, 0.5), (59, 0.95), (1000, 0.05), (200, 0.99)]:
        low, high = quantile_ranks(n, p)
        below = np.arange(low, high)  # X_(r) <= q < X_(s): at least r and fewer than s draws below it
        assert 0.95 <= stats.binom.pmf(below, n, p).sum() < 0.999


def test_too_few_draws_give_infinite_ends():
    assert quantile_interval(np.arange(10.0), 0.99) == (8.0, np.inf)
    assert tolerance_limits(np.arange(58.0), 0.95, side="upper") == (-np.inf, np.inf)


def test_draws_without_a_value_count_as_infinite():
    values = np.append(np.arange(98.0), [np.nan, np.nan])
    assert tolerance_limits(values, 0.9, side="upper")[1] == 95.0
    assert tolerance_limits(values, 0.99, 0.5, side="upper")[1] == np.inf
    assert tolerance_limits(values, 0.9, side="lower")[0] == 4.0


@pytest.mark.parametrize("side", ["lower", "upper", "both"])
def test_content_of_tolerance_limits(side):
    uniform = np.random.default_rng(0).random((2000, 93))
    content = []
    for sample in uniform:
        low, high = tolerance_limits(sample, 0.95, side=side)
        content.append(min(high, 1.0) - max(low, 0.0))
    share = np.mean(np.asarray(content) >= 0.95)
    assert 0.935 <= share <= 0.97  # 95 % at these orders, within three deviations


@pytest.mark.parametrize(
    "call",
    [
        lambda: quantile_interval(np.array([]), 0.5),
        lambda: quantile_interval(np.ones(3), 1.0),
        lambda: tolerance_limits(np.ones(3), 0.9, side="middle"),
        lambda: wilks_draws(0.95, order=0),
        lambda: wilks_draws(1.0),
    ],
)
def test_out_of_range(call):
    with pytest.raises(ValueError, match=r"must|needs"):
        call()
