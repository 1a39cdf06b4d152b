"""Adaptive multilevel splitting against exact laws and plain draws."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import dssc_jax as dj
from dssc_jax.analyses.rare_events.estimate import PlainDraws
from dssc_jax.analyses.rare_events.rare import RareEvent
from dssc_jax.analyses.rare_events.splitting import split
from dssc_jax.closed_loop.metrics.requirements import worst_slack
from dssc_jax.console.analyses import show_rare
from dssc_jax.core.signals import Outcome
from dssc_jax.engine.batching import Engine, evaluate
from tests.runs.test_run_until import TABLE

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
    settings = dj.Splitting(particles=particles, killed=1, moves=20, repeats=60)
    found = split(lambda z, _: stats.norm.isf(p) - z[:, 0], 1, (7,), settings)
    np.testing.assert_allclose(found.estimates, (1.0 - 1.0 / particles) ** found.levels, rtol=1e-12)
    law = stats.poisson(-particles * np.log(p))
    assert found.levels.mean() == pytest.approx(law.mean(), abs=3.5 * law.std() / np.sqrt(60))
    assert found.levels.var(ddof=1) == pytest.approx(law.var(), rel=3.5 * np.sqrt(2.0 / 59))
    relative = found.estimates.std(ddof=1) / p
    assert relative == pytest.approx(np.sqrt(p ** (-1.0 / particles) - 1.0), rel=0.35)


def test_in_loop_noise_is_part_of_a_particle():
    """Half of the variance is noise that only its index knows: a frozen index would miss it."""
    p = 1e-4

    def slack(z, noise):
        hidden = np.array([np.random.default_rng((3, index)).standard_normal() for index in noise])
        return stats.norm.isf(p) - (z[:, 0] + hidden) / np.sqrt(2.0)

    found = split(slack, 1, (1,), dj.Splitting(particles=100, killed=50, moves=8, repeats=20))
    low, high = found.interval(0.999)
    assert low <= p <= high
    assert found.variation < 0.3


def test_failures_that_cannot_be_reached_are_not_called_impossible():
    found = split(lambda z, _: np.ones(len(z)), 2, (0,))
    assert found.mean == 0.0
    assert found.mean_interval() == (0.0, 1.0)
    assert found.interval() == found.plain.interval()  # the plain draws say more than nothing
    assert "4,096 plain draws" in found.method
    certain = split(lambda z, _: -np.ones(len(z)), 2, (0,))  # no level either, all repeats say 1
    assert certain.interval() == certain.plain.interval()
    assert certain.interval()[0] < 1.0
    steps = split(lambda z, _: np.where(z[:, 0] > 1.0, -np.inf, 1.0), 1, (0,))  # no way down, yet it fails at once
    assert steps.probability == pytest.approx(stats.norm.sf(1.0), rel=0.2)


def hidden(z, _):
    """Failures of 2.9e-7 that the slack leads to, and of 6.9e-4 where it shows nothing before they happen."""
    return np.where(z[:, 0] < -3.2, -1.0, 5.0 - z[:, 0])


def test_plain_draws_contradict_where_the_margin_leads_astray():
    truth = stats.norm.sf(3.2) + stats.norm.sf(5.0)
    found = [split(hidden, 1, (seed,), dj.Splitting(particles=60, killed=30, repeats=10)) for seed in range(30)]
    astray = [each for each in found if each.mean_interval()[1] < truth]
    assert len(astray) >= 10  # what the repeats alone would say, orders of magnitude too low
    contradicted = [each for each in astray if each.contradicted]
    assert len(contradicted) >= 0.8 * len(astray)  # a plain draw fails in 94 % of all runs
    for each in contradicted:
        assert np.all(hidden(each.plain.points, None) < 0.0)
        assert each.interval() == each.plain.interval()
        assert each.probability == each.plain.failures / 4096
    assert np.mean([each.interval()[0] <= truth <= each.interval()[1] for each in contradicted]) >= 0.9
    honest = split(four_branch, 2, (0,))
    assert not honest.contradicted
    assert honest.interval() == honest.mean_interval()


def test_a_contradiction_is_told(capsys):
    """In JSON and in the terminal: who contradicts, and whose answer it is."""
    study = dj.Study.from_table(TABLE).override({"plant.a_p": 1.0})
    estimate = split(hidden, 1, (0,), dj.Splitting(particles=60, killed=30, repeats=10))
    assert estimate.contradicted
    event = RareEvent.of(study, dj.Splitting(particles=60, killed=30, repeats=10), estimate, False)
    content = event.summary()
    assert content["plain"] == {
        "draws": 4096,
        "failures": estimate.plain.failures,
        "interval": list(estimate.plain.interval()),
        "contradicts": True,
    }
    assert content["interval"] == content["plain"]["interval"]
    assert content["interval_method"] == "Clopper-Pearson, 4,096 plain draws"
    assert content["by_method"]["probability"] < 1e-5
    show_rare(event, [])
    shown = " ".join(capsys.readouterr().out.split())
    assert "warning: plain draws contradict the splitting" in shown
    low, high = estimate.plain.interval()
    assert f"failure probability {estimate.probability:.3g} in [{low:.3g}, {high:.3g}] (95 % Clopper-Pearson" in shown


def test_a_study_agrees_with_plain_draws():
    study = dj.Study.from_table(TABLE).override({"requirement.0.max": 0.91, "draws": 20_000})
    plain = dj.run(study)
    low, high = plain.summary(0.999)["points"][0]["interval"]
    found = dj.rare(study, None, dj.Splitting(particles=100, killed=50, repeats=10))
    below, above = found.estimate.interval(0.999)
    assert 1e-4 < plain.failed.mean() < 2e-2
    assert max(low, below) < min(high, above)
    assert not found.noisy
    content = found.summary()
    assert content["where"]["plant.k_p"]["failing"][2] < content["where"]["plant.k_p"]["median"]  # weak gain fails
    engine = Engine(study, 100)
    count = min(100, len(found.estimate.noise_index))
    again = evaluate(
        engine,
        {name: values[:count] for name, values in found.failing_values.items()},
        found.estimate.noise_index[:count],
    )
    assert np.all(worst_slack(study.requirements, again) < 0.0)


def test_a_draw_without_a_margin_is_the_worst():
    study = dj.Study.from_table(TABLE)
    results = {
        study.requirements[0].name: np.array([0.45, np.nan, -np.inf]),
        "outcome": np.array([Outcome.OK, Outcome.REQUIREMENT, Outcome.NON_FINITE]),
    }
    np.testing.assert_array_equal(worst_slack(study.requirements, results), [0.5, -np.inf, -np.inf])
    np.testing.assert_array_equal(worst_slack((), results), [np.inf, np.inf, -np.inf])


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"requirement": []}, "at least one"), ({"plant": TABLE["plant"] | {"k_p": 1.0, "a_p": 1.0}}, "nothing is")],
)
def test_what_is_refused(changes, message):
    with pytest.raises(dj.ConfigError, match=message):
        dj.rare(dj.Study.from_table(TABLE).override(changes))


@pytest.mark.parametrize(
    "bad", [{"particles": 5}, {"killed": 200}, {"killed": 0}, {"repeats": 9}, {"moves": 0}, {"plain": 0}]
)
def test_bad_spending(bad):
    with pytest.raises(dj.ConfigError, match="needs"):
        dj.Splitting(**bad)


def test_a_contradiction_without_a_failed_plain_draw_has_no_table_of_failures(capsys):
    study = dj.Study.from_table(TABLE).override({"plant.a_p": 1.0})
    settings = dj.Splitting(particles=60, killed=30, repeats=10)
    likely = split(lambda z, _: 1.0 - z[:, 0], 1, (0,), settings)
    estimate = replace(likely, plain=PlainDraws(4096, np.empty((0, 1))))
    assert estimate.contradicted
    event = RareEvent.of(study, settings, estimate, False)
    assert event.answer.where["plant.k_p"].failing is None
    show_rare(event, [])
    shown = capsys.readouterr().out
    assert "0 of 4,096 plain draws failed" in shown
    assert "failing: 5 %" not in shown
