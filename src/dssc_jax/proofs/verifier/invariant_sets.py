"""(P3), (P5), (P6): a set {z'Pz <= 1} that is invariant and attracts, for all plants of a box and gains of a region."""

from functools import reduce
from itertools import pairwise, product
from typing import Any

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import (
    Balls,
    StageLimits,
    approximate_root,
    both,
    bound_in_set,
    enclosing,
    larger,
    positive_definite,
    require_premise,
    symmetric_ball,
    symmetrised,
)
from dssc_jax.proofs.verifier.enclosed_loop import (
    SAMPLE_PIECES,
    Corner,
    control_rows,
    held_generator,
    held_vertices,
    inside_bounds,
    sample_corners,
    signal_bounds,
    signal_rows,
    start_columns,
    state_places,
)
from dssc_jax.proofs.verifier.gain_enclosures import (
    depends_on_error,
    enclosed_gains,
    enclosed_start_ratio,
    with_moving_error,
)
from dssc_jax.proofs.verifier.slope_ratios import slide_gain

ERROR, SPEED = 0, 1
"""Places of e and e' among the states."""


def invariant_bounds(
    problem: dict[str, Any], box: dict[str, Any], stage: dict[str, Any], gains: Balls, started: bool, where: str
) -> StageLimits:
    """Show that the stage's set is invariant and attracts.

    Args:
        problem: The certificate's problem.
        box: Its box.
        stage: The stage, whose ``multipliers`` are those of the inputs.
        gains: Balls of the gains in the stage's region.
        started: Whether the set has to hold every start and keep sliding.
        where: The stage's place, for messages.
    """
    p, integrated = symmetric_ball(stage["p"]), stage["coordinate"] == "phi_1"
    if not integrated:
        gains = with_moving_error(problem, gains, stage["moved"])
    require_premise(positive_definite(p), f"P2: P is not positive definite in {where}")
    pieces, held = piece_gains(problem, stage), held_vertices(problem, box, stage["degree"])
    if not integrated:  # K_P is a mean over a sample, which may have begun in another piece
        whole = {"k_p": gains["k_p"]} if problem["form"] == "conservative" else {}
        pieces = [(high, with_moving_error(problem, piece, stage["moved"]) | whole) for high, piece in pieces]
    for _, piece in pieces:
        corners = sample_corners(problem, box, held, piece, integrated=integrated)
        check_invariance(arb(problem["sample_time"]), stage, p, corners, where)
    inverse, rows = p.inv(), signal_rows(problem)
    between = [largest_between_samples(problem, box, stage, inverse, gains, at) for at in (ERROR, SPEED)]
    moved = arb(problem["sample_time"]) * between[SPEED] if depends_on_error(problem) else arb(0)
    if started:
        check_start(problem, box, p, integrated, where)
        check_sliding(problem, box, stage, inverse, gains, pieces, moved, where)
    sigma, e = (bound_in_set(inverse, rows[name]) for name in ("sigma", "e"))
    require_premise(not any(problem["by_state"]), f"P8: the set of {where} does not bound what the state adds to d")
    return StageLimits(sigma, e, between[ERROR], arb(0), arb(0), moved)


def piece_gains(problem: dict[str, Any], stage: dict[str, Any]) -> list[tuple[float, Balls]]:
    """The upper end of each piece of |sigma|, and the gains there; the pieces cover the stage's region."""
    count = stage["pieces"]
    ends = [stage["sigma"] * (i / count) ** 2 for i in range(count)] + [stage["sigma"]]
    return [(high, enclosed_gains(problem, high, stage["e"], low)) for low, high in pairwise(ends)]


def check_start(problem: dict[str, Any], box: dict[str, Any], p: arb_mat, integrated: bool, where: str) -> None:
    """(P3) Every start lies in the set."""
    starts = start_columns(problem, box, enclosed_start_ratio(problem, integrated=integrated))
    for j in range(starts.ncols()):
        z = arb_mat([[starts[i, j]] for i in range(starts.nrows())])
        require_premise((z.transpose() * p * z)[0, 0] <= 1, f"P3: a start lies outside of {where}")


def check_sliding(
    problem: dict[str, Any],
    box: dict[str, Any],
    stage: dict[str, Any],
    inverse: arb_mat,
    gains: Balls,
    pieces: list[tuple[float, Balls]],
    moved: arb,
    where: str,
) -> None:
    """(P5) |u_eq| <= rho, where u_eq - d_r - f is a row of z that is affine in its gains.

    In the coordinate q, u_av = q + phi_1(s): phi_1(s) is within |mean - middle| |s| of middle s in each piece. By e,
    phi_1 changes in a sample at most by its slope in e times ``moved``, the bound of the change of e; in the coordinate
    u_av, K_I holds this.
    """
    if problem["rho"] is None:
        return
    rows, room = signal_rows(problem), arb(problem["rho"]) - signal_bounds(problem, box).offset
    held, slide_p = rows["v"], gains["slide_p"]
    if stage["coordinate"] == "phi_1":
        middle = gains["mean"].mid()
        held = held + rows["s"] * middle
        room = room - reduce(larger, [(abs(piece["mean"] - middle) * arb(high)).upper() for high, piece in pieces])
    if problem["form"] == "conservative":
        if stage["coordinate"] == "phi_1":
            room = room - abs(gains["slide_e"]).upper() * moved
        slide_p = slide_gain(problem, stage, gains, bound_in_set(inverse, rows["change"]), moved)
    for a, b in product(both(slide_p), both(gains["slide_i"])):
        row = held + rows["change"] * a + rows["sigma"] * b
        holds = bound_in_set(inverse, row) <= room
        require_premise(holds, f"P5: the equivalent control may exceed rho in {where}")


def check_invariance(t: arb, stage: dict[str, Any], p: arb_mat, corners: list[Corner], where: str) -> None:
    """(P6) V(z+) <= (1 - T lambda) V(z) + T sum of mu_j w_j^2 at every corner, mu_j >= 0 with a sum <= lambda."""
    rate, multipliers = arb(stage["rate"]), [arb(mu) for mu in stage["multipliers"]]
    require_premise(rate > 0 and t * rate < 1, f"P6: lambda is not in (0, 1/T_s) in {where}")
    require_premise(all(mu >= 0 for mu in multipliers), f"P6: a multiplier is negative in {where}")
    require_premise(sum(multipliers, arb(0)) <= rate, f"P6: the multipliers exceed lambda in {where}")
    root = approximate_root(p)  # coordinates in which P is close to I, so that the balls of A stay small
    assert root is not None
    to_own = root.transpose()
    from_own = to_own.inv()
    own_p = from_own.transpose() * p * from_own
    for corner in corners:
        live = [j for j in range(corner.b.ncols()) if not all(corner.b[i, j] == 0 for i in range(corner.b.nrows()))]
        own_a, own_b = to_own * corner.a * from_own, to_own * corner.b
        ap = own_a.transpose() * own_p
        keep, cross, inputs = own_p * (1 - t * rate) - ap * own_a, ap * own_b, own_b.transpose() * own_p * own_b
        n = p.nrows()
        block = [[keep[i, j] for j in range(n)] + [-cross[i, j] for j in live] for i in range(n)]
        for j in live:
            own = [(t * multipliers[j] if i == j else arb(0)) - inputs[j, i] for i in live]
            block.append([*(-cross[i, j] for i in range(n)), *own])
        require_premise(positive_definite(symmetrised(block)), f"P6: the set is not invariant in {where}")


def largest_between_samples(
    problem: dict[str, Any],
    box: dict[str, Any],
    stage: dict[str, Any],
    inverse: arb_mat,
    gains: Balls,
    place: int,
) -> arb:
    """Upper bound of |e(t)| or |e'(t)| at all times, while z at the samples is in the set."""
    integrated = stage["coordinate"] == "phi_1"
    _, _, n = state_places(problem)
    t, k_p = arb(problem["sample_time"]), enclosing(*box["k_p"])
    f = held_generator(problem, enclosing(*box["a_p"]), enclosing(*box.get("rate", (0.0, 0.0))))
    rest, largest = inside_bounds(problem, box, t)[place], arb(0)
    for piece in range(SAMPLE_PIECES):
        flow = (f * (t * enclosing(piece / SAMPLE_PIECES, (piece + 1) / SAMPLE_PIECES))).exp()
        for gain in product(*(both(gains[name]) for name in ("mean" if integrated else "k_p", "k_i", "k_n"))):
            _, command = control_rows(problem, gain, integrated=integrated)
            pushed = k_p * flow[place, n - 2]
            row = [(flow[place, j] if j < n - 2 else arb(0)) + pushed * command[0, j] for j in range(n)]
            largest = larger(largest, (bound_in_set(inverse, arb_mat([row])) + rest).upper())
    return largest
