"""(P3), (P5), (P6): a set {z'Pz <= 1} that is invariant and attracts, for all plants of a box and gains of a region.

V = z'Pz has to fall in a sample at every vertex of plant and gains. V(z+) is convex in z+, and z+ is affine in each
number of plant and gains, so V then falls for all of them. The region is cut into pieces of |sigma|, each with its own
gains.
"""

from itertools import pairwise, product
from typing import NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import (
    Balls,
    StageLimits,
    approximate_root,
    ball_ends,
    bound_in_set,
    column,
    interval_ball,
    maximum,
    positive_definite,
    quadratic_form,
    require_premise,
    symmetric_matrix,
    symmetric_part,
    total,
)
from dssc_jax.proofs.verifier.certificate import Box, InvariantStage, Problem
from dssc_jax.proofs.verifier.enclosed_loop import (
    SAMPLE_PIECES,
    Corner,
    control_rows,
    disturbance_effects,
    sample_corners,
    signal_bounds,
    signal_rows,
    start_columns,
)
from dssc_jax.proofs.verifier.gain_enclosures import (
    depends_on_error,
    enclosed_gains,
    enclosed_start_ratio,
    with_moving_error,
)
from dssc_jax.proofs.verifier.held_plant import flows, generator_over, held_vertices
from dssc_jax.proofs.verifier.slope_ratios import slide_gain

ERROR = 0
"""Place of e in z."""
SPEED = 1
"""Place of e' in z."""
PieceGains = list[tuple[float, Balls]]
"""For each piece of |sigma|, its upper end [m/s] and the gains in it."""


class StageSet(NamedTuple):
    """The set {z'Pz <= 1} of a stage, with the data that the stage's premises need.

    Args:
        problem: The problem, in which the stage's own level and slope bound |d| and |d'|.
        box: Intervals of k_p, a_p and 1/mu.
        stage: The stage.
        p: P, shape (n, n).
        inverse: The inverse of P, shape (n, n).
        gains: Balls of the gains in the stage's region.
        label: Place of the stage, for messages.
    """

    problem: Problem
    box: Box
    stage: InvariantStage
    p: arb_mat
    inverse: arb_mat
    gains: Balls
    label: str

    @property
    def is_integrated(self) -> bool:
        """Whether z contains q = v - phi_1(s) in place of v."""
        return self.stage["coordinate"] == "phi_1"


def invariant_bounds(
    problem: Problem, box: Box, stage: InvariantStage, gains: Balls, from_start: bool, label: str
) -> StageLimits:
    """Show that the set of a stage is invariant and attracts, and return bounds of the signals in this set.

    Args:
        problem: The problem, in which the stage's own level and slope bound |d| and |d'|.
        box: Intervals of k_p, a_p and 1/mu.
        stage: The stage, with P of the set and the multipliers of the inputs.
        gains: Balls of the gains in the stage's region.
        from_start: Whether the set has to hold every start (P3) and keep the loop sliding (P5).
        label: Place of the stage, for messages.

    Raises:
        Rejected: A premise cannot be shown.
    """
    p = symmetric_matrix(stage["p"])
    is_integrated = stage["coordinate"] == "phi_1"
    if not is_integrated:
        gains = with_moving_error(problem, gains, stage["moved"])
    require_premise(positive_definite(p), f"P2: P is not positive definite in {label}")
    pieces = piece_gains(problem, stage)
    if not is_integrated:
        pieces = [(end, increment_gains(problem, stage, gains, piece)) for end, piece in pieces]
    vertices = held_vertices(problem, box, stage["degree"])
    for _, piece in pieces:
        corners = sample_corners(problem, box, vertices, piece, is_integrated=is_integrated)
        check_invariance(arb(problem["sample_time"]), stage, p, corners, label)
    inverse = p.inv()
    stage_set = StageSet(problem, box, stage, p, inverse, gains, label)
    largest_error = largest_between_samples(stage_set, ERROR)
    largest_speed = largest_between_samples(stage_set, SPEED)
    error_change = arb(problem["sample_time"]) * largest_speed if depends_on_error(problem) else arb(0)
    if from_start:
        check_start(stage_set)
        check_sliding(stage_set, pieces, error_change)
    # a set gives no bounds for (P8), so a disturbance that depends on the state needs the method "small gain"
    require_premise(not any(problem["by_state"]), f"P8: the set of {label} does not bound what the state adds to d")
    rows = signal_rows(problem)
    return StageLimits(
        sigma=bound_in_set(inverse, rows.sigma),
        e=bound_in_set(inverse, rows.e),
        change=bound_in_set(inverse, rows.change),
        between=largest_error,
        level=arb(0),
        slope=arb(0),
        error_change=error_change,
    )


def piece_gains(problem: Problem, stage: InvariantStage) -> PieceGains:
    """The gains in each piece of |sigma|. The pieces have equal lengths in |sigma|^(1/2) and cover the stage's region.

    Args:
        problem: The certificate's problem.
        stage: The stage, with the region |sigma| <= ``sigma``, |e| <= ``e`` and the number of pieces.
    """
    count = stage["pieces"]
    cuts = [stage["sigma"] * (i / count) ** 2 for i in range(count)] + [stage["sigma"]]
    return [(end, enclosed_gains(problem, end, stage["e"], sigma_from=begin)) for begin, end in pairwise(cuts)]


def increment_gains(problem: Problem, stage: InvariantStage, gains: Balls, piece: Balls) -> Balls:
    """The gains in v+ = v + K_P (sigma - s) + T_s K_I sigma, in a piece of the region.

    In the conservative form K_P is a mean over a sample that may have begun in another piece, so it has the ball of
    the whole region, and K_I contains the change of phi_1 through e.

    Args:
        problem: The certificate's problem.
        stage: The stage, with a bound of the change of e in a sample.
        gains: Balls of the gains in the whole region.
        piece: Balls of the gains in the piece.
    """
    increments = with_moving_error(problem, piece, stage["moved"])
    return increments | {"k_p": gains["k_p"]} if problem["form"] == "conservative" else increments


def check_start(stage_set: StageSet) -> None:
    """(P3) Require that every start lies in the set {z'Pz <= 1}."""
    problem = stage_set.problem
    ratio = enclosed_start_ratio(problem, is_integrated=stage_set.is_integrated)
    starts = start_columns(problem, stage_set.box, ratio)
    for j in range(starts.ncols()):
        is_inside = quadratic_form(stage_set.p, column(starts, j)) <= 1
        require_premise(is_inside, f"P3: a start lies outside of {stage_set.label}")


def check_sliding(stage_set: StageSet, pieces: PieceGains, error_change: arb) -> None:
    """(P5) Require |u_eq - d_r - f| <= rho - sup |d_r + f| in the set; without a bound rho there is nothing to show.

    u_eq = v + slide_p (sigma - s) + slide_i sigma is affine in both gains, so the ends of their balls suffice. If z
    contains q, v = q + phi_1(s), and in each piece phi_1(s) differs from ``middle`` s by at most |mean - middle| |s|.
    phi_1 may also change by its slope in e times the change of e in a sample; if z contains v, K_I includes this.

    Args:
        stage_set: The set.
        pieces: Upper end of each piece of |sigma| and the gains in it.
        error_change: Bound of the change of e in a sample [m].
    """
    problem = stage_set.problem
    gains = stage_set.gains
    if problem["rho"] is None:
        return
    rows = signal_rows(problem)
    room = arb(problem["rho"]) - signal_bounds(problem, stage_set.box).offset
    u_av_row = rows.v
    slide_p = gains["slide_p"]
    if stage_set.is_integrated:
        middle = gains["mean"].mid()
        u_av_row = u_av_row + rows.s * middle
        distances = [(abs(piece["mean"] - middle) * arb(end)).upper() for end, piece in pieces]
        room = room - maximum(*distances)
    if problem["form"] == "conservative":
        if stage_set.is_integrated:
            room = room - abs(gains["slide_e"]).upper() * error_change
        change = bound_in_set(stage_set.inverse, rows.change)
        slide_p = slide_gain(problem, stage_set.stage, gains, change, error_change)
    for p, i in product(ball_ends(slide_p), ball_ends(gains["slide_i"])):
        row = u_av_row + rows.change * p + rows.sigma * i
        holds = bound_in_set(stage_set.inverse, row) <= room
        require_premise(holds, f"P5: the equivalent control may exceed rho in {stage_set.label}")


def check_invariance(t: arb, stage: InvariantStage, p: arb_mat, corners: list[Corner], label: str) -> None:
    """(P6) Require that V = z'Pz falls at every corner, so that the set {V <= 1} is invariant and attracts.

    The condition is V(z+) <= (1 - T_s lambda) V(z) + T_s sum of mu_j w_j^2 for all inputs w_j, with multipliers mu_j >=
    0 whose sum is at most lambda; with |w_j| <= 1 the sum is then at most T_s lambda. The right side less the left
    side is a quadratic form of z and w, whose matrix has to be positive definite.

    Args:
        t: T_s [s].
        stage: The stage, with lambda and the multipliers.
        p: P, shape (n, n).
        corners: One sample at every vertex of plant and gains.
        label: Place of the stage, for messages.
    """
    rate = arb(stage["rate"])
    multipliers = [arb(mu) for mu in stage["multipliers"]]
    require_premise(rate > 0 and t * rate < 1, f"P6: lambda is not in (0, 1/T_s) in {label}")
    require_premise(all(mu >= 0 for mu in multipliers), f"P6: a multiplier is negative in {label}")
    require_premise(total(multipliers) <= rate, f"P6: the multipliers exceed lambda in {label}")
    root = approximate_root(p)  # L with L L' near P
    assert root is not None  # P is positive definite, as the caller has shown
    to_scaled = root.transpose()  # in x = L'z, P is close to I, so that the balls of A stay small
    from_scaled = to_scaled.inv()
    scaled_p = from_scaled.transpose() * p * from_scaled
    keep = scaled_p * (1 - t * rate)
    for corner in corners:
        scaled_corner = Corner(to_scaled * corner.a * from_scaled, to_scaled * corner.b)
        columns = corner.b.transpose().tolist()
        active = [j for j, entries in enumerate(columns) if not all(x == 0 for x in entries)]
        form = decrease_form(scaled_corner, scaled_p, keep, [t * mu for mu in multipliers], active)
        require_premise(positive_definite(symmetric_part(form)), f"P6: the set is not invariant in {label}")


def decrease_form(corner: Corner, p: arb_mat, keep: arb_mat, weights: list[arb], active: list[int]) -> list[list[arb]]:
    """The matrix of (1 - T_s lambda) V(x) + T_s sum of mu_j w_j^2 - V(x+) as a quadratic form of x and the inputs w_j.

    Args:
        corner: A and B of the sample, in the coordinates x.
        p: P of V = x'Px, shape (n, n).
        keep: (1 - T_s lambda) P, shape (n, n).
        weights: T_s mu_j of each input.
        active: Numbers of the inputs that act. An input whose column of B is 0 is left out: with mu_j = 0 its row would
            be 0, and the matrix not definite.

    Returns:
        The rows of the matrix, those of x first, then those of the active inputs.
    """
    a_p = corner.a.transpose() * p
    by_state = (keep - a_p * corner.a).tolist()
    cross = (a_p * corner.b).tolist()  # A'PB
    inputs = corner.b.transpose() * p * corner.b
    state_rows = []
    for state_row, cross_row in zip(by_state, cross, strict=True):
        state_rows.append([*state_row, *(-cross_row[j] for j in active)])
    input_rows = []
    for j in active:
        input_row = [(weights[j] if i == j else arb(0)) - inputs[j, i] for i in active]
        input_rows.append([*(-cross_row[j] for cross_row in cross), *input_row])
    return [*state_rows, *input_rows]


def largest_between_samples(stage_set: StageSet, place: int) -> arb:
    """Upper bound of |e(t)| [m] or |e'(t)| [m/s] at all times, while z at the samples is in the set.

    Between samples chi(t) = exp(F t) chi + gamma(t) U, so the signal is a row over z, plus the effect of d_r's change
    since the sample. U is affine in the gains, so the ends of their balls suffice.

    Args:
        stage_set: The set.
        place: Place of the signal in z: ``ERROR`` for e, ``SPEED`` for e'.
    """
    problem = stage_set.problem
    box = stage_set.box
    names = ("mean" if stage_set.is_integrated else "k_p", "k_i", "k_n")
    t = arb(problem["sample_time"])
    k_p = interval_ball(*box["k_p"])
    disturbance_bound = disturbance_effects(problem, box, t)[place]
    largest = arb(0)
    for flow in flows(generator_over(problem, box), t, SAMPLE_PIECES):
        *by_chi, by_u = flow.tolist()[place]
        by_state = arb_mat([[*by_chi, arb(0), arb(0)]])  # not of v and s
        for gain in product(*(ball_ends(stage_set.gains[name]) for name in names)):
            command = control_rows(problem, gain, is_integrated=stage_set.is_integrated).command
            row = by_state + command * (k_p * by_u)  # U = k_p (command + d_r)
            largest = maximum(largest, (bound_in_set(stage_set.inverse, row) + disturbance_bound).upper())
    return largest
