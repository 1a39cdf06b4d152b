from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from dssc_jax.statistics import AcceptReject, IntervalsAfterStop, Look, UntilWidth, clopper_pearson, multistage_interval
from dssc_jax.statistics.sequential import look_draws


def stop(rule, plan, failed):
    """Looks, failures and verdict at which a rule with these looks stops."""
    counts = np.cumsum(failed)
    seen = []
    for look in plan:
        seen.append(look)
        failures = int(counts[look.draws - 1])
        verdict = rule.verdict(look, failures)
        if verdict:
            break
    return tuple(seen), failures, verdict


def test_looks_are_geometric_and_end_at_the_most():
    found = look_draws(10_000, 1.5)
    assert found[0] == 100
    assert found[-1] == 10_000
    assert all(1.4 < b / a < 1.6 for a, b in pairwise(found[:-1]))
    assert look_draws(40, 1.5) == [40]


@pytest.mark.parametrize("failures", [0, 3, 50, 99, 100])
def test_a_test_with_one_look_has_the_interval_of_clopper_and_pearson(failures):
    found = multistage_interval([Look(100, -1, 101)], failures, 0.95)
    assert found == pytest.approx(clopper_pearson(failures, 100), abs=1e-8)


def probability_of_stops(looks, p):
    """Law of all stops of a test by enumeration: probabilities by (look, failures)."""
    running = {0: 1.0}
    draws = 0
    found = {}
    for index, look in enumerate(looks):
        spread = {}
        for count, probability in running.items():
            for more in range(look.draws - draws + 1):
                step = stats.binom.pmf(more, look.draws - draws, p)
                spread[count + more] = spread.get(count + more, 0.0) + probability * step
        draws = look.draws
        last = index == len(looks) - 1
        stopped = {count for count in spread if last or count <= look.lower or count >= look.upper}
        found |= {(index, count): spread[count] for count in stopped}
        running = {count: probability for count, probability in spread.items() if count not in stopped}
    return found


PLAN = (Look(10, 0, 8), Look(16, 2, 11), Look(22, 4, 15))


@pytest.mark.parametrize("p", [0.01, 0.1, 0.3, 0.6, 0.95])
def test_the_interval_of_a_small_test_covers_by_enumeration(p):
    """Every stop of a test with three looks, its last look included, with its exact probability."""
    covered = 0.0
    for (index, failures), probability in probability_of_stops(PLAN, p).items():
        low, high = multistage_interval(PLAN[: index + 1], failures, 0.9)
        assert 0.0 <= low < high <= 1.0
        covered += probability * (low <= p <= high)
    assert covered >= 0.9


def test_failures_and_successes_are_treated_alike():
    for index, failures in ((0, 0), (1, 2), (2, 7), (1, 12), (0, 9)):
        low, high = multistage_interval(PLAN[: index + 1], failures, 0.95)
        other = [Look(look.draws, look.draws - look.upper, look.draws - look.lower) for look in PLAN[: index + 1]]
        mirror = multistage_interval(other, other[-1].draws - failures, 0.95)
        assert (low, high) == pytest.approx((1.0 - mirror[1], 1.0 - mirror[0]), abs=1e-8)


def test_no_interval_is_wider_than_asked_whatever_the_stop():
    plan = list(UntilWidth(0.1).looks(100_000))
    possible = 0
    for index, look in enumerate(plan):
        for failures in range(possible, look.lower + 1):
            low, high = multistage_interval(plan[: index + 1], failures, 0.95)
            assert high - low <= 0.1
        possible = look.lower + 1
    assert plan[-1].upper <= plan[-1].lower + 1  # the last look stops everything


@pytest.mark.parametrize("p", [0.003, 0.01, 0.2])
def test_the_sequential_interval_covers(p):
    rng = np.random.default_rng(1)
    rule = UntilWidth(0.06)
    plan = list(rule.looks(5000))
    interval = cache(multistage_interval)
    hits = 0
    others = 0
    for _ in range(400):
        failed = rng.random(5000) < p
        seen, failures, _ = stop(rule, plan, failed)
        low, high = interval(seen, failures, 0.95)
        hits += low <= p <= high
        low, high = IntervalsAfterStop(seen, rule.stops(5000)).interval(failed[: seen[-1].draws])
        others += low <= p <= high
    assert hits >= 369  # 92.3 %, two and a half deviations below 95 %
    assert others >= 396


def test_a_stop_costs_little_more_than_a_fixed_number_of_draws():
    """The fixed number is the smallest whose exact interval is narrow at the expected number of failures."""
    p = 0.076
    width = 0.02
    fixed = next(n for n in range(2000, 4000) if np.diff(clopper_pearson(round(p * n), n))[0] <= width)
    rng = np.random.default_rng(4)
    rule = UntilWidth(width)
    plan = list(rule.looks(6000))
    costs = [stop(rule, plan, rng.random(6000) < p)[0][-1].draws for _ in range(200)]
    assert np.mean(costs) <= 1.15 * fixed


def test_looking_again_and_again_at_a_fixed_interval_does_not():
    """Why the looks must count: a look every 50 draws at Wald's interval covers some 40 % at p = 0.01."""
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
    rule = AcceptReject(0.02, 0.05)
    plan = list(rule.looks(20_000))
    found = [stop(rule, plan, rng.random(20_000) < p) for _ in range(400)]
    assert sum(verdict == wrong for *_, verdict in found) <= 20 + 13  # 5 % and three deviations
    assert sum(verdict is None for *_, verdict in found) == 0
    assert np.mean([seen[-1].draws for seen, *_ in found]) < 2000
    limits = [multistage_interval(seen, failures, 0.95) for seen, failures, _ in found[:100]]
    assert sum(low <= p <= high for low, high in limits) >= 90


@pytest.mark.parametrize(
    "make", [lambda: UntilWidth(0.0), lambda: AcceptReject(0.1, 0.1), lambda: AcceptReject(0.0, 0.1)]
)
def test_out_of_range(make):
    with pytest.raises(ValueError, match="must"):
        make()
