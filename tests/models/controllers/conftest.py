"""The library of the template, and a study of it."""

import pytest

from dssc_jax.flight_code.template_files import template_text
from tests.flight_code.compiling import require
from tests.models.controllers.libraries import built, loaded


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    require("cc")
    return tmp_path_factory.mktemp("libraries")


@pytest.fixture(scope="module")
def template(place):
    """The library of the template."""
    return built(place, "my", template_text("library.c"))


@pytest.fixture
def study(template):
    return loaded(template, k_p={"uniform": [2.0, 4.0]})
