"""Proved studies with their certificates, whose monitors the tests try."""

import json

import pytest

import dssc_jax as dj
from dssc_jax.flight_code.certified_premises import certified_premises
from dssc_jax.flight_code.folder import FlightFolder

AXIS = dj.Study.load("studies/certified_margin.toml").override({"unmodelled.mu": 0.01, "requirement": []})
HOVER = dj.Study.load("studies/hover_wind.toml")
PROVED = {"axis": AXIS, "vehicle": HOVER}


@pytest.fixture(scope="session")
def certificates(tmp_path_factory):
    """The files of the certificates of both studies."""
    found = {}
    for name, study in PROVED.items():
        proved = dj.prove(study)
        assert proved.complete
        found[name] = tmp_path_factory.mktemp("certificates") / f"{name}.json"
        found[name].write_text(json.dumps(proved.certificate()))
    return found


@pytest.fixture(scope="session")
def folders(certificates):
    """The folders of both studies with their monitors."""
    found = {}
    for name, study in PROVED.items():
        premises = certified_premises(study, json.loads(certificates[name].read_text()), name)
        found[name] = FlightFolder(study, premises)
    return found
