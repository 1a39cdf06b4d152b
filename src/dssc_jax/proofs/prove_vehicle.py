"""Prove a vehicle that hovers or flies the mission: search for a proof, then verify it.

docs/vehicle_proofs.md has the theorem.
"""

import json
import math
import time
from dataclasses import dataclass
from typing import ClassVar

from dssc_jax.core.json_types import JsonObject
from dssc_jax.proofs.claims import VEHICLE_CLAIM, Claim
from dssc_jax.proofs.search.obstacles import Obstacle
from dssc_jax.proofs.search.vehicle.bounds import best_bounds, proof_of
from dssc_jax.proofs.search.vehicle.cells import cell_bounds, cells_proof_of
from dssc_jax.proofs.vehicle_problem import CHANNELS, VehicleProblem
from dssc_jax.proofs.vehicle_words import digits_above, digits_below, stated_bounds
from dssc_jax.proofs.verifier.vehicle.verdict import VehicleVerdict, verify_vehicle

VEHICLE_VERSION = 2
"""Version of the certificates of vehicles."""
VEHICLE_KIND = "vehicle"
"""The entry ``kind`` of a vehicle's certificate."""
INFLATION_FACTORS = (1.0, 10.0)
"""Multiples of the usual widening of the found bounds; the next one is tried if the verifier rejects the bounds."""
ROUNDED_START = 1e-9
"""Bounds of a start [m], [m/s], [rad] up to this size only cover rounding; a statement leaves them out."""
VEHICLE_REASONS = {
    Obstacle.GAIN: "no bounds of the signals imply themselves",
    Obstacle.SLIDING: "the equivalent control may exceed rho",
    Obstacle.VERIFIER: "the verifier rejects what the search found",
}


@dataclass(frozen=True)
class VehicleProved:
    """The outcome for a vehicle: bounds of its signals, for every wind and vehicle within the problem's intervals.

    Args:
        problem: The problem that was to be proved.
        proof: The proof that the verifier accepted, as a certificate holds it; None: there is no proof.
        verdict: The verifier's last verdict; None: the search found nothing to verify.
        failure: Why there is no proof: ``GAIN``, ``SLIDING`` or ``VERIFIER``; None if there is one.
        seconds: Computing time [s].
    """

    problem: VehicleProblem
    proof: JsonObject | None
    verdict: VehicleVerdict | None
    failure: Obstacle | None
    seconds: float
    claim: ClassVar[Claim] = VEHICLE_CLAIM

    @property
    def complete(self) -> bool:
        """Whether the vehicle is proved."""
        return self.failure is None

    @property
    def share(self) -> float:
        """1 if the vehicle is proved, else 0: its intervals are not cut into boxes."""
        return float(self.complete)

    @property
    def error(self) -> float:
        """Upper bound of |e| [m] along x and y once settled; infinite if nothing is proved."""
        return math.inf if self.verdict is None or self.failure else self.verdict.settled["x"]["e"]

    @property
    def largest_error(self) -> float:
        """Upper bound of |e| [m] along x and y from the start on; infinite if nothing is proved."""
        return math.inf if self.verdict is None or self.failure else self.verdict.bounds["x"]["e"]

    @property
    def reason(self) -> str:
        """Why there is no proof, in words; empty if there is one."""
        if not self.failure:
            return ""
        detail = f": {self.verdict.reason}" if self.verdict is not None else ""
        return VEHICLE_REASONS[self.failure] + detail

    def summary(self) -> JsonObject:
        """Make a table of the outcome, in JSON's types and SI units.

        It has the tables of :func:`dssc_jax.proofs.vehicle_words.stated_bounds`, or None in their place.
        """
        no_bounds = {"bounds": None, "settled": None}
        return {
            "proved": self.complete,
            "share": self.share,
            "boxes": int(self.complete),
            "error": self.error if self.complete else None,
            "largest_error": self.largest_error if self.complete else None,
            **(no_bounds if self.verdict is None or self.failure else stated_bounds(self.verdict)),
            "statement": self.statement(),
            "failures": [] if self.complete else [{"box": {}, "reason": self.failure, "text": self.reason}],
            "seconds": self.seconds,
        }

    def statement(self) -> str:
        """State what is proved, in a few sentences."""
        if self.verdict is None or self.failure:
            return f"Nothing is proved: {self.reason}."
        wind_h, wind_z = self.problem.wind
        bounds = self.verdict.bounds
        settled = self.verdict.settled
        vehicle = ", ".join(["", *vehicle_words(self.problem)])
        ends = ""
        if settled["x"]["e"] < 0.99 * bounds["x"]["e"]:
            plane = digits_above(settled["x"]["e"])
            height = digits_above(settled["z"]["e"])
            ends = f" It ends within |e_x|, |e_y| <= {plane} m and |e_z| <= {height} m."
        wind = f"every wind with |w_h| <= {wind_h:g} m/s and |w_z| <= {wind_z:g} m/s that changes as it likes"
        largest = {name: digits_above(bounds[name]["e"]) for name in CHANNELS}
        errors = f"|e_x|, |e_y| <= {largest['x']} m, |e_z| <= {largest['z']} m, |e_psi| <= {largest['psi']} rad"
        tilt = f"a tilt of {digits_above(math.degrees(self.verdict.tilt))} degrees"
        rotors = f"between {digits_below(self.verdict.rotor_min)} and {digits_above(self.verdict.rotor_max)} N"
        opening = "For"
        if self.problem.reference is not None:
            opening = "On the mission, from its first point on, level and without a turn there, for"
        return (
            f"{opening} {wind}{vehicle}, all four sampled channels slide from the first sample on, and the vehicle "
            f"never exceeds {errors} and {tilt}. Its rotors stay {rotors}.{ends}"
        )

    def certificate(self) -> JsonObject:
        """The content of a certificate's file; without a proof its entry ``proof`` is None."""
        return certificate_of(self.problem, self.proof if self.complete else None)


def vehicle_words(problem: VehicleProblem) -> list[str]:
    """List the phrases of a statement that apply to a vehicle: intervals, a rotor lag, a delay, a start off rest."""
    words = []
    if problem.thrust_deviation:
        words.append("every thrust over mass in [{:.4g}, {:.4g}] of the believed one".format(*problem.thrust))
    if problem.turn_deviation:
        words.append("every believed inertia in [{:.4g}, {:.4g}] of the true one".format(*problem.turn))
    if problem.rotor_lag:
        words.append(f"a rotor lag of {problem.rotor_lag:g} s")
    if problem.delay:
        words.append(f"a delay of {problem.delay * problem.sample_time:g} s")
    for name, place, unit in (("x", "in the plane", "m"), ("z", "along z", "m"), ("psi", "of yaw", "rad")):
        e, e_dot = problem.channels[name].initial
        if max(e, e_dot) > ROUNDED_START:
            words.append(f"a start within {e:.4g} {unit} and {e_dot:.4g} {unit}/s {place}")
    return words


def certificate_of(problem: VehicleProblem, proof: JsonObject | None) -> JsonObject:
    """Make the content of a certificate's file.

    Args:
        problem: The vehicle.
        proof: The proof; None: there is no proof, and the verifier will reject the file.
    """
    return {"version": VEHICLE_VERSION, "kind": VEHICLE_KIND, "problem": problem.to_dict(), "proof": proof}


def prove_vehicle(problem: VehicleProblem) -> VehicleProved:
    """Search for bounds of a vehicle's signals that imply themselves, and verify the bounds.

    If the verifier rejects the bounds, the search widens them more and tries again. The verifier receives the content
    of a certificate's file, so that it reaches the same verdict when it reads the file.
    """
    start_time = time.perf_counter()
    verdict: VehicleVerdict | None = None
    for inflation_factor in INFLATION_FACTORS:
        proof = search_proof(problem, inflation_factor)
        if isinstance(proof, Obstacle):
            # with a verdict, a narrower proof was found before, and rejected
            failure = proof if verdict is None else Obstacle.VERIFIER
            return VehicleProved(
                problem=problem, proof=None, verdict=verdict, failure=failure, seconds=time.perf_counter() - start_time
            )
        verdict = verify_vehicle(json.loads(json.dumps(certificate_of(problem, proof))))
        if verdict.proved:
            return VehicleProved(
                problem=problem, proof=proof, verdict=verdict, failure=None, seconds=time.perf_counter() - start_time
            )
    return VehicleProved(
        problem=problem,
        proof=None,
        verdict=verdict,
        failure=Obstacle.VERIFIER,
        seconds=time.perf_counter() - start_time,
    )


def search_proof(problem: VehicleProblem, inflation_factor: float) -> JsonObject | Obstacle:
    """Search for bounds that imply themselves.

    A vehicle that may start away from its rest is first given bounds in each cell of time. If these are not found, and
    for every other vehicle, the search looks for one bound of each signal at all times.

    Args:
        problem: The vehicle.
        inflation_factor: Multiple of the usual widening of bounds, which lets the verifier confirm them.

    Returns:
        The proof as a certificate holds it, or why none is found.
    """
    if problem.starts_away:
        bounds_in_cells = cell_bounds(problem, inflation_factor)
        if not isinstance(bounds_in_cells, Obstacle):
            return cells_proof_of(problem, bounds_in_cells)
    bounds = best_bounds(problem, inflation_factor)
    return bounds if isinstance(bounds, Obstacle) else proof_of(problem, bounds)
