import math

import numpy as np
import pytest

from dssc_jax.statistics import (
    chernoff_draws,
    clopper_pearson,
    clopper_pearson_draws,
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
def test_the_planned_width_is_reached(probability):
    enough = clopper_pearson_draws(0.01, probability)
    reach = []
    for draws in (enough - 1, enough):
        share = math.ceil(probability * draws) / draws
        reach.append(np.abs(clopper_pearson(math.ceil(probability * draws), draws) - share).max())
    assert reach[0] > 0.01 >= reach[1]


def test_the_plan_answers_every_question():
    answers = plan(0.05, 0.95, 0.02)
    assert [answer.draws for answer in answers if "Wilks" in answer.question] == [59, 93, 124, 153, 181, 93, 153, 208]
    assert len(plan(0.05)) == len(answers) - 1


@pytest.mark.parametrize("arguments", [(0.0,), (0.05, 1.0), (0.05, 0.95, 0.0), (-1.0,)])
def test_out_of_range(arguments):
    with pytest.raises(ValueError, match=r"must lie in \(0, 1\)"):
        plan(*arguments)
