"""FMUs as plant and controller: the loop of the package's own models, for every draw."""

import ctypes
import struct

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.native_build import build_fmu_library
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.native import fmu_instances
from dssc_jax.core.native.fmu_instances import FmuPorts, Instances, require_no_faults
from dssc_jax.core.signals import Outcome
from dssc_jax.engine.batching import values_of_draws
from dssc_jax.flight_code.folder import FlightFolder
from tests import fmus
from tests.fmu_loops import (
    DRAWS,
    EQUAL,
    K_P,
    METRICS,
    NAMES,
    OWN_PID,
    OWN_PLANT,
    assert_same,
    assert_same_verdicts,
    controller_of,
    loop_of,
    own_results,
    plant_of,
    results,
)

fmpy = pytest.importorskip("fmpy")

# The same numbers


def test_a_loop_of_fmus_is_that_of_the_own_models(place, version):
    source = {"version": version}
    file = fmus.built(place, fmus.renamed(fmus.MASS, "mass" + version[0], **source))
    controller = fmus.built(place, fmus.renamed(fmus.PID, "pid" + version[0], **source))
    study = loop_of(plant_of(file), controller_of(controller))
    found = values_of_draws(study, slice(0, DRAWS))
    assert_same_verdicts(results(study, found), own_results(OWN_PLANT, OWN_PID, found))


@pytest.mark.parametrize("part", ["plant", "controller"])
def test_each_part_alone(part, study, mass, pid, values):
    plant = plant_of(mass) if part == "plant" else OWN_PLANT
    controller = controller_of(pid) if part == "controller" else OWN_PID
    mixed = loop_of(plant, controller)
    named = {name if name in mixed.laws else NAMES[name]: column for name, column in values.items()}
    assert_same(results(mixed, named), own_results(OWN_PLANT, OWN_PID, values))


def test_neither_order_nor_blocks_nor_threads_matter(study, values):
    expected = results(study, values, devices=1)
    mixed = np.random.default_rng(1).permutation(DRAWS)
    for found in (results(study, values, mixed, lanes=5, devices=2), results(study, values, lanes=7)):
        for name, column in expected.items():
            assert np.array_equal(found[name], column, equal_nan=True), name


def test_plain_xla_and_the_stored_run_agree(study, tmp_path, monkeypatch):
    ours = dj.run(study, tmp_path / "lanes")
    monkeypatch.setenv("DSSC_JAX_KERNEL", "scan")
    theirs = dj.run(study, tmp_path / "scan")
    for name in METRICS:
        np.testing.assert_allclose(ours.dataset[name], theirs.dataset[name], rtol=EQUAL)
    assert dj.verify(ours).verdict == "agrees"
    assert dj.replay(ours, 3).attrs["agreement"] == "agrees"


def test_draws_without_any_law_have_instances_of_their_own(mass, pid):
    """Nothing differs between the draws but the noise; a shared instance would mix them."""
    plant = plant_of(mass, parameters={"x0": 0.5, "drag": 1.0, "body_gain": 1.0})
    controller = controller_of(pid, parameters={"k_p": 5.0, "k_i": 2.0, "k_d": 3.0, "filter": 0.02})
    noise = {"kind": "noisy", "position_std": 0.01}
    study = loop_of(plant, controller, sensor=noise)
    own = loop_of({**OWN_PLANT, "k_p": 1.0, "a_p": 1.0, "initial": [0.5, 0.0]}, {**OWN_PID, "k_p": 5.0}, sensor=noise)
    found = results(study, {})
    expected = results(own, {})
    assert len(np.unique(found["error_rms"])) == DRAWS
    for name in METRICS:
        np.testing.assert_allclose(found[name], expected[name], rtol=EQUAL)
    plain = results(study, {}, kernel="scan")
    np.testing.assert_allclose(plain["error_rms"], found["error_rms"], rtol=EQUAL)


def test_a_generated_controller_flies_as_an_fmu(place):
    """The FMU that this package writes is the controller again, with the gains of each draw."""
    gains = {"kind": "pid", "k_p": K_P, "k_i": 2.0, "k_d": 3.0, "filter": 0.02, "low": -4.0, "high": 4.0}
    original = loop_of(OWN_PLANT, gains)
    unit = FlightFolder(original).fmu()
    library, reason = build_fmu_library(unit)
    if library is None:
        pytest.skip(f"no library: {reason}")
    file = place / "generated.fmu"
    file.write_bytes(unit.archive(library))
    inputs = {"y": "measurement.y", "y_dot": "measurement.y_dot", "y_ref": "reference.y"}
    inputs |= {"y_ref_dot": "reference.y_dot", "y_ref_ddot": "reference.y_ddot"}
    table = {"kind": "fmu", "file": str(file), "sha256": dj.allow_native(file).sha256, "inputs": inputs}
    study = loop_of(OWN_PLANT, {**table, "command": "command.u_p", "parameters": {"controller_k_p": K_P}})
    numbers = values_of_draws(original, slice(0, DRAWS))
    expected = results(original, numbers)
    moved = {name.replace("controller.k_p", "controller.parameters.controller_k_p"): x for name, x in numbers.items()}
    assert_same(results(study, moved), expected)
    assert expected["command_max"].max() == 4.0  # at its limit


# Other programs


def test_fmpy_simulates_the_same_flight(study, mass):
    """FMPy's own master, driven by the commands of a trajectory."""
    flight = dj.simulate(study, draw=2)
    start = {"body.gain": "body_gain", "drag": "drag", "x0": "x0"}
    start = {name: float(flight.attrs[f"plant.parameters.{number}"]) for name, number in start.items()}
    time = flight["t"].values
    disturbance = np.where(time >= 2.0 - 1e-9, 0.5, 0.0)
    columns = np.rec.fromarrays([time, flight["u_total"].values + disturbance], names=["time", "u"])
    found = fmpy.simulate_fmu(
        str(mass),
        start_values=start,
        input=columns,
        output=["x", "v"],
        output_interval=0.01,
        stop_time=float(time[-1]),
        use_event_mode=False,
    )
    np.testing.assert_allclose(found["x"], flight["y"].values, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found["v"], flight["y_dot"].values, rtol=1e-9, atol=1e-12)


def test_numpy_computes_the_same_flight(study):
    """A loop of its own: a matrix exponential by its series for the mass, and the PID's equations."""
    flight = dj.simulate(study, draw=5)
    number = {name.rpartition(".")[2]: flight.attrs[name] for name in study.laws}
    k_p, drag, gain = number["k_p"], number["drag"], number["body_gain"]
    system = np.array([[0.0, 1.0, 0.0], [0.0, -drag, gain], [0.0, 0.0, 0.0]]) * 0.01
    held, term = np.eye(3), np.eye(3)
    for order in range(1, 20):
        term = term @ system / order
        held = held + term
    x, sums, slope, last = np.array([number["x0"], 0.0]), 0.0, 0.0, -number["x0"]
    for k, t in enumerate(flight["t"].values):
        error = np.sin(2.0 * np.pi * t / 4.0) - x[0]
        slope = (0.02 * slope + 3.0 * (-x[0] - last)) / 0.03
        last = -x[0]
        u = k_p * error + sums + slope
        assert flight["u"][k] == pytest.approx(u, rel=1e-9, abs=1e-10)
        assert flight["integral"][k] == pytest.approx(sums, rel=1e-9, abs=1e-10)
        sums += 0.01 * 2.0 * error
        x = (held @ np.array([*x, u + (0.5 if k >= 200 else 0.0)]))[:2]


def test_units_and_meanings_are_those_of_the_fmu(study):
    flight = dj.simulate(study, draw=0)
    assert flight["y"].attrs["units"] == "m"
    assert flight["u"].attrs["units"] == "N"
    assert flight["power"].attrs["long_name"] == "power"
    assert study.quantities["plant.parameters.drag"].interval == ">= 0.01"
    assert np.ptp(flight["power"].values) > 0.0


# Steps of other lengths


def test_substeps_and_a_lag(mass):
    """The mean of a lag over each step reaches the FMU; more steps come nearer to the exact solution."""
    lag = {"kind": "lag", "mu": 0.05}
    pid = {**OWN_PID, "k_p": 5.0, "k_d": 2.0}
    plain = {"reference": {"kind": "zero"}, "disturbance": {"kind": "none"}, "unmodelled": lag}
    exact = dj.simulate(loop_of({**OWN_PLANT, "k_p": 1.0, "a_p": 1.0, "initial": [0.5, 0.0]}, pid, **plain))["y"].values
    gaps = []
    for substeps in (1, 2, 4):
        plant = plant_of(mass, parameters={"x0": 0.5, "body_gain": 1.0, "drag": 1.0})
        loop = {"duration": 3.0, "sample_time": 0.01, "substeps": substeps}
        gaps.append(np.max(np.abs(dj.simulate(loop_of(plant, pid, **plain, loop=loop))["y"].values - exact)))
    assert gaps[0] < 1e-4
    assert gaps[1] < 0.3 * gaps[0]  # of second order
    assert gaps[2] < 0.3 * gaps[1]
    assert not dj.integration_error(loop_of(plant, pid, **plain)).exact
    constant = {"disturbance": {"kind": "constant", "value": 0.1}, "reference": {"kind": "zero"}}
    assert dj.integration_error(loop_of(plant, pid, **constant)).exact


def test_without_a_rate_the_difference_quotient_is_taken(mass):
    table = plant_of(mass)
    del table["y_dot"]
    flight = dj.simulate(loop_of(table, OWN_PID), draw=1)
    y, y_dot = flight["y"].values, flight["y_dot"].values
    np.testing.assert_allclose(y_dot[1:], np.diff(y) / 0.01, rtol=1e-9, atol=1e-12)
    assert y_dot[0] == 0.0


def test_disturbances_have_inputs_of_their_own(mass, values):
    """At the FMU's own input d the disturbance acts as if it were added to the command; so does a named input."""
    expected = own_results(OWN_PLANT, OWN_PID, values)
    named = {name if name.startswith("plant") else NAMES[name]: column for name, column in values.items()}
    beside = loop_of(plant_of(mass, disturbance="d"), OWN_PID)
    assert_same(results(beside, named), expected)
    step = {"kind": "step", "value": 0.5, "at": 2.0, "input": "gust"}
    gust = loop_of(plant_of(mass, inputs={"gust": "d"}), OWN_PID, disturbance=[step])
    assert_same(results(gust, named), expected)


# Failures


def test_a_step_that_fails_ends_its_draw_alone(mass, tmp_path):
    plant = plant_of(mass)
    plant["parameters"]["fails_at"] = {"choice": [0.0, 1.5]}
    study = loop_of(plant, OWN_PID)
    result = dj.run(study, tmp_path / "fails")
    failing = result.dataset["plant.parameters.fails_at"].values > 0.0
    assert 0 < failing.sum() < DRAWS
    outcome = result.dataset["outcome"].values
    assert np.all(outcome[failing] == Outcome.NON_FINITE)
    assert np.all(outcome[~failing] != Outcome.NON_FINITE)
    np.testing.assert_allclose(result.dataset["failed_at"].values[failing], 1.51)
    assert dj.verify(result).verdict == "agrees"  # by the plain program, in which ended draws stay where they are


def test_a_draw_that_cannot_start_has_diverged(place):
    start = "if (r[4] > 1.0) return 3; " + fmus.MASS.start
    file = fmus.built(place, fmus.renamed(fmus.MASS, "fussy", start=start))
    plant = plant_of(file, parameters={"drag": {"uniform": [0.5, 1.5]}})
    study = loop_of(plant, OWN_PID)
    numbers = values_of_draws(study, slice(0, DRAWS))
    found = results(study, numbers)
    heavy = numbers["plant.parameters.drag"] > 1.0
    assert 0 < heavy.sum() < DRAWS
    assert np.array_equal(found["outcome"] == Outcome.NON_FINITE, heavy)


def test_an_unstable_loop_ends_as_one_that_diverges(mass, pid):
    """The FMU gets no input that is not finite, and is freed."""
    study = loop_of(plant_of(mass), controller_of(pid, parameters={"k_p": 1e7}))
    assert set(results(study, values_of_draws(study, slice(0, DRAWS)))["outcome"].tolist()) == {Outcome.NON_FINITE}


def memory_of(head, numbers):
    """Memory of a call: two words, then real numbers."""
    return ctypes.create_string_buffer(struct.pack(f"=II{len(numbers)}d", *head, *numbers), 8 + 8 * len(numbers))


def test_steps_are_made_once_and_in_order(mass, monkeypatch):
    """A lane that asks otherwise gets NaN, and the run says so."""
    fmu = dj.allow_native(mass)
    instances = Instances(FmuPorts(fmu, (), (0,), (2, 3)))

    def step(handle, made):
        memory = memory_of((handle, made), [0.1, 1.0, 0.0, 0.0])
        instances.step(ctypes.addressof(memory))
        return struct.unpack("=II4d", memory.raw)

    def start():
        memory = memory_of((7, 3), [0.0, 0.0, 0.0])
        instances.start(ctypes.addressof(memory))
        return struct.unpack("=II", memory.raw[:8])

    (handle, made) = start()
    assert made == 0
    first = step(handle, 0)
    assert first[:2] == (handle, 1)
    assert first[4] == pytest.approx(np.exp(-0.1) - 0.9, rel=1e-12)
    assert np.isnan(step(handle, 0)[4])  # as of a draw that has ended
    require_no_faults()
    second = step(handle, 1)
    assert second[1] == 2
    assert np.isnan(step(handle, 0)[4])
    with pytest.raises(ConfigError, match="was asked for step 0 after 2; steps must be made in order"):
        require_no_faults()
    monkeypatch.setattr(fmu_instances, "MOST_INSTANCES", 1)
    start()
    assert np.isnan(step(handle, 2)[4])
    with pytest.raises(ConfigError, match="has more than 1 draws at once"):
        require_no_faults()


def test_instances_are_freed(mass, values):
    study = loop_of(plant_of(mass), OWN_PID)
    instances = fmu_instances.instances_of(study.loop.plant.begin.__self__.functions.ports)
    named = {name if name.startswith("plant") else NAMES[name]: column for name, column in values.items()}
    kept = []
    for _ in range(3):
        results(study, named, devices=1)
        kept.append(len(instances._running))
    assert kept[0] == kept[1] == kept[2]
