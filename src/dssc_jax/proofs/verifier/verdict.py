"""The verifier: a certificate is proved if every inequality holds in ball arithmetic.

It shares no code with the search, only the certificate's numbers. Every number is a ball (`arb` of FLINT) that contains
the exact one; the floating-point numbers of the certificate are exact. docs/proofs.md states the theorem whose premises
are checked here, (P0) to (P8).
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise, product
from typing import Any, NamedTuple

from flint import arb, ctx

from dssc_jax.proofs.verifier.balls import ENTERED, Rejected, StageLimits, require_premise
from dssc_jax.proofs.verifier.enclosed_loop import signal_bounds
from dssc_jax.proofs.verifier.gain_enclosures import enclosed_gains
from dssc_jax.proofs.verifier.invariant_sets import invariant_bounds
from dssc_jax.proofs.verifier.small_gain import implied_bounds
from dssc_jax.proofs.verifier.well_formed import require_certificate, require_problem, require_proof

PRECISION = 160  # bits
STAGE_METHODS = {"invariant set": invariant_bounds, "small gain": implied_bounds}


class ProofVerdict(NamedTuple):
    """The verifier's answer.

    Args:
        proved: Whether every premise holds.
        reason: The first premise that could not be shown, with its place; empty if proved.
        error: Upper bound of |e| [m] at all times, once the loop has settled; infinite if not proved.
        largest_error: Upper bound of |e| [m] from the start on.
    """

    proved: bool
    reason: str
    error: float
    largest_error: float


@contextmanager
def ball_precision() -> Iterator[None]:
    """Set the working precision of all balls."""
    before, ctx.prec = ctx.prec, PRECISION
    try:
        yield
    finally:
        ctx.prec = before


def verify_certificate(certificate: dict[str, Any]) -> ProofVerdict:
    """Verify a certificate: its problem, and the proof of every box. The boxes have to cover the problem's intervals.

    Args:
        certificate: The content of a certificate's file.
    """
    try:
        require_certificate(certificate)
        problem, proofs = certificate["problem"], certificate["proofs"]
        require_premise(certificate["complete"], "P1: the certificate itself says that it is not complete")
        require_cover(problem, [proof["box"] for proof in proofs])
    except Rejected as rejected:
        return refused(rejected)
    verdicts = [verify_proof(problem, proof) for proof in proofs]
    rejected = next((each for each in verdicts if not each.proved), None)
    error, largest = (max(getattr(each, name) for each in verdicts) for name in ("error", "largest_error"))
    return rejected or ProofVerdict(True, "", error, largest)


def verify_proof(problem: dict[str, Any], proof: dict[str, Any]) -> ProofVerdict:
    """Verify the proof of one box alone."""
    with ball_precision():
        try:
            require_problem(problem)
            require_proof(problem, proof)
            limits = verified_stages(problem, proof)
            errors = [above(each) for each in limits]
            require_premise(all(map(math.isfinite, errors)), "P0: a bound of |e| is not finite, and proves nothing")
        except Rejected as rejected:
            return refused(rejected)
    return ProofVerdict(True, "", min(errors), errors[0])


def above(limits: StageLimits) -> float:
    """The bound of |e(t)|, rounded up."""
    return math.nextafter(float(limits.between), math.inf)


def refused(rejected: Rejected) -> ProofVerdict:
    """The verdict on a premise that could not be shown."""
    return ProofVerdict(False, str(rejected), float("inf"), float("inf"))


def require_cover(problem: dict[str, Any], boxes: list[dict[str, Any]]) -> None:
    """(P1) The boxes cover the intervals of k_p, a_p and 1/mu: every cell of the grid of all ends lies in one."""
    whole = {"k_p": problem["k_p"], "a_p": problem["a_p"]}
    if problem["denominator"]:
        low, high = problem["mu"]
        whole["rate"] = (1.0 / high, 1.0 / low)
    require_premise(bool(boxes), "P1: no box")
    names = list(whole)
    grids = []
    for name in names:
        low, high = whole[name]
        inner = {end for box in boxes for end in box[name] if low < end < high}
        grids.append(list(pairwise(sorted({low, high} | inner))) or [(low, high)])
    for cell in product(*grids):
        held = any(
            all(box[name][0] <= low and high <= box[name][1] for name, (low, high) in zip(names, cell, strict=True))
            for box in boxes
        )
        require_premise(held, f"P1: no box covers {dict(zip(names, cell, strict=True))}")


def verified_stages(problem: dict[str, Any], proof: dict[str, Any]) -> list[StageLimits]:
    """Check every stage of a box; return what each shows."""
    box = proof["box"]
    limits: list[StageLimits] = []
    for number, stage in enumerate(proof["stages"], 1):
        where = f"stage {number} of the box {box}"
        own = {**problem, "level": stage["level"], "slope": stage["slope"]}
        if limits:
            require_region(limits[-1], arb(ENTERED), stage, f"P4: the stage before {where}")
            require_disturbance(problem, limits[-1], stage, f"P8: the stage before {where}")
        elif problem["rho"] is not None:
            exceeds = arb(problem["rho"]) > signal_bounds(own, box).offset
            require_premise(exceeds, "P5: rho does not exceed what disturbance and reference ask for")
        gains = enclosed_gains(problem, stage["sigma"], stage["e"])
        limits.append(STAGE_METHODS[stage["method"]](own, box, stage, gains, started=number == 1, where=where))
        if number == 1:
            require_region(limits[0], arb(1), stage, f"P4: {where}")
            require_disturbance(problem, limits[0], stage, f"P8: {where}")
    return limits


def require_disturbance(problem: dict[str, Any], limits: StageLimits, stage: dict[str, Any], who: str) -> None:
    """(P8) What was shown allows no larger disturbance, and no steeper one, than a stage takes for granted."""
    for name, added in (("level", limits.level), ("slope", limits.slope)):
        require_premise(arb(problem[name]) + added <= arb(stage[name]), f"{who} allows a disturbance of larger {name}")


def require_region(limits: StageLimits, factor: arb, stage: dict[str, Any], who: str) -> None:
    """(P4) What was shown lies in the region of a stage."""
    for name, limit in (("sigma", limits.sigma), ("e", limits.e)):
        require_premise(limit * factor <= arb(stage[name]), f"{who} leaves |{name}| <= {stage[name]}")
    if stage.get("coordinate") == "u_av":
        require_premise(limits.moved * factor <= arb(stage["moved"]), f"{who} lets e change by more in a sample")
