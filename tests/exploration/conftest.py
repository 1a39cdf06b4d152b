"""One small study with sliders for all tests of this folder, compiled once."""

import copy

import pytest

import dssc_jax as dj
from dssc_jax.exploration.live import LiveStudy
from tests.loops import LAGGED

EXPLORED = {
    "name": "explored",
    "seed": 1,
    "draws": 5,
    **LAGGED,
    "requirement": [{"metric": "error_max", "after": 4.0, "max": 0.05}],
}


@pytest.fixture(scope="package")
def explored():
    """The study."""
    return dj.Study.from_table(copy.deepcopy(EXPLORED))


@pytest.fixture(scope="package")
def live(explored):
    """Its draws, compiled."""
    return LiveStudy(explored, draws=120)
