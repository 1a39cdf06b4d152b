"""The remainders of the whole vehicle: their bounds against the true equations of motion, in NumPy."""

import numpy as np
import pytest
from flint import arb

from dssc_jax.proofs.verifier.balls import Rejected
from dssc_jax.proofs.verifier.vehicle.drag import DragRegion, plane_drag, vertical_drag
from dssc_jax.proofs.verifier.vehicle.ranges import ranges_of
from dssc_jax.proofs.verifier.vehicle.remainders import remainders_of
from dssc_jax.proofs.verifier.vehicle.rotors import largest_shortfall
from dssc_jax.proofs.verifier.verdict import ball_precision
from tests.proofs.vehicle_cases import HOVER, problem
from tests.proofs.vehicle_model import Motion, Multirotor, commanded, signals_and_remainders


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
    for _ in range(250):
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


def test_rotors_of_an_octocopter_are_behind_in_the_null_space_of_the_allocation_too():
    """Their speeds follow commands that jump between two wrenches; thrust and moments alone tell too little."""
    craft, _, _ = random_case(np.random.default_rng(0), 0.05)
    craft.rotors = 8
    rng = np.random.default_rng(8)
    matrix = np.stack([craft.wrench(unit) for unit in np.eye(8)], axis=1)
    onto_wrenches = np.linalg.pinv(matrix) @ matrix
    hover = craft.mass_n * HOVER / 8
    exceeded = False
    for _ in range(40):
        sides = [craft.allocated(np.append(8.0 * hover, rng.standard_normal(3) * [3.0, 3.0, 0.5])) for _ in range(2)]
        smallest = min(side.min() for side in sides)
        if smallest < 0.5 * hover:
            continue
        speeds = np.full(8, np.sqrt(hover / craft.k_n))
        part = whole = 0.0
        for i in range(2000):
            wanted = sides[i // 5 % 2]
            speeds = speeds + (np.sqrt(wanted / craft.k_n) - speeds) * -np.expm1(-0.01 / craft.lag)
            for commanded_now in (wanted, sides[(i + 1) // 5 % 2]):
                behind = commanded_now - craft.k_n * speeds**2
                part = max(part, np.abs(onto_wrenches @ behind).max())
                whole = max(whole, np.abs(behind).max())
        exceeded |= whole > part * (1.0 + 1e-6)
        with ball_precision():
            assert whole <= float(largest_shortfall(arb(8), arb(part), arb(float(smallest))))
    assert exceeded
