"""Controllers in C that tests build, and studies of them."""

import dssc_jax as dj
from dssc_jax.cli.native_build import build_library
from tests.conftest import UNCERTAIN


def built(place, name, text):
    """A library of a text."""
    (place / f"{name}.c").write_text(text)
    (place / f"{name}.so").write_bytes(build_library([place / f"{name}.c"], [place]))
    return place / f"{name}.so"


def table(file, **controller):
    """A loop with a controller in C."""
    return {
        **UNCERTAIN,
        "name": "native",
        "controller": {"kind": "library", "file": str(file), **controller},
        "unmodelled": {"kind": "lag", "mu": {"loguniform": [0.005, 0.2]}},
        "metrics": {"names": ["error_rms", "command_tv", "command_max"]},
        "requirement": [{"metric": "error_rms", "after": 1.0, "max": 0.3}],
        "sweep": {},
    }


def loaded(file, **controller):
    """The study of a loaded library."""
    library = dj.allow_native(file)
    return dj.Study.from_table(table(file, sha256=library.sha256, **controller))
