"""Adaptive multilevel splitting against exact laws and plain draws."""

import numpy as np
import pytest
from scipy import stats

import dssc_jax as dj
from dssc_jax.engine import Engine, evaluate
from dssc_jax.rare_events import split
from dssc_jax.requirements import worst_margin
from dssc_jax.types import Outcome
from tests.test_stopping import TABLE

FOUR_BRANCH = 2.222795066e-3


def four_branch(z, _):
    x, y = z.T
    root = np.sqrt(2.0)
    bow = 3.0 + 0.1 * (x - y) ** 2
    return np.min([bow - (x + y) / root, bow + (x + y) / root, (x - y) + 7.0 / root, (y - x) + 7.0 / root], axis=0)


def test_four_branches():
    found = [split(four_branch, 2, (seed,)) for seed in range(6)]
    mean = np.mean([each.probability for each in found])
    spread = np.sqrt(np.mean([each.variation**2 for each in found]))
    assert 0.03 < spread < 0.09
    assert mean == pytest.approx(FOUR_BRANCH, rel=3.5 * spread / np.sqrt(6))
    assert np.all(four_branch(found[0].points, None) < 0.0)
    # all four branches were found
    assert {tuple(signs) for signs in np.sign(found[0].points[np.abs(found[0].points).min(1) > 0.5]).tolist()} == {
        (1.0, 1.0),
        (-1.0, -1.0),
        (1.0, -1.0),
        (-1.0, 1.0),
    }


def test_the_last_particle_form_follows_its_exact_law():
    """p_hat = (1 - 1/N)^J with J ~ Poisson(-N ln p)."""
    particles, p = 20, 3e-2
    how = dj.Splitting(particles=particles, killed=1, moves=20, repeats=60)
    found = split(lambda z, _: stats.norm.isf(p) - z[:, 0], 1, (7,), how)
    np.testing.assert_allclose(found.estimates, (1.0 - 1.0 / particles) ** found.levels, rtol=1e-12)
    law = stats.poisson(-particles * np.log(p))
    assert found.levels.mean() == pytest.approx(law.mean(), abs=3.5 * law.std() / np.sqrt(60))
    assert found.levels.var(ddof=1) == pytest.approx(law.var(), rel=3.5 * np.sqrt(2.0 / 59))
    relative = found.estimates.std(ddof=1) / p
    assert relative == pytest.approx(np.sqrt(p ** (-1.0 / particles) - 1.0), rel=0.35)


def test_in_loop_noise_is_part_of_a_particle():
    """Half of the variance is noise that only its index knows: a frozen index would miss it."""
    p = 1e-4

    def margin(z, noise):
        hidden = np.array([np.random.default_rng((3, index)).standard_normal() for index in noise])
        return stats.norm.isf(p) - (z[:, 0] + hidden) / np.sqrt(2.0)

    found = split(margin, 1, (1,), dj.Splitting(particles=100, killed=50, moves=8, repeats=20))
    low, high = found.interval(0.999)
    assert low <= p <= high
    assert found.variation < 0.3


def test_failures_that_cannot_be_reached_are_not_called_impossible():
    found = split(lambda z, _: np.ones(len(z)), 2, (0,))
    assert found.probability == 0.0
    assert found.interval() == (0.0, 1.0)
    steps = split(lambda z, _: np.where(z[:, 0] > 1.0, -np.inf, 1.0), 1, (0,))  # no way down, yet it fails at once
    assert steps.probability == pytest.approx(stats.norm.sf(1.0), rel=0.2)


def test_a_study_agrees_with_plain_draws():
    study = dj.Study.from_table(TABLE).override({"requirement.0.max": 0.91, "draws": 20_000})
    plain = dj.run(study)
    low, high = plain.summary(0.999)["points"][0]["interval"]
    found = dj.rare(study, dj.Splitting(particles=100, killed=50, repeats=10))
    below, above = found.estimate.interval(0.999)
    assert 1e-4 < plain.failed.mean() < 2e-2
    assert max(low, below) < min(high, above)
    assert not found.noisy
    content = found.to_dict()
    assert content["where"]["plant.k_p"]["failing"][2] < content["where"]["plant.k_p"]["median"]  # weak gain fails
    engine = Engine(study, 100)
    count = min(100, len(found.estimate.noise))
    again = evaluate(
        engine, {name: values[:count] for name, values in found.where.items()}, found.estimate.noise[:count]
    )
    assert np.all(worst_margin(study.requirements, again) < 0.0)


def test_a_draw_without_a_margin_is_the_worst():
    study = dj.Study.from_table(TABLE)
    results = {
        study.requirements[0].name: np.array([0.45, np.nan, -np.inf]),
        "outcome": np.array([Outcome.OK, Outcome.REQUIREMENT, Outcome.NON_FINITE]),
    }
    np.testing.assert_array_equal(worst_margin(study.requirements, results), [0.5, -np.inf, -np.inf])
    np.testing.assert_array_equal(worst_margin((), results), [np.inf, np.inf, -np.inf])


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"requirement": []}, "at least one"), ({"plant": TABLE["plant"] | {"k_p": 1.0, "a_p": 1.0}}, "nothing is")],
)
def test_what_is_refused(changes, message):
    with pytest.raises(dj.ConfigError, match=message):
        dj.rare(dj.Study.from_table(TABLE).override(changes))


@pytest.mark.parametrize("bad", [{"particles": 5}, {"killed": 200}, {"killed": 0}, {"repeats": 9}, {"moves": 0}])
def test_bad_spending(bad):
    with pytest.raises(dj.ConfigError, match="needs"):
        dj.Splitting(**bad)
