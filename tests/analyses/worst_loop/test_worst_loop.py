"""The worst case of the linearised loop, against closed forms and a dense grid of loops that NumPy builds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import expm

import dssc_jax as dj
from dssc_jax.analyses.worst_loop.box import box_of
from dssc_jax.analyses.worst_loop.cells import INTERVALS, cover_box
from dssc_jax.analyses.worst_loop.readouts import GAINS
from dssc_jax.analyses.worst_loop.search import nearest_instability, start_points

SAMPLE_TIME = 0.05
TABLE = {
    "name": "box",
    "draws": 100,
    "loop": {"duration": 60.0, "sample_time": SAMPLE_TIME},
    "plant": {
        "kind": "state_space",
        "a": [[0.0, 1.0], [0.0, {"uniform": [-1.4, -0.6]}]],
        "b": [0.0, {"uniform": [0.7, 1.3]}],
        "c": [1.0, 0.0],
        "x0": [1.0, 0.0],
    },
    "controller": {"kind": "state_feedback", "k_1": 9.0, "k_2": 3.0},
}


@pytest.fixture(scope="module")
def worst():
    return dj.worst_loop(dj.Study.from_table(TABLE))


def closed_loop(a, b):
    """A - B K and B of the loop x'' = a x' + b u, u = -9 y - 3 y', held for a sample."""
    held = expm(np.array([[0.0, 1.0, 0.0], [0.0, a, b], [0.0, 0.0, 0.0]]) * SAMPLE_TIME)
    column = held[:2, 2]
    gains = np.array([9.0, 3.0])
    return held[:2, :2] - np.outer(column, gains), column, -gains


@pytest.fixture(scope="module")
def grid():
    """Peaks of S, T, (S - T)/2 and theta T over 21 x 21 plants."""
    angles = np.geomspace(1e-3, np.pi, 2000)
    peaks = np.zeros(4)
    for a in np.linspace(-1.4, -0.6, 21):
        for b in np.linspace(0.7, 1.3, 21):
            matrix, column, row = closed_loop(a, b)
            poles, modes = np.linalg.eig(matrix)
            weights = (row @ modes) * np.linalg.solve(modes, column)
            g = (weights / (np.exp(1j * angles)[:, None] - poles)).sum(axis=1)
            peaks = np.maximum(peaks, [np.abs(x).max() for x in (1.0 + g, g, 0.5 + g, angles * g)])
    return peaks


def test_bounds_hold_and_are_near_the_worst_of_a_dense_grid(worst, grid):
    margins = worst.answer.loops["input"].margins
    assert worst.answer.loops["input"].stable
    for name, peak in zip(("sensitivity_peak", "complementary_peak"), grid[:2], strict=True):
        assert peak * (1.0 - 1e-4) <= margins[name].found <= margins[name].bounded
        assert margins[name].bounded <= 1.051 * margins[name].found
        assert margins[name].found == pytest.approx(peak, rel=1e-3)
    assert margins["disk"].found == pytest.approx(1.0 / grid[2], rel=1e-3)
    assert 0.951 / grid[2] <= margins["disk"].bounded <= 1.0 / grid[2] * (1.0 + 1e-4)
    assert margins["delay"].bounded <= SAMPLE_TIME / grid[3] * (1.0 + 1e-4)
    assert margins["delay"].bounded <= margins["delay"].found
    assert margins["phase"].bounded <= margins["phase"].found
    assert margins["gain_upper"].bounded <= margins["gain_upper"].found
    assert margins["gain_lower"].bounded >= margins["gain_lower"].found


def test_found_is_no_better_than_drawn_and_its_numbers_have_it(worst):
    answer = worst.answer.loops["input"].margins["disk"]
    assert answer.found <= answer.drawn
    witness = worst.witness("input", "disk")
    again = dj.loop_margins(witness.override({"draws": 1})).dataset["disk"].sel(loop="input")
    assert float(again.values.min()) == pytest.approx(answer.found, rel=1e-6)


def test_the_bounded_disk_is_python_controls(worst):
    control = pytest.importorskip("control")
    answer = worst.answer.loops["input"].margins["disk"]
    numbers = answer.numbers
    matrix, column, row = closed_loop(numbers["plant.a.1.1"], numbers["plant.b.1"])
    opened = matrix - np.outer(column, row)
    loop = control.ss(opened, column[:, None], -row[None], 0.0, SAMPLE_TIME)
    omega = np.geomspace(1e-2, np.pi / SAMPLE_TIME, 20000)
    margin = control.disk_margins(loop, omega)[0]
    assert answer.found == pytest.approx(float(margin), rel=1e-4)
    assert answer.bounded <= float(margin) * (1.0 + 1e-9)


def test_growth_of_the_box_reaches_an_instability_that_a_run_shows(worst):
    answer = worst.answer.loops["input"]
    assert 1.0 < answer.growth_bounded < answer.growth_found
    assert answer.growth_bounded > 0.5 * answer.growth_found
    numbers = answer.unstable
    radius = np.abs(np.linalg.eigvals(closed_loop(numbers["plant.a.1.1"], numbers["plant.b.1"])[0])).max()
    assert radius == pytest.approx(1.0, abs=1e-4)
    trajectory = np.abs(dj.simulate(worst.unstable_witness("input"))["y"].values)
    assert trajectory[len(trajectory) // 2 :].max() > trajectory[: len(trajectory) // 2].max()
    inside = {name: 0.95 * value + 0.05 * (-1.0 if ".a." in name else 1.0) for name, value in numbers.items()}
    calm = np.abs(dj.simulate(worst.study.override(inside))["y"].values)
    assert calm[len(calm) // 2 :].max() < calm[: len(calm) // 2].max()


def first_order(points):
    """x+ = (0.9 + 0.05 u) x + w, v = x: G = 1/(z - 0.9 - 0.05 u)."""
    matrices = np.zeros((len(points), 2, 2))
    matrices[:, 0, 0] = 0.9 + 0.05 * points[:, 0]
    matrices[:, 0, 1] = 1.0
    matrices[:, 1, 0] = 1.0
    return matrices


def no_point_limit():
    return 2**62


def test_a_first_order_loop_has_its_closed_form():
    ends = (-np.ones(1), np.ones(1))
    exact = np.array([1.0 + 1.0 / 0.05, 1.0 / 0.05, 0.5 + 1.0 / 0.05])  # at z = 1 and u = 1
    wanted = np.array([*1.01 * exact, 1e300])
    covered = cover_box(first_order, ends, wanted, 20_000, no_point_limit)
    assert covered.stable
    assert np.all(covered.gains[:3] >= exact)
    assert np.all(covered.gains[:3] <= 1.01 * exact)
    assert nearest_instability(first_order, 1, 4.0, no_point_limit).growth == pytest.approx(2.0, rel=1e-4)


def test_fewer_cells_than_the_first_intervals_end_the_search():
    """A limit below the number of first cells was passed without end: they were halved along the angle alone."""
    ends = (-np.ones(1), np.ones(1))
    unattainable = np.full(len(GAINS), 1e-3)
    assert cover_box(first_order, ends, unattainable, 10, no_point_limit).cells == INTERVALS


def test_no_bound_holds_where_a_loop_of_the_box_is_unstable():
    ends = (-2.5 * np.ones(1), 2.5 * np.ones(1))
    covered = cover_box(first_order, ends, np.full(len(GAINS), 1e300), 3000, no_point_limit)
    assert not covered.stable


def test_an_unstable_box_has_a_counterexample():
    study = dj.Study.from_table(TABLE | {"draws": 20}).override({"plant.b.1": {"uniform": [0.7, 20.0]}})
    worst = dj.worst_loop(study, cells=500)
    loop = worst.answer.loops["input"]
    assert loop.stable is False
    assert loop.growth_bounded < loop.growth_found < 1.0
    numbers = loop.unstable
    poles = np.linalg.eigvals(closed_loop(numbers["plant.a.1.1"], numbers["plant.b.1"])[0])
    assert np.abs(poles).max() > 1.0 - 1e-6
    assert "unstable" in worst.headline


def test_an_island_of_unstable_loops_between_the_tested_growths_is_found():
    """About q = 1.135 the damping is negative; the goals of the bounds were divided by its margin, 0."""
    middle = 1.5 + 0.5 * start_points(1)[3, 0]  # of a point at which the search for the worst margins begins
    peak = f"=-1 + 20*0.0001/(0.0001 + (q - {middle:.9g})**2)"
    plant = TABLE["plant"] | {"a": [[0.0, 1.0], [0.0, peak]], "b": [0.0, 1.0]}
    study = dj.Study.from_table(TABLE | {"draws": 4, "plant": plant, "parameters": {"q": {"uniform": [1.0, 2.0]}}})
    loop = dj.worst_loop(study, cells=500).answer.loops["input"]
    assert loop.stable is False
    assert loop.unstable["parameters.q"] == pytest.approx(middle)
    assert loop.margins["disk"].found == 0.0


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({"plant.b.1": 1.0, "plant.a.1.1": -1.0}, {}, "no uncertain number"),
        ({}, {"broken_at": ("inputs",)}, "no break point 'inputs'"),
        ({}, {"broken_at": ("measured_speed",)}, "a measured signal is no break point: 'input' has the margins"),
        ({}, {"cells": 0}, "cells"),
        ({}, {"points": 0}, "points"),
        ({}, {"sigma": 0.0}, "sigma"),
        ({"sensor": {"kind": "noisy", "jitter": 0.01}}, {}, "differs between draws with the same numbers"),
    ],
)
def test_refusals(change, options, message):
    study = dj.Study.from_table(TABLE | {"draws": 4}).override(change)
    with pytest.raises(dj.ConfigError, match=message):
        dj.worst_loop(study, **options)


def test_the_box_grows_no_farther_than_its_numbers_are_defined():
    """The root of (q - 3)^2 - 0.24 has a gap from 2.51 to 3.49, which the ends of the fourfold box do not show."""
    plant = TABLE["plant"] | {"a": [[0.0, 1.0], [0.0, "=-1 - 0.1*sqrt((q - 3)**2 - 0.24)"]], "b": [0.0, 1.0]}
    study = dj.Study.from_table(TABLE | {"plant": plant, "parameters": {"q": {"uniform": [1.0, 2.0]}}})
    loop = dj.worst_loop(study, cells=500).answer.loops["input"]
    assert loop.growable == 2.0
    assert loop.growth_found == np.inf
    assert loop.stable


def test_a_witness_lies_as_far_out_as_its_numbers_are_defined():
    """2 % beyond the unstable loop the power is that of a negative number."""
    plant = TABLE["plant"] | {"a": [[0.0, 1.0], [0.0, "=40 - 60*(2.5001 - q)**0.1"]], "b": [0.0, 1.0]}
    study = dj.Study.from_table(TABLE | {"plant": plant, "parameters": {"q": {"uniform": [1.0, 2.0]}}})
    found = dj.worst_loop(study, cells=500)
    assert found.answer.loops["input"].growth_found == pytest.approx(2.0, rel=0.01)
    witness = found.unstable_witness("input")
    assert witness is not None
    assert found.unstable("input")["parameters.q"] <= witness.numbers["parameters.q"].value < 2.5001


def test_laws_without_ends_are_cut(worst):
    study = dj.Study.from_table(TABLE | {"draws": 4}).override({"plant.b.1": {"normal": [1.0, 0.05]}})
    side = dj.worst_loop(study, sigma=2.0, cells=100).answer.box["plant.b.1"]
    assert side.cut
    assert side.low == pytest.approx(0.9)
    assert side.high == pytest.approx(1.1)
    assert not worst.answer.box["plant.b.1"].cut


@pytest.mark.parametrize(
    ("law", "reference"),
    [
        ({"uniform": [0.7, 1.3]}, stats.uniform(0.7, 0.6)),
        ({"loguniform": [1e-200, 1e200]}, stats.uniform(1e-200, 1e200)),
        ({"normal": [1.0, 0.05]}, stats.norm(1.0, 0.05)),
        ({"truncated_normal": [1.0, 0.1, 0.9, 1.3]}, stats.truncnorm(-1.0, 3.0, 1.0, 0.1)),
        ({"lognormal": [-7.0, 0.3]}, stats.lognorm(0.3, scale=np.exp(-7.0))),
        ({"beta": [2.0, 3.0]}, stats.beta(2.0, 3.0)),
        ({"beta": [2.0, 3.0, 0.5, 1.5]}, stats.beta(2.0, 3.0, 0.5, 1.0)),
        ({"triangular": [0.5, 1.0, 2.0]}, stats.triang(1.0 / 3.0, 0.5, 1.5)),
        ({"choice": [1.0, 3.0, 2.0]}, stats.uniform(1.0, 2.0)),
    ],
)
def test_a_side_ends_where_its_law_does_or_at_both_cuts(law, reference):
    study = dj.Study.from_table(TABLE | {"draws": 4}).override({"plant.b.1": law, "plant.a.1.1": -1.0})
    (side,) = box_of(study, 2.5).sides
    endless = {"normal", "lognormal"} & law.keys()
    tail = stats.norm.cdf(-2.5) if endless else 0.0
    assert side.cut == bool(endless)
    assert (side.low, side.high) == pytest.approx((reference.ppf(tail), reference.ppf(1.0 - tail)), rel=1e-9)
    assert side.at(np.array([-1.0, 1.0])) == pytest.approx([side.low, side.high], rel=1e-9)


@pytest.mark.parametrize("sigma", [10.0, 40.0])
def test_a_cut_far_out_has_no_end_lost_to_rounding(sigma):
    study = dj.Study.from_table(TABLE | {"draws": 4}).override({"plant.b.1": {"lognormal": [0.0, 0.3]}})
    side = box_of(study, sigma).sides[1]
    assert (np.log(side.low), np.log(side.high)) == pytest.approx((-0.3 * sigma, 0.3 * sigma))
    with pytest.raises(dj.ConfigError, match=r"sigma: cuts plant\.b\.1 at \[0, inf\]; take fewer"):
        box_of(study, 1e4)


@pytest.mark.filterwarnings("error")
def test_a_lognormal_number_has_both_ends_and_a_value_in_its_witness():
    """The loop is stable on all of the box by NumPy, and its largest sensitivity is that of a dense search."""
    law = {"lognormal": [0.0, 0.1]}
    worst = dj.worst_loop(dj.Study.from_table(TABLE | {"draws": 4}).override({"plant.b.1": law}), cells=1000)
    loop = worst.answer.loops["input"]
    rng = np.random.default_rng(3)
    low, high = np.exp([-0.3, 0.3])
    points = [*((a, b) for a in (-1.4, -0.6) for b in (low, high))]
    points += list(zip(rng.uniform(-1.4, -0.6, 200), rng.uniform(low, high, 200), strict=True))
    assert max(np.abs(np.linalg.eigvals(closed_loop(a, b)[0])).max() for a, b in points) < 1.0
    assert loop.stable
    angles = np.geomspace(1e-2, np.pi, 500)

    def peak(a, b):
        matrix, column, row = closed_loop(a, b)
        g = np.linalg.solve(np.exp(1j * angles)[:, None, None] * np.eye(2) - matrix, column[:, None])[..., 0] @ row
        return np.abs(1.0 + g).max()

    found = loop.margins["sensitivity_peak"]
    assert found.found == pytest.approx(max(peak(a, b) for a, b in points), rel=1e-3)
    witness = worst.witness("input", "sensitivity_peak").table["plant"]
    assert peak(witness["a"][1][1], witness["b"][1]) == pytest.approx(found.found, rel=1e-3)


def test_a_stable_box_without_a_bound_says_so(worst):
    """Stability may be proved where the bounds of the gains stay infinite."""
    unbounded = replace(worst, dataset=worst.dataset.assign(bounded=np.nan * worst.dataset["bounded"]))
    assert "with a disk margin of at least" in worst.headline
    assert "with no bound of its margins" in unbounded.headline
    assert "nan" not in unbounded.headline


def test_correlated_numbers_have_the_box_of_independent_ones():
    """A correlation of two laws is no rule for numbers in their place: it refused every point of the box."""
    pair = {"plant.a.1.1, plant.b.1": 0.5}
    numbers = dj.Study.from_table(TABLE).laws
    assert set(numbers) == {"plant.a.1.1", "plant.b.1"}
    tied = dj.worst_loop(dj.Study.from_table(TABLE | {"correlation": pair}), cells=50)
    free = dj.worst_loop(dj.Study.from_table(TABLE), cells=50)
    found = tied.numbers("input", "gain_upper")
    assert found == pytest.approx(free.numbers("input", "gain_upper"))
    assert not tied.witness("input", "gain_upper").laws


def delayed_radius(samples):
    """Spectral radius of y'' = -y' + v, u = -3 y - 2 y', for v between the commands of two samples; T_s = 0.2 s."""
    whole = int(np.floor(samples))
    held = expm(np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 0.0]]) * 0.2)
    size = 3 + whole  # y, y', and the last whole + 1 commands, newest first
    commands = np.zeros((whole + 2, size))  # the present command, and those before it
    commands[0, :2] = -3.0, -2.0
    commands[1:, 2:] = np.eye(whole + 1)
    weight = samples - whole
    delayed = (1.0 - weight) * commands[whole] + weight * commands[whole + 1]
    step = np.concatenate([np.zeros((2, size)), commands[:-1]])
    step[:2, :2] = held[:2, :2]
    step[:2] += np.outer(held[:2, 2], delayed)
    return np.abs(np.linalg.eigvals(step)).max()


def test_states_that_no_draw_needs_count_where_the_box_needs_them():
    """The only draw is delayed by less than 2 samples, the box by 2.4: the command three samples ago matters there."""
    study = dj.Study.from_table(
        {
            "name": "late",
            "draws": 1,
            "seed": 4,
            "loop": {"duration": 8.0, "sample_time": 0.2},
            "plant": {"kind": "normal_form", "k_p": 1.0, "a_p": 1.0, "initial": [1.0, 0.0]},
            "controller": {"kind": "state_feedback", "k_1": 3.0, "k_2": 2.0},
            "unmodelled": {"kind": "delay", "samples": {"uniform": [0.5, 2.4]}, "memory": 6},
        }
    )
    loop = dj.worst_loop(study, cells=1000).answer.loops["input"]
    at_end = dj.loop_margins(study.override({"unmodelled.samples": 2.4})).dataset["sensitivity_peak"].values.max()
    assert loop.margins["sensitivity_peak"].found >= at_end * (1.0 - 1e-6)
    assert not loop.margins["sensitivity_peak"].bounded < at_end
    unstable = loop.unstable["unmodelled.samples"]
    assert delayed_radius(unstable) == pytest.approx(1.0, abs=1e-4)
    assert delayed_radius(unstable - 0.05) < 1.0 < delayed_radius(unstable + 0.05)
    assert loop.growth_bounded < loop.growth_found == pytest.approx((unstable - 1.45) / 0.95)
