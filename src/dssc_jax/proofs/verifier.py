"""The verifier: a certificate is proved if every inequality holds in ball arithmetic.

It shares no code with the search, only the certificate's numbers. Every number is a ball (`arb` of FLINT) that contains
the exact one; the floating-point numbers of the certificate are exact. docs/proofs.md states the theorem whose premises
are checked here, (P1) to (P6).
"""

from itertools import pairwise, product
from typing import Any, NamedTuple

from flint import arb, arb_mat, ctx

from dssc_jax.proofs.balls import (
    Rejected,
    both,
    enclosing,
    exact_ends,
    larger,
    positive_definite,
    require_premise,
    set_within,
    symmetric_ball,
    symmetrised,
)
from dssc_jax.proofs.enclosed_loop import (
    SAMPLE_PIECES,
    command_row,
    dimensions,
    held_generator,
    inside_bounds,
    sample_corners,
    signal_rows,
)
from dssc_jax.proofs.gain_enclosures import Balls, enclosed_gains
from dssc_jax.proofs.worst_case import settled_error

PRECISION = 160  # bits
ENTERED = "1.0001"  # a multiple of a set that trajectories enter in finite time


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


def verify_certificate(certificate: dict[str, Any]) -> ProofVerdict:
    """Verify a certificate: its problem, and the proof of every box. The boxes have to cover the problem's intervals.

    Args:
        certificate: ``problem`` and ``proofs``, as in a certificate's file.
    """
    before, ctx.prec = ctx.prec, PRECISION
    try:
        problem = certificate["problem"]
        require_cover(problem, [proof["box"] for proof in certificate["proofs"]])
        bounds = [verified_box(problem, proof) for proof in certificate["proofs"]]
        settled, ever = (max(each) for each in zip(*bounds, strict=True))
        return ProofVerdict(True, "", settled, ever)
    except Rejected as rejected:
        return ProofVerdict(False, str(rejected), float("inf"), float("inf"))
    finally:
        ctx.prec = before


def accepts(problem: dict[str, Any], proof: dict[str, Any]) -> ProofVerdict:
    """Verify the proof of one box alone."""
    before, ctx.prec = ctx.prec, PRECISION
    try:
        return ProofVerdict(True, "", *verified_box(problem, proof))
    except Rejected as rejected:
        return ProofVerdict(False, str(rejected), float("inf"), float("inf"))
    finally:
        ctx.prec = before


def require_cover(problem: dict[str, Any], boxes: list[dict[str, Any]]) -> None:
    """(P1) The boxes cover the intervals of k_p, a_p and 1/mu: every cell of the grid of all ends lies in one."""
    whole = {"k_p": problem["k_p"], "a_p": problem["a_p"]}
    if problem["lag_order"]:
        low, high = problem["mu"]
        require_premise(0.0 < low <= high, "P1: mu must be positive")
        whole["rate"] = (1.0 / high, 1.0 / low)
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


def verified_box(problem: dict[str, Any], proof: dict[str, Any]) -> tuple[float, float]:
    """Check every stage of a box; return the bounds of |e| when settled and from the start on."""
    stages, box = proof["stages"], proof["box"]
    require_premise(len(stages) > 0, "P2: no stage")
    signs = [box["k_p"][0] > 0.0, *(problem[name] > 0.0 for name in ("sample_time", "l0")), problem["slope"] >= 0.0]
    require_premise(all(signs) and problem["level"] >= 0.0, "P2: k_p, T_s and l0 must be positive, bounds not negative")
    bounds, previous = [], None
    for number, stage in enumerate(stages):
        where = f"stage {number + 1} of the box {box}"
        p, gains = symmetric_ball(stage["p"]), enclosed_gains(problem, stage["sigma"], stage["e"])
        require_premise(positive_definite(p), f"P2: P is not positive definite in {where}")
        check_invariance(problem, box, stage, p, gains, where)
        rows = signal_rows(problem)
        if previous is None:
            check_start(problem, p, where)
            for name in ("sigma", "e"):
                inside = set_within(p, rows[name], arb(stage[name]))
                require_premise(inside, f"P4: the set leaves |{name}| <= {stage[name]} in {where}")
            check_sliding(problem, p, gains, where)
        else:
            for name in ("sigma", "e"):
                inside = set_within(previous, rows[name], arb(stage[name]) / arb(ENTERED))
                require_premise(inside, f"P4: the set before exceeds |{name}| <= {stage[name]} in {where}")
        bounds.append(between_samples(problem, box, p, gains))
        previous = p
    sharper = settled_error(problem, box, stages[-1], symmetric_ball(stages[-1]["p"]))
    settled = bounds[-1] if sharper is None or sharper > bounds[-1] else sharper
    return float(settled.upper()), float(bounds[0].upper())


def check_start(problem: dict[str, Any], p: arb_mat, where: str) -> None:
    """(P3) Every start lies in the set: z is affine in the initial state, in d(0) and in k_p d(0)."""
    lag, level = problem["lag_order"], arb(problem["level"])
    for plant in product(*(exact_ends(pair) for pair in problem["initial"])):
        for d, k_p in product((-level, level), exact_ends(problem["k_p"])):
            sigma = plant[1] + arb(problem["l0"]) * plant[0]
            z = [*plant, *([k_p * d] * lag), -d, sigma if problem["matched"] else arb(0)]
            column = arb_mat([[x] for x in z])
            size = (column.transpose() * p * column)[0, 0]
            require_premise(size <= 1, f"P3: a start lies outside of {where}")


def check_sliding(problem: dict[str, Any], p: arb_mat, gains: Balls, where: str) -> None:
    """(P5) |u_eq| <= rho, where u_eq - d is a row of z that is affine in its gains."""
    if problem["rho"] is None:
        return
    rows = signal_rows(problem)
    left = arb(problem["rho"]) - arb(problem["level"])
    require_premise(left > 0, "P5: rho does not exceed the disturbance")
    for a, b in product(both(gains["slide_p"]), both(gains["slide_i"])):
        row = rows["v"] + rows["change"] * a + rows["sigma"] * b
        require_premise(set_within(p, row, left), f"P5: the equivalent control may exceed rho in {where}")


def check_invariance(
    problem: dict[str, Any], box: dict[str, Any], stage: dict[str, Any], p: arb_mat, gains: Balls, where: str
) -> None:
    """(P6) V(z+) <= (1 - T lambda) V(z) + T sum of mu_j w_j^2 at every corner, mu_j >= 0 with a sum <= lambda."""
    t, rate = arb(problem["sample_time"]), arb(stage["rate"])
    multipliers = [arb(mu) for mu in stage["multipliers"]]
    require_premise(rate > 0 and t * rate < 1, f"P6: lambda is not in (0, 1/T_s) in {where}")
    require_premise(all(mu >= 0 for mu in multipliers), f"P6: a multiplier is negative in {where}")
    require_premise(sum(multipliers, arb(0)) <= rate, f"P6: the multipliers exceed lambda in {where}")
    for corner in sample_corners(problem, box, gains):
        live = [j for j in range(corner.b.ncols()) if not all(corner.b[i, j] == 0 for i in range(corner.b.nrows()))]
        ap = corner.a.transpose() * p
        keep = p * (1 - t * rate) - ap * corner.a
        n, cross, inputs = p.nrows(), ap * corner.b, corner.b.transpose() * p * corner.b
        block = [[keep[i, j] for j in range(n)] + [-cross[i, j] for j in live] for i in range(n)]
        for j in live:
            own = [(t * multipliers[j] if i == j else arb(0)) - inputs[j, i] for i in live]
            block.append([*(-cross[i, j] for i in range(n)), *own])
        require_premise(positive_definite(symmetrised(block)), f"P6: the set is not invariant in {where}")


def between_samples(problem: dict[str, Any], box: dict[str, Any], p: arb_mat, gains: Balls) -> arb:
    """Upper bound of |e(t)| at all times, while z at the samples is in the set."""
    _, _, n = dimensions(problem)
    rows, t, inverse = signal_rows(problem), arb(problem["sample_time"]), p.inv()
    f = held_generator(problem, enclosing(*box["a_p"]), enclosing(*box.get("rate", (0.0, 0.0))))
    rest = inside_bounds(problem, box, t)[0]
    largest = arb(0)
    for piece in range(SAMPLE_PIECES):
        flow = (f * (t * enclosing(piece / SAMPLE_PIECES, (piece + 1) / SAMPLE_PIECES))).exp()
        for gain in product(*(both(gains[name]) for name in ("k_p", "k_i", "k_n"))):
            new = rows["v"] + rows["change"] * gain[0] + rows["sigma"] * (t * gain[1])
            command = command_row(problem, new, gain[2])
            k_p = enclosing(*box["k_p"])
            row = arb_mat(
                [[(flow[0, j] if j < n - 2 else arb(0)) + k_p * flow[0, n - 2] * command[0, j] for j in range(n)]]
            )
            size = (row * inverse * row.transpose())[0, 0]
            largest = larger(largest, (abs(size).upper().sqrt() + rest).upper())
    return largest
