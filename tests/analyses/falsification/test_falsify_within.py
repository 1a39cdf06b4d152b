"""The worst draw within k sigma: the set, the likelihoods, and the search against brute force."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import dssc_jax as dj
from dssc_jax.analyses.falsification.search import SearchPrograms
from dssc_jax.analyses.falsification.search_sets import MOST_SIGMA, search_set
from dssc_jax.cli.main import guarded
from dssc_jax.closed_loop.metrics.requirements import worst_slack
from dssc_jax.statistics import distance_of_mass, mass_within

CORNER = Path(__file__).parents[3] / "studies" / "falsify_corner.toml"
LAWS = {"plant.k_p": stats.lognorm(0.15), "plant.a_p": stats.uniform(0.6, 0.8)}
RANKED = 2.0 * np.sin(np.pi / 6.0 * 0.8)  # of the normal scores, whose ranks have a correlation of 0.8
CORRELATION = np.array([[1.0, RANKED], [RANKED, 1.0]])
CHANGES = {
    "plant.k_p": {"lognormal": [0.0, 0.15]},
    "plant.a_p": {"uniform": [0.6, 1.4]},
    "plant.initial": [1.0, 0.5],
    "disturbance.value": 0.4,
    "correlation": {"plant.k_p, plant.a_p": 0.8},
}


@pytest.fixture(scope="module")
def correlated():
    """Two correlated numbers of different laws."""
    return dj.Study.load(CORNER).override(CHANGES)


@pytest.fixture(scope="module")
def found(correlated):
    """The worst draw within two sigma."""
    return dj.falsify(correlated, budget=300, within_sigma=2.0)


def mahalanobis(values):
    """Distance of values in sigma, from SciPy's laws: their normal scores in the metric of their correlation."""
    scores = np.array([stats.norm.ppf(law.cdf(values[name])) for name, law in LAWS.items()])
    return np.sqrt(np.sum(scores * np.linalg.solve(CORRELATION, scores), axis=0))


@pytest.mark.parametrize("numbers", [1, 2, 14])
def test_probability_within_a_distance(numbers):
    distances = np.array([0.1, 1.0, 3.0, 5.0])
    np.testing.assert_allclose(mass_within(distances, numbers), stats.chi2(numbers).cdf(distances**2), rtol=1e-12)
    for mass in (0.01, 0.5, 0.999):
        assert mass_within(distance_of_mass(mass, numbers), numbers) == pytest.approx(mass, rel=1e-12)


def test_every_point_lies_within(found):
    """And has the distance, density and mass that SciPy gives its values."""
    data = found.dataset
    distance = mahalanobis({name: data[name].values for name in LAWS})
    np.testing.assert_allclose(data["distance"].values, distance, rtol=1e-6, atol=1e-9)
    assert data["distance"].values.max() <= 2.0 * (1.0 + 1e-9)
    np.testing.assert_allclose(data["log_density"].values, -0.5 * distance**2, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(data["mass"].values, stats.chi2(2).cdf(distance**2), rtol=1e-6, atol=1e-9)


def test_no_draw_of_a_dense_grid_is_worse(correlated, found):
    """4,000 points of the disk |z| <= 2, put through SciPy's laws."""
    angle, radius = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 200), np.linspace(0.05, 2.0, 20))
    scores = np.linalg.cholesky(CORRELATION) @ np.array(
        [(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()]
    )
    values = {name: law.ppf(stats.norm.cdf(score)) for (name, law), score in zip(LAWS.items(), scores, strict=True)}
    plain = SearchPrograms.of(correlated, 300).plain
    slacks = worst_slack(plain.swept.requirements, plain(np.zeros(angle.size, dtype=int), values))
    assert found.slack <= slacks.min() + 0.002 * np.ptp(slacks)
    assert found.likelihood.distance == pytest.approx(2.0, rel=0.02)


def test_draws_beyond_the_set_are_worse(correlated, found):
    """The larger the set, the worse its worst draw, up to the whole support."""
    wider = dj.falsify(correlated, budget=300, within_sigma=3.0)
    support = dj.falsify(correlated, budget=300)
    assert support.slack <= wider.slack + 1e-9 < found.slack
    assert support.within is None
    assert support.likelihood.distance > 3.0


def test_a_mass_is_a_distance(correlated, found):
    mass = float(stats.chi2(2).cdf(4.0))
    same = dj.falsify(correlated, budget=300, within_mass=mass)
    assert same.within == pytest.approx(2.0)
    assert same.slack == pytest.approx(found.slack, abs=1e-6)


def test_the_likeliest_failure(correlated):
    """It fails, no failing point is nearer, and it is told with its numbers."""
    hard = correlated.override({"requirement.0.max": 0.45})
    found = dj.falsify(hard, budget=300, within_sigma=3.0)
    nearest = found.summary()["nearest_failure"]
    failing = found.dataset["slack"].values < 0.0
    assert nearest["slack"] < 0.0
    assert nearest["likelihood"]["distance"] == found.dataset["distance"].values[failing].min()
    assert mahalanobis(nearest["witness"]) == pytest.approx(nearest["likelihood"]["distance"], rel=1e-6)
    assert dj.falsify(correlated.override({"requirement.0.max": 5.0}), budget=64).nearest_failure is None


def test_a_folder_keeps_it(found, tmp_path):
    found.save(tmp_path / "worst")
    again = dj.load(tmp_path / "worst")
    assert again.summary() == found.summary()
    assert again.within == 2.0


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--within-sigma", "0"], "within sigma: must be in (0, 8], got 0"),
        (["--within-sigma", "9"], "within sigma: must be in (0, 8], got 9"),
        (["--within-sigma", "nan"], "within sigma: must be in (0, 8], got nan"),
        (["--within-mass", "1.5"], "within mass: must be a probability in (0, 1), got 1.5"),
        (["--within-mass", "0.9999999999999999"], "sigma for 5 numbers; must be at most 8 sigma"),
        (["--within-sigma", "2", "--within-mass", "0.9"], "give either sigma or mass, got sigma = 2 and mass = 0.9"),
    ],
)
def test_bad_sets(options, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert guarded(["falsify", str(CORNER), *options]) == 2
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert guarded(["falsify", str(CORNER), "--budget", "64", "--within-mass", "0.5", "--json"]) in (0, 1)
    said = json.loads(capsys.readouterr().out)
    assert said["within"]["mass"] == pytest.approx(0.5)
    assert said["likelihood"]["distance"] <= said["within"]["distance"] * (1.0 + 1e-9)
    assert guarded(["falsify", str(CORNER), "--budget", "64", "--within-mass", "0.5", "--out", "b"]) in (0, 1)
    told = " ".join(capsys.readouterr().out.split())
    assert "which holds 0.5 of all draws" in told
    assert "worst draw at" in told


def test_the_largest_set_still_tells_levels_apart():
    """At the outermost distance every number is finite, and its law's level is not 1."""
    study = dj.Study.load(CORNER)
    region = search_set(study, sigma=MOST_SIGMA)
    points = MOST_SIGMA * np.vstack([np.eye(5), -np.eye(5)])
    for values in region.values(points).values():
        assert np.isfinite(values).all()
    assert region.levels(points).max() < 1.0
