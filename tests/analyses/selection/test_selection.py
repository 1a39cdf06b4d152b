"""Races of candidates: against known failure probabilities, and how often their statement is wrong."""

import copy

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax import ConfigError
from dssc_jax.analyses.selection.race import race
from dssc_jax.statistics import log_evidence_of_less
from tests.analyses.test_one_shape import TABLE


def coins(shares, seed):
    """Candidates that fail with known probabilities, dependent through common draws."""
    rng = np.random.default_rng(seed)
    common = rng.random(200_000)
    shifts = np.random.default_rng(7).random((len(shares), 1)) * 0.3

    def failing(running, draws):
        moved = (common[draws] + shifts[running]) % 1.0
        return moved < shares[running][:, None]

    return failing


def surplus(shares, chosen):
    """By how much the worst of the chosen fails more often than the best of the others."""
    others = np.delete(shares, chosen)
    return shares[chosen].max() - others.min()


def test_the_evidence_is_the_capital_of_its_bets():
    """Draw by draw, over all orders of the outcomes the same."""
    rng = np.random.default_rng(0)
    outcomes = rng.choice([1, -1, 0], size=300, p=[0.03, 0.1, 0.87])
    margin = 0.02
    stakes = np.geomspace(0.003, 0.97, 16) / (1.0 - margin)
    capital = np.ones(16)
    for outcome in outcomes:
        capital *= 1.0 + stakes * (margin - outcome)
    counts = np.count_nonzero(outcomes == 1), np.count_nonzero(outcomes == -1), len(outcomes)
    assert log_evidence_of_less(*counts, margin) == pytest.approx(np.log(capital.mean()))
    with pytest.raises(ValueError, match="margin"):
        log_evidence_of_less(1, 2, 3, 1.0)


@pytest.mark.parametrize("margin", [0.0, 0.05])
def test_false_evidence_is_as_rare_as_stated_at_every_look(margin):
    """The largest capital of a walk passes 20 in at most a twentieth of the walks if the margin is the truth."""
    rng = np.random.default_rng(1)
    worse, better = 0.1 + margin, 0.1
    moves = rng.random((2000, 1500))
    a = np.cumsum(moves < worse, axis=1)
    b = np.cumsum(moves > 1.0 - better, axis=1)
    largest = log_evidence_of_less(a, b, np.arange(1, 1501), margin).max(axis=1)
    passed = np.count_nonzero(largest >= np.log(20.0))
    assert passed <= 100 + 3.0 * np.sqrt(95.0)


def test_the_best_are_found_by_few_simulations():
    shares = np.concatenate([np.full(6, 0.01), np.linspace(0.05, 0.9, 250)])
    np.random.default_rng(2).shuffle(shares)
    found = race(coins(shares, 3), len(shares), 5, 0.02, 10**7)
    assert set(found.chosen) <= set(np.flatnonzero(shares == 0.01))
    assert found.within == 0.02
    assert found.simulations < len(shares) * found.draws.max() / 5
    again = race(coins(shares, 3), len(shares), 5, 0.02, 10**7)
    np.testing.assert_array_equal(again.chosen, found.chosen)


def test_where_many_never_fail_few_are_simulated_further():
    shares = np.concatenate([np.zeros(100), np.full(100, 0.03), np.linspace(0.1, 0.9, 100)])
    np.random.default_rng(2).shuffle(shares)
    found = race(coins(shares, 3), len(shares), 5, 0.02, 10**7)
    assert shares[found.chosen].max() <= 0.02
    assert found.simulations < 200 * len(shares)
    assert found.draws[found.chosen].min() > 500


def test_the_statement_is_seldom_wrong():
    """60 races between candidates that hardly differ: at most 3 wrong statements are stated, 8 would be 1 in 500."""
    shares = np.linspace(0.02, 0.12, 24)
    wrong = 0
    for seed in range(60):
        found = race(coins(shares, seed), len(shares), 3, 0.03, 10**7)
        wrong += surplus(shares, found.chosen) > found.within
    assert wrong <= 7


def test_too_few_simulations_have_a_wider_statement():
    shares = np.linspace(0.02, 0.12, 24)
    found = race(coins(shares, 1), len(shares), 3, 0.001, 5000)
    assert 0.001 < found.within < 0.5
    assert surplus(shares, found.chosen) <= found.within


def test_a_study_agrees_with_plain_draws():
    study = dj.Study.from_table(copy.deepcopy(TABLE))
    found = dj.select(study, candidates=32, keep=2, within=0.2)
    answer = found.answer
    assert answer.within <= 0.2
    best = found.chosen[0]
    values = answer.chosen[0].values
    judged = dj.run(
        study.override({"seed": (study.config.seed + 1), "draws": answer.chosen[0].draws} | values), check=False
    )
    assert judged.summary()["points"][0]["failures"] == found.dataset["failures"].values[best]


def test_bad_questions_are_refused():
    study = dj.Study.from_table(copy.deepcopy(TABLE))
    with pytest.raises(ConfigError, match="0 < LO < HI"):
        dj.select(study, over={"plant.k_p": (1.0, 1.0)})
    with pytest.raises(ConfigError, match="`keep` < `candidates`"):
        dj.select(study, candidates=4, keep=4)
    with pytest.raises(ConfigError, match="within"):
        dj.select(study, within=1.0)
    with pytest.raises(ConfigError, match="independent draws"):
        dj.select(study.override({"sampling": "sobol", "draws": 64}))
