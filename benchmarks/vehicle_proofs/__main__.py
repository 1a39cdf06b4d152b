"""``make vehicle``: bounds beside worst winds, adversarial flights, falsified certificates, integration, the mission.

``python -m benchmarks.vehicle_proofs PART ..`` measures some of them.
"""

import sys
import textwrap
import time
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import dssc_jax as dj
from benchmarks.page import put
from benchmarks.vehicle_proofs.designs import GAINS, SPREAD, Design, bounds_of, designs
from benchmarks.vehicle_proofs.falsified import CHANGES, Falsified, falsified
from benchmarks.vehicle_proofs.flights import ROUNDED, Columns, fly
from benchmarks.vehicle_proofs.missions import mission_text
from dssc_jax.core.json_types import JsonObject
from dssc_jax.models.uav.vehicle import alternating, ring
from dssc_jax.proofs.prove_vehicle import VehicleProved, prove_vehicle
from dssc_jax.proofs.vehicle_coverage import vehicle_problem_of
from dssc_jax.proofs.verifier.vehicle.verdict import verify_vehicle

PAGE = Path(__file__).parents[2] / "docs" / "vehicle_proofs.md"
TRIES = 48
"""Random loops."""
FLIGHTS, SECONDS = 100_000, 20.0
FALSIFIED, CHECKS = 300, 256
SUBSTEPS = 8
AT_ONCE = {
    "wind.speed": 5.0,
    "wind.vertical": 2.5,
    "plant.vehicle.motor_lag": 0.05,
    "unmodelled": {"kind": "delay", "samples": 4.0},
    "plant.vehicle.mass": {"uniform": [0.98 * 10.9, 1.02 * 10.9]},
    "plant.vehicle.body_inertia": [{"uniform": ends} for ends in ([0.38, 0.42], [0.38, 0.42], [0.703, 0.757])],
}
SIX = {"plant.vehicle.rotor_angles": list(ring(6)), "plant.vehicle.spins": list(alternating(6))}
CASES = (
    *((f"Case 1, {speed:g} m/s", "hover_wind", speed, {}) for speed in (3.0, 5.0, 8.0, 10.0)),
    *((f"tuned, {speed:g} m/s", "hover_wind_tuned", speed, {}) for speed in (8.0, 12.0)),
    ("all at once, 5 m/s", "hover_wind_tuned", 5.0, AT_ONCE),
    ("all at once, 5 m/s, six rotors", "hover_wind_tuned", 5.0, AT_ONCE | SIX),
)
"""Label, study, bound of the horizontal wind [m/s] and other changes."""


class Case(NamedTuple):
    """A proved study, the worst wind found for it, and the proof's two parts in seconds of a processor."""

    label: str
    study: dj.Study
    proved: VehicleProved
    search: float
    verification: float
    worst: Any


@cache
def cases() -> list[Case]:
    """Every case."""
    found = []
    for label, name, speed, changes in CASES:
        study = dj.Study.load(name).override({"wind.speed": speed, "wind.vertical": 0.5 * speed} | changes)
        began = time.process_time()
        proved = prove_vehicle(vehicle_problem_of(study))
        both = time.process_time() - began
        verify_vehicle(proved.certificate())
        verification = time.process_time() - began - both
        worst = dj.worst_wind(study, signals=["error_max_x"])
        found.append(Case(label, study, proved, both - verification, verification, worst))
        print(label, proved.statement(), worst.answer.signals[0].worst, flush=True)
    return found


def bounds_text() -> str:
    """What is proved of the packaged gains, beside the worst wind found."""
    head = (
        "case", "proved abs(e_x) [m]", "settled", "tilt [deg]", "rotors [N]", "worst found [m]", "ratio",
        "search, verification [s of a processor]",
    )  # fmt: skip
    rows = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for case in cases():
        worst = case.worst.answer.signals[0].worst
        if case.proved.verdict is None or not case.proved.complete:
            rows.append(f"| {case.label} | {case.proved.reason} | | | | {worst:.4g} | | |")
            continue
        verdict = case.proved.verdict
        cells = (
            case.label,
            f"{case.proved.largest_error:.4g}",
            f"{case.proved.error:.4g}",
            f"{np.degrees(verdict.tilt):.3g}",
            f"{verdict.rotor_min:.2f} to {verdict.rotor_max:.2f}",
            f"{worst:.4g}",
            f"{case.proved.largest_error / worst:.3f}",
            f"{case.search:.1f}, {case.verification:.1f}",
        )
        rows.append(f"| {' | '.join(cells)} |")
    table = "\n".join(rows)
    return f"""\
`dj.prove` and `dj.worst_wind` (signal `error_max_x`) of the same study; the vertical wind is at most half of the
horizontal one. All at once: the tuned gains with a rotor lag of 0.05 s, an unmodelled delay of 4 samples, the
mass within 2 % and the body's inertia within 5 % (I_z up to 0.757, as the triangle inequality of inertias
demands). The search of the worst wind moves mass and inertia, too. It gives a lower bound: the true worst case
lies between the two columns.

{table}"""


def integration_text() -> str:
    """How far the simulated signals are from those of a finer integration, in the worst winds found."""
    rows = ["| case | signal | largest deviation | bound | share |", "|---|---|---|---|---|"]
    largest = 0.0
    for case in cases():
        if case.proved.verdict is None or not case.proved.complete:
            continue
        study = case.worst.flight("error_max_x")
        coarse, fine = dj.simulate(study), dj.simulate(study.override({"loop.substeps": SUBSTEPS}))
        bounds = bounds_of(case.proved.verdict)
        shares = {name: (gap, bound, gap / bound) for name, (gap, bound) in gaps(coarse, fine, bounds).items()}
        name = max(shares, key=lambda signal: shares[signal][2])
        largest = max(largest, shares[name][2])
        for signal in dict.fromkeys(("e_x", name)):
            gap, bound, share = shares[signal]
            rows.append(f"| {case.label} | {signal} | {gap:.2e} | {bound:.4g} | {share:.2e} |")
    return (
        "The theorem is about the exact differential equations; a simulation takes one step of RK4 in a sample. The "
        f"largest deviation of every stated signal (e, e', sigma of x, y, z, psi; tilt; rotors) between that and "
        f"{SUBSTEPS} steps a sample, at all samples of the worst winds found: at most {largest:.2e} of its bound. The "
        "table has e_x and the signal whose deviation is the largest share of its bound. The bound of a rotor counts "
        "from the thrust of hover.\n\n" + "\n".join(rows)
    )


def gaps(coarse: Any, fine: Any, bounds: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Largest deviation between two flights, and bound, of every stated signal."""

    def gap(name: str) -> float:
        return float(np.abs(coarse[name].values - fine[name].values).max())

    found = {}
    for channel in ("x", "y", "z", "psi"):
        for signal, column in (("e", "e"), ("e_dot", "y_dot"), ("sigma", "sigma")):
            found[f"{signal}_{channel}"] = (gap(f"{channel}_{column}"), bounds[channel][signal])
    found["tilt"] = (gap("tilt"), bounds["tilt"])
    rotors = [name for name in coarse if name.startswith("rotor_") and name.removeprefix("rotor_").isdigit()]
    hover = float(coarse["rotor_1"].values[0])
    distance = min(bounds["rotor_max"] - hover, hover - bounds["rotor_min"])
    found["rotors"] = (max(gap(name) for name in rotors), distance)
    return found


def flights_text() -> str:
    """Adversarial flights of random proved loops."""
    proved, refused = designs(TRIES)
    count = -(-FLIGHTS // len(proved))
    nearest: dict[str, list[float]] = {}
    left = 0
    at: list[str] = []
    began = time.perf_counter()
    for seed, design in enumerate(proved):
        flown = fly(design.certificate["problem"], design.bounds, count, SECONDS, seed)
        left += int(flown.left().sum())
        for name, share in flown.shares.items():
            nearest.setdefault(name, []).append(float(share.max()))
            at += [f"design {seed}, flight {i}: {name} {share[i]:.6g}" for i in np.flatnonzero(~(share <= ROUNDED))]
        at += [f"design {seed}, flight {i}: not sliding" for i in np.flatnonzero(flown.outside_sliding > 0.0)]
    print("\n".join(at[:40]))
    seconds = time.perf_counter() - began
    shares = {name: np.array(column) for name, column in nearest.items()}
    return described(proved, refused, count, left, shares, seconds)


def starts_of(problem: JsonObject) -> list[tuple[float, float]]:
    """Bounds of every channel's start."""
    return [channel["initial"] for channel in problem["channels"].values()]


def described(proved: list[Design], refused: list[str], count: int, left: int, nearest: Columns, seconds: float) -> str:
    """The flights in words and a table."""
    problems = [design.certificate["problem"] for design in proved]
    with_lag = sum(problem["rotor_lag"] > 0 for problem in problems)
    with_delay = sum(problem["delay"] > 0 for problem in problems)
    with_mass = sum(problem["mass"][0] < problem["mass"][1] for problem in problems)
    with_inertia = sum(problem["inertia"][0][0] < problem["inertia"][0][1] for problem in problems)
    six = sum(problem["rotors"] == 6 for problem in problems)
    away = sum(problem["channels"]["x"]["initial"][0] > 0 for problem in problems)
    reasons = ", ".join(f"{text} {times}" for text, times in Counter(refused).most_common())
    resting = np.array([not any(sum(pair) for pair in starts_of(problem)) for problem in problems])
    rows = ["| signal | nearest | nearest of the loops that start at rest | median of the loops |", "|---|---|---|---|"]
    for name, share in nearest.items():
        rows.append(f"| {name} | {share.max():.3f} | {share[resting].max():.3f} | {np.median(share):.3f} |")
    table = "\n".join(rows)
    return f"""\
{TRIES} random loops about the tuned gains ({len(GAINS)} gains of each channel within {100 * SPREAD:g} %, winds of
1 to 10 m/s): {len(proved)} are proved. Of these {with_lag} have a rotor lag
of up to 0.05 s, {with_delay} a delay of up to 4 samples, {with_mass} an uncertain mass, {with_inertia} an
uncertain inertia, {six} six rotors, and {away} start away from where they hover. Not proved: {reasons or "none"}.

{count * len(proved):,} flights of {SECONDS:g} s, {count:,} of each proved loop, in {seconds:.0f} s. Vehicles and
starts lie at the ends of their intervals or within. The wind is always at its bounds. It switches at random
times, swings with any period and with the loop's own, follows the motion or turns against it at every sample, or
is the worst wind of the linear loop, turned in time. Every signal is compared with its bound at every sample:
**{left} flights leave a bound or stop sliding.** The nearest to its bound, as a share of it (of a rotor: of the
distance from hover; speed and alpha are norms of the plane):

{table}"""


def falsified_text() -> str:
    """How falsified certificates fare; flights tell whether those that are accepted are true."""
    proved, _ = designs(TRIES)
    found = falsified(proved, FALSIFIED, 11)
    accepted = [(place, each) for place, each in enumerate(found) if each.bounds is not None]
    false, empty, flown, nearest = [], 0, 0, 0.0
    for place, each in accepted:
        assert each.bounds is not None
        try:
            flights = fly(each.content["problem"], each.bounds, CHECKS, SECONDS, place, each.origin)
        except ValueError:
            empty += 1
            continue
        flown += CHECKS
        nearest = max(nearest, *(float(share.max()) for share in flights.shares.values()))
        if flights.left().any():
            false.append(f"{place} ({each.kind})")
    print("false:", false)
    silent = sum(each.bounds is None and not each.reason for each in found)
    rejected = FALSIFIED - len(accepted)
    return f"""\
{FALSIFIED} certificates of these loops with one thing changed, by 1 % or 5 % unless the table says otherwise:
{rejected} are rejected, {silent} of them without a reason; {len(accepted)} are accepted, since their slack covers
the change, or the change makes the problem easier. {flown:,} adversarial flights of the changed problems,
{CHECKS} each: **{len(false)} accepted certificates are false**; the nearest signal reaches {nearest:.3f} of its
bound. {empty} accepted ones speak of no vehicle: their intervals of mass, thrust, turn and inertia exclude each
other.

{table_of(found)}"""


def table_of(found: list[Falsified]) -> str:
    """Rejected and accepted certificates and the premises that fail, by kind of the change."""
    rows = ["| changed | rejected | accepted | premises that fail |", "|---|---|---|---|"]
    for kind in CHANGES:
        these = [each for each in found if each.kind == kind]
        reasons = Counter(each.reason.split(":")[0] for each in these if each.bounds is None)
        told = ", ".join(f"{premise} {times}" for premise, times in sorted(reasons.items()))
        rejected = sum(each.bounds is None for each in these)
        rows.append(f"| {kind} | {rejected} | {len(these) - rejected} | {told} |")
    return "\n".join(rows)


def wrapped(text: str) -> str:
    """Text for a page, with lines of at most 120 characters outside of tables."""
    parts = text.split("\n\n")
    return "\n\n".join(part if part.startswith("|") else textwrap.fill(part, 120) for part in parts)


def main() -> None:
    """Measure the parts that are named, or all, and write each into the page."""
    parts = {
        "bounds": bounds_text,
        "flights": flights_text,
        "falsified": falsified_text,
        "integration": integration_text,
        "mission": mission_text,
    }
    for name in sys.argv[1:] or parts:
        began = time.perf_counter()
        text = parts[name]()
        put(name, f"{wrapped(text)}\n\n({time.perf_counter() - began:.0f} s.)", PAGE)


if __name__ == "__main__":
    main()
