"""The page of a study, moved by program as a notebook does."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.exploration.actions import Superseded, proof, stop_when_stale
from dssc_jax.exploration.live import LiveStudy
from dssc_jax.exploration.study_page import StudyPage
from dssc_jax.statistics import rounded_probability


@pytest.fixture
def page(live, tmp_path):
    return StudyPage(live, folder=tmp_path)


def test_a_move_shows_its_run(page):
    start = page.now
    page.move({"unmodelled.mu": 0.2})
    assert page.now.probability > start.probability
    assert f"{int(page.now.failed.sum())} failures in 120 draws" in page.headline.object
    fan = page.fans[0]
    np.testing.assert_array_equal(fan.current.data["q50"], page.now.fan("y").values[2])
    np.testing.assert_array_equal(fan.previous.data["q50"], start.fan("y").values[2])
    np.testing.assert_array_equal(fan.draw.data["value"], page.now.signal("y")[page.now.order[0]])
    assert page.probability.source.data["p"] == [page.now.probability, start.probability]


def test_draws_are_chosen(page):
    page.draw_choice.value = "median draw"
    assert page.draw == page.now.order[60]
    place = 3
    expected = page.draws.failed.data["draw"][place]
    page.draws.failed.selected.indices = [place]
    assert page.draw == expected
    assert f"draw {expected}, which fails" in page.status.object


def test_what_is_saved_reproduces_what_is_shown(page, tmp_path):
    page.move({"unmodelled.mu": 0.05, "plant.k_p (width)": 0.7})
    page.save_as("saved.toml")
    assert "gives the same outcome in every draw" in page.status.object
    result = dj.run(dj.Study.load(tmp_path / "saved.toml"))
    np.testing.assert_array_equal(result.dataset["outcome"].values, page.now.results["outcome"])


@pytest.mark.parametrize("name", ["../other.toml", "/etc/x.toml", "x", "", ".toml", "a b.toml", "x.toml\n"])
def test_only_files_of_the_folder_are_written(page, name, tmp_path):
    page.save_as(name)
    assert 'role="alert"' in page.status.object
    assert not list(tmp_path.iterdir())


def test_nothing_is_overwritten(page, tmp_path):
    (tmp_path / "mine.toml").write_text("mine")
    page.save_as("mine.toml")
    assert "exists" in page.status.object
    assert (tmp_path / "mine.toml").read_text() == "mine"


def test_an_inadmissible_position_is_explained(page):
    shown = page.now
    page.move({"plant.k_p (width)": 10.0})
    assert page.now is shown
    assert "high-frequency gain k_p" in page.status.object
    assert "must be &gt; 0" in page.status.object
    with pytest.raises(dj.ConfigError, match="none of the sliders"):
        page.move({"nothing": 1.0})


def test_a_margin_on_request(page):
    """That of ``margin`` on the same draws; a move clears it."""
    slider = next(slider for slider in page.sliders if slider.key == "unmodelled.mu")
    page.ask_margin(slider)
    bounds = (page.positions[slider], slider.high)
    alone = dj.margin(page.now.study, over="unmodelled.mu", bounds=bounds, log=slider.log)
    assert alone.headline in page.answer.object
    assert "downwards" in page.answer.object
    page.move({"unmodelled.mu": 0.04})
    assert page.answer.object == ""


def test_a_proof_on_request():
    """Of a loop that a proof covers, and the reason for one that it does not."""
    pytest.importorskip("clarabel")
    covered = dj.Study.load("certified_margin").override({"unmodelled.mu": 0.003, "plant.k_p": 1.0, "plant.a_p": 0.0})
    page = dj.explore(covered, draws=4)
    page.ask(proof, "searching")
    assert "proved: For every plant with" in page.answer.object


def test_a_question_ends_when_a_move_has_come():
    with pytest.raises(Superseded):
        stop_when_stale(lambda: True)(1, 2)


def test_a_loop_that_no_proof_covers(page):
    page.ask(proof, "searching")
    assert "not proved: " in page.answer.object


def test_a_model_that_raises_does_not_end_the_page(page, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("<b>in the model</b>")

    monkeypatch.setattr(page.live, "run", broken)
    page.move({"controller.rho": 5.0})
    assert "ZeroDivisionError: &lt;b&gt;in the model" in page.status.object


def test_explore_in_a_program(explored):
    page = dj.explore(explored, sliders=["controller.rho", "unmodelled.mu"], draws=20)
    assert list(page.positions.values()) == [6.0, 0.02]
    page.move({"controller.rho": 12.0})
    assert page.now.study.leaves()["controller.rho"] == pytest.approx(12.0, rel=0.06)
    assert page.view.objects


def test_reset_and_compare(page):
    page.move({"unmodelled.mu": 0.1})
    page.compare_with_this()
    assert page.before is page.now
    page.reset.clicks += 1
    assert page.positions == page.live.start


def test_a_vehicle():
    study = dj.Study.load("uav_robustness").override({"loop.duration": 1.0, "requirement": [], "metrics": {}})
    page = StudyPage(LiveStudy(study, draws=4))
    assert [part.name for part in page.fans] == ["x_e", "y_e", "z_e", "psi_e"]
    path = page.paths[1].path.data
    np.testing.assert_array_equal(path["upward"], page.now.signal("z_y")[page.draw])


def test_laws_may_be_wrong(page):
    """The interval grows with the slider, and is that of the library."""
    assert "mean shift up to 0: failure probability in [" in page.wrong_laws.answer.object
    page.wrong_laws.kind.value = "Kullback-Leibler divergence"
    page.wrong_laws.size.value = 0.1
    run = page.now
    (stated,) = dj.run(run.study, check=False, within={"kl": 0.1}).summary()["points"][0]["stated"]
    low, high = map(rounded_probability, stated["interval"])
    assert f"kl up to 0.1: failure probability in [{low}, {high}] whatever draws fail" in page.wrong_laws.answer.object
    page.move({"unmodelled.mu": 0.2})
    assert f"[{low}, {high}]" not in page.wrong_laws.answer.object


def test_arguments_that_are_ranges(explored):
    """Each has a slider; the button answers for all laws within them."""
    ranged = explored.override({"plant.k_p": {"uniform": [[0.6, 0.8], 1.2]}})
    page = StudyPage(LiveStudy(ranged, draws=120))
    slider = next(slider for slider in page.sliders if slider.name == "plant.k_p")
    assert (slider.key, slider.low, slider.high, slider.start) == ("plant.k_p (lo)", 0.6, 0.8, 0.7)
    assert page.now.study.laws["plant.k_p"].arguments == (0.7, 1.2)
    page.move({"plant.k_p (lo)": 0.6})
    assert page.now.study.laws["plant.k_p"].arguments == (0.6, 1.2)
    assert page.now.values["plant.k_p"].min() < 0.62
    page.ask_ranges()
    assert "for every law within the ranges" in page.answer.object
    assert slider not in page.margin_number.options.values()
