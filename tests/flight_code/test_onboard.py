"""The inner loop and the mixer in C: the same bits as the analysis, on this processor and on ARM."""

import shutil

import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_code.folder import FlightFolder
from tests.flight_code.compiling import made, require
from tests.models.uav.test_cascades import study_of

FLIGHT = (3.0, -2.0, 1.0, 1.5)


def folder_of(study, folder):
    """The folder of a study's code, written with a recording of 2 draws and 30 samples."""
    code = FlightFolder(study)
    for name, text in code.texts().items():
        (folder / name).write_text(text)
    (folder / "recorded.bin").write_bytes(b"".join(code.recording(2, 30)))
    (folder / "inner_loop.bin").write_bytes(b"".join(code.software_recording(2, 30)))
    return code


FORWARD = (1.0, 0.0, 1.0, 0.0)
"""With commands of exactly 0, so that signs of zeros count."""


@pytest.mark.parametrize(
    ("kind", "precision", "commands"), [("px4", 64, FLIGHT), ("crazyflie", 32, FLIGHT), ("px4", 64, FORWARD)]
)
def test_same_bits_as_the_analysis(kind, precision, commands, tmp_path):
    """Controllers, cascade and mixer; the world is uncertain and its wind too, the code's numbers are not."""
    require("make", "gcc")
    study = study_of(kind, commands, frequency=200.0, substeps=2, draws=2).override(
        {
            "plant.vehicle.motor_lag": {"uniform": [0.015, 0.03]},
            "plant.vehicle.structure_drag": [{"uniform": [0.0, 0.1]}, 0.05, 0.05],
            "loop.precision": precision,
            "loop.integrator": "euler",
        }
    )
    folder_of(study, tmp_path)
    readme = (tmp_path / "README.md").read_text()
    assert "`rotor_0`, rotor 1 of trajectories, is at (" in readme
    output = made(tmp_path, "check")
    assert "inner loop: 0 of " in output
    assert ", 2 flights" in output
    if shutil.which("aarch64-linux-gnu-gcc") and shutil.which("qemu-aarch64"):
        assert "inner loop: 0 of " in made(tmp_path, "arm64")
    bench = (tmp_path / "inner_loop.bin").read_bytes()
    changed = bytearray(bench)
    changed[-3] ^= 1
    (tmp_path / "inner_loop.bin").write_bytes(bytes(changed))
    assert "inner loop: 1 of " in made(tmp_path, "inner-loop-check", fails=True)


def test_numbers_with_laws_are_refused():
    """The code has constants: a law of what the inner loop believes has no place in it."""
    study = study_of("px4", FLIGHT).override({"plant.believed.mass": {"uniform": [1.0, 1.4]}})
    with pytest.raises(ConfigError, match=r"plant\.believed\.mass: has a law"):
        FlightFolder(study)


def test_the_article_s_inner_loop_is_not_generated():
    """It is continuous in time; header and README go on naming it among what is not generated."""
    study = study_of("article", FLIGHT)
    folder = FlightFolder(study)
    assert folder.software is None
    assert "the mixer" in folder.texts()["README.md"]
