"""Time cells in the verifier of the vehicle: responses against NumPy, and what it accepts and refuses."""

import copy
import json

import numpy as np
import pytest
from flint import arb
from scipy.linalg import expm

import dssc_jax as dj
from dssc_jax.core.json_types import JsonObject
from dssc_jax.proofs.verifier.balls import Rejected
from dssc_jax.proofs.verifier.vehicle.cell_bounds import (
    effects_of,
    implied_in_cells,
    inputs_in_cells,
    responses_in_cells,
)
from dssc_jax.proofs.verifier.vehicle.cell_responses import cell_responses
from dssc_jax.proofs.verifier.vehicle.channels import signal_names
from dssc_jax.proofs.verifier.vehicle.deviations import deviations_in_regions, deviations_of
from dssc_jax.proofs.verifier.vehicle.implied import vehicle_of
from dssc_jax.proofs.verifier.vehicle.ranges import ranges_of
from dssc_jax.proofs.verifier.vehicle.remainders import remainders_of
from dssc_jax.proofs.verifier.vehicle.responses import PHASES, observe_channel
from dssc_jax.proofs.verifier.vehicle.verdict import verify_vehicle
from dssc_jax.proofs.verifier.verdict import ball_precision
from tests.proofs.test_vehicle_verifier import CHANNELS, linear_proof, middles, problem, sampled_numbers

SAMPLES = 30
CELLS = 6
LONG = 6000


def brute_force(content, name, proof, phase, signal):
    """g_l of omega_u, omega_q and each remainder, (LONG, inputs), and the responses to starts, (LONG, 3), at one phase.

    The integrals are Gauss sums over 16 times in a sample, right to within 1e-5.
    """
    a, b_u, b_q, channel, sampled = sampled_numbers(content, name, proof)
    t = content["sample_time"]
    n = channel.order
    generator = np.vstack([middles(channel.generator), np.zeros(n + 1)])
    f = generator[:n, :n]
    fresh = float(sampled.fresh)
    s = float(phase) * t
    row = middles(channel.signals[signal])[0]
    seen = row @ expm(generator * s)
    rows = [np.append(seen[:n], np.zeros(len(a) - n)) + seen[n] * middles(sampled.acting)[0]]
    for _ in range(LONG - 1):
        rows.append(rows[-1] @ a)
    rows = np.array(rows)
    direct = abs(seen[n]) * fresh
    parts = [
        np.append(direct, np.abs(rows[:-1] @ b_u)[:, 0]),
        np.append(t * direct, np.abs(rows[:-1] @ b_q)[:, 0]),
    ]
    points, weights = np.polynomial.legendre.leggauss(16)
    grid = (points + 1.0) / 2.0
    for column in channel.inputs.values():
        b = middles(column)[:, 0]
        flows = np.array([expm(f * t * r) @ b for r in grid])
        within = s / 2.0 * weights @ np.abs([row[:n] @ expm(f * s * r) @ b for r in grid])
        parts.append(np.append(within, t / 2.0 * np.abs(rows[:-1, :n] @ flows.T) @ weights))
    k_1, k_2, _ = proof["slopes"]
    ratio = {"zero": 0.0, "matched": k_1, "midpoint": k_1 + 0.5 * t * k_2}[content["channels"][name]["start"]]
    starts = np.zeros((len(a), 3))
    starts[[0, 1], [0, 1]] = 1.0
    starts[-1] = [*(-ratio * middles(sampled.sigma)[0, :2]), 1.0]
    return np.array(parts).T, np.abs(rows @ starts)


@pytest.mark.parametrize(("lag", "delay", "name"), [(0.05, 1.5, "x"), (0.0, 0.0, "z"), (0.05, 3, "psi")])
def test_sums_and_starts_bound_brute_force(lag, delay, name):
    """Sums up to the end of a cell, their limits, and peaks: never below NumPy's, and at most 1 % above."""
    content = problem(lag, delay)
    proof = linear_proof(content, name, 0.0 if name == "psi" else 0.03)
    with ball_precision():
        responses = cell_responses(content, name, observe_channel(content, name, proof), SAMPLES, CELLS)
    count = len(responses.signals) - 1
    signals = responses.signals[:count]
    per_phase = count // len(PHASES)
    initial = np.array(content["channels"][name]["initial"])
    for i, signal in enumerate(signals):
        g, starts = brute_force(content, name, proof, PHASES[i // per_phase], signal)
        sums = np.cumsum(g, axis=0)
        pairs = [(sums[SAMPLES * (m + 1) - 1], responses.upper[m, i]) for m in range(CELLS)]
        pairs += [(sums[-1], responses.total_sum[i])]
        pairs += [(sums[SAMPLES * m - 1], responses.lower[m, i]) for m in range(1, CELLS)]
        assert np.all(np.abs(responses.lower[0, i] - g[0]) <= 0.01 * g[0] + 1e-5 * sums[-1])
        for j in range(CELLS):
            within = starts[SAMPLES * j : SAMPLES * (j + 1)]
            pairs += [((within[:, :2] @ initial).max(), responses.starts[j, i])]
            pairs += [(within[:, 2].max(), responses.deviations[j, i])]
        pairs += [((starts[SAMPLES * CELLS :, :2] @ initial).max(), responses.starts[-1, i])]
        for reached, bound in pairs:
            assert np.all(reached <= bound * (1.0 + 1e-5) + 1e-14), signal
            assert np.all(bound <= 1.01 * reached + 1e-9), signal


def test_responses_to_the_constant_bound_those_of_each_cell():
    """The loop of z in NumPy, with the constant 1 from t = 0 on; e and u_av rise to their final values."""
    content = problem(0.05, 1.5)
    proof = linear_proof(content, "z", 0.03)
    with ball_precision():
        responses = cell_responses(content, "z", observe_channel(content, "z", proof), SAMPLES, CELLS)
    a, _, _, channel, sampled = sampled_numbers(content, "z", proof)
    t = content["sample_time"]
    n = channel.order
    generator = np.zeros((n + 2, n + 2))
    generator[:n, : n + 1] = middles(channel.generator)
    generator[1, n + 1] = 1.0
    forced = expm(generator * t)[:n, n + 1]
    states = [np.zeros(len(a))]
    for _ in range(8000):
        after = a @ states[-1]
        after[:n] += forced
        states.append(after)
    states = np.array(states)
    held = np.column_stack([states[:, :n], states @ middles(sampled.acting)[0], np.ones(len(states))])
    per_phase = len(channel.signals)
    for i, signal in enumerate(responses.signals[:-1]):
        seen = held @ expm(generator * float(PHASES[i // per_phase]) * t).T
        reached = np.abs(seen[:, : n + 1] @ middles(channel.signals[signal])[0])
        for j in range(CELLS + 1):
            cell = slice(SAMPLES * j, SAMPLES * (j + 1) if j < CELLS else None)
            assert reached[cell].max() <= responses.constants[j, i] * (1.0 + 1e-9)
            assert responses.constants[j, i] <= 1.001 * reached[cell].max() + 1e-5 * reached.max() + 1e-9


def test_effects_of_random_inputs_bound_the_sum_over_samples():
    """Random inputs, falling ones and constant ones: at no sample of any cell the exact sum exceeds the bound."""
    content = problem(0.05, 1.5)
    proof = linear_proof(content, "x", 0.03)
    with ball_precision():
        responses = cell_responses(content, "x", observe_channel(content, "x", proof), SAMPLES, CELLS)
    i = responses.signals.index("turn")
    g, _ = brute_force(content, "x", proof, PHASES[0], "turn")
    rng = np.random.default_rng(1)
    tightest = np.full(3, np.inf)
    for kind in range(3):
        for _ in range(20):
            sizes = rng.random((CELLS + 1, g.shape[1]))
            falling = sizes[0] * 0.95 ** np.arange(CELLS + 1)[:, None]
            sizes = [sizes, falling, np.ones(sizes.shape)][kind]
            held = np.repeat(sizes, SAMPLES, axis=0)
            held = np.vstack([held, np.repeat(sizes[-1:], LONG - len(held), axis=0)])
            for u in range(g.shape[1]):
                sums = np.convolve(held[:, u], g[:, u])[:LONG]
                for j in range(CELLS + 1):
                    bound = effects_of(responses, sizes[: j + 1], j == CELLS)[i, u]
                    cell = slice(SAMPLES * j, SAMPLES * (j + 1) if j < CELLS else None)
                    assert sums[cell].max() <= bound * (1.0 + 1e-6)
                    tightest[kind] = min(tightest[kind], sums[cell].max() / bound)
    assert tightest[1] > 0.85
    assert tightest[2] > 0.98


def test_regions_share_their_pieces_and_agree_with_each_alone():
    """The largest over the pieces up to a bound is that of the region, to within the room of the enclosures."""
    content = problem()
    proof = linear_proof(content, "x", 0.03)
    sigmas = [0.8, 0.02, 0.3, 0.3, 2.5]
    with ball_precision():
        together = deviations_in_regions(content, "x", proof, [arb(sigma) for sigma in sigmas])
        for sigma, deviations in zip(sigmas, together, strict=True):
            alone = deviations_of(content, "x", proof, sigma)
            for shared, own in zip(deviations, alone, strict=True):
                assert abs(float(shared) / float(own) - 1.0) < 2e-3


def hexacopter_bounds(scale):
    """A hexacopter with a rotor lag, and bounds of its signals."""
    content = problem(0.05) | {"rotors": 6}
    bounds = {name: dict.fromkeys(signal_names(name, lagging=True), arb("0.02") * scale) for name in CHANNELS}
    return content, bounds


def test_rotors_with_a_lag_remember_the_cells_before():
    """After a rough cell f_min, f_max and d stay; without a lag they belong to the cell."""
    with ball_precision():
        content, rough = hexacopter_bounds(3)
        _, calm = hexacopter_bounds(1)
        dampings = dict.fromkeys(CHANNELS, 0.0)
        at = ranges_of(content)
        before = remainders_of(content, at, rough, dampings)
        alone = remainders_of(content, at, calm, dampings)
        after = remainders_of(content, at, calm, dampings, before)
        assert after.rotors.smallest == before.rotors.smallest < alone.rotors.smallest
        assert after.rotors.largest == before.rotors.largest > alone.rotors.largest
        assert after.shortfall == before.shortfall > alone.shortfall
        assert alone.channels["x"]["lag"] < after.channels["x"]["lag"] < before.channels["x"]["lag"]
        four = remainders_of(content | {"rotors": 4}, at, rough, dampings)
        assert remainders_of(content | {"rotors": 4}, at, calm, dampings, four).shortfall < four.shortfall
        stiff = problem()
        before = remainders_of(stiff, at, rough, dampings)
        assert remainders_of(stiff, at, calm, dampings, before) == remainders_of(stiff, at, calm, dampings)
        too_far = after._replace(shortfall=arb(100))
        with pytest.raises(Rejected, match="V3: the rotors may be too far behind"):
            remainders_of(content, at, calm, dampings, too_far)


@pytest.fixture(scope="module")
def resting() -> JsonObject:
    """A certificate without cells, in a wind of 3 m/s and from rest."""
    study = dj.Study.load("studies/hover_wind_tuned.toml").override({"wind.speed": 3.0, "wind.vertical": 1.5})
    return dj.prove(study).certificate()


def with_cells(certificate, samples, count, factor):
    """The same with cells, whose bounds are those of all times times a factor."""
    result = copy.deepcopy(certificate)
    channels = result["proof"]["channels"]
    bounds = {
        name: {signal: [factor * y] * count for signal, y in channels[name]["bounds"].items()} for name in CHANNELS
    }
    result["proof"]["cells"] = {"samples": samples, "bounds": bounds}
    return result


def test_cells_with_the_bounds_of_all_times_are_proved(resting):
    """The bounds are the largest, the envelope holds all; the upper limits are those without cells."""
    without = verify_vehicle(resting)
    assert without.proved
    assert without.cell == 0.0
    assert dict(without.envelope) == {}
    verdict = verify_vehicle(with_cells(resting, 40, 5, 1.0005))
    assert verdict.proved, verdict.reason
    assert verdict.cell == 40 * 0.005
    assert verdict.settled == without.settled
    assert without.tilt < verdict.tilt < 1.001 * without.tilt
    assert verdict.rotor_min < without.rotor_min < without.rotor_max < verdict.rotor_max
    for name in CHANNELS:
        for signal, y in without.bounds[name].items():
            assert len(verdict.envelope[name][signal]) == 6
            assert verdict.envelope[name][signal][-1] == y
            assert verdict.bounds[name][signal] == verdict.envelope[name][signal][2] == pytest.approx(1.0005 * y)


@pytest.mark.parametrize(("name", "signal", "cell"), [("x", "e", 2), ("z", "sigma", 0), ("psi", "u_av", 4)])
def test_a_bound_below_what_is_reached_is_refused(resting, name, signal, cell):
    """The reason names cell and signal."""
    certificate = with_cells(resting, 40, 5, 1.0005)
    certificate["proof"]["cells"]["bounds"][name][signal][cell] *= 0.01
    verdict = verify_vehicle(certificate)
    assert verdict.reason == f"V4: the bound of {name}.{signal} in cell {cell} does not imply itself"
    assert dict(verdict.envelope) == {}


def test_premises_of_a_cell_are_refused_with_its_number(resting):
    """V3 names the cell; the last cell has earlier ones to bear."""
    certificate = with_cells(resting, 40, 5, 1.0005)
    certificate["proof"]["cells"]["bounds"]["psi"]["e"][3] = 4.0
    assert verify_vehicle(certificate).reason == "V3: psi.e may reach half a turn in cell 3"
    reason = verify_vehicle(with_cells(resting, 400, 5, 1.05)).reason
    assert reason.startswith("V4: the bound of ")
    assert reason.endswith(" in the last cell does not imply itself")
    certificate = with_cells(resting, 40, 5, 1.0005)
    certificate["proof"]["cells"]["bounds"]["x"]["u_av"][1] = 3.1
    assert verify_vehicle(certificate).reason == "V5: the equivalent control of x may exceed rho"


def repeated(vehicle, bounds, responses):
    """F of bounds in cells again and again, each time with some room."""
    for _ in range(16):
        implied = implied_in_cells(vehicle, bounds, inputs_in_cells(vehicle, bounds), responses)
        bounds = [
            {name: {signal: (1.005 * y).upper() for signal, y in cell[name].items()} for name in CHANNELS}
            for cell in implied
        ]
    return bounds


def test_bounds_of_a_start_away_from_rest_fall_from_cell_to_cell():
    """Bounds found by repeating F in cells are proved, where one bound for all times does not imply itself."""
    content = problem()
    content["channels"]["x"]["initial"] = [0.1, 0.0]
    dampings = {"x": 0.03, "z": 0.02, "psi": 0.0}
    count = 15
    proof = {"channels": {name: linear_proof(content, name, dampings[name]) for name in CHANNELS}, "settled": None}
    names = {name: signal_names(name, lagging=False) for name in CHANNELS}
    listed = {name: {signal: [0.0] * count for signal in names[name]} for name in CHANNELS}
    proof["cells"] = {"samples": 100, "bounds": listed}
    with ball_precision():
        vehicle = vehicle_of(content, proof["channels"])
        y = [{name: dict.fromkeys(names[name], arb("1e-3")) for name in CHANNELS} for _ in range(count + 1)]
        y = repeated(vehicle, y, responses_in_cells(vehicle, proof["cells"]))
    for name in CHANNELS:
        proof["channels"][name]["bounds"] = {signal: float(bound) for signal, bound in y[-1][name].items()}
        listed[name] = {signal: [float(cell[name][signal]) for cell in y[:-1]] for signal in names[name]}
    certificate = json.loads(json.dumps({"version": 2, "kind": "vehicle", "problem": content, "proof": proof}))
    verdict = verify_vehicle(certificate)
    assert verdict.proved, verdict.reason
    e = verdict.envelope["x"]["e"]
    assert max(e) == verdict.bounds["x"]["e"] > 0.1
    assert np.all(np.diff(e[3:-1]) < 0.0)
    assert e[-1] < 0.6 * e[0]
    assert verdict.settled["x"]["e"] < e[-1]
    with ball_precision():
        alone = vehicle_of(content, proof["channels"])
        with pytest.raises(Rejected, match="V3: "):
            repeated(alone, y[-1:], {})


MALFORMED = [
    (lambda cells: cells | {"more": 1}, "V0: cells has an unknown entry more"),
    (lambda _: [], "V0: cells is no table"),
    (lambda cells: cells | {"samples": 2001}, "V0: cells.samples is no integer from 1 to 2000"),
    (lambda cells: cells | {"samples": 40.0}, "V0: cells.samples is no integer"),
    (lambda cells: cells | {"bounds": {}}, "V0: cells.bounds has no entry psi, x, z"),
]


@pytest.mark.parametrize(("change", "reason"), MALFORMED)
def test_malformed_cells_are_refused(resting, change, reason):
    """Entries and numbers of samples."""
    certificate = with_cells(resting, 40, 5, 1.0005)
    certificate["proof"]["cells"] = change(certificate["proof"]["cells"])
    assert verify_vehicle(certificate).reason.startswith(reason)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ([1.0] * 4, "V0: cells.z.e has 4 items in place of 5"),
        ([1.0, 0.0, 1.0, 1.0, 1.0], "V0: cells.z.e is not positive"),
        ([1.0, "1", 1.0, 1.0, 1.0], "V0: cells.z.e is not a finite number"),
    ],
)
def test_malformed_lists_of_bounds_are_refused(resting, values, reason):
    """Their length, and signs."""
    certificate = with_cells(resting, 40, 5, 1.0005)
    certificate["proof"]["cells"]["bounds"]["z"]["e"] = values
    assert verify_vehicle(certificate).reason == reason


def test_too_many_and_missing_cells_are_refused(resting):
    """401 or none; and a proof without the entry."""
    assert "more than 400" in verify_vehicle(with_cells(resting, 40, 401, 1.0005)).reason
    assert "has no items" in verify_vehicle(with_cells(resting, 40, 0, 1.0005)).reason
    certificate = copy.deepcopy(resting)
    del certificate["proof"]["cells"]
    assert verify_vehicle(certificate).reason == "V0: proof has no entry cells"
