"""The failure probability over a box of laws by weights, against half spaces and other closed forms."""

import numpy as np
import pytest
from scipy import stats

from dssc_jax.analyses.laws.ranged_draws import RangedDraws, log_density, log_mixture, mixture_values
from dssc_jax.study.laws import parse_law

PART = np.array([2.0, -1.0, 0.5])
EDGE = 3.0
CASES = 40


def half_space(laws):
    """The failure probability of PART . x > EDGE under normal laws."""
    arguments = np.array([law.arguments for law in laws.values()])
    mean = PART[: len(arguments)] @ arguments[:, 0]
    deviation = np.linalg.norm(PART[: len(arguments)] * arguments[:, 1])
    return stats.norm.sf((EDGE - mean) / deviation)


def drawn(laws, draws, seed, fails):
    """Draws of the mixtures of some laws."""
    levels = np.random.default_rng(seed).random((draws, len(laws)))
    values = {name: mixture_values(law, levels[:, i]) for i, (name, law) in enumerate(laws.items())}
    return RangedDraws(laws, values, fails(values), 0.95)


def beyond(values):
    return np.stack(list(values.values()), axis=1) @ PART[: len(values)] > EDGE


def normal_box(rng):
    """A random box of three normal laws, of which some arguments are known."""
    laws = {}
    for name in "abc":
        mean = rng.uniform(-0.5, 0.5)
        deviation = rng.uniform(0.7, 1.3)
        ranges = [[mean, mean + rng.uniform(0.05, 0.5)], [deviation, deviation * rng.uniform(1.02, 1.4)]]
        known = rng.random(2) < 0.3
        if known.all():
            known[0] = False
        laws[name] = parse_law(
            {"normal": [pair[0] if fixed else pair for pair, fixed in zip(ranges, known, strict=True)]}
        )
    return laws


@pytest.mark.parametrize(
    "table",
    [
        {"normal": [[0.9, 1.1], [0.05, 0.1]]},
        {"uniform": [[0.5, 0.8], [1.2, 1.5]]},
        {"triangular": [0.2, [0.5, 0.9], [1.0, 2.0]]},
        {"beta": [[0.5, 2.0], 3.0]},
    ],
)
def test_the_draws_have_the_density_that_the_weights_assume(table):
    """Shares of the mixture's draws below some values, against the integral of its density."""
    law = parse_law(table)
    values = mixture_values(law, (np.arange(200_000) + 0.5) / 200_000)
    grid = np.linspace(values.min(), values.max(), 100_001)
    density = np.exp(log_mixture(law, 0.5 * (grid[1:] + grid[:-1])))
    below = np.cumsum(density) * (grid[1] - grid[0])
    for share in (0.1, 0.4, 0.8):
        assert np.interp(np.quantile(values, share), grid[1:], below) == pytest.approx(share, abs=2e-3)


def test_weights_are_bounded_and_have_the_mean_one():
    law = parse_law({"uniform": [[0.5, 0.8], [1.2, 1.5]]})
    values = mixture_values(law, (np.arange(100_000) + 0.5) / 100_000)
    for member in law.corners:
        weights = np.exp(log_density(member, values) - log_mixture(law, values))
        assert weights.mean() == pytest.approx(1.0, abs=1e-3)
        assert weights.max() <= 5.0


def test_the_worst_and_the_best_law_of_a_half_space():
    """They are at corners of the box."""
    laws = {"a": parse_law({"normal": [[-0.3, 0.2], [0.8, 1.2]]}), "b": parse_law({"normal": [[-0.1, 0.1], 1.0]})}
    draws = drawn(laws, 20_000, 3, beyond)
    highest = draws.highest()
    lowest = draws.lowest()
    np.testing.assert_allclose(highest.laws["a"].arguments, (0.2, 1.2), atol=1e-3)
    np.testing.assert_allclose(highest.laws["b"].arguments, (-0.1, 1.0), atol=1e-3)
    np.testing.assert_allclose(lowest.laws["a"].arguments, (-0.3, 0.8), atol=1e-3)
    assert highest.probability == pytest.approx(half_space(highest.laws), rel=0.05)
    assert lowest.probability == pytest.approx(half_space(lowest.laws), rel=0.15)


def test_a_worst_law_inside_of_the_box_is_found():
    """A draw fails within a band: the worst mean lies in it, not at an end of its range."""
    laws = {"a": parse_law({"normal": [[-1.0, 2.0], 0.5]})}
    draws = drawn(laws, 20_000, 1, lambda values: np.abs(values["a"] - 0.7) < 0.3)
    highest = draws.highest()
    assert highest.laws["a"].arguments[0] == pytest.approx(0.7, abs=0.1)
    truth = stats.norm.cdf(0.6) - stats.norm.cdf(-0.6)
    assert highest.interval[0] < truth < highest.interval[1]
    assert highest.probability == pytest.approx(truth, rel=0.05)


def test_random_laws_within_random_boxes():
    """The interval contains the failure probability of a random law of each box, and nearly always that of all."""
    rng = np.random.default_rng(11)
    all_laws = 0
    for seed in range(CASES):
        laws = normal_box(rng)
        draws = drawn(laws, 1024, seed, beyond)
        assert draws.trusted
        low, high = draws.lowest().interval[0], draws.highest().interval[1]
        point = rng.uniform(*np.transpose(draws.bounds))
        assert low <= half_space(draws.laws_at(point)) <= high
        corners = [half_space(draws.laws_at(corner)) for corner in draws.corners]
        all_laws += low <= min(corners) and max(corners) <= high
    assert all_laws >= 0.93 * CASES


def test_no_failure_still_has_an_upper_limit():
    laws = {"a": parse_law({"normal": [[-0.1, 0.1], 1.0]})}
    draws = drawn(laws, 1000, 1, lambda values: values["a"] > 50.0)
    assert draws.lowest().interval[0] == 0.0
    assert 3.6 / 1000 < draws.highest().interval[1] < 5.0 / 1000


def test_boxes_that_are_too_wide_are_not_trusted():
    laws = {name: parse_law({"normal": [[-9.0, 9.0], [0.01, 3.0]]}) for name in "abc"}
    assert not drawn(laws, 1000, 1, beyond).trusted
