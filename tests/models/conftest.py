"""FMUs that are built once for the tests of a file, and the loop of both."""

import pytest

from dssc_jax.engine.batching import values_of_draws
from tests import fmus
from tests.flight_code.compiling import require
from tests.fmu_loops import DRAWS, controller_of, loop_of, plant_of


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    require("cc")
    return tmp_path_factory.mktemp("fmus")


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def version(request):
    return request.param


@pytest.fixture(scope="module")
def mass(place):
    return fmus.built(place, fmus.MASS)


@pytest.fixture(scope="module")
def pid(place):
    return fmus.built(place, fmus.PID)


@pytest.fixture(scope="module")
def study(mass, pid):
    """Both parts in FMUs."""
    return loop_of(plant_of(mass), controller_of(pid, outputs={"integral": "integral"}))


@pytest.fixture(scope="module")
def values(study):
    return values_of_draws(study, slice(0, DRAWS))
