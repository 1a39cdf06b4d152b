"""What generated controllers do beside a plain step: angles, broken inputs, parameters, starts, names, C++."""

import math
import subprocess
from typing import Annotated, NamedTuple

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.contracts import Controller
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Command
from dssc_jax.flight_code.controller import channel_labels
from dssc_jax.flight_code.folder import FlightFolder
from dssc_jax.flight_code.recording import recorded_draws
from dssc_jax.flight_logs.channel_replay import analysed_command
from dssc_jax.lanes.c.names import c_string, member_names, prefix_name
from tests.angles import heading
from tests.flight_code.compiling import FLAGS, CompiledController, made, require
from tests.flight_code.test_code import table, values_compared, written

PI = {"kind": "pi", "k_p": 1.5, "k_i": 0.5}
DSSC = {
    "kind": "dssc",
    "rho": 2.0,
    "functions": {"kind": "approx_sta_2", "kappa1": 2.0, "kappa2": 2.0, "delta": 0.5, "tau_av": 0.05},
}
LEAD = {"kind": "lead_filter", "tau_f": 0.02}
CPP_FLAGS = ["-std=c++11", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic"]


def principal(angle):
    """The angle in (-pi, pi], by the complex plane."""
    return float(np.angle(np.exp(1j * angle)))


@pytest.fixture(scope="module")
def steering(tmp_path_factory):
    """The controller of a heading with a lead filter, compiled."""
    study = dj.Study.from_table(heading(differentiator=LEAD))
    return study, CompiledController(FlightFolder(study), tmp_path_factory.mktemp("steering"))


@pytest.mark.parametrize("psi", [-3.1, 3.1, -math.pi, 3.0, 0.2, 7.0, -40.0])
@pytest.mark.parametrize("desired", [3.1, -3.1, math.pi, -2.9, 0.0, -25.0])
def test_the_error_of_an_angle_is_wrapped_in_c(steering, psi, desired):
    """PI by hand: u = -(k_p + k_i T_s) sigma with sigma = l_0 e at the first sample, and the short way round."""
    _, compiled = steering
    compiled.reset()
    answer = compiled.step((psi, 0.0), (desired, 0.0, 0.0))
    expected = -(4.0 + 1.0 * 0.005) * 0.5 * principal(psi - desired)
    assert answer.flag == 0
    if abs(abs(principal(psi - desired)) - math.pi) < 1e-9:
        expected = math.copysign(expected, answer.command[2])  # half a turn: either way
    assert answer.command[2] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("psi", "desired", "flag"), [(0.9e5, 0.9e5, 0), (1.1e5, 0.0, 1), (0.0, -1e30, 1), (0.0, 0.0, 0)]
)
def test_an_angle_whose_turns_have_no_resolution_is_refused(steering, psi, desired, flag):
    """A reading of 1e30 made all later ones continuous with it."""
    _, compiled = steering
    compiled.reset()
    assert compiled.step((0.1, 0.0), (0.0, 0.0, 0.0)).flag == 0
    answer = compiled.step((psi, 0.0), (desired, 0.0, 0.0))
    assert answer.flag == flag
    assert abs(compiled.step((0.1, 0.0), (0.0, 0.0, 0.0)).command[2]) > 0.01


def test_c_and_replay_agree_for_any_turns_of_the_same_flight(steering):
    """A heading that turns through pi, given continuous, wrapped, and with turns added at random."""
    study, compiled = steering
    rng = np.random.default_rng(4)
    times = 0.005 * np.arange(400)
    psi, desired = 2.5 + 1.2 * times + 0.1 * np.sin(9.0 * times), 2.6 + 1.2 * times
    rate = np.full(400, 1.2)
    turns = 2.0 * np.pi * rng.integers(-3, 4, (2, 400))
    shapes = {
        "continuous": (psi, desired),
        "wrapped": (np.angle(np.exp(1j * psi)), np.angle(np.exp(1j * desired))),
        "turned": (psi + turns[0], desired + turns[1]),
    }
    flown = {}
    for name, (measured, goal) in shapes.items():
        compiled.reset()
        steps = zip(measured, goal, strict=True)
        flown[name] = np.array([compiled.step((m, 0.0), (r, 1.2, 0.0)).command[2] for m, r in steps])
        reference = np.stack([goal, rate, 0.0 * rate])
        replayed = analysed_command(study, 0, np.stack([measured, 0.0 * rate]), reference)
        assert np.max(np.abs(replayed - flown[name])) < 1e-9
    assert np.max(np.abs(flown["wrapped"] - flown["continuous"])) < 1e-9
    assert np.max(np.abs(flown["turned"] - flown["continuous"])) < 1e-9
    assert np.max(np.abs(flown["continuous"])) < 6.0  # a turn through the lead filter would give 1,250


@pytest.mark.parametrize("precision", [64, 32])
def test_recordings_have_raw_angles(precision, tmp_path):
    """The bench replays readings in (-pi, pi] that jump by a turn."""
    require("cc", "make")
    turning = heading(
        start=2.5,
        reference={"kind": "ramp", "slope": 2.0, "offset": 2.6},
        differentiator=LEAD,
        sensor={"kind": "noisy", "position_std": 0.001, "jitter": 0.004},
        loop={"duration": 3.0, "sample_time": 0.005, "precision": precision},
        controller=DSSC | {"l0": 1.0},
    )
    study = dj.Study.from_table(turning)
    folder = written(tmp_path, study, draws=2, samples=600)
    for recorded in recorded_draws(study, folder.code.controllers, 2, 600):
        readings = recorded.rows[:, 0]
        assert np.max(np.abs(readings)) <= np.pi + 1e-6
        assert np.sum(np.abs(np.diff(readings)) > 6.0) >= 1
        assert np.max(np.abs(np.diff(recorded.rows[:, 7]))) < 1.0
    (controller,) = folder.code.controllers
    assert values_compared(made(tmp_path, "check")) == 2 * 600 * (3 + len(controller.states) + len(controller.infos))


@pytest.fixture(scope="module", params=[PI, DSSC], ids=["pi", "dssc"])
def compiled(request, tmp_path_factory):
    """A compiled controller with a differentiator."""
    study = dj.Study.from_table(table(request.param, LEAD))
    return CompiledController(FlightFolder(study), tmp_path_factory.mktemp("compiled"))


def samples(count):
    """Measurements and references of a flight."""
    for k in range(count):
        yield (0.3 * math.cos(0.1 * k), 0.0), (0.1 * math.sin(0.07 * k), 0.01, 0.0)


@pytest.mark.parametrize("place", range(5))
@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_a_broken_input_destroys_nothing(compiled, place, number):
    """The sample with it is as if it had never been, but for the flag; the command is held."""
    compiled.reset()
    undisturbed = [compiled.step(*sample) for sample in samples(20)]
    compiled.reset()
    for k, (measurement, reference) in enumerate(samples(20)):
        if k == 10:
            signals = [*measurement, *reference]
            signals[place] = number
            held = compiled.step(tuple(signals[:2]), tuple(signals[2:]))
            assert held.flag == 1
            assert held.command == undisturbed[9].command
            assert held.state == undisturbed[9].state
        assert compiled.step(measurement, reference) == undisturbed[k]


def test_a_result_that_overflows_destroys_nothing(compiled):
    compiled.reset()
    settled = [compiled.step(*sample) for sample in samples(5)][-1]
    answer = compiled.step((1e308, 0.0), (-1e308, 0.0, 0.0))
    assert answer.flag == 2
    assert answer.command == settled.command
    assert answer.state == settled.state


def test_before_the_first_sample_the_command_is_zero(tmp_path):
    fresh = CompiledController(FlightFolder(dj.Study.from_table(table(PI))), tmp_path)
    assert fresh.step((math.nan, 0.0), (0.0, 0.0, 0.0))[:2] == (1, (0.0, 0.0, 0.0))
    assert fresh.step((0.1, 0.0), (0.0, 0.0, 0.0)).flag == 0


def test_parameters_are_checked_against_their_ranges(tmp_path):
    compiled = CompiledController(FlightFolder(dj.Study.from_table(table(DSSC))), tmp_path)
    names = [parameter.name for parameter in compiled.controller.parameters]
    header = (tmp_path / "flown_controller.h").read_text()
    assert compiled.check() == 0
    for name, number in (
        ("rho", -1.0),
        ("rho", 0.0),
        ("functions_tau_av", math.nan),
        ("l0", math.inf),
        ("functions_kappa1", -1.0),
    ):
        original = getattr(compiled.memory.parameters, name)
        setattr(compiled.memory.parameters, name, number)
        found = compiled.check()
        assert names[found - 1] == name
        assert f" {name};  /* {found}: " in header
        setattr(compiled.memory.parameters, name, original)
    assert compiled.check() == 0
    assert "> 0" in next(line for line in header.splitlines() if " rho;  /*" in line)


def test_limits_are_checked_in_pairs(tmp_path):
    """The lower one is named where it is not below the upper one, and its comment says so."""
    limits = {"kind": "pid", "k_p": 1.0, "low": -0.5, "high": 0.5}
    compiled = CompiledController(FlightFolder(dj.Study.from_table(table(limits))), tmp_path)
    names = [parameter.name for parameter in compiled.controller.parameters]
    assert compiled.check() == 0
    compiled.memory.parameters.low = 0.6
    assert names[compiled.check() - 1] == "low"
    compiled.memory.parameters.high = 0.7
    assert compiled.check() == 0
    header = (tmp_path / "flown_controller.h").read_text()
    assert "lower limit of the command, < high; -0.5 */" in header


def test_reset_is_a_fresh_start(compiled):
    compiled.reset()
    first = [compiled.step(*sample) for sample in samples(10)]
    compiled.reset()
    assert compiled.state() == (0.0,) * len(compiled.state())
    assert [compiled.step(*sample) for sample in samples(10)] == first


@pytest.mark.parametrize("command", [0.4, -0.7, 0.0])
def test_a_start_without_a_bump(compiled, command):
    """The first command is the one before, and the next ones go on from it."""
    compiled.reset()
    measurement, reference = (0.12, 0.0), (0.1, 0.0, 0.0)
    assert compiled.transfer(measurement, reference, command) == 0
    first = compiled.step(measurement, reference)
    assert first.command[2] == pytest.approx(command, abs=1e-9)
    assert compiled.step(measurement, reference).command[2] == pytest.approx(command, abs=0.05)


def test_a_command_that_cannot_be_carried(compiled, tmp_path):
    measurement, reference = (0.12, 0.0), (0.1, 0.0, 0.0)
    compiled.reset()
    previous = compiled.step(measurement, reference)
    assert compiled.transfer(measurement, reference, math.nan) == 1
    assert compiled.state() == previous.state
    limited = {"kind": "pid", "k_p": 1.0, "k_i": 0.5, "low": -0.5, "high": 0.5}
    place = tmp_path / "limited"
    place.mkdir()
    pid = CompiledController(FlightFolder(dj.Study.from_table(table(limited))), place)
    assert pid.transfer(measurement, reference, 0.4) == 0
    assert pid.transfer(measurement, reference, 2.0) == 4
    assert pid.step(measurement, reference).command[2] == 0.5
    pid.memory.parameters.k_i = 0.0
    assert pid.transfer(measurement, reference, 0.4) == 4
    at_rest = (0.12, 0.0), (0.12, 0.0, 0.0)
    assert pid.transfer(*at_rest, 1e-11) == 0  # the command would be 0
    assert pid.transfer(*at_rest, 1e-8) == 4


def test_a_controller_without_state_says_that_it_cannot_transfer():
    texts = FlightFolder(dj.Study.from_table(table({"kind": "smc", "gain": 1.0}))).texts()
    assert "No flown_transfer" in texts["flown_controller.h"]
    assert "flown_transfer" not in texts["flown_controller.c"]
    assert "there is no `flown_transfer`" in texts["README.md"]


def test_what_is_not_generated_is_said():
    texts = FlightFolder(dj.Study.load("uav_robustness")).texts()
    for text in (texts["README.md"], " ".join(texts["uav_robustness_controller.h"].replace("\n *", "").split())):
        for part in ("attitude loops", "velocity loops", "mixer", "sensors"):
            assert part in text


@pytest.mark.parametrize("precision", [64, 32])
def test_the_sources_are_cpp(precision, tmp_path):
    """Compiled as C++ and called from C; and called from C++ when compiled as C."""
    require("cc", "c++", "make")
    written(tmp_path, dj.Study.from_table(table(DSSC, LEAD, precision)))
    values_compared(made(tmp_path, "cpp"))
    (tmp_path / "flight.cpp").write_text(
        '#include "flown_controller.h"\nint main() {\n    flown_controller controller;\n    flown_init(&controller);\n'
        "    return static_cast<int>(flown_check(&controller.parameters));\n}\n"
    )
    subprocess.run(["cc", *FLAGS, "-c", "flown_controller.c", "-o", "c.o"], cwd=tmp_path, check=True)
    subprocess.run(["c++", *CPP_FLAGS, "flight.cpp", "c.o", "-o", "flight"], cwd=tmp_path, check=True)
    assert subprocess.run(["./flight"], cwd=tmp_path, check=False).returncode == 0


UGLY = ["main", "int", "replay", "real", "errno", "class", "stdin", "printf"]


@pytest.mark.parametrize("name", UGLY)
def test_a_study_of_any_name_compiles(name, tmp_path):
    """Keywords, C's library, the bench's own names."""
    require("cc", "c++")
    folder = FlightFolder(dj.Study.from_table(table(PI) | {"name": name}))
    for file, text in folder.texts().items():
        (tmp_path / file).write_text(text)
    (source,) = tmp_path.glob("*_controller.c")
    subprocess.run(["cc", *FLAGS, "-fsyntax-only", source.name, "bench.c"], cwd=tmp_path, check=True)
    subprocess.run(["c++", *CPP_FLAGS, "-fsyntax-only", "-x", "c++", source.name], cwd=tmp_path, check=True)


class UglyGains(NamedTuple):
    """Names that mean something in C or C++."""

    main: Annotated[float, Quantity("1", "gain", at_least=0.0)] = 1.0
    int: Annotated[float, Quantity("1", "offset */ of the command")] = 0.1
    errno: Annotated[float, Quantity("1", "gain")] = 1.0
    new: Annotated[float, Quantity("1", "gain")] = 1.0
    stdin: Annotated[float, Quantity("1", "gain")] = 1.0
    EPSILON: Annotated[float, Quantity("1", "gain")] = 1.0
    K: Annotated[float, Quantity("1", "gain")] = 1.0
    linux: Annotated[float, Quantity("1", "gain")] = 1.0
    l0: Annotated[float, Quantity("1/s", "error pole", above=0.0)] = 1.0


class UglyInfo(NamedTuple):
    """Telemetry with such names."""

    int: float
    INFINITY: float
    operator: float


def ugly_step(gains, state, measurement, reference, dt):
    total, (integral,) = state
    errno = gains.main * (measurement.y - reference.y) + gains.int
    main = errno * gains.errno * gains.new * gains.stdin * gains.EPSILON
    printf = main * gains.K * gains.linux + total
    stdout = printf + integral
    return (total + dt * stdout, (integral + dt * printf,)), Command(-stdout, main), UglyInfo(main, printf, errno)


UGLY_CONTROLLER = Controller(UglyGains, init=lambda gains, measurement, reference: (0.0, (0.0,)), step=ugly_step)


def test_parameters_states_and_telemetry_of_any_name(tmp_path):
    require("cc", "c++", "make")
    study = dj.Study.from_table(table({"kind": "tests.flight_code.test_generated_functions:UGLY_CONTROLLER"}, LEAD))
    folder = written(tmp_path, study)
    (controller,) = folder.code.controllers
    assert controller.states == ("differentiator_y", "differentiator_velocity", "value_0", "value_1_0")
    values_compared(made(tmp_path, "check"))
    values_compared(made(tmp_path, "cpp"))


def test_names():
    assert prefix_name("main") == "study_main"
    assert prefix_name("pthread-mutex") == "study_pthread_mutex"
    assert prefix_name("4.th-study") == "study_4_th_study"
    assert prefix_name("semantic") == "semantic"
    assert member_names(["k_p", "int", "", "0", "K", "k p", "k_p"]) == [
        "k_p",
        "int_",
        "value",
        "value_0",
        "K_",
        "k_p_2",
        "k_p_3",
    ]
    assert channel_labels(("x", "a b", "a_b", "\u00b5")) == ["x", "a_b", "a_b_2", "channel"]
    assert c_string('a "b" \\ ??/ \u00b5') == '"a \\"b\\" \\\\ ?\\?/ ?"'
