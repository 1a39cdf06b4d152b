"""The inner loop and the mixer in C: the same bits as the analysis, on this processor and on ARM."""

import shutil
import subprocess

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
    ("kind", "precision", "commands", "start"),
    [
        ("px4", 64, FLIGHT, "zero"),
        ("crazyflie", 32, FLIGHT, "zero"),
        ("px4", 64, FORWARD, "zero"),
        ("px4", 64, FLIGHT, "settled"),
    ],
)
def test_same_bits_as_the_analysis(kind, precision, commands, start, tmp_path):
    """Controllers, cascade and mixer; the world is uncertain and its wind too, the code's numbers are not.

    The C knows no settled start, so recorded flights do not begin with one.
    """
    require("make", "gcc")
    study = study_of(kind, commands, frequency=200.0, substeps=2, draws=2).override(
        {
            "plant.vehicle.motor_lag": {"uniform": [0.015, 0.03]},
            "plant.vehicle.structure_drag": [{"uniform": [0.0, 0.1]}, 0.05, 0.05],
            "loop.precision": precision,
            "loop.integrator": "euler",
            "plant.inner_loop.start": start,
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


CALLS = """
#include "NAME.h"
#include <math.h>
#include <stdio.h>
#include <string.h>

static NAME_readings leaning(double length)
{
    NAME_readings seen = {0};
    seen.attitude_w = length * cos(0.1);
    seen.attitude_x = length * sin(0.1);
    return seen;
}

int main(void)
{
    const double lengths[] = {1.0, 1.0005, 1.01, 0.0, NAN};
    NAME inner_loop = {0};
    NAME_readings seen = leaning(1.0);
    printf("%u", NAME_init(&inner_loop, &seen));
    for (int i = 0; i < 5; i++) {
        const NAME before = inner_loop;
        seen = leaning(lengths[i]);
        const unsigned flag = NAME_tick(&inner_loop, &seen);
        printf(" %u%s", flag, flag && memcmp(&before, &inner_loop, sizeof before) == 0 ? " kept" : "");
    }
    return 0;
}
"""


def test_a_quaternion_that_is_no_rotation_is_refused(tmp_path):
    """The function returns 1 and keeps its state; rounding and a filter's small error of length pass."""
    require("gcc")
    study = study_of("px4", FLIGHT, frequency=200.0, substeps=2, draws=2)
    folder_of(study, tmp_path)
    (header,) = tmp_path.glob("*_inner_loop.h")
    (tmp_path / "calls.c").write_text(CALLS.replace("NAME", header.stem))
    built = ["gcc", "-std=c99", "-O1", "-ffp-contract=off", "calls.c", f"{header.stem}.c", "-o", "calls", "-lm"]
    subprocess.run(built, cwd=tmp_path, check=True)
    answer = subprocess.run(["./calls"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    assert answer == "0 0 0 1 kept 1 kept 1 kept"


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
