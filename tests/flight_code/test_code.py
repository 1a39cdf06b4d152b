"""The controllers of studies in C: the bits of the strict analysis, on every processor that can be had."""

import json
import re
from pathlib import Path

import jax
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import Command
from dssc_jax.engine.sampling import draw
from dssc_jax.flight_code.controller import sampled_controllers
from dssc_jax.flight_code.folder import FlightFolder
from dssc_jax.flight_code.recording import recorded_draws, recording_lane
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.models.differentiators import DIFFERENTIATORS
from tests.cli.conftest import last_json
from tests.flight_code.compiling import made, require
from tests.test_programs import CONTROLLER_TABLES, DIFFERENTIATOR_TABLES

NO_DIFFERENCE = r"^0 of (\d+) values differ"


def table(controller, differentiator=None, precision=64):
    """A loop with noise, a lag and a step of disturbance."""
    return {
        "name": "flown",
        "seed": 5,
        "draws": 8,
        "loop": {"duration": 3.0, "sample_time": 0.01, "precision": precision},
        "plant": {"kind": "normal_form", "k_p": {"uniform": [0.8, 1.2]}, "initial": [1.0, 0.0]},
        "reference": {"kind": "sine", "amplitude": 0.5, "period": 2.0},
        "controller": {"l0": 1.0, **controller},
        "sensor": {"kind": "noisy", "position_std": 0.001, "velocity_std": 0.002},
        "differentiator": differentiator or {"kind": "none"},
        "unmodelled": {"kind": "lag", "mu": {"loguniform": [0.005, 0.05]}},
        "disturbance": {"kind": "step", "value": 0.3, "at": 1.0},
    }


def cases():
    """Every kind of controller and row, in every sampled form; the differentiators take turns."""
    number = 0
    for controller in CONTROLLER_TABLES:
        entry = CONTROLLERS[controller["kind"]]
        for option in entry.members:
            chosen = {entry.option: option.value} if entry.option else {}
            label = controller.get("functions", {}).get("kind", "") if controller["kind"] == "dssc" else ""
            name = "-".join(filter(None, (controller["kind"], label, str(option or ""))))
            differentiator = DIFFERENTIATOR_TABLES[number % len(DIFFERENTIATOR_TABLES)]
            yield pytest.param({**controller, **chosen}, differentiator, (64, 32)[number // 2 % 2], id=name)
            number += 1


def written(tmp_path, study, draws=8, samples=300):
    """The folder of a study's controllers."""
    folder = FlightFolder(study)
    for name, text in folder.texts().items():
        (tmp_path / name).write_text(text)
    (tmp_path / "recorded.bin").write_bytes(b"".join(folder.recording(draws, samples)))
    return folder


def values_compared(printed):
    """The number of values that the bench compared, all of them equal."""
    (count,) = re.findall(NO_DIFFERENCE, printed, re.MULTILINE)
    return int(count)


@pytest.fixture(scope="module")
def case2(tmp_path_factory):
    """The folder of a packaged study of DSSC, and of the same study in float32."""
    folders = {}
    for precision in (64, 32):
        folders[precision] = tmp_path_factory.mktemp(f"case{precision}")
        study = dj.Study.load("mu_robustness").override({"loop.precision": precision})
        written(folders[precision], study, draws=4, samples=4000)
    return folders


@pytest.mark.parametrize(("controller", "differentiator", "precision"), [*cases()])
def test_same_bits(controller, differentiator, precision, tmp_path):
    require("cc", "make")
    study = dj.Study.from_table(table(controller, differentiator, precision))
    folder = written(tmp_path, study)
    (controller,) = folder.code.controllers
    results = 3 + len(controller.states) + len(controller.infos)
    assert values_compared(made(tmp_path, "check")) == 8 * 300 * results


def test_every_differentiator_is_compared():
    kinds = {table["kind"] for table in DIFFERENTIATOR_TABLES}
    assert kinds == set(DIFFERENTIATORS)


@pytest.mark.parametrize("precision", [64, 32])
@pytest.mark.parametrize(
    ("target", "tools"),
    [
        ("clang", ["clang"]),
        ("arm64", ["aarch64-linux-gnu-gcc", "qemu-aarch64"]),
        ("armhf", ["arm-linux-gnueabihf-gcc", "qemu-arm"]),
    ],
)
def test_same_bits_elsewhere(case2, precision, target, tools):
    require("make", *tools)
    assert values_compared(made(case2[precision], target)) == 4 * 4000 * 17


@pytest.mark.parametrize("precision", [64, 32])
def test_hostile_numbers_and_sanitizers(case2, precision):
    require("cc", "make")
    printed = made(case2[precision], "sanitized")
    assert values_compared(printed) == 4 * 4000 * 17
    assert "1000000 hostile samples" in printed
    assert "0 with a wrong flag" in printed


def test_changed_arithmetic_is_detected_and_named(case2):
    require("cc", "make")
    printed = made(case2[64], "detected")
    for fault in ("compiled with -ffast-math", "sums are reordered", "NaN is taken not to occur"):
        assert f"fault: {fault}" in printed
    if "fma" in Path("/proc/cpuinfo").read_text().split():
        assert "fault: products and sums are contracted" in printed
        assert "differs: command.u" in printed


def test_a_wrong_controller_is_detected(tmp_path):
    """A sign turned by hand."""
    require("cc", "make")
    written(tmp_path, dj.Study.from_table(table({"kind": "pi", "k_p": 1.0, "k_i": 0.5})))
    source = tmp_path / "flown_controller.c"
    text = source.read_text()
    assert "measurement.y - reference.y" in text
    source.write_text(text.replace("measurement.y - reference.y", "reference.y - measurement.y"))
    printed = made(tmp_path, "check", fails=True)
    assert "differs: command.u of draw 0, sample 0" in printed


@pytest.mark.parametrize("kind", ["dssc", "sta", "pid"])
def test_numbers_as_inputs_change_no_bit_of_the_analysis(kind):
    """The recorded program has the controller's numbers as inputs; the analysis compiles them in."""
    controller = next(table for table in CONTROLLER_TABLES if table["kind"] == kind)
    study = dj.Study.from_table(table(controller))
    controllers, samples = sampled_controllers(study), 200
    recorded = [draw.rows for draw in recorded_draws(study, controllers, 8, samples)]
    with arithmetic():
        number, index = jax.ShapeDtypeStruct((), np.float64), jax.ShapeDtypeStruct((), np.uint32)
        lane = recording_lane(study, samples)
        lanes = CompiledLanes(lane, dict.fromkeys(study.laws, number), index, strict=True)
        (columns,) = lanes.start((draw(study, np.arange(8)), np.arange(8)), 8, 1)()
    assert np.array_equal(np.stack(recorded), np.stack(columns, axis=2))


def test_laws_of_gains_vary_between_draws(tmp_path):
    require("cc", "make")
    gains = {"kind": "pi", "k_p": {"uniform": [0.5, 2.0]}, "k_i": 0.5}
    folder = written(tmp_path, dj.Study.from_table(table(gains)))
    (controller,) = folder.code.controllers
    assert [parameter.value for parameter in controller.parameters if parameter.uncertain] == [1.25]
    assert "k_p;  /*" in (tmp_path / "flown_controller.h").read_text()
    assert "1.25, median of its law" in (tmp_path / "flown_controller.h").read_text()
    drawn = {draw.parameters.tobytes() for draw in recorded_draws(folder.code.study, folder.code.controllers, 8, 2)}
    assert len(drawn) == 8
    made(tmp_path, "check")


def test_command(tmp_path, capsys):
    require("cc", "make")
    arguments = ["code", "paper_case1", "--out", str(tmp_path), "--draws", "1", "--samples", "50", "--json"]
    assert guarded(arguments) == 0
    found = last_json(capsys)
    assert found["study"] == "paper-case1"
    assert [channel["channel"] for channel in found["channels"]] == ["x", "y", "z", "psi"]
    assert [channel["state_bytes"] for channel in found["channels"]] == [24, 24, 24, 32]  # psi keeps its last reading
    assert all(channel["loops"] == 0 for channel in found["channels"])
    assert all(channel["chain"] < sum(channel["operations"].values()) for channel in found["channels"])
    assert sorted(found["files"]) == sorted(path.name for path in tmp_path.iterdir())
    values_compared(made(tmp_path, "check"))
    assert json.loads(json.dumps(found)) == found
    assert guarded(arguments) == 0  # replaces what it wrote
    changed = tmp_path / "Makefile"
    changed.write_text("all: ; my own\n")
    assert guarded(arguments) == 2
    assert changed.read_text() == "all: ; my own\n"


def test_what_has_no_c_is_refused():
    study = dj.Study.from_table(table({"kind": "tests.flight_code.test_code:SORTING", "k_p": 1.0, "k_i": 0.5}))
    with pytest.raises(ConfigError, match=r"controller: has no exact form in C.*sort.*test_code.py"):
        FlightFolder(study)


def sorting(gains, state, measurement, reference, dt):
    middle = jax.numpy.sort(jax.numpy.stack([measurement.y, reference.y, measurement.y_dot]))[1]
    return state, Command(-gains.k_p * middle, 0.0), ()


SORTING = next(iter(CONTROLLERS["pi"].members.values()))._replace(step=sorting)


def with_state(start, following):
    """A controller whose state, within its pair of fields, starts and continues so."""
    return SORTING._replace(
        init=lambda gains, measurement, reference: {"y": measurement.y, "n": start()},
        step=lambda gains, state, measurement, reference, dt: (
            {"y": measurement.y, "n": following(state["n"])},
            Command(-gains.k_p * measurement.y + 0.01 * jax.numpy.sum(state["n"]).astype(float), 0.0),
            (),
        ),
        transfer=None,
    )


BYTE = with_state(lambda: jax.numpy.uint8(0), lambda n: n + jax.numpy.uint8(1))
WORD = with_state(lambda: jax.numpy.uint32(1), lambda n: n * jax.numpy.uint32(5))
ARRAY = with_state(lambda: jax.numpy.zeros(2), lambda n: 0.5 * n)
COUNTER = with_state(lambda: 0, lambda n: jax.numpy.where(n >= 255, 0, n + 1))
FLAG = with_state(lambda: False, lambda n: n < 0.5)


@pytest.mark.parametrize(
    ("name", "kind"), [("BYTE", "uint8"), ("WORD", "uint32"), ("ARRAY", r"an array of shape \(2,\)")]
)
def test_a_state_that_code_cannot_keep_is_refused_by_name(name, kind):
    """An unsigned counter became a double that never wrapped; shifts of a word ended in a traceback."""
    study = dj.Study.from_table(table({"kind": f"{__name__}:{name}", "k_p": 1.0, "k_i": 0.5}))
    with pytest.raises(ConfigError, match=f"^controller: keeps n as {kind}.*: keep "):
        FlightFolder(study)


@pytest.mark.parametrize("name", ["COUNTER", "FLAG"])
def test_integers_and_flags_are_kept_as_in_the_loop(name, tmp_path):
    study = dj.Study.from_table(table({"kind": f"{__name__}:{name}", "k_p": 1.0, "k_i": 0.5}))
    written(tmp_path, study)
    assert values_compared(made(tmp_path, "check")) > 0
