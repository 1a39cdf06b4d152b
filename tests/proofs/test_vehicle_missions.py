"""Proofs of a vehicle whose reference moves: the nominal flight, what is left of the remainders, and flights."""

import copy

import numpy as np
import pytest
from flint import arb
from scipy.linalg import expm

import dssc_jax as dj
from benchmarks.vehicle_proofs.designs import Design, bounds_of
from benchmarks.vehicle_proofs.falsified import plain
from benchmarks.vehicle_proofs.flights import fly
from benchmarks.vehicle_proofs.problems import study_of
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_code.certified_premises import certified_premises
from dssc_jax.proofs.prove_vehicle import prove_vehicle
from dssc_jax.proofs.search.vehicle.bounds_map import linear_channels
from dssc_jax.proofs.search.vehicle.channels import Damping, StraightLines
from dssc_jax.proofs.search.vehicle.deviations import points_of
from dssc_jax.proofs.search.vehicle.nominal import axis_inputs_of, steady_response
from dssc_jax.proofs.vehicle_coverage import vehicle_problem_of
from dssc_jax.proofs.vehicle_words import vehicle_in_words
from dssc_jax.proofs.verifier.balls import Rejected
from dssc_jax.proofs.verifier.vehicle.deviations import deviations_of
from dssc_jax.proofs.verifier.vehicle.flight import Coupling
from dssc_jax.proofs.verifier.vehicle.ranges import ranges_of
from dssc_jax.proofs.verifier.vehicle.remainders import remainders_of
from dssc_jax.proofs.verifier.vehicle.responses import PHASES, observe_channel
from dssc_jax.proofs.verifier.verdict import ball_precision
from tests.proofs.test_vehicle_remainders import random_case
from tests.proofs.test_vehicle_verifier import linear_proof, middles, sampled_numbers
from tests.proofs.vehicle_cases import HOVER, problem, vehicle_problem_from
from tests.proofs.vehicle_model import commanded, plane_remainders, signals_and_remainders, turned

REFERENCE = {"x": [2.0, 4.0, 0.3], "y": [1.5, 4.0, 1.9], "z": [0.5, 3.0, 0.0], "psi": [-0.4, 4.0, 0.5]}
DAMPING = 0.03
PERIOD = 12.0
"""A common period of the reference [s]."""


def sine(axis, t, order):
    """A derivative of the reference of an axis."""
    amplitude, period, phase = REFERENCE[axis]
    rate = 2.0 * np.pi / period
    return amplitude * rate**order * np.sin(rate * t + phase + 0.5 * np.pi * order)


def known_parts(content, axis, t):
    """The known parts of the force and of the torque of an axis of the plane, and alpha_0."""
    alpha_0 = {name: sine(name, t, 2) + DAMPING * sine(name, t, 1) for name in "xy"}
    across = -alpha_0["y"] if axis == "x" else alpha_0["x"]
    force = sine("z", t, 2) * alpha_0[axis] / HOVER
    torque = content["damping"] * sine("psi", t, 1) * across - content["stiffness"] * force
    return force, torque, alpha_0[axis]


def flown(content, name, axis, proof, samples, substeps):
    """The linear loop of an axis, stepped until its transient has decayed and over one period more.

    Its forces are held between the points of a fine grid, at their values in the middle. Returns the signals at the
    phases of the samples in the last period, with their differences to what is known.
    """
    a, _, _, channel, sampled = sampled_numbers(content, name, proof)
    t_s = content["sample_time"]
    controller = content["channels"][name]
    n = channel.order
    generator = middles(channel.generator)
    columns = {rest: middles(column)[:, 0] for rest, column in channel.inputs.items()}
    acting, fresh = middles(sampled.acting)[0], float(sampled.fresh)
    slope_1, slope_2, slope_n = proof["slopes"]
    step = t_s / substeps
    block = np.zeros((2 * n + 1, 2 * n + 1))
    block[:n, : n + 1] = generator
    block[:n, n + 1 :] = np.eye(n)
    held = expm(block * step)[:n]
    z = np.zeros(len(a))
    rows = {signal: middles(row)[0] for signal, row in channel.signals.items()}
    seen = {signal: [] for signal in [*rows, "rate", "u_av", "alpha_gap", "wanted_gap", "lift_gap", "yaw_gap"]}
    period = round(PERIOD / t_s)
    points = {round(float(phase) * substeps) for phase in PHASES}
    for k in range(samples + period):
        t = k * t_s
        speed, bend = sine(axis, t, 1), sine(axis, t, 2)
        by_sum = -t_s * slope_2 * speed
        by_command = (slope_1 + slope_n) * speed - by_sum + (controller["l0"] * speed + bend)
        command = acting @ z + fresh * by_command
        chi = z[:n]
        for i in range(substeps):
            middle = t + (i + 0.5) * step
            pushed = np.zeros(n)
            pushed[0] = -sine(axis, middle, 1)
            if name == "x":
                force, torque, _ = known_parts(content, axis, middle)
                pushed = pushed + force * columns["force"] + torque * columns["torque"]
            chi = held @ np.concatenate([chi, [command], pushed])
            if k >= samples and i + 1 in points:
                now = t + (i + 1) * step
                values = {signal: row @ np.append(chi, command) for signal, row in rows.items()}
                rate = values["e_dot"]
                values["rate"] = rate
                values["e_dot"] -= sine(axis, now, 1)
                values["sigma"] -= sine(axis, now, 1)
                values["bend"] -= sine(axis, now, 2) + controller["l0"] * sine(axis, now, 1)
                if name == "x":
                    force, _, alpha_0 = known_parts(content, axis, now)
                    values["bend"] += force
                    values["alpha_gap"] = values["alpha"] - alpha_0
                    values["wanted_gap"] = values["wanted"] - alpha_0
                elif name == "z":
                    values["lift_gap"] = values["wanted"] - sine(axis, now, 2)
                else:
                    values["yaw_gap"] = rate - sine(axis, now, 1)
                for signal, value in values.items():
                    seen[signal].append(value)
        if k >= samples:
            seen["u_av"] += [middles(sampled.equivalent)[0] @ z + by_sum - slope_1 * speed] * len(points)
        moved = a @ z
        moved[:n] = chi
        moved[-1] += by_sum
        if len(a) > n + 1:
            moved[n] += by_command
        z = moved
    return {signal: np.array(values) for signal, values in seen.items() if values}, z


@pytest.mark.parametrize(("name", "delay"), [("x", 1.5), ("z", 0.0), ("psi", 2.0)])
def test_bounds_of_the_nominal_flight_hold_a_simulated_one(name, delay):
    """Never below what NumPy reaches, and close to it; the state at t = 0 is that of the flight."""
    content = problem(0.0, delay) | {"reference": REFERENCE}
    proof = linear_proof(content, name, 0.0 if name == "psi" else DAMPING)
    with ball_precision():
        seen = observe_channel(content, name, proof)
        bounds = {signal: float(bound) for signal, bound in seen.flight.items()}
    samples = round(4 * PERIOD / content["sample_time"])
    axes = {"x": "xy"}.get(name, [name])
    flights = [flown(content, name, axis, proof, samples, 8) for axis in axes]
    along = {"e", "e_dot", "sigma", "bend", "u_av"}
    room = 1.6 if name == "x" else 1.25  # five frequencies, whose peaks need not meet
    for signal in flights[0][0]:
        values = np.array([flight[signal] for flight, _ in flights])
        reached = np.abs(values).max() if signal in along or name != "x" else np.linalg.norm(values, axis=0).max()
        assert reached <= bounds[signal] * (1.0 + 1e-4) + 1e-6, signal
        assert bounds[signal] <= room * reached + 1e-4, signal
    starts = middles(seen.starts)[:, 4:]
    for column, (_, z), axis in zip(starts.T, flights, axes, strict=True):
        first = np.zeros(len(z))
        if name == "psi":
            ratio = {"zero": 0.0, "matched": proof["slopes"][0]}[content["channels"][name]["start"]]
            first[-1] = ratio * sine(axis, 0.0, 1)
        else:
            first[1] = sine(axis, 0.0, 1)
        assert column == pytest.approx(first - z, rel=2e-3, abs=2e-4)


def test_what_is_left_of_the_remainders_stays_within_its_bounds():
    """Random states about random known parts; the known parts matter, and some cases come close to the bounds."""
    rng = np.random.default_rng(5)
    closest = {"force": 0.0, "torque": 0.0}
    smaller = 0
    checked = 0
    for _ in range(300):
        craft, at, content = random_case(rng, 0.0)
        thrusts = commanded(craft, at)
        if thrusts.min() <= 0.0:
            continue
        alpha = HOVER * turned(at.angles[2], at.angles)
        spread = 10.0 ** rng.uniform(-3.0, 0.0, 4)
        alpha_0 = alpha + spread[0] * rng.standard_normal(2)
        lift = at.wanted[2] + spread[1] * rng.standard_normal()
        yaw = at.rates[2] + spread[2] * rng.standard_normal()
        at.wanted[:2] = alpha_0 + spread[3] * rng.standard_normal(2)
        thrusts = commanded(craft, at)
        if thrusts.min() <= 0.0:
            continue
        signals, _ = signals_and_remainders(craft, at, (DAMPING, 0.0))
        rests = dict(zip(("force", "torque"), plane_remainders(craft, at, DAMPING), strict=True))
        across = np.array([-alpha_0[1], alpha_0[0]])
        force = lift * alpha_0 / HOVER
        torque = content["damping"] * yaw * across - content["stiffness"] * force
        gaps = [np.linalg.norm(alpha - alpha_0), np.linalg.norm(at.wanted[:2] - alpha_0)]
        gaps += [abs(at.wanted[2] - lift), abs(at.rates[2] - yaw), abs(lift), abs(yaw)]
        with ball_precision():
            bounds = {
                name: {signal: arb(float(value)) * (1 + arb("1e-12")) + arb("1e-13") for signal, value in y.items()}
                for name, y in signals.items()
            }
            coupling = Coupling(*(arb(float(gap)) * (1 + arb("1e-12")) + arb("1e-13") for gap in gaps))
            dampings = {"x": DAMPING, "z": 0.0, "psi": 0.0}
            try:
                limits = remainders_of(content, ranges_of(content), bounds, dampings, None, coupling)
                plain_limits = remainders_of(content, ranges_of(content), bounds, dampings)
            except Rejected:
                continue
        checked += 1
        for rest, value, known in (("force", rests["force"], force), ("torque", rests["torque"], torque)):
            left = np.linalg.norm(value - known)
            bound = float(limits.channels["x"][rest])
            assert left <= bound * (1.0 + 1e-9) + 1e-9, rest
            if bound > 1e-6:
                closest[rest] = max(closest[rest], left / bound)
            smaller += bound < float(plain_limits.channels["x"][rest])
    assert checked > 100
    assert min(closest.values()) > 0.8
    assert smaller > 100


@pytest.mark.parametrize("start", ["matched", "midpoint"])
def test_the_first_sum_deviates_by_no_more_than_its_bound(start):
    """q_(-1) of ``midpoint`` holds phi_2 itself, and so all of omega_q, however small its rest omega_r is."""
    content = problem()
    sigma = 0.5
    half = {"matched": 0.0, "midpoint": 0.5 * content["sample_time"]}[start]
    points = points_of(vehicle_problem_from(content), "x", sigma)
    size = np.abs(points.sigma)
    k_1, k_2, k_3 = linear_proof(content, "x", DAMPING)["slopes"]
    first = (points.columns["mean"] - k_1) * size
    integral = (points.columns["k_i"] - k_2) * size
    command = first + (points.columns["k_n"] - k_3) * size
    last = np.argmax(size)
    share = float(integral[last] / command[last])
    assert abs(integral - share * command).max() < 0.5 * abs(integral).max()
    with ball_precision():
        proof = linear_proof(content, "x", DAMPING, share)
        t = arb(content["sample_time"])
        bound = float(deviations_of(content, "x", proof, sigma).of_start(start, arb(sigma), t, arb(share)))
    reached = abs(first + half * integral).max()
    assert reached <= bound * (1.0 + 1e-9) <= 1.1 * reached


MISSION = {
    "reference": {"kind": "mission"},
    "plant.position": [0.0, 20.0, 5.0],
    "plant.velocity": [np.pi, 0.0, 0.1 * np.pi],
    "plant.yaw": 0.25 * np.pi,
    "wind.speed": 5.0,
    "wind.vertical": 2.5,
}


@pytest.fixture(scope="module")
def design() -> Design:
    """The tuned gains on the mission."""
    proved = prove_vehicle(vehicle_problem_of(dj.Study.load("hover_wind_tuned").override(MISSION)))
    assert proved.complete, proved.reason
    assert proved.verdict is not None
    assert "mission" in proved.statement()
    return Design(plain(proved.certificate()), bounds_of(proved.verdict))


def test_no_flight_of_the_mission_leaves_a_bound(design):
    """Adversarial winds; some flights come near, and bounds of half the size are left."""
    flights = fly(design.certificate["problem"], design.bounds, 256, 20.0, 1)
    assert not flights.left().any()
    nearest = {name: share.max() for name, share in flights.shares.items()}
    assert min(nearest[name] for name in ("e_x", "e_y", "e_z", "sigma_x", "tilt", "alpha")) > 0.4


def larger_circle(content):
    """The vehicle follows a circle that is 5 % larger."""
    for axis in "xy":
        content["problem"]["reference"][axis][0] *= 1.05


def endless_period(content):
    """An axis has no period."""
    content["problem"]["reference"]["z"][1] = 0.0


def one_axis_less(content):
    """An axis has no reference."""
    del content["problem"]["reference"]["psi"]


def lagging_rotors(content):
    """The rotors lag, and the reference moves."""
    content["problem"]["rotor_lag"] = 0.01


def other_channels(content):
    """The upper limits have channels of their own."""
    content["proof"]["settled"] = {
        name: {key: value for key, value in channel.items() if key != "bounds"}
        for name, channel in content["proof"]["channels"].items()
    }


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (larger_circle, "V4"),
        (endless_period, "V0: reference.z"),
        (one_axis_less, "V0"),
        (lagging_rotors, "V0"),
        (other_channels, "V0: settled"),
    ],
)
def test_falsified_missions_are_rejected(design, change, reason):
    """The reference belongs to the proof."""
    content = copy.deepcopy(design.certificate)
    change(content)
    verdict = dj.check_certificate(content)
    assert not verdict.proved
    assert verdict.reason.startswith(reason)


def test_a_mission_flies_from_its_certificate_and_has_no_monitor(design):
    """The study of the problem has this problem; a monitor's refusal says why."""
    content = design.certificate["problem"]
    again = plain(vehicle_problem_of(study_of(content, 10.0)).to_dict())
    assert "x: 20.0 sin(2 pi t/40.0 + 0.0), y:" in vehicle_in_words(content)["reference"]
    assert again["reference"] == content["reference"]
    for name, channel in content["channels"].items():
        assert again["channels"][name].pop("initial") == pytest.approx(channel["initial"], abs=1e-11)
        assert again["channels"][name] == {key: value for key, value in channel.items() if key != "initial"}
    study = dj.Study.load("hover_wind_tuned").override(MISSION)
    with pytest.raises(ConfigError, match="a monitor watches a vehicle that hovers"):
        certified_premises(study, design.certificate, "proof.json")


def test_deviations_from_the_nominal_flight_stay_within_the_bounds_of_their_cell(design):
    """A simulated flight against the search's sines, which no bound of the verifier knows; it comes close to bounds."""
    content = design.certificate
    cells = content["proof"]["cells"]
    flown = dj.simulate(dj.Study.load("hover_wind_tuned").override(MISSION | {"loop.duration": 20.0}))
    t = flown["t"].values
    cell = np.minimum(np.arange(len(t)) // cells["samples"], len(cells["bounds"]["z"]["e"]))
    nearest = 0.0
    for name, axis in (("x", "x"), ("x", "y"), ("z", "z"), ("psi", "psi")):
        nominal = nominal_samples(content, name, axis, len(t))
        deviation = np.abs(np.stack([flown[f"{axis}_e"].values, flown[f"{axis}_y_dot"].values], axis=1) - nominal)
        final = content["proof"]["channels"][name]["bounds"]
        for column, signal in zip(deviation.T, ("e", "e_dot"), strict=True):
            bound = np.append(cells["bounds"][name][signal], final[signal])[cell]
            assert np.all(column <= bound), (axis, signal)
            nearest = max(nearest, float(np.max(column / bound)))
    assert nearest > 0.8


def nominal_samples(content, name, axis, count):
    """e and v of the nominal flight of the mission at the samples, (count, 2): its sines in the search's numbers."""
    vehicle = vehicle_problem_from(content["problem"])
    proofs = content["proof"]["channels"]
    damping = Damping(proofs["x"]["drag_damping"], proofs["z"]["drag_damping"])
    lines = StraightLines(*proofs[name]["slopes"], proofs[name]["share"])
    inputs = axis_inputs_of(vehicle, damping.plane)[axis]
    linear = linear_channels(vehicle, damping)[name]
    t = vehicle.sample_time * np.arange(count)
    result = np.zeros((count, 2))
    for frequency in inputs.frequencies:
        state = steady_response(vehicle, name, linear, lines, inputs, frequency).state[:2]
        result += np.real(np.exp(2j * np.pi * float(frequency) * t)[:, None] * state)
    return result
