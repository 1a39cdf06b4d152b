import numpy as np
import pytest
from scipy import stats

from dssc_jax.study.laws import LAWS, Law, parse_law

ORACLES = {
    ("uniform", (0.8, 1.2)): stats.uniform(0.8, 0.4),
    ("loguniform", (1e-3, 0.5)): stats.loguniform(1e-3, 0.5),
    ("normal", (1.0, 0.1)): stats.norm(1.0, 0.1),
    ("truncated_normal", (1.0, 0.5, 0.2, 1.1)): stats.truncnorm(-1.6, 0.2, 1.0, 0.5),
    ("truncated_normal", (0.0, 1.0, 3.0, 9.0)): stats.truncnorm(3.0, 9.0),
    ("truncated_normal", (0.0, 1.0, -9.0, -3.0)): stats.truncnorm(-9.0, -3.0),
    ("lognormal", (0.3, 0.2)): stats.lognorm(0.2, scale=np.exp(0.3)),
    ("beta", (2.0, 3.0)): stats.beta(2.0, 3.0),
    ("beta", (2.0, 3.0, -1.0, 4.0)): stats.beta(2.0, 3.0, -1.0, 5.0),
    ("triangular", (1.0, 1.5, 4.0)): stats.triang(1 / 6, 1.0, 3.0),
    ("triangular", (1.0, 1.0, 4.0)): stats.triang(0.0, 1.0, 3.0),
}


@pytest.mark.parametrize("case", ORACLES, ids=str)
def test_quantiles_against_scipy(case):
    u = np.concatenate([[1e-12, 1e-6], np.linspace(0.001, 0.999, 57), [1 - 1e-9]])
    np.testing.assert_allclose(Law(*case).quantile(u), ORACLES[case].ppf(u), rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("case", ORACLES, ids=str)
def test_values_stay_in_the_support(case):
    law = Law(*case)
    low, high = law.support
    values = law.quantile(np.array([2.0**-53, 0.5, 1 - 2.0**-53]))
    assert np.all((low <= values) & (values <= high))
    assert np.all(np.isfinite(values))


def test_choice_is_even():
    values = Law("choice", (3.0, 1.0, 2.0)).quantile((np.arange(3000) + 0.5) / 3000)
    assert [np.sum(values == v) for v in (1.0, 2.0, 3.0)] == [1000, 1000, 1000]


def test_every_law_is_tested():
    assert {kind for kind, _ in ORACLES} | {"choice", "point"} == set(LAWS)


def test_every_law_but_choice_and_point_can_be_moved_and_widened():
    """A law without ``roles`` would silently keep its values where all laws are widened or shifted."""
    assert [kind for kind, spec in LAWS.items() if not spec.roles] == ["choice", "point"]


@pytest.mark.parametrize("case", ORACLES, ids=str)
def test_a_moved_law_has_moved_values(case):
    """Values of the law with other arguments are those of the law, moved and widened about the median."""
    law = Law(*case)
    u = np.linspace(0.01, 0.99, 25)
    median = 1.3 * law.median
    moved = law.moved(median, 0.8).quantile(u)
    spread = law.spread(law.quantile(u), 0.8)
    expected = spread * (median / law.median) if law.logarithmic else spread + (median - law.median)
    np.testing.assert_allclose(moved, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"uniform": [1.2, 0.8]}, r"uniform \[lo, hi\]: lo must be below hi, got \[1.2, 0.8\]"),
        ({"uniform": [1.0, 1.0]}, "lo must be below hi"),
        ({"unifrom": [0, 1]}, "did you mean 'uniform'"),
        ({"normal": [1.0]}, "got 1 arguments"),
        ({"normal": [1.0, -0.1]}, "std must be positive"),
        ({"loguniform": [0.0, 1.0]}, "0 < lo < hi"),
        ({"beta": [1.0, 2.0, 3.0]}, "got 3 arguments"),
        ({"triangular": [0, 2, 1]}, "lo <= mode <= hi"),
        ({"choice": []}, "at least one"),
        ({"uniform": ["a", 1]}, "finite numbers"),
        ({"uniform": [0, float("inf")]}, "finite numbers"),
        ({"uniform": [0, 1], "normal": [0, 1]}, "one name"),
    ],
)
def test_bad_laws(table, message):
    with pytest.raises(ValueError, match=message):
        parse_law(table)


def test_a_choice_of_many_values_is_read_at_once():
    """Its rules are checked once, and not for every pair of ends of every value."""
    values = [float(value) for value in range(2000)]
    assert parse_law({"choice": values}).quantile(np.array([0.0, 1.0])).tolist() == [0.0, 1999.0]
