"""The mission: bounds about the nominal flight beside the worst winds found, and adversarial flights."""

import time

import numpy as np

import dssc_jax as dj
from benchmarks.vehicle_proofs.designs import bounds_of
from benchmarks.vehicle_proofs.falsified import plain
from benchmarks.vehicle_proofs.flights import fly
from dssc_jax.proofs.prove_vehicle import prove_vehicle
from dssc_jax.proofs.vehicle_coverage import vehicle_problem_of
from dssc_jax.proofs.verifier.vehicle.verdict import verify_vehicle

MISSION = dj.Study.load("mission_wind").table
TUNED = {
    "reference": MISSION["reference"],
    "plant.position": MISSION["plant"]["position"],
    "plant.velocity": MISSION["plant"]["velocity"],
    "plant.yaw": MISSION["plant"]["yaw"],
    "loop.duration": 80.0,
}
CASES = (
    ("Case 1", "mission_wind", {}, 3.0),
    ("Case 1", "mission_wind", {}, 5.0),
    ("tuned", "hover_wind_tuned", TUNED, 5.0),
    ("tuned", "hover_wind_tuned", TUNED, 8.0),
)
"""Gains, study, its changes, and bound of the horizontal wind [m/s]."""
FLIGHTS, SECONDS = 5_000, 80.0
HEAD = (
    "gains, wind", "proved abs(e_x) [m]", "settled", "nominal", "worst found [m]", "ratio", "abs(e_z) [m]",
    "abs(e_psi) [rad]", "tilt [deg]", "flights' nearest", "search, verification [s of a processor]",
)  # fmt: skip


def mission_text() -> str:
    """What is proved of the mission, beside the worst wind found and adversarial flights."""
    rows = [f"| {' | '.join(HEAD)} |", "|" + "---|" * len(HEAD)]
    left = 0
    flown = 0
    for seed, (gains, name, changes, speed) in enumerate(CASES):
        study = dj.Study.load(name).override(changes | {"wind.speed": speed, "wind.vertical": 0.5 * speed})
        began = time.process_time()
        proved = prove_vehicle(vehicle_problem_of(study))
        both = time.process_time() - began
        label = f"{gains}, {speed:g} m/s"
        if proved.verdict is None or not proved.complete:
            rows.append(f"| {label} | {proved.reason} |" + " |" * (len(HEAD) - 2))
            continue
        certificate = plain(proved.certificate())
        began = time.process_time()
        verdict = verify_vehicle(certificate)
        verification = time.process_time() - began
        worst = dj.worst_wind(study, signals=["error_max_x"]).answer.signals[0].worst
        flights = fly(certificate["problem"], bounds_of(verdict), FLIGHTS, SECONDS, seed)
        left += int(flights.left().sum())
        flown += FLIGHTS
        nearest = max(flights.shares, key=lambda signal: flights.shares[signal].max())
        cells = (
            label,
            f"{proved.largest_error:.4g}",
            f"{proved.error:.4g}",
            f"{verdict.nominal['x']:.3g}",
            f"{worst:.4g}",
            f"{proved.largest_error / worst:.3f}",
            f"{verdict.bounds['z']['e']:.3g}",
            f"{verdict.bounds['psi']['e']:.3g}",
            f"{np.degrees(verdict.tilt):.3g}",
            f"{nearest} {flights.shares[nearest].max():.3f}, e_x {flights.shares['e_x'].max():.3f}",
            f"{both - verification:.1f}, {verification:.1f}",
        )
        rows.append(f"| {' | '.join(cells)} |")
        print(rows[-1], flush=True)
    table = "\n".join(rows)
    return f"""\
The mission from where it begins: with the reference's position, velocity and yaw, level, and without a turn. The
vertical wind is at most half of the horizontal one. `nominal` is the bound of |e_x| and |e_y| of the nominal flight,
which is part of the proved one. {flown:,} adversarial flights of {SECONDS:g} s, {FLIGHTS:,} of each proved loop:
**{left} leave a bound or stop sliding.**

{table}"""
