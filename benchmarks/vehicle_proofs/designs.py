"""Random loops of a hovering vehicle, and those of them that are proved."""

import math
import multiprocessing
from functools import cache
from typing import NamedTuple

import numpy as np

import dssc_jax as dj
from dssc_jax.core.json_types import JsonObject
from dssc_jax.models.uav.vehicle import alternating, ring
from dssc_jax.proofs.prove_vehicle import prove_vehicle
from dssc_jax.proofs.vehicle_coverage import vehicle_problem_of
from dssc_jax.proofs.vehicle_words import stated_bounds
from dssc_jax.proofs.verifier.vehicle.verdict import VehicleVerdict

TUNED = "hover_wind_tuned"
SPREAD = 0.3
"""Gains are within this share of the tuned ones."""
FASTEST_WIND = 10.0  # m/s
SLOWEST_MOTOR = 0.05  # s
LONGEST_DELAY = 4.0  # samples
MASS_SPREAD, INERTIA_SPREAD = 0.02, 0.05
PROCESSES = 2
GAINS = ("l0", "functions.kappa_o", "functions.kappa_m", "functions.tau_av", "rho")


class Design(NamedTuple):
    """A proved loop.

    Args:
        certificate: Its certificate.
        bounds: Bounds of its signals, see :func:`bounds_of`.
    """

    certificate: JsonObject
    bounds: JsonObject


def bounds_of(verdict: VehicleVerdict) -> JsonObject:
    """The bounds that a statement holds, and those of two norms of the plane."""
    plane = verdict.bounds["x"]
    return stated_bounds(verdict)["bounds"] | {"speed": plane["speed"], "alpha": plane["alpha"]}


def law(rng: np.random.Generator, middle: float, spread: float) -> dict[str, list[float]]:
    """A uniform law about a number, with at most the given spread."""
    half = middle * rng.uniform(0.1, 1.0) * spread
    return {"uniform": [middle - half, middle + half]}


def inertia_laws(rng: np.random.Generator, inertia: tuple[float, ...]) -> list[dict[str, list[float]]]:
    """Laws of the body's inertia; I_z is at most the sum of the others, as the triangle inequality demands."""
    laws = [law(rng, value, INERTIA_SPREAD) for value in inertia]
    x, y, z = (entry["uniform"] for entry in laws)
    z[1] = min(z[1], x[0] + y[0])
    return laws


def random_changes(rng: np.random.Generator) -> dict[str, object]:
    """Changes of the tuned study: wind, gains, lag, delay, laws, rotors and starts."""
    speed = rng.uniform(1.0, FASTEST_WIND)
    changes: dict[str, object] = {"wind.speed": speed, "wind.vertical": speed * rng.uniform(0.1, 0.6)}
    base = dj.Study.load(TUNED)
    for place, channel in ((0, ""), (2, "z."), (3, "psi.")):
        gains = base.template.controller[place]
        values = {
            "l0": gains.l0,
            "functions.kappa_o": gains.functions.kappa_o,
            "functions.kappa_m": gains.functions.kappa_m,
            "functions.tau_av": gains.functions.tau_av,
            "rho": gains.rho.rho,
        }
        for name in GAINS:
            changes[f"controller.{channel}{name}"] = values[name] * rng.uniform(1.0 - SPREAD, 1.0 + SPREAD)
    changes["controller.predictor_start"] = str(rng.choice(["matched", "midpoint", "zero"], p=[0.5, 0.3, 0.2]))
    if rng.random() < 0.5:
        changes["plant.vehicle.motor_lag"] = rng.uniform(0.005, SLOWEST_MOTOR)
    if rng.random() < 0.5:
        samples = rng.uniform(0.0, LONGEST_DELAY)
        samples = float(math.ceil(samples)) if rng.random() < 0.5 else samples
        changes["unmodelled"] = {"kind": "delay", "samples": samples}
    vehicle = base.template.plant.vehicle
    if rng.random() < 0.5:
        changes["plant.vehicle.mass"] = law(rng, vehicle.mass, MASS_SPREAD)
    if rng.random() < 0.5:
        changes["plant.vehicle.body_inertia"] = inertia_laws(rng, vehicle.body_inertia)
    if rng.random() < 0.4:
        changes |= {"plant.vehicle.rotor_angles": list(ring(6)), "plant.vehicle.spins": list(alternating(6))}
    if rng.random() < 0.3:
        away = {"uniform": [-0.05, 0.05]}
        changes |= {"plant.position": [away] * 3, "plant.velocity": [away] * 3, "plant.yaw": {"uniform": [-0.01, 0.01]}}
    return changes


def design_of(seed: int) -> Design | str:
    """The proof of a random loop, or why there is none."""
    study = dj.Study.load(TUNED).override(random_changes(np.random.default_rng([7, seed])))
    proved = prove_vehicle(vehicle_problem_of(study))
    if not proved.complete or proved.verdict is None:
        return proved.reason
    return Design(proved.certificate(), bounds_of(proved.verdict))


@cache
def designs(tries: int) -> tuple[list[Design], list[str]]:
    """The proved ones of so many random loops, and why the others are not."""
    with multiprocessing.get_context("spawn").Pool(PROCESSES) as pool:
        found = list(pool.imap(design_of, range(tries)))
    return [each for each in found if isinstance(each, Design)], [each for each in found if isinstance(each, str)]
