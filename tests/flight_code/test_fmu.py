"""The controllers as FMUs: valid, and with the bits of the analysis when FMPy simulates them."""

import platform
import zipfile
from contextlib import contextmanager
from ctypes import c_void_p
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.cli.native_build import build_fmu_library
from dssc_jax.core.signals import ReferencePoint
from dssc_jax.flight_code import fmu as fmu_module
from dssc_jax.flight_code.controller import COMMAND
from dssc_jax.flight_code.fmu_description import base_exponents, xml_text
from dssc_jax.flight_code.fmu_variables import channel_variable, parameter_name
from dssc_jax.flight_code.folder import FlightFolder
from dssc_jax.flight_code.recording import recorded_draws
from tests.cli.conftest import last_json
from tests.flight_code.compiling import require
from tests.flight_code.test_code import table
from tests.test_programs import CONTROLLER_TABLES

fmpy = pytest.importorskip("fmpy")
from fmpy import fmi2, read_model_description, validation  # noqa: E402
from fmpy.build import build_platform_binary  # noqa: E402
from fmpy.fmi1 import FMICallException  # noqa: E402

SIGNALS = ["measurement.y", "measurement.y_dot"] + [f"reference.{m}" for m in ReferencePoint._fields]
RESULTS = [f"command.{m}" for m in COMMAND]
ROWS = {row["functions"]["kind"]: row for row in CONTROLLER_TABLES if row["kind"] == "dssc"}
PID = next(row for row in CONTROLLER_TABLES if row["kind"] == "pid")
PI = {"kind": "pi", "k_p": {"uniform": [0.5, 2.0]}, "k_i": 0.5}
LEVANT = {"kind": "levant", "lipschitz": 10.0}

needs_library = pytest.mark.skipif(
    platform.machine() != "x86_64", reason="the FMU holds a library for x86-64 alone; its sources compile everywhere"
)


class Opened(NamedTuple):
    """An FMU, unpacked."""

    folder: FlightFolder
    file: str
    place: str
    references: dict
    description: object


@pytest.fixture
def opened(tmp_path):
    """Writes, validates and unpacks the FMU of a study."""
    require("cc")

    def make(study):
        folder = FlightFolder(study)
        unit = folder.fmu()
        library, reason = build_fmu_library(unit)
        assert reason is None
        file = tmp_path / f"{unit.name}.fmu"
        file.write_bytes(unit.archive(library))
        assert validation.validate_fmu(str(file)) == []
        description = read_model_description(str(file))
        place = fmpy.extract(str(file), unzipdir=str(tmp_path / unit.name))
        references = {variable.name: variable.valueReference for variable in description.modelVariables}
        return Opened(folder, str(file), place, references, description)

    return make


@contextmanager
def instance(unit, said=None, name="one"):
    """An instance that is ready for its first step; its messages go to a list."""
    slave = fmi2.FMU2Slave(
        guid=unit.description.guid,
        unzipDirectory=unit.place,
        modelIdentifier=unit.description.coSimulation.modelIdentifier,
        instanceName=name,
    )
    callbacks = fmi2.fmi2CallbackFunctions()
    log = fmi2.fmi2CallbackLoggerTYPE(
        lambda environment, name, status, category, message: (said if said is not None else []).append(message.decode())
    )
    callbacks.logger = log
    slave.instantiate(callbacks=callbacks)
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    yield slave
    slave.freeInstance()


def replayed(unit, slave, draws):
    """Commands of the FMU for the recorded signals of one draw, beside the recorded ones; one draw of each channel."""
    controllers, time = unit.folder.code.controllers, unit.folder.code.study.loop.sample_time
    for drawn, controller in zip(draws, controllers, strict=True):
        for parameter, value in zip(controller.parameters, drawn.parameters, strict=True):
            slave.setReal([unit.references[parameter_name(controller, parameter)]], [float(value)])
    found = []
    for k in range(len(draws[0].rows)):
        for drawn, controller in zip(draws, controllers, strict=True):
            names = [unit.references[channel_variable(controller, name)] for name in SIGNALS]
            slave.setReal(names, [float(x) for x in drawn.rows[k, :5]])
        slave.doStep(k * time, time)
        found.append(
            [
                slave.getReal([unit.references[channel_variable(controller, name)] for name in RESULTS])
                for controller in controllers
            ]
        )
    return np.array(found), np.stack([drawn.rows[:, 5:8] for drawn in draws], axis=1)


def recorded(folder, samples, draws=1):
    """Draws, each a list with one record for each channel."""
    records = list(recorded_draws(folder.code.study, folder.code.controllers, draws, samples))
    count = len(folder.code.controllers)
    return [records[i : i + count] for i in range(0, len(records), count)]


CASES = {
    "pi, law, float32": dj.Study.from_table(table(PI, precision=32)),
    "pid": dj.Study.from_table(table(PID)),
    "levant and dssc": dj.Study.from_table(table(ROWS["approx_sta_2"], LEVANT)),
    "dssc vgsta": dj.Study.from_table(table(ROWS["vgsta"])),
    "motor": dj.Study.load("motor"),
    "vehicle": dj.Study.load("uav_robustness"),
}


@needs_library
@pytest.mark.parametrize("case", CASES)
def test_same_bits_as_the_analysis(case, opened):
    unit = opened(CASES[case])
    for draws in recorded(unit.folder, 60, draws=2):
        with instance(unit) as slave:
            found, expected = replayed(unit, slave, draws)
        assert np.array_equal(found, expected.astype(float))


@needs_library
def test_a_tool_simulates_it(opened):
    """FMPy's own master: what it records after a step is the command of the sample at the step's begin."""
    unit = opened(CASES["pid"])
    ((drawn,),) = recorded(unit.folder, 100)
    time = unit.folder.code.study.loop.sample_time * np.arange(100)
    columns = np.rec.fromarrays([time, *drawn.rows[:, :5].T], names=["time", *SIGNALS])
    result = fmpy.simulate_fmu(unit.file, input=columns, output=RESULTS, stop_time=0.99, step_size=0.01)
    assert np.max(np.abs(result["command.u_p"][1:100] - drawn.rows[: len(result["command.u_p"]) - 1, 7])) <= 1e-12


@needs_library
def test_sources_compile_with_the_standard_headers(opened):
    """As source-code FMU, built by FMPy with CMake; then the same bits."""
    require("cmake")
    unit = opened(CASES["pid"])
    source_only = unit.file.replace(".fmu", "_sources.fmu")
    Path(source_only).write_bytes(unit.folder.fmu().archive())
    place = unit._replace(place=fmpy.extract(source_only, unzipdir=f"{unit.place}_built"))
    cmake = Path(f"{place.place}_cmake")
    cmake.mkdir()
    build_platform_binary(place.place, build_dir=cmake)
    (draws,) = recorded(unit.folder, 20)
    with instance(place) as slave:
        found, expected = replayed(place, slave, draws)
    assert np.array_equal(found, expected)


@needs_library
def test_parameters_change_between_steps_and_reset_restores(opened):
    unit = opened(CASES["pid"])
    (draws,) = recorded(unit.folder, 30)
    with instance(unit) as slave:
        first, expected = replayed(unit, slave, draws)
        slave.reset()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        second, _ = replayed(unit, slave, draws)
        assert np.array_equal(first, second)
        assert expected[-1, 0, 2] == -0.5  # at its lower limit
        low = unit.references["controller.low"]
        (previous,) = slave.getReal([low])
        slave.setReal([low], [-0.25])
        slave.doStep(0.30, 0.01)
        assert slave.getReal([unit.references["command.u_p"]]) == [-0.25]
        slave.reset()
        assert slave.getReal([low]) == [previous]


@needs_library
def test_two_instances_do_not_meet(opened):
    unit = opened(CASES["pid"])
    (first_draw,), (second_draw,) = recorded(unit.folder, 30, draws=2)
    with instance(unit, name="first") as first, instance(unit, name="second") as second:
        commands = [[], []]
        for k in range(30):
            for place, (slave, drawn) in enumerate(((first, first_draw), (second, second_draw))):
                slave.setReal([unit.references[name] for name in SIGNALS], [float(x) for x in drawn.rows[k, :5]])
                slave.doStep(0.01 * k, 0.01)
                commands[place] += slave.getReal([unit.references["command.u_p"]])
    assert np.array_equal(commands[0], first_draw.rows[:, 7])
    assert np.array_equal(commands[1], second_draw.rows[:, 7])


@needs_library
def test_a_saved_state_repeats_the_step(opened):
    unit = opened(CASES["levant and dssc"])
    with instance(unit) as slave:
        output = [unit.references["command.u_p"]]
        slave.setReal([unit.references["measurement.y"]], [0.3])
        slave.doStep(0.0, 0.01)
        kept = slave.getFMUState()
        assert isinstance(kept, c_void_p)
        slave.doStep(0.01, 0.01)
        first = slave.getReal(output)
        slave.setFMUState(kept)
        slave.doStep(0.01, 0.01)
        assert slave.getReal(output) == first
        slave.freeFMUState(kept)


@needs_library
def test_misuse_is_an_error_with_a_reason(opened):
    unit, said = opened(CASES["pid"]), []
    with instance(unit, said) as slave:
        wrong = [
            (
                lambda: slave.doStep(0.0, 0.02),
                "the communication step is 0.02 s; the controller's sample time is 0.01 s",
            ),
            (lambda: slave.doStep(0.0, float("nan")), "the communication step is nan s"),
            (lambda: slave.setReal([unit.references["command.u"]], [1.0]), "an output cannot be set"),
            (lambda: slave.getReal([999]), "no real variable with the value reference 999"),
            (lambda: slave.getBoolean([0]), "no boolean variable"),
            (lambda: slave.enterInitializationMode(), "enterInitializationMode comes once"),
        ]
        for call, reason in wrong:
            with pytest.raises(FMICallException):
                call()
            assert reason in said[-1]
        slave.doStep(0.0, 0.01)
        with pytest.raises(FMICallException):
            slave.doStep(0.02, 0.01)
        assert "begins at 0.02 s; the controller's next sample is at 0.01 s" in said[-1]
        slave.setReal([unit.references["measurement.y"]], [1e308])
        slave.setReal([unit.references["reference.y"]], [-1e308])
        with pytest.raises(FMICallException):
            slave.doStep(0.01, 0.01)
        assert "the command or the state would not be finite after the sample at 0.01 s" in said[-1]
        assert slave.getInteger([unit.references["flag"]]) == [2]
        with pytest.raises(FMICallException):
            slave.doStep(0.02, 0.01)
        assert "reset the FMU" in said[-1]


@needs_library
def test_a_broken_input_holds_command_and_telemetry(opened):
    unit, said = opened(CASES["pid"]), []
    outputs = [place for name, place in unit.references.items() if name.startswith(("command", "telemetry"))]
    with instance(unit, said) as slave:
        slave.setReal([unit.references["measurement.y"]], [0.3])
        slave.doStep(0.0, 0.01)
        held = slave.getReal(outputs)
        slave.setReal([unit.references["measurement.y"]], [float("nan")])
        slave.doStep(0.01, 0.01)
        assert "is not finite at 0.01 s: the command is held" in said[-1]
        assert slave.getReal(outputs) == held
        assert slave.getInteger([unit.references["flag"]]) == [1]
        slave.setReal([unit.references["measurement.y"]], [0.3])
        slave.doStep(0.02, 0.01)
        assert slave.getInteger([unit.references["flag"]]) == [0]
        assert np.isfinite(slave.getReal(outputs)).all()


@needs_library
def test_parameters_outside_of_their_ranges_are_refused(opened):
    unit, said = opened(CASES["pid"]), []
    with instance(unit, said) as slave:
        slave.setReal([unit.references["controller.k_p"]], [-1.0])
        with pytest.raises(FMICallException):
            slave.doStep(0.0, 0.01)
        assert "the parameter controller.k_p must be finite and >= 0" in said[-1]


@needs_library
def test_names_that_xml_escapes(opened):
    units = {"output": "m", "output_meaning": 'a <b> & "c" \u03bc'}
    unit = opened(dj.Study.from_table(table(PID) | {"name": "4.th-study", "units": units}))
    assert unit.description.coSimulation.modelIdentifier == "study_4_th_study"
    described = {variable.name: variable.description for variable in unit.description.modelVariables}
    assert described["measurement.y"] == 'measured a <b> & "c" \u03bc'
    assert xml_text("one\ntwo \x01") == "one two \ufffd"


def test_units_of_the_description():
    assert base_exponents("V s/rad") == {"kg": 1, "m": 2, "s": -2, "A": -1, "rad": -1}
    assert base_exponents("1") == {}
    assert base_exponents("y/s") is None
    assert base_exponents("(m/s)^(1/2)") is None
    assert base_exponents("no unit!") is None


def test_command(tmp_path, capsys):
    """Description and sources hold what they say; the same study makes the same bytes."""
    require("cc")
    arguments = ["code", "motor", "--draws", "1", "--samples", "20", "--fmu", "--json", "--out"]
    assert guarded([*arguments, str(tmp_path / "a")]) == 0
    found = last_json(capsys)
    assert found["fmu"] == {
        "file": "motor.fmu",
        "library": platform.machine() == "x86_64",
        "reason": found["fmu"]["reason"],
    }
    assert "motor.fmu" in found["files"]
    assert guarded([*arguments, str(tmp_path / "b")]) == 0
    first, second = ((tmp_path / folder / "motor.fmu").read_bytes() for folder in "ab")
    assert first == second
    with zipfile.ZipFile(tmp_path / "a" / "motor.fmu") as archive:
        source = archive.read("sources/motor_controller.c").decode()
    assert source == (tmp_path / "a" / "motor_controller.c").read_text()
    variables = {
        variable.name: variable for variable in read_model_description(str(tmp_path / "a" / "motor.fmu")).modelVariables
    }
    gain = variables["controller.k_p"]
    assert (gain.causality, gain.variability, gain.start, gain.unit) == ("parameter", "tunable", "100.0", "V s/rad")
    assert variables["measurement.y"].description == "measured shaft speed"
    assert variables["command.u_p"].unit == "V"


def test_without_a_compiler_the_sources_are_written(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(fmu_module.shutil, "which", lambda name: None)
    out = str(tmp_path / "motor")
    assert guarded(["code", "motor", "--draws", "1", "--samples", "20", "--fmu", "--out", out]) == 0
    assert "its sources only: no compiler is found (cc, gcc, clang)" in capsys.readouterr().out
    assert validation.validate_fmu(f"{out}/motor.fmu") == []
    with zipfile.ZipFile(f"{out}/motor.fmu") as archive:
        assert not any(name.startswith("binaries") for name in archive.namelist())


def test_a_compiler_that_fails_gives_its_reason(monkeypatch):
    require("cc")
    unit = FlightFolder(CASES["pid"]).fmu()
    broken = fmu_module.ControllerFmu(
        unit.name, unit.description, unit.sources | {"fmu.c": "int main(void) { nothing }"}
    )
    library, reason = build_fmu_library(broken)
    assert library is None
    assert "error" in str(reason)
