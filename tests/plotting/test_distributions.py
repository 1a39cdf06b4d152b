"""Distribution functions: each step is at the share of draws at or below it, those without a value included."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.statistics import clopper_pearson
from tests.conftest import UNCERTAIN

DRAWS = 40
MISSING = 10  # draws without a value
REQUIRED = [
    {"formula": "always[0.2,0.8] abs(e) < 0.2"},
    {"signal": "y", "metric": "lowest", "min": -0.5},
    {"metric": "error_rms", "max": 0.5},
]


@pytest.fixture(scope="module")
def ran():
    loop = UNCERTAIN["loop"] | {"duration": 1.0}
    table = UNCERTAIN | {"loop": loop, "draws": DRAWS, "sweep": {}, "requirement": REQUIRED}
    return dj.run(dj.Study.from_table(table))


def with_values(result, name, values):
    """The result with other values of a metric."""
    return dj.Result(result.study, result.dataset.assign({name: ("draw", values)}))


def curve(result, name):
    """Values and shares of the distribution function of a metric, and the text of the legend."""
    ax = dj.plot.distribution(result, metric=name).axes[0]
    values, shares = ax.lines[0].get_data()
    return values, shares, " ".join(text.get_text() for text in ax.get_legend().get_texts())


@pytest.mark.parametrize(("name", "below"), [("formula_1", MISSING), ("lowest_y", MISSING), ("error_rms", 0)], ids=str)
def test_draws_without_a_value_are_at_the_bad_end(ran, name, below):
    values = np.arange(float(DRAWS))
    values[5 : 5 + MISSING] = np.nan
    drawn, shares, legend = curve(with_values(ran, name, values), name)
    assert drawn.tolist() == np.sort(values[~np.isnan(values)]).tolist()
    assert shares == pytest.approx((below + np.arange(1, DRAWS - MISSING + 1)) / DRAWS)
    assert f"{MISSING} further {'left' if below else 'right'}" in legend
    band = dj.plot.distribution(with_values(ran, name, values), metric=name).axes[0].collections[0]
    heights = band.get_paths()[0].vertices[:, 1]
    for end in clopper_pearson(below + 1, DRAWS):
        assert np.isclose(heights, end).any()


def test_values_that_do_not_fit_on_an_axis_are_counted_at_their_own_end(ran):
    values = np.arange(float(DRAWS))
    values[:3] = -1e200
    values[-2:] = 1e200
    drawn, shares, legend = curve(with_values(ran, "error_rms", values), "error_rms")
    assert (drawn[0], drawn[-1]) == (3.0, DRAWS - 3.0)
    assert (shares[0], shares[-1]) == pytest.approx((4 / DRAWS, (DRAWS - 2) / DRAWS))
    assert "draws; 3 further left, 2 further right" in legend


def test_a_margin_of_a_loop_without_an_operating_point_is_at_the_limit_of_stability(ran):
    study = ran.study.override({"requirement": [{"margin": "phase", "min": "20 deg"}]})
    values = np.linspace(0.2, 0.9, DRAWS)
    values[:MISSING] = np.nan
    result = dj.run(study)
    (name,) = (measure.name for measure in study.measures if measure.metric.margin is not None)
    drawn, shares, _ = curve(with_values(result, name, values), name)
    assert (drawn[MISSING - 1], shares[MISSING - 1]) == (0.0, MISSING / DRAWS)
    assert drawn[MISSING] > 0.2
