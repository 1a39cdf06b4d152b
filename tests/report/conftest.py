"""One small run and one small sweep for all the report's tests; nothing writes to them."""

import copy

import pytest

import dssc_jax as dj
from tests.conftest import UNCERTAIN

NASTY = "</style><script>alert(1)</script> & \"quotes\" 'apostrophes' <b>bold"


@pytest.fixture(scope="package")
def swept():
    """Three by two points; descriptions and names may hold anything."""
    return dj.run(dj.Study.from_table({**copy.deepcopy(UNCERTAIN), "description": NASTY}, f"{NASTY}.toml"))


@pytest.fixture(scope="package")
def ran():
    """The same without its sweep."""
    return dj.run(dj.Study.from_table(copy.deepcopy(UNCERTAIN)).without_sweep())
