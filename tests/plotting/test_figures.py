"""Figures: they draw where they are told to, with units and intervals, and lose no peak."""

import copy
import doctest
import io

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

import dssc_jax as dj
from dssc_jax.plotting import thinning
from dssc_jax.plotting.cells import cell_edges, contour
from dssc_jax.plotting.style import label
from dssc_jax.plotting.thinning import PIXEL_COLUMNS, spaced_indices, thinned
from dssc_jax.results.result import headline_measure
from dssc_jax.statistics import clopper_pearson
from tests.conftest import UNCERTAIN


@pytest.fixture(scope="module")
def swept():
    return dj.run(dj.Study.from_table(copy.deepcopy(UNCERTAIN)))


@pytest.fixture(scope="module")
def one(swept):
    return swept.at(dict.fromkeys(swept.study.axes, 0))


@pytest.fixture(scope="module")
def flown(swept):
    return dj.simulate(swept.study, 2)


def drawings(swept, one, flown):
    """Every single panel by name, as a function of the axes."""
    row = swept.at({"controller.l0": 0})
    return {
        "distribution": lambda ax: dj.plot.distribution(one, ax),
        "factor": lambda ax: dj.plot.factor(one, "plant.k_p", ax),
        "probability map": lambda ax: dj.plot.probability(swept, ax),
        "probability curve": lambda ax: dj.plot.probability(row, ax),
        "typical map": lambda ax: dj.plot.typical(swept, ax),
        "typical curve": lambda ax: dj.plot.typical(row, ax, metric="command_tv"),
        "signals": lambda ax: dj.plot.signals(flown, ["e", "y"], ax),
    }


def test_numbers_of_32_bits_are_drawn(one):
    short = copy.copy(one)
    short.dataset = one.dataset.astype("float32")
    for figure in (dj.plot.distribution(short), dj.plot.factor(short, "plant.k_p"), dj.plot.failures(short)):
        assert all(ax.has_data() for ax in figure.axes)


def test_panels_draw_into_given_axes_or_their_own(swept, one, flown):
    for name, draw in drawings(swept, one, flown).items():
        figure = Figure()
        left, right = figure.subplots(1, 2)
        assert draw(right) is figure, name
        assert right.has_data(), name
        assert not left.has_data(), name
        assert draw(None) is not figure, name


def test_axes_carry_units_and_figures_are_vectors(swept, one, flown):
    for name, draw in drawings(swept, one, flown).items():
        figure = draw(None)
        ax = figure.axes[0]
        assert ax.get_xlabel(), name
        assert ax.get_ylabel(), name
        text = io.StringIO()
        figure.savefig(text, format="svg")
        assert text.getvalue().count("<image") == name.endswith("map"), name  # the colour bar's gradient
    assert "[s]" in dj.plot.probability(swept).axes[0].get_xlabel() + dj.plot.probability(swept).axes[0].get_ylabel()
    assert "[m/s]" in dj.plot.signals(flown, ["sigma"]).axes[0].get_ylabel()


def test_composites(swept, one, flown):
    for figure in (dj.plot.sweep(swept), dj.plot.failures(one), dj.plot.trajectory(flown)):
        figure.savefig(io.BytesIO(), format="pdf")


def test_the_distributions_band_is_the_exact_interval(one):
    ax = dj.plot.distribution(one).axes[0]
    draws = one.dataset.sizes["draw"]
    steps = np.asarray(ax.lines[0].get_ydata())
    assert steps == pytest.approx(np.arange(1, draws + 1) / draws)
    band = ax.collections[0].get_paths()[0].vertices[:, 1]
    for k in (1, draws // 2, draws):
        assert any(np.isclose(band, bound).any() for bound in clopper_pearson(k, draws))
    assert {round(v, 9) for v in clopper_pearson(1, draws)} <= {round(v, 9) for v in band}


def test_a_study_that_measures_no_error_is_about_its_first_metric(uncertain):
    measured = uncertain.override({"metrics.names": ["iae"], "requirement": [], "sweep": {}, "loop.duration": 1.0})
    assert "integral of |e|" in dj.plot.failures(dj.run(measured)).axes[0].get_xlabel()
    flight = dj.Study.load("studies/paper_case1.toml").override({"requirement": []})
    assert headline_measure(flight).name == "position_error_rms"


def test_a_sweeps_points_are_not_pooled(swept):
    with pytest.raises(ValueError, match=r"take Result\.at"):
        dj.plot.distribution(swept)
    with pytest.raises(ValueError, match=r"take Result\.at"):
        dj.plot.factor(swept, "plant.k_p")
    with pytest.raises(dj.ConfigError, match="did you mean 'error_rms'"):
        dj.plot.typical(swept, metric="error_rmz")
    with pytest.raises(dj.ConfigError, match=r"did you mean 'plant\.k_p'"):
        dj.plot.factor(swept.at(dict.fromkeys(swept.study.axes, 0)), "plant.kp")


def test_the_certified_stretch_is_hatched(swept):
    row = swept.at({"controller.l0": 0})
    data = row.dataset.assign(certified=("controller.functions.tau_av", np.array([True, True, False])))
    ax = dj.plot.probability(dj.Result(row.study, data)).axes[0]
    (hatched,) = [patch for patch in ax.patches if isinstance(patch, Rectangle) and patch.get_hatch()]
    axis = data["controller.functions.tau_av"].values
    assert hatched.get_x() < axis[0]
    assert axis[1] < hatched.get_x() + hatched.get_width() < axis[2]
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels.count("Theorem 1: without lag and sampling") == 1


def test_an_axis_has_one_unit(flown):
    figure = dj.plot.signals(flown, ["e", "sigma", "y", "u"])
    assert [ax.get_ylabel() for ax in figure.axes] == ["[m]", "[m/s]"]
    assert [len(ax.get_lines()) for ax in figure.axes] == [2, 2]
    with pytest.raises(ValueError, match=r"axes have one unit, got signals in \[m\], \[m/s\]"):
        dj.plot.signals(flown, ["e", "sigma"], figure.axes[0])
    for ax in dj.plot.trajectory(flown).axes:
        assert ax.get_ylabel().count("[") <= 1


def test_the_failure_figure_shows_what_fails_most(swept):
    study = swept.study.without_sweep()
    rules = [
        {"metric": "error_max", "max": 1e6},
        {"metric": "command_max", "min": 1e6},
        {"metric": "sigma_max", "max": 1e6},
    ]
    run = dj.run(study.override({"requirement": rules, "plot": {}, "draws": 20}))
    assert dj.plot.failures(run).axes[0].get_xlabel().startswith("largest |u|")
    named = run.study.override({"plot": {"metric": "sigma_max"}})
    assert "sigma" in dj.plot.failures(dj.run(named)).axes[0].get_xlabel()


def test_more_signals_than_colours(flown):
    with pytest.raises(ValueError, match="at most 5 signals, got 6"):
        dj.plot.signals(flown, ["e"] * 6)


def test_cell_edges():
    assert cell_edges(np.array([1.0, 2.0, 4.0]), False) == pytest.approx([0.5, 1.5, 3.0, 5.0])
    assert cell_edges(np.array([1.0, 10.0, 100.0]), True) == pytest.approx(10.0 ** np.array([-0.5, 0.5, 1.5, 2.5]))
    assert cell_edges(np.array([3.0]), False) == pytest.approx([2.5, 3.5])


def pixels(figure):
    """The pixels of a figure."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())


def test_the_order_of_the_values_of_a_sweep_changes_no_figure(swept):
    """The same sweep as its study lists the values in another order: curves and maps run along the axis."""
    orders = {"controller.functions.tau_av": [2, 0, 1], "controller.l0": [1, 0]}
    axes = {name: [swept.study.axes[name][i] for i in order] for name, order in orders.items()}
    listed = dj.Result(swept.study.override({"sweep": axes}), swept.dataset.isel(orders))
    listed_row = listed.at({"controller.l0": 1})
    row = swept.at({"controller.l0": 0})
    assert listed_row.dataset["controller.functions.tau_av"].values.tolist() == [0.1, 0.02, 0.05]
    for draw in (dj.plot.sweep, dj.plot.probability, dj.plot.typical):
        assert np.array_equal(pixels(draw(listed)), pixels(draw(swept)))
        assert np.array_equal(pixels(draw(listed_row)), pixels(draw(row)))


def test_values_lie_in_the_middle_of_their_cells_on_a_logarithmic_axis(swept):
    """Values from 0.01 to 1 by factors of 10: a cell reaches to the geometric mean of neighbours."""
    axes = {"controller.functions.tau_av": {"values": [0.01, 0.1, 1.0]}, "controller.l0": {"values": [0.5, 1.0]}}
    study = swept.study.override({"sweep": axes})
    grid = swept.dataset.isel({"controller.functions.tau_av": [0, 1, 2], "controller.l0": [0, 1]})
    data = grid.assign_coords({name: np.asarray(values) for name, values in study.axes.items()})
    mesh = dj.plot.probability(dj.Result(study, data)).axes[0].collections[0]
    corners = mesh.get_coordinates()
    by_axis = [np.unique(corners[..., i].round(12)) for i in range(2)]
    expected = [[0.25, 0.75, 1.25], 10.0 ** np.array([-2.5, -1.5, -0.5, 0.5])]
    for edges in expected:
        assert any(len(found) == len(edges) and np.allclose(found, edges) for found in by_axis)


def test_a_large_map_is_one_image(swept):
    """61 x 61 points of the one draw repeated: cells as an image, text and lines as vectors."""
    axes = {name: {"linspace": [0.1, 1.0, 61]} for name in ("controller.functions.tau_av", "controller.l0")}
    study = swept.study.override({"sweep": axes})
    grid = swept.dataset.isel({name: np.zeros(61, int) for name in axes})
    data = grid.assign_coords({name: np.asarray(values) for name, values in study.axes.items()})
    text = io.StringIO()
    dj.plot.probability(dj.Result(study, data)).savefig(text, format="svg")
    assert text.getvalue().count("<image") == 2
    assert len(text.getvalue()) < 500_000


def test_thinning_keeps_peaks_gaps_and_order():
    t = np.linspace(0.0, 1.0, 50_000)
    y = np.sin(40.0 * t)
    y[12_345], y[40_000:41_000] = 9.0, np.nan
    kept_t, kept_y = thinned(t, y)
    assert len(kept_t) <= 2 * PIXEL_COLUMNS
    assert (np.diff(kept_t) > 0).all()
    assert np.nanmax(kept_y) == 9.0
    assert np.nanmin(kept_y) == np.nanmin(y)
    assert np.isnan(kept_y).any()
    assert thinned(t[:10], y[:10])[0] is not t
    assert (thinned(t[:10], y[:10])[0] == t[:10]).all()


def test_the_example_of_thinning_holds():
    assert doctest.testmod(thinning).attempted == 1
    assert doctest.testmod(thinning).failed == 0


def test_dollars_in_a_users_words_are_no_mathematics():
    figure = Figure()
    figure.subplots().set_xlabel(label({"long_name": "cost $x_{$", "units": "$"}))
    figure.savefig(io.BytesIO(), format="svg")


def test_picked_keeps_both_ends():
    assert spaced_indices(3).tolist() == [0, 1, 2]
    assert spaced_indices(100_000, 5).tolist() == [0, 25000, 50000, 74999, 99999]


def test_a_contour_at_0_has_no_value_on_its_bad_side():
    """Minus infinity lies below 0, as a robustness without a value does; NaN lies above."""
    x, y = np.arange(3.0), np.arange(2.0)
    for missing, expected in ((-np.inf, True), (np.nan, False)):
        ax = Figure().add_subplot()
        contour(ax, x, y, np.array([[missing, 1.0, 1.0], [missing, 1.0, -1.0]]), 0.0, "-")
        paths = np.vstack([path.vertices for path in ax.collections[0].get_paths()])
        assert bool((paths[:, 0] < 1.0).any()) == expected
