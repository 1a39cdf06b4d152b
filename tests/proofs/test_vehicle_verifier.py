"""The verifier of the whole vehicle: its responses against NumPy, and certificates that it accepts or refuses."""

import copy
import json
import math

import numpy as np
import pytest
from flint import arb
from scipy.linalg import expm, solve_discrete_lyapunov

from dssc_jax.proofs.verifier.vehicle.channels import channel_of, sampled_channel, signal_names
from dssc_jax.proofs.verifier.vehicle.implied import deviations_under, implied_bounds, inputs_under, vehicle_of
from dssc_jax.proofs.verifier.vehicle.responses import PHASES, channel_responses, observe_channel
from dssc_jax.proofs.verifier.vehicle.verdict import verify_vehicle
from dssc_jax.proofs.verifier.verdict import ball_precision
from tests.proofs.vehicle_cases import HOVER, problem

CHANNELS = ("x", "z", "psi")


def middles(matrix):
    """The middles of a matrix of balls."""
    return np.array([[float(x.mid()) for x in row] for row in matrix.tolist()])


def linear_proof(content, name, damping, share=0.0):
    """Slopes a little below those at the origin and a V of the linear loop; no bounds."""
    functions = content["channels"][name]["functions"]
    k_1 = 1.0 / (functions["kappa_o"] * functions["delta_o"] * functions["tau_av"])
    tau_m = functions["kappa_m"] * functions["delta_m"]
    slopes = [0.9 * k_1, 0.8 * k_1 / tau_m, 0.9 / tau_m]
    proof = {"slopes": slopes, "share": share, "drag_damping": damping, "rate": 0.0, "p": [], "bounds": {}}
    a = sampled_numbers(content, name, proof)[0]
    radius = np.abs(np.linalg.eigvals(a)).max()
    share = 0.8 * (1.0 - radius**2)
    p = solve_discrete_lyapunov((a / np.sqrt(1.0 - 1.05 * share)).T, np.eye(len(a)))
    return proof | {"rate": share / content["sample_time"], "p": (0.5 * (p + p.T)).tolist()}


def sampled_numbers(content, name, proof):
    """A, b_u, b_q and the channel, in float64."""
    with ball_precision():
        channel = channel_of(content, name, proof["drag_damping"])
        parts = content["channels"][name], proof, content["sample_time"], content["delay"]
        sampled = sampled_channel(channel, *parts)
        return middles(sampled.a), middles(sampled.by_command), middles(sampled.by_integral), channel, sampled


@pytest.fixture(scope="module", params=[(0.0, 0.0), (0.05, 1.5)], ids=["plain", "lag and delay"])
def certificate(request):
    """A certificate whose bounds are found by repeating F from small ones."""
    content = problem(*request.param)
    dampings = {"x": 0.03, "z": 0.02, "psi": 0.0}
    proof = {"channels": {name: linear_proof(content, name, dampings[name]) for name in CHANNELS}}
    proof |= {"cells": None, "settled": None}
    lagging = content["rotor_lag"] > 0.0
    with ball_precision():
        vehicle = vehicle_of(content, proof["channels"])
        y = {name: dict.fromkeys(signal_names(name, lagging=lagging), arb("1e-3")) for name in CHANNELS}
        for _ in range(30):
            implied = implied_bounds(
                vehicle, y, inputs_under(vehicle, y, deviations_under(vehicle, y)), from_start=True
            )
            y = {name: {signal: (1.002 * y_i).upper() for signal, y_i in implied[name].items()} for name in CHANNELS}
    for name in CHANNELS:
        proof["channels"][name]["bounds"] = {signal: float(y_i) for signal, y_i in y[name].items()}
    return json.loads(json.dumps({"version": 2, "kind": "vehicle", "problem": content, "proof": proof}))


@pytest.mark.parametrize(
    ("lag", "delay", "name", "share"),
    [(0.05, 1.5, "x", 0.0), (0.0, 0.0, "x", 0.15), (0.05, 0.4, "z", -0.2), (0.05, 3, "psi", 0.0)],
)
def test_sums_and_integrals_bound_those_of_a_fine_grid(lag, delay, name, share):
    """Brute force over 6,000 samples with 16 times in each: never above the bound, and less than 1 % below it."""
    content = problem(lag, delay)
    proof = linear_proof(content, name, 0.0 if name == "psi" else 0.03, share)
    with ball_precision():
        responses = channel_responses(content, name, observe_channel(content, name, proof))
    a, b_u, b_q, channel, sampled = sampled_numbers(content, name, proof)
    t = content["sample_time"]
    n = channel.order
    generator = np.vstack([middles(channel.generator), np.zeros(n + 1)])
    f = generator[:n, :n]
    fresh = float(sampled.fresh)
    grid = t * (np.arange(16) + 0.5) / 16
    powers = [np.eye(len(a))]
    for _ in range(6000):
        powers.append(powers[-1] @ a)
    powers = np.array(powers)
    for place, phase in enumerate(PHASES):
        s = float(phase) * t
        for signal, row in channel.signals.items():
            seen = middles(row)[0] @ expm(generator * s)
            rho = np.append(seen[:n], np.zeros(len(a) - n)) + seen[n] * middles(sampled.acting)[0]
            rows = rho @ powers
            response = responses[signal][place]
            by_command = np.abs(rows @ b_u).sum() + abs(seen[n]) * fresh * (1.0 + t * share)
            by_integral = np.abs(rows @ b_q).sum() + t * abs(seen[n]) * fresh
            pairs = [(by_command, response.command), (by_integral, response.integral)]
            for rest, column in channel.inputs.items():
                flows = np.array([expm(f * r) @ middles(column)[:, 0] for r in grid])
                total = t / 16 * np.abs(rows[:, :n] @ flows.T).sum()
                inner = s * (np.arange(16) + 0.5) / 16
                within = [abs(middles(row)[0, :n] @ expm(f * r) @ middles(column)[:, 0]) for r in inner]
                pairs.append((total + s / 16 * sum(within), response.remainders[rest]))
            for reached, bound in pairs:
                assert reached <= float(bound) * (1.0 + 1e-6)
                assert float(bound) <= 1.01 * reached + 1e-12


def test_responses_to_starts_and_to_the_constant_bound_simulated_ones():
    """The loop of z in NumPy, stepped from its starts, and with the constant 1 from t = 0 on."""
    content = problem(0.05, 1.5)
    proof = linear_proof(content, "z", 0.03)
    with ball_precision():
        responses = channel_responses(content, "z", observe_channel(content, "z", proof))
    a, _, _, channel, sampled = sampled_numbers(content, "z", proof)
    t = content["sample_time"]
    n = channel.order
    generator = np.zeros((n + 2, n + 2))  # of chi, U and o
    generator[:n, : n + 1] = middles(channel.generator)
    generator[1, n + 1] = 1.0
    forced = expm(generator * t)[:n, n + 1]
    k_1, k_2, _ = proof["slopes"]
    of_sigma = -(k_1 + 0.5 * t * k_2) * middles(sampled.sigma)[0]
    units = np.eye(len(a))
    starts = [units[0] + of_sigma[0] * units[-1], units[1] + of_sigma[1] * units[-1], units[-1], 0.0 * units[0]]
    for start, z in enumerate(starts):
        constant = float(start == 3)
        states = []
        for _ in range(20_000):
            states.append(z)
            z = a @ z
            z[:n] += constant * forced
        states = np.array(states)
        acting = states @ middles(sampled.acting)[0]
        held = np.column_stack([states[:, :n], acting, np.full(len(acting), constant)])
        for place, phase in enumerate(PHASES):
            seen = held @ expm(generator * float(phase) * t).T
            for signal, row in channel.signals.items():
                response = responses[signal][place]
                bound = float(response.constant if start == 3 else response.starts[start])
                reached = np.abs(seen[:, : n + 1] @ middles(row)[0])
                assert reached.max() <= bound * (1.0 + 1e-9)
                assert bound <= 1.001 * reached.max() + 1e-9
                if start == 3:
                    assert abs(float(response.settled_constant) - reached[-1]) < 1e-6


def test_a_certificate_is_proved_and_its_bounds_settle(certificate):
    """All bounds are those of the file, those of the upper limits are no larger, and the rotors are within limits."""
    verdict = verify_vehicle(certificate)
    assert verdict.proved, verdict.reason
    for name in CHANNELS:
        for signal, bound in certificate["proof"]["channels"][name]["bounds"].items():
            assert bound <= verdict.bounds[name][signal] <= bound * (1.0 + 1e-12)
            assert verdict.settled[name][signal] <= verdict.bounds[name][signal]
    assert verdict.settled["x"]["e"] < 0.999 * verdict.bounds["x"]["e"]
    assert 0.0 < verdict.rotor_min < certificate["problem"]["believed_mass"] * HOVER / 4 < verdict.rotor_max < 53.0
    assert verdict.settled_tilt <= verdict.tilt < 0.5


WRONG = [
    ("proof.channels.x.bounds.e", 0.97, "V4"),
    ("proof.channels.psi.bounds.sigma", 0.97, "V4"),
    ("problem.channels.z.rho", 0.02, "V5: the equivalent control of z"),
    ("problem.wind.0", 1.2, "V4"),
    ("problem.rotor_limit", 0.5, "V3"),
    ("proof.channels.z.rate", 1.5, "V1: V of z does not fall"),
    ("proof.channels.x.p.0.0", -1.0, "V1: P of x"),
    ("proof.channels.psi.bounds.e", 1e4, "V3"),
    ("problem.sample_time", 0.0, "V0: sample_time is not positive"),
    ("problem.rotors", 0.75, "V0: rotors"),
    ("problem.delay", -1e9, "V0"),
    ("problem.mass.0", 2.0, "V0: mass ends before it begins"),
    ("proof.channels.x.bounds.e", -1.0, "V0: x.e is not positive"),
    ("problem.channels.psi.initial.0", -1.0, "V0: psi.initial is negative"),
    ("proof.channels.x.p.0.1", 1.1, "V0: x.p is not symmetric"),
    ("problem.wind.0", math.nan, "V0: wind is not a finite number"),
]


def changed(content, path, change):
    """A copy with one entry changed by a function."""
    result = copy.deepcopy(content)
    *parents, last = [int(key) if key.isdigit() else key for key in path.split(".")]
    place = result
    for key in parents:
        place = place[key]
    place[last] = change(place[last])
    return result


@pytest.mark.parametrize(("path", "factor", "reason"), WRONG)
def test_a_certificate_with_one_number_changed_is_refused(certificate, path, factor, reason):
    """The reason names the premise."""
    shift = -1.0 if path == "problem.delay" else 0.0
    verdict = verify_vehicle(changed(certificate, path, lambda value: value * factor + shift))
    assert not verdict.proved
    assert verdict.reason.startswith(reason)
    assert verdict.bounds == {}
    assert math.isinf(verdict.tilt)


MALFORMED = [
    ("problem", lambda table: table | {"more": 1.0}, "V0: problem has an unknown entry more"),
    ("proof.channels", lambda table: {"x": table["x"]}, "V0: proof.channels has no entry psi, z"),
    ("proof.channels.x.bounds", lambda table: table | {"thrust": 1.0}, "V0: x.bounds has an unknown entry thrust"),
    ("problem.channels.x.functions.kind", lambda _: "vgsta", "V0: "),
    ("problem.channels.x.functions", lambda _: {"kind": "sta", "kappa1": 1.0, "kappa2": 1.0, "k_o": 1.0}, "V0: "),
    ("problem.channels.x.start", lambda _: ["zero"], "V0: x.start is none of"),
    ("problem.channels.x.nominal", lambda _: [1.0, 1.0, 1], "V0: x.nominal is not true or false"),
    ("problem.mass", lambda _: "10.9", "V0: mass is no list"),
    ("problem.rotor_lag", lambda _: True, "V0: rotor_lag is not a finite number"),
    ("proof.channels.psi.drag_damping", lambda _: 0.1, "V0: psi.drag_damping is not 0"),
    ("proof.channels.x.p", lambda p: p[:-1], "V0: x.p has"),
    ("kind", lambda _: "axis", "V0: kind is not vehicle"),
    ("version", lambda _: 1, "V0: version is not 2"),
]


@pytest.mark.parametrize(("path", "change", "reason"), MALFORMED)
def test_malformed_contents_are_refused(certificate, path, change, reason):
    """Entries, types and shapes."""
    verdict = verify_vehicle(changed(certificate, path, change))
    assert not verdict.proved
    assert verdict.reason.startswith(reason)


@pytest.mark.parametrize("content", [None, [], {}, "text", {"version": 1}])
def test_no_certificate_is_refused(content):
    """Whatever a file holds."""
    assert verify_vehicle(content).reason.startswith("V0: ")
