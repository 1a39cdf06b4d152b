"""What a summary says of several requirements: each by itself, over all draws, beside the joint failure."""

import dataclasses
import json
import tracemalloc
from itertools import combinations

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.closed_loop.metrics.requirements import violated
from dssc_jax.console.draws import show_draw
from dssc_jax.console.results import show_result
from dssc_jax.core.signals import Outcome
from dssc_jax.plotting.thinning import PIXEL_COLUMNS
from dssc_jax.report import html
from dssc_jax.results import summary
from dssc_jax.results.schema import empty_dataset
from dssc_jax.results.summary import BATCH_POINTS, most_violated
from dssc_jax.statistics import FixedCount, IntervalsAfterStop, Look, clopper_pearson, compare_failures

STUDY = {
    "name": "several",
    "seed": 5,
    "draws": 64,
    "loop": {"duration": 2.0, "sample_time": 0.01},
    "plant": {
        "kind": "normal_form",
        "k_p": {"uniform": [0.5, 1.5]},
        "a_p": {"choice": [0.2, 0.6, 1.0, 1.4, -400.0]},  # the last diverges in a few samples
        "initial": [1.0, 0.0],
    },
    "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 0.5},
    "requirement": [
        {"metric": "error_max", "after": 1.0, "max": 0.62},
        {"metric": "error_rms", "max": 0.75},
        {"metric": "command_tv", "max": 1.1},
        {"metric": "command_max", "min": 0.7},
    ],
    "sweep": {"controller.k_p": [0.5, 1.0, 2.0], "controller.k_i": [0.2, 0.5]},
}
TIMED = {"times": {"seconds": 1.0, "compile_seconds": 0.5, "rate": 1e6}}
LABELS = ["error_max_after_1", "error_rms", "command_tv", "command_max_min"]


@pytest.fixture(scope="module")
def swept():
    return dj.run(dj.Study.from_table(STUDY))


@pytest.fixture(scope="module")
def replicated():
    return dj.run(dj.Study.from_table({**STUDY, "sampling": "sobol"}))


def by_hand(result, index):
    """Which draws of a point ended early, and which violate each requirement, by NumPy from the dataset."""
    early = np.isfinite(result.dataset["failed_at"].values[index])
    slacks = [result.dataset[f"slack_{label}"].values[index] for label in LABELS]
    return early, [early | ~(slack >= 0.0) for slack in slacks]


def test_every_requirement_counts_all_of_its_draws(swept):
    points = swept.summary()["points"]
    assert len(points) == 6
    hidden = 0
    for index, point in zip(np.ndindex(3, 2), points, strict=True):
        axes = swept.study.axes.values()
        assert [point[name] for name in swept.study.axes] == [axis[i] for axis, i in zip(axes, index, strict=True)]
        early, broken = by_hand(swept, index)
        assert [requirement["name"] for requirement in point["requirements"]] == LABELS
        for requirement, here in zip(point["requirements"], broken, strict=True):
            failures = np.count_nonzero(here)
            assert requirement["failures"] == failures
            assert requirement["probability"] == failures / 64
            assert requirement["interval"] == clopper_pearson(failures, 64).tolist()
            hidden += failures - early.sum() - point["outcomes"][f"first_violated_{requirement['name']}"]
        assert point["failures"] == np.count_nonzero(np.any(broken, axis=0))
        assert point["ended_early"] == early.sum() > 0
    assert hidden > 0  # what the outcome codes, which name the first only, do not tell


def test_alone_and_overlaps_tell_how_violations_combine(swept):
    for index, point in zip(np.ndindex(3, 2), swept.summary()["points"], strict=True):
        early, broken = by_hand(swept, index)
        ran = [here & ~early for here in broken]
        together = np.sum(ran, axis=0)
        alone = [requirement["alone"] for requirement in point["requirements"]]
        assert alone == [np.count_nonzero(here & (together == 1)) for here in ran]
        pairs = {tuple(pair["names"]): pair["draws"] for pair in point["overlaps"]}
        wanted = {(LABELS[a], LABELS[b]): np.count_nonzero(ran[a] & ran[b]) for a, b in combinations(range(4), 2)}
        assert pairs == {names: draws for names, draws in wanted.items() if draws}
    assert any(point["overlaps"] for point in swept.summary()["points"])


def test_two_requirements_part_the_failures(swept):
    """Ended early, the first alone, the second alone, both: nothing is counted twice and nothing is missing."""
    for point in dj.run(swept.study.override({"requirement": STUDY["requirement"][:2]})).summary()["points"]:
        both = sum(pair["draws"] for pair in point["overlaps"])
        first, second = point["requirements"]
        assert point["failures"] == point["ended_early"] + first["alone"] + second["alone"] + both
        assert first["failures"] == point["ended_early"] + first["alone"] + both
        assert second["failures"] == point["ended_early"] + second["alone"] + both


def test_a_draw_that_ended_early_violates_every_requirement(swept):
    diverged = swept.dataset["outcome"].values == Outcome.NON_FINITE
    assert np.all(diverged[..., swept.dataset["plant.a_p"].values == -400.0])
    for label in LABELS:
        assert np.all(violated(swept.dataset[f"slack_{label}"].values[diverged]))


def test_a_margin_that_is_no_number_is_a_violation(swept):
    data = swept.dataset.copy(deep=True)
    data["slack_command_tv"][:] = np.nan
    for point in dj.Result(swept.study, data).summary()["points"]:
        assert point["requirements"][2]["failures"] == 64


def test_the_interval_is_that_of_the_draws(swept, replicated):
    """A requirement's interval is made as that of the joint failure is, at every point."""
    look = {"draws": swept.study.config.draws, "lower": -1, "upper": 1000}
    stopped = dj.Result(swept.study, swept.dataset, {"stopping": {"looks": [look | {"failures": 0}], "stops": 3}})
    assert stopped.method == IntervalsAfterStop((Look(**look),), 3)
    for result in (stopped, replicated):
        for index, point in zip(np.ndindex(3, 2), result.summary(0.9)["points"], strict=True):
            for requirement, here in zip(point["requirements"], by_hand(result, index)[1], strict=True):
                assert requirement["interval"] == pytest.approx(result.method.interval(here, 0.9).tolist(), abs=1e-15)
    exact = swept.summary(0.9)["points"][0]["requirements"][0]["interval"]
    assert stopped.summary(0.9)["points"][0]["requirements"][0]["interval"] != exact


def test_what_was_saved_gets_its_counts_from_its_margins(swept, tmp_path):
    folder = swept.save(tmp_path / "saved")
    (folder / "summary.json").write_text("{}")
    assert dj.load(folder).summary()["points"] == swept.summary()["points"]


def test_without_requirements_early_ends_are_the_failures(swept):
    bare = dj.run(swept.study.override({"requirement": []}))
    for point in bare.summary()["points"]:
        assert (point["requirements"], point["overlaps"]) == ([], [])
        assert point["failures"] == point["ended_early"] > 0
        assert most_violated(point) == "-"


def test_the_most_violated_requirement(swept):
    point = swept.summary()["points"][0]
    counts = [requirement["failures"] for requirement in point["requirements"]]
    assert most_violated(point) == f"{LABELS[int(np.argmax(counts))]} ({max(counts)})"
    met = [requirement | {"failures": 0} for requirement in point["requirements"]]
    assert most_violated({"requirements": met}) == "-"


def test_the_terminal_shows_each_requirement(swept, capsys):
    run = dj.run(swept.study.without_sweep())
    (point,) = run.summary()["points"]
    show_result(run)
    shown = [line.split() for line in capsys.readouterr().out.splitlines()]
    for each in point["requirements"]:
        low, high = each["interval"]
        count = [f"{each['failures']}/64", f"{each['probability']:.4g}", f"[{low:.3g},", f"{high:.3g}]"]
        timing = [str(each["first"]), f"{each['violated_at']:.4g}"]
        assert [*each["text"].split(), *count, str(each["alone"]), *timing] in shown
    for pair in point["overlaps"]:
        low, high = pair["interval"]
        count = [f"{pair['failures']}/64", f"{pair['probability']:.4g}", f"[{low:.3g},", f"{high:.3g}]"]
        assert [pair["names"][0], "and", pair["names"][1], *count, str(pair["draws"])] in shown
    early = f"ended early, and so violated every requirement: {point['ended_early']} non finite"
    assert early.split() in shown


def test_a_sweep_tells_what_fails_most(swept, capsys):
    show_result(swept)
    shown, page = capsys.readouterr().out, html(swept, worst=0)
    told = {most_violated(point) for point in swept.summary()["points"]}
    assert len(told) > 1
    for text in told:
        assert text in shown
        assert text in page


def test_the_report_shows_each_requirement_and_what_overlaps(swept):
    page = html(swept, worst=0)
    at = swept.failed.mean("draw").values.reshape(-1)
    point = swept.summary()["points"][int(np.argmin(np.abs(at - 0.5)))]
    for each in point["requirements"]:
        text = each["text"].replace("<", "&lt;").replace(">", "&gt;")
        low, high = each["interval"]
        cells = [f"violates {text}</th>", f"{each['failures']}</td>", f"{each['probability']:.4g}</td>"]
        cells += [f"{low:.3g} to {high:.3g}</td>", f"{each['alone']}</td>"]
        places = [page.index(cells[0])]
        for cell in cells[1:]:
            places.append(page.index(cell, places[-1]))
        assert places[-1] < page.index("</tr>", places[0])
    assert page.count("Requirements that the same draws violate") > 0
    assert f"for all of them ({point['ended_early']} draws here)" in page


def test_a_draw_names_every_requirement_that_it_violates(swept, capsys):
    """Where the outcome code, and the meaning that goes with it, name the first only."""
    study = swept.study.override({"controller.k_p": 1.0, "controller.k_i": 0.5}).without_sweep()
    broken = np.array([~(dj.run(study).dataset[f"slack_{label}"].values >= 0.0) for label in LABELS])
    draw = int(np.flatnonzero(broken[0] & broken[1] & ~broken[3])[0])
    run = dj.simulate(study, draw)
    wanted = "violates error_max after 1 s <= 0.62 m and error_rms <= 0.75 m"
    assert run.attrs["verdict"].startswith(wanted)
    assert run.attrs["outcome_meaning"] == "first_violated_error_max_after_1"
    assert run.attrs["verdict"] in " ".join(dj.plot.trajectory(run).get_suptitle().split())
    show_draw(run.attrs, {}, [])
    assert f"draw {draw}: {wanted}" in capsys.readouterr().out
    diverged = int(np.flatnonzero(np.all(broken, axis=0))[0])
    assert dj.simulate(study, diverged).attrs["verdict"] == "does not stay finite"


def test_a_short_sweep_is_compared_draw_by_draw(capsys):
    """With the first value, as `compare` does; not for a design of draws, nor for many values."""
    study = dj.Study.from_table(STUDY).override({"sweep": {"controller.k_p": [0.5, 0.6, 2.0]}, "draws": 60})
    result = dj.run(study)
    show_result(result)
    printed = " ".join(capsys.readouterr().out.split())
    failed = result.failed.values
    for i in (1, 2):
        pair = compare_failures(failed[i], failed[0])
        assert f"{pair.only_a} {pair.only_b} {pair.difference:+.3g} in [" in printed
    assert "against 0.5, same draws" in printed
    for changes in ({"sampling": "sobol", "draws": 64}, {"sweep.controller.k_p": {"linspace": [0.5, 2.0, 7]}}):
        show_result(dj.run(study.override(changes)))
        assert "same draws" not in capsys.readouterr().out


def many(points, draws=1):
    """A finished sweep of so many points, without having been simulated: every third draw fails."""
    axis = {"controller.k_p": {"linspace": [0.5, 2.0, points]}}
    changes = {"sweep": axis, "draws": draws, "metrics.names": ["error_rms"], "requirement": STUDY["requirement"][:1]}
    study = dj.Study.from_table(STUDY).override(changes)
    data = empty_dataset(study)
    failed = np.arange(points * draws).reshape(points, draws) % 3 == 0
    data["outcome"].values[...] = np.where(failed, Outcome.REQUIREMENT, Outcome.OK)
    data["slack_error_max_after_1"].values[...] = np.where(failed, -0.1, 0.1)
    for measure in study.measures:
        data[measure.name].values[...] = np.linspace(0.0, 1.0, points)[:, None]
    return dj.Result(study, data)


def test_cost_goes_by_lanes_and_not_by_points(monkeypatch):
    """Intervals of thousands of points are one call."""
    asked = []
    of_shape = FixedCount.interval
    monkeypatch.setattr(
        FixedCount, "interval", lambda self, failed, c: asked.append(failed.shape) or of_shape(self, failed, c)
    )
    points = many(20_000).summary()["points"]
    assert len(points) == 20_000
    assert [point["failures"] for point in points[:4]] == [1, 0, 0, 1]
    assert sum(shape[0] for shape in asked) == 2 * 20_000  # of all failures, and of the requirement's
    assert len(asked) <= 2 * (20_000 // BATCH_POINTS + 1)
    asked.clear()
    many(4, draws=2**19).summary()
    assert [shape[0] for shape in asked] == [2, 2, 2, 2]  # and a point of many draws does not fill the memory


def peak(result):
    """Bytes that the lines of a summary take at once."""
    tracemalloc.start()
    try:
        for _ in result.lines():
            pass
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_few_points_are_in_memory_at_once(monkeypatch):
    monkeypatch.setattr(summary, "BATCH_POINTS", 256)
    assert peak(many(2048)) < 1.5 * peak(many(256))


def test_the_file_is_the_summary_with_a_point_a_line(swept, tmp_path):
    text = (swept.save(tmp_path / "saved") / "summary.json").read_text()
    kept = json.loads(text)
    assert kept == json.loads(json.dumps(swept.summary()))
    starts = [line for line in text.splitlines() if line.startswith('{"controller.k_p": ')]
    assert len(starts) == len(kept["points"]) == 6


def test_figures_and_tables_of_many_points_are_no_larger(capsys):
    result = many(20_000)
    inside = np.arange(20_000) // 1000 % 2 == 0
    result.dataset = result.dataset.assign_coords(certified=("controller.k_p", inside))
    figure = dj.plot.sweep(result)
    for ax in figure.axes:
        assert max(len(line.get_xdata()) for line in ax.lines) <= 2 * PIXEL_COLUMNS
        assert all(line.get_marker() in ("", "None") for line in ax.lines)
        assert sum(len(path.vertices) for band in ax.collections for path in band.get_paths()) < 6 * PIXEL_COLUMNS
        assert len(ax.patches) == 10  # certified stretches
    show_result(dj.Result(result.study, result.dataset, TIMED))
    told = capsys.readouterr().out
    assert "... and 19960 more points in summary.json" in told
    assert len(told.splitlines()) < 60


def test_a_large_map_is_shown_in_steps(capsys):
    axes = {"controller.k_p": {"linspace": [0.5, 2.0, 100]}, "controller.k_i": {"linspace": [0.1, 1.0, 60]}}
    study = dj.Study.from_table(STUDY).override({"sweep": axes, "draws": 1})
    data = empty_dataset(study)
    data["outcome"].values[...] = Outcome.OK
    show_result(dj.Result(study, data, TIMED))
    told = capsys.readouterr().out
    assert "each step is 3 of 100 values of controller.k_p, and 3 of 60 of controller.k_i" in " ".join(told.split())
    assert len(told.splitlines()) < 60


def test_a_draw_without_a_robustness_counts_as_infinitely_bad():
    """Of a robustness, and of any metric that only falls, the worst value is -inf, not inf."""
    formula = {"name": "near", "formula": "always[1,1.9] abs(e) < 0.62"}
    result = dj.run(dj.Study.from_table({**STUDY, "requirement": [formula], "sweep": {}}))
    (point,) = result.summary()["points"]
    values = result.dataset["near"].values
    ended = np.isnan(values)
    assert 0.05 < ended.mean() < 0.5
    ordered = np.sort(np.where(ended, -np.inf, values))
    assert point["metrics"]["near"]["q5"] is None
    assert point["metrics"]["near"]["q50"] == ordered[31]
    assert point["metrics"]["near"]["q95"] == ordered[60]


SURE = {
    "name": "sure",
    "draws": 7,
    "loop": {"duration": 0.5, "sample_time": 0.05},
    "plant": {"kind": "normal_form", "k_p": 1.0, "a_p": 0.5, "initial": [1.0, 0.0]},
    "controller": {"kind": "pid", "k_p": 1.0},
    "requirement": [{"metric": "error_max", "max": 2.0}],
}


def test_equal_draws_may_have_no_value(tmp_path):
    """A metric that no draw has is the same in all of them."""
    result = dj.run(dj.Study.from_table(SURE), tmp_path / "r")
    without = result.dataset.assign(error_max=np.nan * result.dataset["error_max"])
    assert dataclasses.replace(result, dataset=without).has_equal_draws
    one = without["error_max"].copy()
    one[0] = 1.0
    assert not dataclasses.replace(result, dataset=without.assign(error_max=one)).has_equal_draws


@pytest.mark.parametrize(
    ("changes", "equal"),
    [
        ({}, True),
        ({"sweep": {"controller.k_p": [0.5, 1.0]}}, True),
        ({"plant.k_p": {"uniform": [0.9, 1.1]}}, False),
        ({"sensor": {"kind": "noisy", "position_std": 0.01}}, False),
        ({"draws": 1}, False),
    ],
)
def test_equal_draws_have_no_interval(changes, equal, tmp_path, capsys):
    """One draw of a deterministic study says as much as seven; noise alone makes them differ."""
    result = dj.run(dj.Study.from_table(SURE).override(changes), tmp_path / "r")
    assert result.has_equal_draws == equal
    assert json.loads((tmp_path / "r" / "summary.json").read_text())["equal_draws"] == equal
    show_result(result)
    said = " ".join(capsys.readouterr().out.split())
    assert ("nothing in the study is random, so all 7 draws are the same, and there is no interval" in said) == equal
    assert ("95 %" in said) != equal
