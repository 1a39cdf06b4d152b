"""Margins of several controllers on the same draws."""

import dataclasses

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.statistics import compare_failures
from tests.analyses.comparison.test_compare import TABLE

WALK = {"over": "unmodelled.mu", "bounds": (0.02, 1.5), "log": True, "points": 5, "bisections": 5}


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(TABLE)


@pytest.fixture(scope="module")
def found(study):
    return dj.compare_margins(study, ["dssc", "pi", "smc"], **WALK)


def test_each_is_the_margin_that_is_found_alone(study, found):
    table = dj.compare(study.override({"draws": 1}), ["dssc", "pi"]).corresponding.tables["pi"]
    alone = dj.margin(study.override({"controller": table}), **WALK)
    assert found.margins["pi"].dataset.identical(alone.dataset)
    drawn = [of.dataset["plant.k_p"].values for of in found.margins.values()]
    assert np.array_equal(drawn[0], drawn[1])


def test_pairs_count_who_goes_further(found):
    pairs = {(pair.a, pair.b): pair for pair in found.pairs()}
    assert set(pairs) == {("dssc", "pi"), ("dssc", "smc"), ("pi", "smc")}
    for (a, b), pair in pairs.items():
        left, right = found.margins[a].reached, found.margins[b].reached
        assert pair.a_further == np.count_nonzero(left > right)
        assert pair.b_further == np.count_nonzero(right > left)
        assert pair.interval == compare_failures(left > right, right > left).interval


def test_censored_draws_tie_or_are_ranked(found):
    """Beyond is further than any value, before is less than any."""
    margins = found.margins["dssc"]
    moved = margins.dataset.copy(deep=True)
    moved["censoring"].values[:2] = (-1, 1)
    ranked = dataclasses.replace(margins, dataset=moved)
    assert ranked.reached[:2].tolist() == [-np.inf, np.inf]
    assert np.array_equal(ranked.reached[2:], margins.reached[2:])


def test_each_comes_back_with_its_own_study(found, tmp_path):
    back = dj.load(found.save(tmp_path / "m"))
    assert list(back.margins) == ["dssc", "pi", "smc"]
    for name, margins in found.margins.items():
        assert back.margins[name] == margins
        assert back.margins[name].study.config.controller["kind"] == name


def test_progress_reaches_its_end(study):
    seen = []
    few = study.override({"draws": 2})
    dj.compare_margins(few, ["dssc", "pi"], **WALK, progress=lambda done, total: seen.append((done, total)))
    assert all(done <= total == 40 for done, total in seen)
    assert seen == sorted(seen)


@pytest.mark.parametrize("names", [["dssc"], ["dssc", "dssc"], []])
def test_two_names_at_least(study, names):
    with pytest.raises(dj.ConfigError, match="two different names"):
        dj.compare_margins(study, names, **WALK)
