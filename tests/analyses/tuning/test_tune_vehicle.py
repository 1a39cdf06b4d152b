"""Tuning a vehicle under proof: the proved error falls, and the certificate is that of the tuned vehicle."""

import json
from pathlib import Path

import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from tests.cli.conftest import last_json

pytest.importorskip("flint")

FEW = ("--set=tune.steps=3", "--set=tune.draws=4", "--set=tune.validation=4", "--set=draws=4")
SHORT = ("--set=loop.duration=1.0", "--set=tune.limits={}")


def test_the_proved_error_of_a_vehicle_falls(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    study = dj.Study.load("tune_hover_wind")
    monkeypatch.chdir(tmp_path)
    assert guarded(["tune", "tune_hover_wind", *FEW, *SHORT, "--out", "again.toml"]) == 0
    assert "proved bound of |e| along x and y once settled: " in capsys.readouterr().out
    (folder,) = (tmp_path / "results").iterdir()
    aimed = json.loads((folder / "summary.json").read_text())["aimed"]
    assert aimed["start"] == pytest.approx(dj.prove(study).error, rel=1e-6)
    assert aimed["result"] < 0.9 * aimed["start"]
    assert guarded(["prove", str(folder / "proof.json"), "--json"]) == 0
    verdict = last_json(capsys)
    assert verdict["settled"]["x"]["e"] == pytest.approx(aimed["result"], rel=1e-6)
    tuned = dj.load(folder)
    assert "proved bound of |e| along x and y once settled" in tuned.headline
    assert tuned.dataset["proved_error"].attrs["units"] == "m"
    content = json.loads((folder / "proof.json").read_text())
    content["problem"]["channels"]["x"]["l0"] *= 1.0001
    (folder / "proof.json").write_text(json.dumps(content))
    assert guarded(["prove", str(folder / "proof.json")]) == 1
