"""The verifier of the whole vehicle: each part against NumPy, the remainders against the equations of motion."""

import copy
import json
import math

import numpy as np
import pytest
from flint import arb
from scipy.linalg import expm, solve_discrete_lyapunov

from dssc_jax.proofs.verifier.balls import Rejected
from dssc_jax.proofs.verifier.vehicle.channels import channel_of, sampled_channel, signal_names
from dssc_jax.proofs.verifier.vehicle.drag import DragRegion, plane_drag, vertical_drag
from dssc_jax.proofs.verifier.vehicle.implied import deviations_under, implied_bounds, inputs_under, vehicle_of
from dssc_jax.proofs.verifier.vehicle.ranges import ranges_of
from dssc_jax.proofs.verifier.vehicle.remainders import remainders_of
from dssc_jax.proofs.verifier.vehicle.responses import PHASES, channel_responses
from dssc_jax.proofs.verifier.vehicle.verdict import verify_vehicle
from dssc_jax.proofs.verifier.verdict import ball_precision
from tests.proofs.vehicle_model import Motion, Multirotor, commanded, signals_and_remainders

CHANNELS = ("x", "z", "psi")
HOVER = 9.81


def middles(matrix):
    """The middles of a matrix of balls."""
    return np.array([[float(x.mid()) for x in row] for row in matrix.tolist()])


def controller(l0, kappa_o, kappa_m, start):
    """A channel of a problem."""
    functions = {"kind": "square_root", "kappa_o": kappa_o, "kappa_m": kappa_m, "delta_o": 1.0, "delta_m": 1.0}
    return {
        "l0": l0,
        "functions": functions | {"tau_av": 0.03},
        "rho": 3.0,
        "nominal": [1.0, 1.0, True],
        "start": start,
        "initial": [0.02, 0.01],
    }


def problem(rotor_lag=0.0, delay=0.0):
    """A quadrotor in a light wind, with a mass that the inner loops know to within half a per cent."""
    return {
        "sample_time": 0.005,
        "delay": delay,
        "velocity_gain": 1.0,
        "stiffness": 60.0,
        "damping": 15.0,
        "yaw_gain": 1.0,
        "yaw_integral_gain": 0.2,
        "mass": [10.85, 10.95],
        "believed_mass": 10.9,
        "thrust": [0.995, 1.005],
        "turn": [0.98, 1.02],
        "inertia": [[0.43, 0.45], [0.43, 0.45], [0.73, 0.75]],
        "believed_inertia": [0.44, 0.44, 0.74],
        "rotors": 4,
        "arm": 0.57,
        "torque_coefficient": 0.57,
        "thrust_coefficient": 0.0024,
        "rotor_limit": 53.0,
        "rotor_lag": rotor_lag,
        "rotor_inertia": 5e-6,
        "structure_drag": [0.03, 0.015],
        "propeller_drag": 8e-6,
        "wind": [3.0, 1.5],
        "channels": {
            "x": controller(0.75, 23.0, 1.1, "midpoint"),
            "z": controller(0.35, 14.0, 3.3, "midpoint"),
            "psi": controller(2.9, 11.5, 3.2, "zero"),
        },
    }


def linear_proof(content, name, damping):
    """Slopes a little below those at the origin and a V of the linear loop; no bounds."""
    functions = content["channels"][name]["functions"]
    k_1 = 1.0 / (functions["kappa_o"] * functions["delta_o"] * functions["tau_av"])
    tau_m = functions["kappa_m"] * functions["delta_m"]
    slopes = [0.9 * k_1, 0.8 * k_1 / tau_m, 0.9 / tau_m]
    proof = {"slopes": slopes, "drag_damping": damping, "rate": 0.0, "p": [], "bounds": {}}
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
    lagging = content["rotor_lag"] > 0.0
    with ball_precision():
        vehicle = vehicle_of(content, proof)
        y = {name: dict.fromkeys(signal_names(name, lagging=lagging), arb("1e-3")) for name in CHANNELS}
        for _ in range(60):
            implied = implied_bounds(vehicle, y, inputs_under(vehicle, y, deviations_under(vehicle, y)), started=True)
            y = {name: {signal: (1.002 * y_i).upper() for signal, y_i in implied[name].items()} for name in CHANNELS}
    for name in CHANNELS:
        proof["channels"][name]["bounds"] = {signal: float(y_i) for signal, y_i in y[name].items()}
    return json.loads(json.dumps({"version": 1, "kind": "vehicle", "problem": content, "proof": proof}))


@pytest.mark.parametrize(
    ("lag", "delay", "name"), [(0.05, 1.5, "x"), (0.0, 0.0, "x"), (0.05, 0.4, "z"), (0.05, 3, "psi")]
)
def test_sums_and_integrals_bound_those_of_a_fine_grid(lag, delay, name):
    """Brute force over 6,000 samples with 16 times in each: never above the bound, and less than 1 % below it."""
    content = problem(lag, delay)
    proof = linear_proof(content, name, 0.0 if name == "psi" else 0.03)
    with ball_precision():
        responses = channel_responses(content, name, proof)
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
            by_command = np.abs(rows @ b_u).sum() + abs(seen[n]) * fresh
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
        responses = channel_responses(content, "z", proof)
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
        for _ in range(8000):
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


def drag_at(region, v, w, x_share):
    """|-x r + c v| for vectors, with x a share of the way between its ends."""
    speed, wind, damping, drag, light, heavy, across, by_rotors = region
    del speed, wind
    r = v - w
    size = np.linalg.norm(r, axis=0)
    low = drag * size / heavy
    high = drag * np.sqrt(size**2 + across**2) / light + by_rotors
    return np.linalg.norm(damping * v - (low + x_share * (high - low)) * r, axis=0)


@pytest.mark.parametrize("seed", range(12))
def test_suprema_of_the_drag_bound_a_dense_search(seed):
    """200,000 motions and winds, many of them at their ends; the supremum is less than 0.3 % above what they reach."""
    rng = np.random.default_rng(seed)
    region = rng.uniform([0.1, 0.0, 0.0, 0.0, 1.0, 10.0, 0.0, 0.0], [3.0, 8.0, 1.0, 0.5, 10.0, 12.0, 5.0, 0.3])
    region[rng.integers(1, 4)] *= rng.integers(0, 2)  # no wind, no damping, or no drag
    speed, wind = region[:2]
    with ball_precision():
        balls = DragRegion(*map(arb, region.tolist()))
        plane = float(plane_drag(balls))
        vertical = float(vertical_drag(balls))
    count = 200_000
    v = speed * np.where(rng.random(count) < 0.4, 1.0, np.sqrt(rng.random(count)))
    w = wind * np.where(rng.random(count) < 0.7, 1.0, rng.random(count))
    angle = np.where(rng.random(count) < 0.3, np.pi * rng.integers(0, 2, count), rng.uniform(0.0, np.pi, count))
    share = np.where(rng.random(count) < 0.9, rng.integers(0, 2, count), rng.random(count))
    ahead = np.stack([v, 0.0 * v])
    reached = drag_at(region, ahead, w * np.stack([np.cos(angle), np.sin(angle)]), share).max()
    line = np.stack([w * rng.choice([-1.0, 1.0], count), 0.0 * w])
    reached_line = drag_at(region, ahead, line, share).max()
    assert reached <= plane * (1.0 + 1e-12)
    assert plane <= 1.003 * reached
    assert reached_line <= vertical * (1.0 + 1e-12)
    assert vertical <= 1.003 * reached_line


def random_case(rng, lag):
    """A vehicle at an end of its intervals, a state, and the part of a problem that the remainders depend on."""

    def interval(middle):
        width = 0.1 * rng.random() * rng.integers(0, 2)
        return [middle * (1.0 - width), middle * (1.0 + width)]

    def scaled(count, size):
        return rng.standard_normal(count) * size * 10.0 ** rng.uniform(-2.0, 0.0) * (rng.random() < 0.8)

    believed = np.array([0.44 * rng.uniform(0.8, 1.2), 0.44 * rng.uniform(0.8, 1.2), 0.74])
    mass, ratio, inertia = interval(10.9), interval(1.0), [interval(float(j)) for j in believed]
    kappa = [10.9 / m * r for m in mass for r in ratio]
    nu = [r * j / x for j, axis in zip(believed, inertia, strict=True) for x in axis for r in ratio]
    craft = Multirotor(
        mass=float(rng.choice(mass)),
        inertia=np.array([rng.choice(axis) for axis in inertia]),
        k_t=0.0024 * float(rng.choice(ratio)),
        mass_n=10.9,
        inertia_n=believed,
        k_n=0.0024,
        rotors=int(rng.choice([4, 6, 8])),
        arm=rng.uniform(0.3, 0.7),
        c_tau=float(rng.choice([0.57, 0.2])),
        lag=lag,
        hub=float(rng.choice([0.0, 5e-3])),
        k_h=float(rng.choice([0.0, 0.03, 0.3])),
        k_z=float(rng.choice([0.0, 0.015, 0.3])),
        k_p=float(rng.choice([0.0, 8e-6, 2e-3])),
        a_0=60.0,
        a_1=15.0,
    )
    at = Motion(
        velocity=np.append(scaled(2, 3.0), scaled(1, 2.0)),
        angles=np.append(scaled(2, 0.25), rng.uniform(-3.0, 3.0)),
        rates=np.append(scaled(2, 0.5), scaled(1, 0.5)),
        speeds=np.zeros(craft.rotors),
        wanted=np.append(scaled(2, 2.0), scaled(1, 2.0)),
        eta_psi=float(scaled(1, 1.0)[0]),
        wind=np.append(scaled(2, 8.0), scaled(1, 4.0)),
    )
    content = problem(lag) | {
        "mass": mass,
        "thrust": [min(kappa), max(kappa)],
        "turn": [min(nu), max(nu)],
        "inertia": inertia,
        "believed_inertia": believed.tolist(),
        "rotors": craft.rotors,
        "arm": craft.arm,
        "torque_coefficient": craft.c_tau,
        "rotor_limit": 1e9,
        "rotor_inertia": craft.hub,
        "structure_drag": [craft.k_h, craft.k_z],
        "propeller_drag": craft.k_p,
        "wind": [float(np.linalg.norm(at.wind[:2])), abs(float(at.wind[2]))],
    }
    return craft, at, content


@pytest.mark.parametrize("lag", [0.0, 0.05])
def test_remainders_of_the_true_equations_of_motion_stay_within_their_bounds(lag):
    """Random vehicles and states, each with its own signals as bounds; some come close to every bound."""
    rng = np.random.default_rng(3)
    closest = {}
    refusals = []
    for _ in range(400):
        craft, at, content = random_case(rng, lag)
        thrusts = commanded(craft, at)
        if thrusts.min() <= 0.0:
            continue
        hover = craft.mass_n * HOVER / craft.rotors
        share = rng.random(craft.rotors) * rng.integers(0, 2)
        mixed = craft.allocated(craft.wrench(share * hover + (1.0 - share) * thrusts))
        at.speeds = np.sqrt(mixed / craft.k_n)
        dampings = {"x": float(rng.choice([0.0, 0.1])), "z": float(rng.choice([0.0, 0.1])), "psi": 0.0}
        signals, rests = signals_and_remainders(craft, at, (dampings["x"], dampings["z"]))
        with ball_precision():
            bounds = {
                name: {signal: arb(float(value)) * (1 + arb("1e-12")) + arb("1e-13") for signal, value in y.items()}
                for name, y in signals.items()
            }
            try:
                limits = remainders_of(content, ranges_of(content), bounds, dampings)
            except Rejected as rejected:
                refusals.append(str(rejected))
                continue
        smallest, largest = float(limits.rotors.smallest), float(limits.rotors.largest)
        assert smallest - 1e-9 <= thrusts.min()
        assert thrusts.max() <= largest + 1e-9
        if lag and mixed.min() < smallest - 1e-9:
            continue  # no motion within the bounds comes there
        kappa = craft.mass_n / craft.mass * craft.k_t / craft.k_n
        rests["z"]["force"] = abs(rests["z"]["force"] - (kappa - 1.0) * HOVER)
        assert abs(kappa - 1.0) * HOVER <= float(limits.constant) + 1e-12
        for name, values in rests.items():
            for rest, value in values.items():
                bound = float(limits.channels[name][rest])
                assert value <= bound * (1.0 + 1e-9) + 1e-9, (name, rest)
                if bound > 1e-6:
                    closest[name, rest] = max(closest.get((name, rest), 0.0), value / bound)
    assert min(closest.values()) > 0.9
    assert len(refusals) < 40
    assert all(reason.startswith("V3") for reason in refusals)


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
    ("version", lambda _: 2, "V0: version is not 1"),
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
