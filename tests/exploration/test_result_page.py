"""The page of a result, clicked by program."""

import copy

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.exploration.page import MEDIAN_DRAW, RANDOM_DRAW, WORST_DRAW
from dssc_jax.exploration.result_page import ResultPage
from dssc_jax.exploration.wrong_laws import ALL_MEANS, ALL_WIDTHS
from dssc_jax.results.stated_errors import StatedAmounts
from tests.conftest import UNCERTAIN


@pytest.fixture(scope="module")
def page():
    return ResultPage(dj.run(dj.Study.from_table(copy.deepcopy(UNCERTAIN))))


def test_a_click_shows_the_stored_draw_again(page):
    """The flight is that of ``simulate`` at the row's point, and agrees with what is stored."""
    row = 77
    page.brushing.clicked_row.data = {"row": [row]}
    draw, point = int(page.table.draw[row]), page.table.point(row)
    assert page.flight.attrs["draw"] == draw
    assert page.flight.attrs["agreement"] == "agrees"
    alone = dj.simulate(page.result.study, draw=draw, point=point)
    np.testing.assert_allclose(page.flight["y"].values, alone["y"].values, rtol=1e-9)
    np.testing.assert_array_equal(page.sources["y"].data["value"][0], page.flight["y"].values)
    assert page.flight.attrs["error_max"] == pytest.approx(page.table.columns["error_max"][row], rel=1e-6)


def test_worst_median_and_random_draws(page):
    slack = page.result.dataset[page.result.study.requirements[0].name].values.reshape(-1)
    assert page.row_of(WORST_DRAW) == np.argmin(slack)
    assert slack[page.row_of(MEDIAN_DRAW)] == np.sort(slack)[len(slack) // 2]
    assert len({page.row_of(RANDOM_DRAW) for _ in range(20)}) > 5


def test_pinned_draws_stay(page):
    page.unpin()
    for row in (0, 30, 60):
        page.replay(row)
        page.pin_draw()
    page.replay(90)
    assert [*page.sources["e"].data["draw"]] == [page.table.draw[row] for row in (90, 0, 30, 60)]
    assert len(set(page.sources["e"].data["colour"])) == 4
    page.unpin()
    assert [*page.sources["e"].data["draw"]] == [page.table.draw[90]]


def test_a_result_from_others_is_brushed_but_not_run(tmp_path, monkeypatch):
    """A study that names code of its own is not imported: its draws are counted, and a click says what is needed."""
    code = "from dssc_jax.models.sensors import SENSORS\nSENSOR = SENSORS['ideal'].members[None]\n"
    (tmp_path / "explored_code.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    table = {**copy.deepcopy(UNCERTAIN), "sensor": {"kind": "explored_code:SENSOR"}}
    dj.run(dj.Study.from_table(table), out=tmp_path / "result")
    page = ResultPage(dj.load(tmp_path / "result"))
    assert page.brushing.statement().startswith("all 144 draws")
    page.replay(0)
    assert "trust the code" in page.status.object
    assert page.flight is None


def test_a_vehicle_s_path_is_seen_from_above_and_from_the_side():
    short = {"draws": 2, "loop.duration": 1.0, "requirement": [], "metrics": {}}
    flown = dj.run(dj.Study.load("paper_case1").override(short))
    page = ResultPage(flown)
    page.replay(1)
    page.pin_draw()
    page.replay(0)
    assert len(page.paths) == 2
    view = page.sources["xy"].data
    assert len(view["across"]) == len(view["colour"]) == 2
    np.testing.assert_array_equal(view["upward"][0], page.flight["y_y"].values)
    np.testing.assert_array_equal(page.sources["desired xz"].data["upward"][0], page.flight["z_y_ref"].values)
    assert page.flight_view is not None
    ghosts = page.flight_view.tracks.data["z"]
    np.testing.assert_array_equal(ghosts[0], page.flight["z_y"].values.astype(np.float32))
    np.testing.assert_array_equal(ghosts[1], page.pinned[0]["z_y"].values.astype(np.float32))
    assert page.flight_view.title.text == "2 flights; draw 0 passes"
    assert page.flight_view.figure in page.view[-1].object.children


def test_explore_a_result(page):
    assert dj.explore(page.result).view.objects
    with pytest.raises(dj.ConfigError, match="a result has its own"):
        dj.explore(page.result, draws=5)


def test_laws_may_be_wrong():
    """Shift and widening by the weights, as `run` tells them; a result of a sweep has no such slider."""
    study = dj.Study.from_table(copy.deepcopy(UNCERTAIN)).without_sweep()
    page = ResultPage(dj.run(study, check=False))
    page.wrong_laws.kind.value = ALL_MEANS
    page.wrong_laws.size.value = 0.2
    (stated,) = page.result.stated_errors(StatedAmounts({}, 0.2, None))
    assert page.wrong_laws.answer.object.count("[") == 1 + (stated.weighted_interval is not None)
    assert "mean shift up to 0.2" in page.wrong_laws.answer.object
    page.wrong_laws.kind.value = ALL_WIDTHS
    assert "widening up to 1.2" in page.wrong_laws.answer.object
    page.wrong_laws.limit.value = 0.9
    page.show_how_wrong()
    assert f"Kullback-Leibler {dj.laws(page.result, limit=0.9).answer.kl:.3g}" in page.wrong_laws.answer.object
    page.wrong_laws.limit.value = None
    page.show_how_wrong()
    assert "limit: must lie in (0, 1)" in page.wrong_laws.answer.object
