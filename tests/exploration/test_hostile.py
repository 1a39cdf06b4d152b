"""What a page meets outside the laboratory: a busy port, a folder that is being written, a huge result, odd values."""

import copy
import socket

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.exploration.brushing import Brushing
from dssc_jax.exploration.draw_table import MOST_ROWS, DrawTable
from dssc_jax.exploration.interactive_report import interactive_html
from tests.loops import LAGGED


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # the server leaves its socket unclosed
def test_a_busy_port(capsys):
    with socket.socket() as occupant:
        occupant.bind(("127.0.0.1", 0))
        occupant.listen()
        port = str(occupant.getsockname()[1])
        assert guarded(["explore", "motor", "--draws", "4", "--no-browser", "--port", port]) == 2
    assert f"--port: cannot serve at port {port}" in " ".join(capsys.readouterr().err.split())


def test_a_folder_that_is_being_written(explored, tmp_path, capsys):
    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        dj.run(explored.override({"draws": 96}), tmp_path / "begun", block=24, progress=stop)
    for command in (["explore", str(tmp_path / "begun")], ["report", str(tmp_path / "begun"), "--interactive"]):
        assert guarded(command) == 2
        assert "is not complete" in " ".join(capsys.readouterr().err.split())


def test_a_study_that_is_gone_or_wrong(tmp_path, capsys):
    (tmp_path / "wrong.toml").write_text("name = 'wrong'\n")
    for study, said in (("absent.toml", "absent.toml"), ("wrong.toml", "loop: is required and missing")):
        assert guarded(["explore", str(tmp_path / study)]) == 2
        assert said in " ".join(capsys.readouterr().err.split())


@pytest.fixture(scope="module")
def million():
    """A million draws of a short loop."""
    table = {**copy.deepcopy(LAGGED), "name": "many", "seed": 1, "draws": 1_000_000}
    return dj.run(dj.Study.from_table(table).override({"loop.duration": 0.1}))


def test_a_million_draws_are_thinned_evenly(million):
    table = DrawTable(million)
    assert len(table.rows) == MOST_ROWS
    assert np.all(np.diff(table.rows) == 10)
    assert "100,000 of 1,000,000 draws are shown" in Brushing(table, "folder").statement()
    assert len(interactive_html(million)) < 15e6


def test_values_that_no_axis_can_show(explored):
    """Draws that diverge have infinite metrics: they are counted, and left out of the axes."""
    wild = dj.run(explored.override({"draws": 40}))
    metric = wild.dataset["error_max_after_4"]
    wild.dataset["error_max_after_4"] = metric.where(metric["draw"] % 3 != 0, np.inf)
    brushing = Brushing(DrawTable(wild), "folder")
    shown = brushing.table.columns["error_max_after_4"]
    assert np.isnan(shown[::3]).all()
    assert brushing.statement().startswith("all 40 draws")
    assert np.isfinite(brushing.bars["y"].data["left"]).all()
    assert np.isfinite([*brushing.parallel.paint.args["lows"], *brushing.parallel.paint.args["highs"]]).all()
