from itertools import pairwise

import numpy as np
import pytest

from dssc_jax.statistics import AcceptReject, DataDriven, UntilWidth, looks
from dssc_jax.statistics.proportions import look_error


def test_all_looks_together_spend_no_more_than_the_error():
    assert sum(look_error(j, 0.05) for j in range(1, 100_000)) == pytest.approx(0.05, rel=1e-4)
    assert sum(look_error(j, 0.05) for j in range(1, 100_000)) < 0.05


def test_looks_are_geometric_and_end_at_the_most():
    found = looks(10_000)
    assert found[0] == 100
    assert found[-1] == 10_000
    assert all(1.4 < b / a < 1.6 for a, b in pairwise(found[:-1]))
    assert looks(40) == [40]


def stop(rule, failed, most):
    """Draws, look and verdict at which the rule stops."""
    counts = np.cumsum(failed)
    for look, draws in enumerate(looks(most), 1):
        verdict = rule.verdict(int(counts[draws - 1]), draws, look)
        if verdict:
            break
    return draws, look, verdict


@pytest.mark.parametrize("p", [0.003, 0.01, 0.2])
def test_the_sequential_interval_covers(p):
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(300):
        failed = rng.random(5000) < p
        draws, look, _ = stop(UntilWidth(0.06), failed, 5000)
        low, high = DataDriven(look).interval(failed[:draws])
        hits += low <= p <= high
    assert hits >= 279  # 93 %


def test_looking_again_and_again_at_a_fixed_interval_does_not():
    """Why the error is shared out: a look every 50 draws at Wald's interval covers some 40 % at p = 0.01."""
    rng = np.random.default_rng(2)
    failed = rng.random((2000, 5000)) < 0.01
    draws = np.arange(50, 5001, 50)
    share = np.cumsum(failed, axis=1)[:, draws - 1] / draws
    half = 1.96 * np.sqrt(share * (1.0 - share) / draws)
    first = np.argmax(half <= 0.01, axis=1)
    row = np.arange(2000)
    covered = np.abs(share[row, first] - 0.01) <= half[row, first]
    assert covered.mean() == pytest.approx(0.40, abs=0.04)


@pytest.mark.parametrize(("p", "wrong"), [(0.02, "rejected"), (0.05, "accepted")])
def test_wrong_verdicts_are_as_rare_as_promised(p, wrong):
    rng = np.random.default_rng(3)
    verdicts = [stop(AcceptReject(0.02, 0.05), rng.random(20_000) < p, 20_000) for _ in range(400)]
    assert sum(verdict == wrong for *_, verdict in verdicts) <= 20 + 13  # 5 % and three deviations
    assert sum(verdict is None for *_, verdict in verdicts) == 0
    assert np.mean([draws for draws, *_ in verdicts]) < 2000


@pytest.mark.parametrize(
    "make", [lambda: UntilWidth(0.0), lambda: AcceptReject(0.1, 0.1), lambda: AcceptReject(0.0, 0.1)]
)
def test_out_of_range(make):
    with pytest.raises(ValueError, match="must"):
        make()
