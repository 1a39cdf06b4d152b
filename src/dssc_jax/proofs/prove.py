"""Prove a study's sampled loop: search for a proof, verify it, and halve every box of uncertain numbers without one."""

import heapq
import itertools
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.units import UNNAMED_UNITS, ChannelUnits
from dssc_jax.proofs import BOXES
from dssc_jax.proofs.claims import AXIS_CLAIM, Claim
from dssc_jax.proofs.coverage import AnyProblem, problem_of
from dssc_jax.proofs.problem import Box, Interval, ProofProblem
from dssc_jax.proofs.prove_vehicle import VEHICLE_KIND, VEHICLE_VERSION, VehicleProved, prove_vehicle
from dssc_jax.proofs.search.box_search import Failure, Proof, halves, prove_box, volume
from dssc_jax.proofs.search.obstacles import Obstacle
from dssc_jax.proofs.vehicle_problem import VehicleProblem
from dssc_jax.proofs.verifier.vehicle.verdict import VehicleVerdict, verify_vehicle
from dssc_jax.proofs.verifier.verdict import ProofVerdict, verify_certificate, verify_proof
from dssc_jax.study import Study

VERSION = 6
"""Version of the certificates of loops of the class (5)-(8)."""
REASONS = {
    Obstacle.ORIGIN: "the loop is not stable at sigma = e = 0",
    Obstacle.DECAY: "no common quadratic function decreases for all gains of the smallest region",
    Obstacle.REGION: "no invariant set holds the start and stays in a region whose gains it allows",
    Obstacle.GAIN: "no bounds of the signals imply themselves, with a disturbance that depends on the state",
    Obstacle.SLIDING: "the equivalent control may exceed rho",
    Obstacle.VERIFIER: "the verifier rejects what the search found",
}
"""Why a box is not proved, in words."""


@dataclass(frozen=True)
class Proved:
    """The outcome for a loop of the class (5)-(8): the proved boxes of its uncertain numbers, and bounds of |e|.

    Args:
        problem: The problem that was to be proved.
        proofs: The proofs that the verifier accepted, one for each proved box.
        failures: The boxes that were given up, each with the reason.
        error: Upper bound of |e| [m] at all times once settled, in the proved boxes; infinite if no box is proved.
        largest_error: Upper bound of |e| [m] from the start on; infinite if no box is proved.
        seconds: Computing time [s].
        units: Units of the output and the command, which the statement in words names.
    """

    problem: ProofProblem
    proofs: list[Proof]
    failures: list[Failure]
    error: float
    largest_error: float
    seconds: float
    units: ChannelUnits = UNNAMED_UNITS
    claim: ClassVar[Claim] = AXIS_CLAIM

    @property
    def complete(self) -> bool:
        """Whether every box is proved."""
        return not self.failures

    @property
    def reason(self) -> str:
        """Why the first of the boxes without a proof has none, in words; empty if all boxes are proved."""
        return REASONS[self.failures[0].reason] if self.failures else ""

    @property
    def share(self) -> float:
        """Share of the problem's box that is proved, by volume; 1/mu counts on a logarithmic scale."""
        if self.complete:
            return 1.0
        return float(sum(volume(proof.box, self.problem) for proof in self.proofs))

    def summary(self) -> JsonObject:
        """A table of the outcome, in JSON's types: whether all is proved, bounds of |e| [m], statement and failures."""
        has_proofs = bool(self.proofs)
        failures = [
            {"box": with_mu(failure.box), "reason": failure.reason, "text": REASONS[failure.reason]}
            for failure in self.failures
        ]
        return {
            "proved": self.complete,
            "share": self.share,
            "boxes": len(self.proofs),
            "error": self.error if has_proofs else None,
            "largest_error": self.largest_error if has_proofs else None,
            "statement": self.statement(),
            "failures": failures,
            "seconds": self.seconds,
        }

    def statement(self) -> str:
        """The proved statement in one sentence; if not all boxes are proved, it names the share of the plants."""
        if not self.proofs:
            return f"Nothing is proved: {self.reason}."
        box = with_mu(self.problem.box)
        intervals = " and ".join(interval_text(name, interval, self.units) for name, interval in box.items())
        plants = "every plant" if self.complete else f"{self.share:.1%} of the plants"
        level = self.units.of("u")
        slope = self.units.of("u/s")
        bounds = f"|d| <= {self.problem.level:g} {level} and |d'| <= {self.problem.slope:g} {slope}"
        signal = f"every disturbance with {bounds}"
        if any(self.problem.by_state):
            gains = ", ".join(f"k_d{i} = {k:g}" for i, k in enumerate(self.problem.by_state, 1) if k)
            signal = f"every disturbance that depends on the state with {gains} (docs/proofs.md), besides {bounds}"
        y = self.units.output
        slides = "" if self.problem.rho is None else "slides from the first sample on, "
        return (
            f"For {plants} with {intervals} and {signal}, the sampled loop {slides}never exceeds "
            f"|e| = {self.largest_error:.4g} {y} and ends within |e| <= {self.error:.4g} {y}."
        )

    def certificate(self) -> JsonObject:
        """The content of a certificate's file: the problem, and the proofs of the proved boxes."""
        proofs = [proof.to_dict() for proof in self.proofs]
        return {"version": VERSION, "complete": self.complete, "problem": self.problem.to_dict(), "proofs": proofs}


def with_mu(box: Box) -> Box:
    """Convert a box for readers: an interval of the time constant mu [s] replaces that of ``rate``, 1/mu [1/s]."""
    intervals = {name: interval for name, interval in box.items() if name != "rate"}
    if "rate" in box:
        low, high = box["rate"]
        intervals["mu"] = (1.0 / high, 1.0 / low)
    return intervals


def interval_text(name: str, interval: Interval, units: ChannelUnits) -> str:
    """A phrase such as ``mu in [0.01, 0.02] s``: an uncertain number, its interval or its only value, and its unit.

    Args:
        name: ``k_p``, ``a_p`` or ``mu``; any other name has the unit 1/s, as a_p.
        interval: Lower and upper end; equal ends are written as one value.
        units: Units of the output and the command, from which the unit of k_p follows.
    """
    unit = {"mu": "s", "k_p": units.of("y/(s^2 u)")}.get(name, "1/s")
    low, high = interval
    return f"{name} = {low:g} {unit}" if low == high else f"{name} in [{low:g}, {high:g}] {unit}"


AnyProved: TypeAlias = Proved | VehicleProved
"""What is proved of a loop of the class (5)-(8), or of a vehicle."""


def prove(study: Study, *, boxes: int = BOXES, progress: Callable[[int, int], None] | None = None) -> AnyProved:
    """Prove that a study's sampled loop slides and stays near its reference, for all values of its uncertain numbers.

    The support of each law becomes an interval. For a loop of the class (5)-(8), a box of intervals without a proof is
    halved, and each half is tried. Only what the verifier accepts counts as proved; see docs/proofs.md and
    docs/vehicle_proofs.md.

    Args:
        study: A study of DSSC, SSC or PI on a plant (5)-(8), or of a vehicle that hovers or flies the mission; its
            sweep is ignored.
        boxes: Largest number of boxes that are tried; a vehicle is one box.
        progress: Called after each box with the number of boxes done, and of all boxes known so far. A vehicle does
            not call it.

    Raises:
        NotCovered: The loop is outside of what a proof covers; the message gives the reason.
        ConfigError: ``boxes`` is not positive.
    """
    outcome = prove_problem(problem_of(study), boxes, progress)
    return replace(outcome, units=study.units[0]) if isinstance(outcome, Proved) else outcome


def prove_problem(problem: AnyProblem, boxes: int, progress: Callable[[int, int], None] | None = None) -> AnyProved:
    """Prove a problem that was read from a study: a vehicle in one piece, a loop of the class (5)-(8) box by box.

    Args:
        problem: The problem that is to be proved.
        boxes: Largest number of boxes that are tried; a vehicle is one box.
        progress: Called after each box with the number of boxes done, and of all boxes known so far. A vehicle does
            not call it.

    Raises:
        ConfigError: ``boxes`` is not positive.
    """
    if boxes < 1:
        raise ConfigError("boxes", f"must be at least 1, got {boxes}")
    if isinstance(problem, VehicleProblem):
        return prove_vehicle(problem)
    return prove_axis(problem, boxes, progress)


def prove_axis(problem: ProofProblem, boxes: int, progress: Callable[[int, int], None] | None) -> Proved:
    """Prove a loop of the class (5)-(8) for a box of uncertain numbers, in smaller boxes where one proof is not enough.

    Each step tries the largest box that is still open. A box without a proof is halved, unless it is a point or its
    halves would make more than ``boxes`` boxes in all; then it counts as a failure.

    Args:
        problem: The loop and its uncertain numbers.
        boxes: Largest number of boxes that are tried.
        progress: Called after each box with the number of boxes done, and of all boxes known so far.
    """
    start_time = time.perf_counter()
    content = problem.to_dict()
    order = itertools.count()
    # a heap of (-volume, number, box): the largest volume first, then the smallest number. The whole box has volume 1
    pending_boxes: list[tuple[float, int, Box]] = [(-1.0, next(order), problem.box)]
    proofs: list[Proof] = []
    failures: list[Failure] = []
    verdicts: list[ProofVerdict] = []
    tried_count = 0
    while pending_boxes:
        _, _, box = heapq.heappop(pending_boxes)
        tried_count += 1
        result = proved_box(problem, content, box)
        is_point = all(low == high for low, high in box.values())
        halves_are_too_many = tried_count + len(pending_boxes) + 2 > boxes
        if isinstance(result, VerifiedProof):
            proofs.append(result.proof)
            verdicts.append(result.verdict)
        elif is_point or halves_are_too_many:
            failures.append(result)
        else:
            for half in halves(box, problem):
                heapq.heappush(pending_boxes, (-volume(half, problem), next(order), half))
        if progress is not None:
            progress(tried_count, tried_count + len(pending_boxes))
    return Proved(
        problem=problem,
        proofs=proofs,
        failures=failures,
        error=max((verdict.error for verdict in verdicts), default=np.inf),
        largest_error=max((verdict.largest_error for verdict in verdicts), default=np.inf),
        seconds=time.perf_counter() - start_time,
    )


class VerifiedProof(NamedTuple):
    """A proof for one box that the verifier accepts, and the verifier's verdict with the bounds of |e|."""

    proof: Proof
    verdict: ProofVerdict


def proved_box(problem: ProofProblem, content: Mapping[str, object], box: Box) -> VerifiedProof | Failure:
    """Search for a proof for one box, and verify it.

    If the verifier rejects the proof, the last stage is dropped and the rest is verified again. The first stages alone
    are a proof, too, with a larger final bound of |e|.

    Args:
        problem: The loop and its uncertain numbers.
        content: The problem as a certificate holds it.
        box: Intervals of the uncertain numbers.
    """
    result = prove_box(problem, box)
    if isinstance(result, Failure):
        return result
    for count in range(len(result.stages), 0, -1):
        proof = Proof(box, result.stages[:count])
        verdict = verify_proof(content, proof.to_dict())
        if verdict.proved:
            return VerifiedProof(proof, verdict)
    return Failure(box, Obstacle.VERIFIER)


def check_certificate(content: object) -> ProofVerdict | VehicleVerdict:
    """Verify the content of a certificate's file, of a loop (5)-(8) or of a vehicle, without trust in its author.

    Args:
        content: The file's content, as it was read from JSON; any value is allowed.

    Raises:
        ConfigError: The content is no certificate of this program's version.
    """
    is_vehicle = isinstance(content, dict) and content.get("kind") == VEHICLE_KIND
    version = content.get("version") if isinstance(content, dict) else None
    expected_version = VEHICLE_VERSION if is_vehicle else VERSION
    if type(version) is not int or version != expected_version:
        rule = f"is not {expected_version}: no certificate of this program; prove the study again"
        raise ConfigError("version", rule)
    return verify_vehicle(content) if is_vehicle else verify_certificate(content)
