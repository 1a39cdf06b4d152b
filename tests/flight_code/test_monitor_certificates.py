"""Certificates that `dssc-jax code --monitor` takes and refuses."""

import json
import re

import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_code.certified_premises import certified_premises
from dssc_jax.flight_code.folder import FlightFolder
from dssc_jax.flight_code.traced_monitor import traced_monitor
from tests.cli.conftest import last_json
from tests.flight_code.compiling import made, require
from tests.flight_code.conftest import AXIS


def arguments_of(study, certificate, out):
    return [
        "code",
        study,
        "--monitor",
        str(certificate),
        "--out",
        str(out),
        "--draws",
        "1",
        "--samples",
        "20",
        "--json",
    ]


def test_command(certificates, tmp_path, capsys):
    study = arguments_of("hover_wind", certificates["vehicle"], tmp_path)
    assert guarded(study) == 0
    found = last_json(capsys)
    assert list(found["monitor"]["flags"])[:3] == ["start", "x_e", "x_e_dot"]
    assert sorted(found["files"]) == sorted(path.name for path in tmp_path.iterdir())
    require("cc", "make")
    assert "monitor: 0 of" in made(tmp_path, "check")


def tampered(content):
    """The vehicle's certificate with a smaller bound."""
    content["proof"]["channels"]["x"]["bounds"]["e"] *= 0.5
    return content


@pytest.mark.parametrize(
    ("study", "change", "reason"),
    [
        ("hover_wind", tampered, "is rejected by the verifier: V4: the bound of x.e does not imply itself"),
        ("hover_wind", lambda content: content | {"version": 99}, "version: is not 2"),
        ("hover_wind_tuned", lambda content: content, "is the certificate of another loop than the study's"),
        ("mu_robustness", lambda content: content, "is outside of what a proof covers|another loop than the study's"),
        ("hover_wind", lambda content: [1, 2], "version"),
    ],
)
def test_refusals(certificates, tmp_path, capsys, study, change, reason):
    path = tmp_path / "certificate.json"
    path.write_text(json.dumps(change(json.loads(certificates["vehicle"].read_text()))))
    out = tmp_path / "out"
    assert guarded(arguments_of(study, path, out)) == 2
    assert re.search(reason, " ".join(capsys.readouterr().err.split()))
    assert not out.exists()


def test_what_is_no_file_is_refused(tmp_path, capsys):
    path = tmp_path / "certificate.json"
    path.write_text("{")
    for certificate in (path, tmp_path / "absent.json"):
        assert guarded(arguments_of("hover_wind", certificate, tmp_path / "out")) == 2
        assert "cannot be read" in capsys.readouterr().err


def test_a_study_that_differs_in_one_number_is_refused(certificates):
    content = json.loads(certificates["axis"].read_text())
    changed = AXIS.override({"controller.l0": 0.51})
    with pytest.raises(ConfigError, match=r"another loop than the study's: `l0` differs"):
        certified_premises(changed, content, "axis")


def test_what_cannot_be_seen_is_named():
    study = dj.Study.load("studies/certified_margin.toml").override(
        {"plant.k_p": 1.0, "plant.a_p": 0.3, "unmodelled.mu": 0.01, "sensor": {"kind": "lag", "mu": 0.002}}
    )
    proved = dj.prove(study, boxes=1)
    assert proved.complete
    premises = certified_premises(study, json.loads(json.dumps(proved.certificate())), "lagging")
    assert premises.unwatched == "The disturbance is not seen: the sensor lags behind the output."
    assert not [flag for flag in premises.flags() if "disturbance" in flag.name]
    assert traced_monitor(FlightFolder(study).code, premises).inputs[-1] == "sliding_margin"
