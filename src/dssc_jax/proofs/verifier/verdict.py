"""The verifier of a certificate: a loop is proved if the premises (P0) to (P8) of the theorem hold in ball arithmetic.

The verifier shares no code with the search. It takes the certificate's numbers as exact. All other numbers are balls
(`arb` of FLINT) that contain the exact ones, except that sums of impulse responses and Table 1's gains are float64 with
a bound of every rounding. docs/proofs.md states the theorem.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise, product
from typing import NamedTuple, cast

from flint import arb, ctx

from dssc_jax.proofs.verifier.balls import ENTERED, Balls, Rejected, StageLimits, require_premise
from dssc_jax.proofs.verifier.certificate import Box, BoxProof, InvariantStage, Problem, SmallGainStage
from dssc_jax.proofs.verifier.enclosed_loop import signal_bounds
from dssc_jax.proofs.verifier.gain_enclosures import enclosed_gains
from dssc_jax.proofs.verifier.invariant_sets import invariant_bounds
from dssc_jax.proofs.verifier.small_gain import implied_bounds
from dssc_jax.proofs.verifier.well_formed import (
    SMALL_GAIN,
    require_certificate,
    require_problem,
    require_proof,
)

PRECISION = 160
"""Bits of a ball's midpoint."""
AnyStage = SmallGainStage | InvariantStage
"""A stage of either method."""


class ProofVerdict(NamedTuple):
    """Whether a certificate, or the proof of one box in it, is proved, and which bounds of |e| it proves.

    Args:
        proved: Whether every premise holds.
        reason: The first premise that could not be shown, with its place; empty if proved.
        error: Upper bound of |e| [m] at all times, once the loop has settled; infinite if not proved.
        largest_error: Upper bound of |e| [m] from the start on; infinite if not proved.
    """

    proved: bool
    reason: str
    error: float
    largest_error: float


@contextmanager
def ball_precision() -> Iterator[None]:
    """Compute with :data:`PRECISION` bits in all balls while the context lasts, then as before."""
    previous = ctx.prec
    ctx.prec = PRECISION
    try:
        yield
    finally:
        ctx.prec = previous


def verify_certificate(content: object) -> ProofVerdict:
    """Verify a whole certificate: its form (P0), that its boxes cover the problem (P1), and the proof of every box.

    Args:
        content: The content of a certificate's file.

    Returns:
        The largest bounds over all boxes if every box is proved, else the verdict on the first box that is not.
    """
    try:
        certificate = require_certificate(content)
        problem = certificate["problem"]
        require_premise(certificate["complete"], "P1: the certificate itself says that it is not complete")
        require_cover(problem, [proof["box"] for proof in certificate["proofs"]])
    except Rejected as rejected:
        return refusal(rejected)
    verdicts = [verify_proof(problem, proof) for proof in certificate["proofs"]]
    for verdict in verdicts:
        if not verdict.proved:
            return verdict
    error = max(verdict.error for verdict in verdicts)
    largest_error = max(verdict.largest_error for verdict in verdicts)
    return ProofVerdict(proved=True, reason="", error=error, largest_error=largest_error)


def verify_proof(problem_content: object, proof_content: object) -> ProofVerdict:
    """Verify the proof of one box, independently of other boxes.

    Args:
        problem_content: The problem of a certificate, whose form is checked first.
        proof_content: The proof of one of its boxes, whose form is checked first.
    """
    with ball_precision():
        try:
            problem = require_problem(problem_content)
            proof = require_proof(problem, proof_content)
            limits = verified_stages(problem, proof)
            # of each stage, rounded up; the first stage bounds |e| from the start on, every stage once settled
            errors = [math.nextafter(float(stage_limits.between), math.inf) for stage_limits in limits]
            require_premise(all(map(math.isfinite, errors)), "P0: a bound of |e| is not finite, and proves nothing")
        except Rejected as rejected:
            return refusal(rejected)
    return ProofVerdict(proved=True, reason="", error=min(errors), largest_error=errors[0])


def refusal(rejected: Rejected) -> ProofVerdict:
    """The verdict "not proved", with the premise that cannot be shown as its reason."""
    return ProofVerdict(proved=False, reason=str(rejected), error=math.inf, largest_error=math.inf)


def require_cover(problem: Problem, boxes: Sequence[Box]) -> None:
    """(P1) Require that the boxes cover the problem's intervals of k_p, a_p and 1/mu.

    The ends of all boxes cut the problem's intervals into a grid. Every cell of the grid has to lie within some box.
    """
    intervals = {"k_p": problem["k_p"], "a_p": problem["a_p"]}
    if problem["denominator"]:
        low, high = problem["mu"]
        intervals["rate"] = (1.0 / high, 1.0 / low)  # rounded to float64, as the problem's box is
    require_premise(bool(boxes), "P1: no box")
    grids = []
    for name, (low, high) in intervals.items():
        inner_ends = {end for box in boxes for end in box[name] if low < end < high}
        cuts = sorted({low, high} | inner_ends)
        grids.append(list(pairwise(cuts)) or [(low, high)])  # an interval without width is one cell
    for cell_sides in product(*grids):
        cell = dict(zip(intervals, cell_sides, strict=True))
        is_covered = any(is_within(cell, box) for box in boxes)
        require_premise(is_covered, f"P1: no box covers {cell}")


def is_within(cell: Box, box: Box) -> bool:
    """Whether every interval of a cell lies within the box's interval of the same name."""
    for name, (low, high) in cell.items():
        box_low, box_high = box[name]
        if not (box_low <= low and high <= box_high):
            return False
    return True


def verified_stages(problem: Problem, proof: BoxProof) -> list[StageLimits]:
    """Verify the stages of a box in their order, and return the limits that each of them shows.

    The first stage holds from the start on. A later stage begins where the stage before it ends. So its region has to
    contain the earlier stage's limits (P4), and it has to assume a disturbance as large as these limits allow (P8).

    Raises:
        Rejected: A premise cannot be shown.
    """
    box = proof["box"]
    limits: list[StageLimits] = []
    for number, stage in enumerate(proof["stages"], 1):
        label = f"stage {number} of the box {box}"
        stage_problem: Problem = {**problem, "level": stage["level"], "slope": stage["slope"]}
        if limits:
            require_region(limits[-1], arb(ENTERED), stage, f"P4: the stage before {label}")
            require_disturbance(problem, limits[-1], stage, f"P8: the stage before {label}")
        elif problem["rho"] is not None:
            has_room = arb(problem["rho"]) > signal_bounds(stage_problem, box).offset
            require_premise(has_room, "P5: rho does not exceed what disturbance and reference ask for")
        gains = enclosed_gains(problem, stage["sigma"], stage["e"])
        limits.append(verified_stage(stage_problem, box, stage, gains, from_start=number == 1, label=label))
        if number == 1:
            require_region(limits[0], arb(1), stage, f"P4: {label}")
            require_disturbance(problem, limits[0], stage, f"P8: {label}")
    return limits


def verified_stage(
    problem: Problem, box: Box, stage: AnyStage, gains: Balls, *, from_start: bool, label: str
) -> StageLimits:
    """Verify one stage by its method, and return the limits that the stage shows.

    Args:
        problem: The problem, in which the stage's own level and slope bound |d| and |d'|.
        box: Intervals of k_p, a_p and 1/mu.
        stage: The stage.
        gains: Balls of the gains in the stage's region.
        from_start: Whether the stage is the first one, which has to hold from the start on.
        label: Place of the stage, for messages.
    """
    if stage["method"] == SMALL_GAIN:
        return implied_bounds(problem, box, cast(SmallGainStage, stage), gains, from_start, label)
    return invariant_bounds(problem, box, cast(InvariantStage, stage), gains, from_start, label)


def require_disturbance(problem: Problem, limits: StageLimits, stage: AnyStage, subject: str) -> None:
    """(P8) Require that the limits of a stage allow no larger and no steeper disturbance than a stage assumes.

    Args:
        problem: The problem, with bounds of the part of the disturbance that does not depend on the state.
        limits: The limits that a stage has shown, of the state's share of the disturbance.
        stage: The stage that assumes ``level`` and ``slope``.
        subject: What allows the disturbance, for messages.
    """
    level_holds = arb(problem["level"]) + limits.level <= arb(stage["level"])
    require_premise(level_holds, f"{subject} allows a disturbance of larger level")
    slope_holds = arb(problem["slope"]) + limits.slope <= arb(stage["slope"])
    require_premise(slope_holds, f"{subject} allows a disturbance of larger slope")


def require_region(limits: StageLimits, factor: arb, stage: AnyStage, subject: str) -> None:
    """(P4) Require that the limits that a stage has shown lie in the region of a stage, its own or the next one's.

    Args:
        limits: The limits that a stage has shown.
        factor: Factor on these limits: 1 if they hold at all times, :data:`ENTERED` if they bound upper limits.
        stage: The stage with the region.
        subject: What may leave the region, for messages.
    """
    sigma = stage["sigma"]
    e = stage["e"]
    require_premise(limits.sigma * factor <= arb(sigma), f"{subject} leaves |sigma| <= {sigma}")
    require_premise(limits.e * factor <= arb(e), f"{subject} leaves |e| <= {e}")
    if stage["method"] == SMALL_GAIN:
        change = cast(SmallGainStage, stage)["change"]
        require_premise(limits.change * factor <= arb(change), f"{subject} lets sigma change by more in a sample")
    elif stage["coordinate"] == "u_av":
        error_change = arb(cast(InvariantStage, stage)["moved"])
        require_premise(limits.error_change * factor <= error_change, f"{subject} lets e change by more in a sample")
