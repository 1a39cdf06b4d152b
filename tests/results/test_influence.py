"""What matters in a result: idle knobs are reported, and uncertain numbers are ranked by what they explain."""

import doctest
from itertools import pairwise

import numpy as np
import pytest
import xarray as xr

import dssc_jax as dj
import dssc_jax.results.influence as influences
from dssc_jax.results.influence import (
    equal_count_bins,
    idle_axes,
    idle_text,
    influence,
    largest_change,
    sorted_by_influence,
)
from tests.conftest import UNCERTAIN

LOOP = {
    **UNCERTAIN,
    "draws": 60,
    "controller": UNCERTAIN["controller"] | {"predictor_start": "midpoint"},  # in sliding from the first sample
    "plant": {"kind": "normal_form", "k_p": {"uniform": [0.8, 1.2]}, "a_p": {"uniform": [0.9, 1.1]}},
    "requirement": [{"metric": "error_rms", "after": 2.0, "max": 0.2}],
}


UNCHANGED = "no verdict changes, and no quantile (5, 50, 95 %) of a metric by more than 1 %"


def swept(axis):
    return dj.run(dj.Study.from_table({**LOOP, "sweep": axis}))


def test_an_idle_knob_is_reported_with_what_it_does_change():
    """tau_av at a fixed product k_o tau_av, and a gain."""
    idle = swept({"controller.functions.tau_av": [0.02, 0.05]})
    assert idle_axes(idle) == ["controller.functions.tau_av"]
    assert idle_text(idle) == f"over controller.functions.tau_av {UNCHANGED}"
    factor = xr.DataArray([1.0, 0.6], dims="controller.functions.tau_av")
    jerky = idle.dataset.assign(command_tv=idle.dataset["command_tv"] * factor)
    text = idle_text(dj.Result(idle.study, jerky))
    assert text.startswith("controller.functions.tau_av is idle here: no verdict and no required metric changes")
    assert "most changes command_tv, by 40%" in text
    matters = swept({"controller.functions.kappa2": [0.5, 4.0]})
    assert idle_axes(matters) == []
    assert idle_text(matters) == ""


def test_an_axis_that_changes_nothing_at_all():
    result = swept({"controller.functions.kappa2": [0.5, 4.0]})
    same = result.dataset.isel({"controller.functions.kappa2": [0, 0]}).assign_coords(
        {"controller.functions.kappa2": [0.5, 4.0]}
    )
    assert idle_text(dj.Result(result.study, same)) == f"over controller.functions.kappa2 {UNCHANGED}"
    assert "no verdict changes, and no quantile" in dj.plot.sweep(dj.Result(result.study, same))._suptitle.get_text()


def test_the_change_of_a_metric_is_that_of_its_quantiles():
    draws = np.arange(101.0)
    metric = xr.DataArray(np.stack([draws, 2.0 * draws]), dims=("axis", "draw"))
    assert largest_change(metric, "axis") == pytest.approx(0.5)
    gone = metric.where(metric["axis"] == 0)
    assert largest_change(gone, "axis") == np.inf


def test_influence_is_the_share_of_variance_that_a_number_explains():
    """A failure that depends on one number alone: the ratio is 1 where bins separate it, about 0 for the other."""
    result = dj.run(dj.Study.from_table({**LOOP, "draws": 400, "sweep": {}}))
    gain = result.dataset["plant.k_p"].values
    outcome = np.where(gain < np.median(gain), 10, 0).astype(result.dataset["outcome"].dtype)
    forced = dj.Result(result.study, result.dataset.assign(outcome=("draw", outcome)))
    assert influence(forced, "plant.k_p") == pytest.approx(1.0 - 7 / 399)
    assert influence(forced, "plant.a_p") < 0.05
    names = list(result.study.laws)
    assert sorted_by_influence(forced, names)[0] == "plant.k_p"
    assert sorted(sorted_by_influence(forced, names)) == sorted(names)


@pytest.mark.parametrize("required", [{"formula": "always[0,1] abs(e) < 1e-9"}, {"metric": "error_rms", "max": 1e-9}])
def test_if_all_draws_fail_those_without_a_value_are_the_worst(required):
    """The other draws get worse as the gain falls, to those without a value: the ranks follow the gain alone."""
    result = dj.run(dj.Study.from_table({**LOOP, "draws": 80, "sweep": {}, "requirement": [required]}))
    assert result.failed.all()
    measure = result.study.requirements[0].measure
    gain = result.dataset["plant.k_p"].values
    sign = 1.0 if measure.metric.worst == -np.inf else -1.0
    values = np.where(gain < np.quantile(gain, 0.3), np.nan, sign * gain)
    ended = dj.Result(result.study, result.dataset.assign({measure.name: ("draw", values)}))
    assert influence(ended, "plant.k_p") > 0.85
    none = dj.Result(result.study, result.dataset.assign({measure.name: ("draw", np.full(80, np.nan))}))
    assert influence(none, "plant.k_p") == 0.0


def test_the_change_of_a_metric_counts_draws_without_a_value_as_its_worst():
    """With 3 % at -inf the median and both outer quantiles are finite, with 6 % the lower one is not."""
    draws = np.arange(100.0)
    few, more = draws.copy(), draws.copy()
    few[:3] = more[:6] = np.nan
    metric = xr.DataArray(np.stack([few, more]), dims=("axis", "draw"))
    assert largest_change(metric, "axis", -np.inf) == np.inf
    few[:6] = np.nan
    metric = xr.DataArray(np.stack([few, few]), dims=("axis", "draw"))
    assert largest_change(metric, "axis", -np.inf) == 0.0


def test_equal_values_share_a_bin_and_the_mean_of_their_ranks():
    assert doctest.testmod(influences).attempted == 2
    assert doctest.testmod(influences).failed == 0


@pytest.mark.parametrize("draws", [7, 12, 64, 1003])
@pytest.mark.parametrize("count", [1, 2, 3, 8, 20])
def test_no_bin_separates_draws_of_equal_value(draws, count):
    values = np.random.default_rng(count).choice(np.linspace(0.9, 1.1, count), draws)
    bins = equal_count_bins(values)
    assert sorted(np.concatenate(bins)) == list(range(draws))
    assert all(len(members) for members in bins)
    for lower, upper in pairwise(bins):
        assert values[lower].max() < values[upper].min()
    if count <= 3 and draws > 7:
        assert len(bins) == count


def test_a_repeated_value_among_others_has_a_bin_of_its_own():
    values = np.concatenate([np.linspace(0.0, 1.0, 40, endpoint=False), np.full(60, 1.0), np.linspace(1.1, 2.0, 20)])
    bins = [np.unique(values[members]) for members in equal_count_bins(values)]
    assert any(members.tolist() == [1.0] for members in bins)


def test_bins_of_values_that_do_not_repeat_have_nearly_equal_sizes():
    values = np.random.default_rng(1).normal(size=43)
    assert [len(members) for members in equal_count_bins(values)] == [6, 6, 6, 5, 5, 5, 5, 5]
    assert [len(members) for members in equal_count_bins(values[:7])] == [7]


def test_the_values_of_a_choice_are_drawn_at_their_own_failures():
    table = {**LOOP, "draws": 300, "sweep": {}}
    study = dj.Study.from_table(table).override({"plant.k_p": {"choice": [0.9, 1.0, 1.1]}})
    result = dj.run(study)
    gain = result.dataset["plant.k_p"].values
    code = np.where((gain == 1.0) | ((gain == 0.9) & (np.arange(300) % 7 == 0)), 10, 0)
    forced = dj.Result(study, result.dataset.assign(outcome=("draw", code.astype(result.dataset["outcome"].dtype))))
    values, shares = dj.plot.factor(forced, "plant.k_p").axes[0].lines[0].get_data()
    assert values.tolist() == [0.9, 1.0, 1.1]
    assert shares.tolist() == [np.mean(code[gain == value] > 0) for value in values]


def test_the_figure_of_failures_shows_the_most_influential_numbers_and_how_many_more_there_are():
    study = dj.Study.from_table({**LOOP, "sweep": {}, "draws": 100})
    wide = study.override({"controller.functions.kappa1": {"uniform": [0.9, 1.1]}})
    wide = wide.override({"controller.functions.kappa2": {"uniform": [0.5, 2.0]}})
    result = dj.run(wide)
    figure = dj.plot.failures(result)
    assert len(result.study.laws) == 6
    assert "the 5 most influential of 6 uncertain numbers" in figure._suptitle.get_text()
    shown = [ax.get_xlabel().partition("\n")[0] for ax in figure.axes[1:] if ax.get_xlabel()]
    assert shown == sorted_by_influence(result, list(result.study.laws))[:5]


def test_probability_axes_fit_the_data():
    result = dj.run(dj.Study.from_table({**LOOP, "draws": 400, "sweep": {}}))
    few = np.zeros(400, result.dataset["outcome"].dtype)
    few[:4] = 10
    rare = dj.Result(result.study, result.dataset.assign(outcome=("draw", few)))
    low, high = dj.plot.factor(rare, "plant.k_p").axes[0].get_ylim()
    assert -0.02 < low < 0.0 < high < 0.3
    many = dj.Result(result.study, result.dataset.assign(outcome=("draw", np.full_like(few, 10))))
    assert dj.plot.factor(many, "plant.k_p").axes[0].get_ylim()[1] > 1.0
