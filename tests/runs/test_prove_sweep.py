"""Proofs at the points of a sweep: beside the draws, in the results folder, in figures, and verified again."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax import plotting
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.plotting.standings import standing_of, standing_words
from dssc_jax.report import html
from dssc_jax.results.proofs import PROOFS_FILE
from tests.cli.conftest import last_json

OVERS = ("--over=unmodelled.mu=0.004:0.04:2:log", "--over=controller.functions.phi_b=4:40:2:log")
SETTINGS = ("--set=loop.duration=2.0", "--set=draws=8", "--set=requirement=[]", "--set=plant.a_p=0.3")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A sweep over a lag and a gain with proofs, by the command."""
    path = tmp_path_factory.mktemp("proved") / "map"
    assert (
        guarded(["sweep", "design_map", *OVERS, *SETTINGS, "--prove", "--boxes=1", "--out", str(path), "--json"]) == 0
    )
    return path


def test_a_sweep_knows_what_is_proved(folder):
    """Small lag and gain are proved, large ones are unstable; the figures and the summary say so."""
    result = dj.load(folder)
    assert isinstance(result, dj.Result)
    proved, error = result.dataset["proved"], result.dataset["proved_error"]
    assert proved.dims == ("unmodelled.mu", "controller.functions.phi_b")
    assert bool(proved[0, 0])
    assert not bool(proved[1, 1])
    assert np.array_equal(np.isfinite(error), proved)
    assert result.certificate.startswith(
        f"{int(proved.sum())} of 4 points are proved, with lag and sampling; Theorem 1"
    )
    assert (folder / "figures" / "sweep.png").stat().st_size > 10_000
    shown = [text.get_text() for text in plotting.standing(result).axes[0].get_legend().get_texts()]
    assert shown[:4] == standing_words("every plant of the laws")
    along = result.at({"unmodelled.mu": 0})
    assert plotting.probability(along).axes[0].get_legend() is not None
    with pytest.raises(ValueError, match="needs a sweep over two axes with proofs"):
        plotting.standing(along)


def test_the_report_says_what_is_proved(folder):
    text = html(dj.load(folder), worst=0)
    assert "What is proved" in text
    assert "proved for every plant of the laws" in text
    assert "verifies every certificate again" in text


def test_points_stand_in_one_of_four_ways():
    share = np.array([0.0, 0.3, 0.0, 0.3, 1.0])
    proved = np.array([True, True, False, False, False])
    assert standing_of(proved, share).tolist() == [0, 0, 1, 2, 3]


def test_the_proofs_of_a_folder_are_verified_again(folder, tmp_path, capsys):
    """A forged certificate is refused, and damage is told."""
    assert guarded(["prove", str(folder / PROOFS_FILE), "--json"]) == 0
    answer = last_json(capsys)
    assert answer["proved"]
    assert answer["points"] == 4
    content = json.loads((folder / PROOFS_FILE).read_text())
    forged = tmp_path / "forged.json"
    index = next(i for i, point in enumerate(content["points"]) if point["proved"])
    content["certificates"][index]["problem"]["slope"] *= 3.0
    forged.write_text(json.dumps(content))
    assert guarded(["prove", str(forged)]) == 1
    assert "P8: " in capsys.readouterr().out
    own = json.loads((folder / PROOFS_FILE).read_text())
    swapped = tmp_path / "swapped"
    shutil.copytree(folder, swapped)
    own["certificates"][0] = own["certificates"][index ^ 1] if index ^ 1 else own["certificates"][1]
    (swapped / PROOFS_FILE).write_text(json.dumps(own))
    assert guarded(["prove", str(swapped / PROOFS_FILE)]) == 1
    assert "point 0 is that of another loop" in capsys.readouterr().out
    del content["points"]
    forged.write_text(json.dumps(content))
    assert guarded(["prove", str(forged)]) == 2
    assert "are damaged" in capsys.readouterr().err


def test_proofs_of_another_study_or_damaged_ones(folder, tmp_path):
    other = dj.load(folder)
    assert isinstance(other, dj.Result)
    path = other.save(tmp_path / "copy")
    assert (
        "proved" not in dj.Result.of(other.study, other.dataset.drop_vars(["proved", "proved_error"]), {}, path).dataset
    )
    content = json.loads((folder / PROOFS_FILE).read_text())
    Path(path, PROOFS_FILE).write_text(json.dumps(content | {"study_hash": "of another"}))
    assert "proved" not in dj.load(path).dataset
    Path(path, PROOFS_FILE).write_text(json.dumps(content | {"points": content["points"][:-1]}))
    with pytest.raises(ConfigError, match="is damaged"):
        dj.load(path)


def test_what_is_not_covered_is_told_before_a_draw_is_made(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert guarded(["sweep", "mu_robustness", "--prove"]) == 2
    assert "is outside of what a proof covers" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
