import math

import numpy as np
import pytest
from scipy import stats

from dssc_jax.statistics import (
    assured_draws,
    chernoff_draws,
    clopper_pearson,
    expected_draws,
    plan,
    wilks_draws,
    worst_case_draws,
)


def test_published_numbers():
    assert chernoff_draws(0.01, 0.99) == 26492
    assert worst_case_draws(0.01, 0.99) == 459


def test_the_worst_case_is_the_first_tolerance_limit_and_the_demonstration_without_failure():
    for error, confidence in [(0.05, 0.95), (0.01, 0.9), (0.2, 0.99)]:
        draws = worst_case_draws(error, confidence)
        assert draws == wilks_draws(1.0 - error, confidence)
        assert 1.0 - (1.0 - confidence) ** (1.0 / draws) <= error  # one-sided Clopper-Pearson at no failure


@pytest.mark.parametrize("probability", [1e-3, 0.05, 0.5, 0.97])
def test_the_planned_width_is_reached_at_the_expected_count(probability):
    enough = expected_draws(0.01, probability)
    draws = np.arange(max(enough - 200, 1), enough + 200)
    reach = np.abs(clopper_pearson(probability * draws, draws) - probability).max(-1)
    np.testing.assert_array_equal(reach <= 0.01, draws >= enough)


def exact_sum(draws, error, probability, confidence):
    """Probability that the interval reaches at most ``error``, count by count over the whole binomial law."""
    counts = np.arange(draws + 1)
    reach = np.abs(clopper_pearson(counts, draws, confidence) - counts[:, None] / draws).max(-1)
    return stats.binom.pmf(counts, draws, probability)[reach <= error].sum()


@pytest.mark.parametrize(
    ("error", "probability", "confidence"),
    [
        (0.05, 0.02, 0.95),
        (0.02, 0.1, 0.95),
        (0.05, 0.001, 0.95),
        (0.1, 0.3, 0.9),
        (0.1, 0.5, 0.95),
        (0.05, 0.45, 0.95),
        (0.1, 0.9, 0.95),
        (0.4, 0.2, 0.99),
    ],
)
def test_the_assured_width_is_reached_from_then_on(error, probability, confidence):
    """By the exact sum: at the answer, at every larger number of draws tried, and not at one fewer."""
    enough = assured_draws(error, probability, confidence)
    assert exact_sum(enough - 1, error, probability, confidence) < confidence
    later = [exact_sum(draws, error, probability, confidence) for draws in range(enough, enough + 400)]
    assert min(later) >= confidence


def test_the_assured_width_is_reached_in_simulation():
    probability, error, trials = 0.02, 0.01, 20_000
    rng = np.random.default_rng(5)
    share = {}
    for name, planned in (("expected", expected_draws), ("assured", assured_draws)):
        draws = planned(error, probability)
        counts = rng.binomial(draws, probability, trials)
        reach = np.abs(clopper_pearson(counts, draws) - counts[:, None] / draws).max(-1)
        share[name] = np.mean(reach <= error)
    assert 0.4 < share["expected"] < 0.7  # a coin's toss, which the plan says
    assert share["assured"] > 0.95 - 3.0 * math.sqrt(0.05 * 0.95 / trials)
    told = [answer.statement for answer in plan(error, 0.95, probability) if "expected count" in answer.question]
    assert float(told[0].split(": in ")[1].split()[0]) == pytest.approx(100.0 * share["expected"], abs=2.0)


def test_the_plan_answers_every_question():
    answers = plan(0.05, 0.95, 0.02)
    assert [answer.draws for answer in answers if "Wilks" in answer.question] == [59, 93, 124, 153, 181, 93, 153, 208]
    assured = [answer for answer in answers if "assured" in answer.question]
    assert [answer.draws for answer in assured] == [assured_draws(0.05, 0.02)]
    assert "in 95 % of all cases or more" in assured[0].statement
    assert len(plan(0.05)) == len(answers) - 2


@pytest.mark.parametrize("arguments", [(0.0,), (0.05, 1.0), (0.05, 0.95, 0.0), (-1.0,)])
def test_out_of_range(arguments):
    with pytest.raises(ValueError, match=r"must lie in \(0, 1\)"):
        plan(*arguments)
