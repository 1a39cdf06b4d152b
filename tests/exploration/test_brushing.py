"""The table of draws, the page with linked brushing, and what the interactive report contains."""

import copy
import json
import re

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.exploration.brushing import Brushing
from dssc_jax.exploration.draw_table import DrawTable
from dssc_jax.exploration.interactive_report import interactive_html
from dssc_jax.exploration.parallel import fitting_label
from tests.conftest import UNCERTAIN
from tests.report.conftest import NASTY


@pytest.fixture(scope="module")
def swept():
    """Three by two points of 24 draws, with markup in the description."""
    return dj.run(dj.Study.from_table({**copy.deepcopy(UNCERTAIN), "description": NASTY}))


def test_every_row_is_its_draw(swept):
    table = DrawTable(swept)
    assert table.complete
    assert len(table.rows) == 6 * 24
    for row in (0, 25, 143):
        at, draw = table.point(row), int(table.draw[row])
        stored = swept.dataset.sel({**at, "draw": draw})
        assert table.columns["error_max"][row] == stored["error_max"]
        assert table.columns["plant.k_p"][row] == swept.dataset["plant.k_p"].values[draw]
        assert table.failed[row] == (stored["outcome"] != 0)


def test_a_large_result_is_thinned_and_says_so(swept):
    table = DrawTable(swept, max_rows=50)
    assert len(table.rows) == 48
    assert "48 of 144 draws are shown" in Brushing(table, "folder").statement()
    assert table.columns["error_max"][1] == DrawTable(swept).columns["error_max"][3]


def test_histograms_are_those_of_numpy(swept):
    brushing = Brushing(DrawTable(swept), "folder")
    name = brushing.table.first_axes[1]
    values = brushing.table.columns[name]
    counts, _ = np.histogram(values[np.isfinite(values)], 40)
    np.testing.assert_array_equal(brushing.bars["y"].data["all"], counts)
    assert brushing.bars["y"].data["failed"].sum() == (brushing.table.failed & np.isfinite(values)).sum()


def test_the_map_has_the_summary_s_intervals(swept):
    cells = Brushing(DrawTable(swept), "folder").map.cells.data
    names = list(swept.study.axes)
    points = swept.summary()["points"]
    assert len(points) == len(cells["probability"]) == 6
    for point, p, low, high, *at in zip(
        points, cells["probability"], cells["low"], cells["high"], *(cells[name] for name in names), strict=True
    ):
        assert at == pytest.approx([point[name] for name in names])
        assert p == point["probability"]
        assert [low, high] == pytest.approx(point["interval"])
    assert Brushing(DrawTable(dj.run(swept.study.without_sweep())), "folder").map is None


def test_the_map_ascends_in_whichever_order_the_study_lists_the_values(swept):
    orders = {"controller.functions.tau_av": [2, 0, 1], "controller.l0": [1, 0]}
    axes = {name: [swept.study.axes[name][i] for i in order] for name, order in orders.items()}
    listed = dj.Result(swept.study.override({"sweep": axes}), swept.dataset.isel(orders))
    cells = Brushing(DrawTable(listed), "folder").map.cells.data
    for name, column in Brushing(DrawTable(swept), "folder").map.cells.data.items():
        assert np.array_equal(cells[name], column)


def test_the_statement_is_the_summary_s(swept):
    run = dj.run(swept.study.without_sweep())
    point = run.summary()["points"][0]
    said = Brushing(DrawTable(run), "folder").statement()
    assert f"{point['failures']} fail" in said
    assert f"[{point['interval'][0]:.3g}, {point['interval'][1]:.3g}]" in said


def test_the_file_is_self_contained_and_markup_is_text(swept):
    text = interactive_html(swept)
    assert "<script>alert" not in text
    tags = re.sub(r"(<script[^>]*>).*?</script>", r"\1", text, flags=re.DOTALL)  # a library's code may write tags
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=", tags)
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert "default-src 'none'" in policy[1]
    assert json.dumps("error_max")[1:-1] in text


def test_an_analysis_has_no_draws_to_brush(explored):
    margins = dj.margin(explored, over="unmodelled.mu", bounds=(0.01, 0.5))
    with pytest.raises(dj.ConfigError, match="not those of 'margin'"):
        interactive_html(margins)


def test_labels_under_axes_keep_the_name_of_an_index():
    assert fitting_label("plant.vehicle.body_inertia.0 [kg m^2]") == "body_inertia.0\n[kg m^2]"
    assert fitting_label("position_error_max_after_5 [m]") == "position_error_\nmax_after_5\n[m]"
    assert fitting_label("x") == "x"
