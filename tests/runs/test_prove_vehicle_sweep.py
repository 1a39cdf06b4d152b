"""Proofs of a vehicle over wind and rotor lag: in the folder, in figures, in reports, and verified again."""

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax import plotting
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.exploration.actions import proof
from dssc_jax.exploration.live import LiveRun
from dssc_jax.plotting.standings import STANDINGS, standing_of
from dssc_jax.report import html
from dssc_jax.results.proofs import PROOFS_FILE
from tests.cli.conftest import last_json

pytest.importorskip("flint")

OVERS = ("--over=plant.vehicle.motor_lag=0.02:0.4:2", "--over=wind.speed=2:4:2")
SHORT = ("--set=loop.duration=1.0", "--set=draws=4")
COVERED = "every wind and vehicle within the bounds"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep over lag and wind with proofs, by the command."""
    path = tmp_path_factory.mktemp("proved") / "map"
    arguments = ["sweep", "hover_wind_map", *OVERS, *SHORT, "--prove", "--out", str(path), "--json"]
    assert guarded(arguments) == 0
    return path


@pytest.fixture(scope="module")
def result(folder: Path) -> dj.Result:
    """Its result."""
    loaded = dj.load(folder)
    assert isinstance(loaded, dj.Result)
    return loaded


def test_a_small_lag_is_proved_and_a_large_one_is_not(result: dj.Result) -> None:
    """Each proved point has the bounds of a proof of its own: the vertical wind moves with the horizontal one."""
    proved = result.dataset["proved"]
    assert proved.values.tolist() == [[True, True], [False, False]]
    assert result.point_proofs is not None
    bounds = result.point_proofs.bounds
    alone = dj.prove(dj.Study.load("hover_wind_map").without_sweep().override(AT_4))
    expected = alone.summary()["bounds"]
    assert bounds["|e_x|, |e_y|"][0, 1] == pytest.approx(expected["x"]["e"], rel=1e-6)
    assert bounds["tilt"][0, 1] == pytest.approx(expected["tilt"], rel=1e-6)
    assert bounds["largest thrust of a rotor"][0, 1] == pytest.approx(expected["rotor_max"], rel=1e-6)
    assert "|w_h| <= 4 m/s and |w_z| <= 2 m/s" in result.point_proofs.statements[1]
    assert np.array_equal(np.isfinite(bounds["tilt"]), proved)
    assert (result.dataset["error_max_x"].max("draw").values[0] < bounds["|e_x|, |e_y|"][0]).all()


AT_4 = {"plant.vehicle.motor_lag": 0.02, "wind.speed": 4.0}


def test_over_two_gains_strong_control_chatters_and_weak_control_is_proved() -> None:
    """kappa_o = 1 tilts the vehicle too far in every draw; that of Case 1 is proved, with the bounds of hover_wind."""
    sweep = {"controller.functions.kappa_o": [1.0, 110.651], "controller.l0": [0.2]}
    study = dj.Study.load("hover_wind_gains").override({"sweep": sweep, "draws": 4, "loop.duration": 10.0})
    proofs = dj.prove_sweep(study)
    share = dj.run(study).failed.mean("draw").values
    assert standing_of(proofs.proved, share).tolist() == [[len(STANDINGS) - 1], [0]]
    alone = dj.prove(dj.Study.load("hover_wind")).summary()["bounds"]
    assert proofs.bounds["|e_x|, |e_y|"][1, 0] == pytest.approx(alone["x"]["e"], rel=1e-9)


def test_figure_and_report_say_what_a_proof_of_a_vehicle_covers(result: dj.Result) -> None:
    shown = [text.get_text() for text in plotting.standing(result).axes[0].get_legend().get_texts()]
    assert shown[0] == f"proved for {COVERED}"
    assert result.dataset["proved_error"].attrs["units"] == "m"
    assert "along x and y" in result.dataset["proved_error"].attrs["long_name"]
    assert result.certificate.startswith("2 of 4 points are proved, with lag and sampling")
    text = html(result, worst=0)
    assert f"proved for {COVERED}" in text
    assert "every plant of the laws" not in text
    assert "The largest bound is proved at plant.vehicle.motor_lag = 0.02, wind.speed = 4: For every wind with" in text
    assert "smallest thrust of a rotor [N]" in text
    assert "Proved points: never exceeded" in text


def test_the_certificates_are_verified_again(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each is that of its own point, and not of another."""
    assert guarded(["prove", str(folder / PROOFS_FILE), "--json"]) == 0
    assert last_json(capsys) == {"proved": True, "points": 4, "certificates": 2, "reasons": []}
    swapped = tmp_path / "swapped"
    shutil.copytree(folder, swapped)
    content = json.loads((folder / PROOFS_FILE).read_text())
    content["certificates"][1] = content["certificates"][0]
    (swapped / PROOFS_FILE).write_text(json.dumps(content))
    assert guarded(["prove", str(swapped / PROOFS_FILE)]) == 1
    assert "point 1 is that of another loop" in capsys.readouterr().out


def test_damaged_bounds_are_told(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    content = json.loads((folder / PROOFS_FILE).read_text())
    del content["points"][0]["bounds"]["tilt"]
    (copy / PROOFS_FILE).write_text(json.dumps(content))
    with pytest.raises(ConfigError, match="is damaged"):
        dj.load(copy)


def test_the_wind_is_walked_as_far_as_it_is_proved(capsys: pytest.CaptureFixture[str]) -> None:
    """Both components move, and the answer holds the bounds at the last proved value."""
    assert guarded(["prove", "hover_wind_tuned", "--over=wind.speed=2:3", "--json"]) == 0
    answer = last_json(capsys)
    assert answer["proved_up_to"] == 3.0
    assert answer["covered"] == COVERED
    assert "|w_h| <= 3 m/s and |w_z| <= 1.5 m/s" in answer["statement"]
    assert answer["settled"]["x"]["e"] == answer["error"]
    assert answer["bounds"]["y"] == answer["bounds"]["x"]
    assert 0.0 < math.degrees(answer["bounds"]["tilt"]) < 1.0


def test_a_margin_tells_how_far_a_vehicle_is_proved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk = ("--over=wind.speed=2:3", "--points=2", "--bisections=1", "--prove")
    assert guarded(["margin", "hover_wind_tuned", *walk, *SHORT, "--out", str(tmp_path / "m"), "--json"]) == 0
    answer = last_json(capsys)["proof"]
    assert answer["proved_up_to"] == 3.0
    assert answer["covered"] == COVERED
    loaded = dj.load(tmp_path / "m")
    texts = [text.get_text() for text in loaded.figure().axes[0].get_legend().get_texts()]
    assert any(text.replace("\n", " ") == f"proved as far as 3, for {COVERED}" for text in texts)


def test_explore_proves_a_vehicle_on_request() -> None:
    """And says why another is not proved."""
    hover = dj.Study.load("hover_wind_tuned")

    def shown(changes: dict[str, object]) -> str:
        return proof(LiveRun(hover.override(changes), {}, {}, np.zeros(0)), lambda *_: None)

    assert shown({"wind.speed": 3.0}).startswith("proved: For every wind with |w_h| <= 3 m/s")
    assert shown({"plant.vehicle.motor_lag": 0.4}).startswith(f"not proved for {COVERED}: Nothing is proved: no bounds")
    assert "wind.kind = 'bounded'" in shown(
        {"wind": {"kind": "dryden", "speed": 3.0, "airspeed": 5.0, "altitude": 20.0}}
    )
