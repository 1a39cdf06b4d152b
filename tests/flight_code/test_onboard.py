"""The inner loop and the mixer in C: the same bits as the analysis, on this processor and on ARM."""

import platform
import re
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
    assert "inner loop: 0 of " in made(tmp_path, "cpp")
    assert re.search(r"inner loop: 200000 hostile rows, \d+ with a flag, 0 numbers lost", made(tmp_path, "sanitized"))
    assert re.search(r"inner loop: [1-9]\d* of \d+ values differ", made(tmp_path, "inner-loop-detected"))
    assert "inner loop: cycles of a tick" in made(tmp_path, "cycles") or platform.machine() != "x86_64"
    assert made(tmp_path, "stack").count("_tick\t") == 1
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
    NAME inner_loop;
    NAME_init(&inner_loop);
    NAME_readings seen = leaning(1.0);
    printf("%u", NAME_start(&inner_loop, &seen));
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


def test_gains_with_laws_are_parameters(tmp_path):
    """The bench gives each flight the gains of its draw; the code itself has the medians."""
    require("make", "gcc")
    laws = {
        "plant.believed.mass": {"uniform": [1.0, 1.4]},
        "plant.inner_loop.rate_p": [{"uniform": [0.1, 0.2]}, 0.15, 0.2],
    }
    folder_of(study_of("px4", FLIGHT, frequency=200.0, substeps=2, draws=2).override(laws), tmp_path)
    assert "inner loop: 0 of " in made(tmp_path, "check")
    (source,) = tmp_path.glob("*_inner_loop.c")
    text = source.read_text()
    assert "inner_loop->parameters.believed_mass = 1.2;" in text
    assert "parameters->thrust_min < parameters->thrust_max" in text
    source.write_text(re.sub(r"(parameters.rate_p_0 = )[0-9.]+", r"\g<1>9.0", text))
    assert "inner loop: 0 of " in made(tmp_path, "inner-loop-check")
    source.write_text(re.sub(r"(parameters.rate_p_1 = )[0-9.]+", r"\g<1>0.16", text))
    assert "inner loop: 0 of " not in made(tmp_path, "inner-loop-check", fails=True)


@pytest.mark.parametrize("hover", [{}, {"plant.inner_loop.thrust_hover": 0.5}])
def test_a_believed_mass_is_a_parameter_where_it_has_an_effect(hover, tmp_path):
    """PX4 takes the weight from MPC_THR_HOVER, if it is set."""
    code = folder_of(study_of("px4", FLIGHT, draws=2).override(hover), tmp_path)
    (header,) = [text for name, text in code.texts().items() if name.endswith("_inner_loop.h")]
    assert ("believed_mass" in header) == (not hover)


def test_other_numbers_with_laws_are_refused():
    """A settled start depends on the draw's mass, which is no gain."""
    laws = {"plant.inner_loop.start": "settled", "plant.vehicle.mass": {"uniform": [1.0, 1.4]}}
    with pytest.raises(ConfigError, match=r"plant\.vehicle\.mass: has a law"):
        FlightFolder(study_of("px4", FLIGHT).override(laws))


TAKEOVER = """
#include "NAME.h"
#include <math.h>
#include <stdio.h>

int main(void)
{
    NAME loop;
    NAME_readings seen = {0};
    NAME_driven driven = {2.9, 3.0, 2.95, 3.05};
    NAME_commands wanted = {0};
    double deviation = 0.0;
    seen.velocity_x = wanted.x = 0.5;
    seen.velocity_z = wanted.z = -0.25;
    seen.attitude_w = sqrt(1.0 - 0.05 * 0.05 - 0.04 * 0.04 - 0.3 * 0.3);
    seen.attitude_x = 0.05;
    seen.attitude_y = -0.04;
    seen.attitude_z = 0.3;
    NAME_init(&loop);
    loop.parameters.GAIN = 0.21;
    printf("%u ", NAME_check(&loop.parameters));
    printf("%u", NAME_transfer(&loop, &seen, &driven));
    for (int sample = 0; sample < 3; sample++) {
        printf(" %u", NAME_sample(&loop, &seen, &wanted));
        printf(" %u", NAME_tick(&loop, &seen));
        deviation = fmax(deviation, fabs(loop.rotor_0 - driven.rotor_0));
        deviation = fmax(deviation, fabs(loop.rotor_1 - driven.rotor_1));
        deviation = fmax(deviation, fabs(loop.rotor_2 - driven.rotor_2));
        deviation = fmax(deviation, fabs(loop.rotor_3 - driven.rotor_3));
    }
    printf(" %.1e %g", deviation, loop.parameters.GAIN);
    driven.rotor_2 = 1e6;
    printf(" %u %d", NAME_transfer(&loop, &seen, &driven), loop.rotor_2 <= 6.0);
    driven.rotor_2 = 2.95;
    seen.attitude_w = 0.5;
    seen.attitude_x = sqrt(0.75);
    seen.attitude_y = seen.attitude_z = 0.0;
    printf(" %u", NAME_transfer(&loop, &seen, &driven));
    NAME_init(&loop);
    printf(" %u %u", NAME_sample(&loop, &seen, &wanted), NAME_tick(&loop, &seen));
    driven.rotor_2 = NAN;
    printf(" %u", NAME_transfer(&loop, &seen, &driven));
    loop.parameters.GAIN = -0.21;
    printf(" %u", NAME_check(&loop.parameters) != 0u);
    return 0;
}
"""


@pytest.mark.parametrize("kind", ["px4", "crazyflie"])
def test_takeover_in_steady_flight_is_bumpless(kind, tmp_path):
    """Leaning against a wind, with the rotors of another controller, which go on as before; parameters stay."""
    require("gcc")
    folder_of(study_of(kind, FLIGHT, frequency=200.0, substeps=2, draws=2), tmp_path)
    (header,) = tmp_path.glob("*_inner_loop.h")
    (tmp_path / "calls.c").write_text(TAKEOVER.replace("NAME", header.stem).replace("GAIN", "rate_p_0"))
    built = ["gcc", "-std=c99", "-O1", "-ffp-contract=off", "calls.c", f"{header.stem}.c", "-o", "calls", "-lm"]
    subprocess.run(built, cwd=tmp_path, check=True)
    answer = subprocess.run(["./calls"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    *flags, deviation, kept, beyond, limited, tilted, sampled, ticked, refused, told = answer.split()
    assert flags == ["0"] * 8
    assert float(deviation) < 1e-9
    assert (kept, refused, told) == ("0.21", "1", "1")
    assert (beyond, limited, tilted) == ("4", "1", "4")
    assert (sampled, ticked) == ("3", "3")


def test_the_article_s_inner_loop_is_not_generated():
    """It is continuous in time; header and README go on naming it among what is not generated."""
    study = study_of("article", FLIGHT)
    folder = FlightFolder(study)
    assert folder.software is None
    assert "the mixer" in folder.texts()["README.md"]
