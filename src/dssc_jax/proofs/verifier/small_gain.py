"""(P7) Bounds of all signals that imply themselves: a linear middle loop, and a small gain of the deviations from it.

With other plants and gains than those of the middle loop, the loop is

    z+ = A z + B w + b_v omega_v + b_u omega_u + omega,    |omega_i| <= k_p dGamma_i |command| + sum of dPhi_ij |z_j|

omega_v is the deviation of the increment of v (or q), and omega_u the further deviation of the command. A signal is at
most the peak of its response to the starts, plus the sums of its absolute impulse responses times the bounds of the
inputs. Bounds Y of the signals give bounds of the deviations, and these give new bounds of the signals. If the new
bounds are less than Y for every signal, then by induction no signal ever exceeds its bound. docs/proofs.md has the
proof.
"""

from typing import NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import (
    ENTERED,
    Balls,
    Rejected,
    StageLimits,
    identity,
    matrix_of_columns,
    maximum,
    minimum_bound,
    positive_definite,
    require_premise,
    side_by_side,
    symmetric_matrix,
    total,
)
from dssc_jax.proofs.verifier.certificate import Box, Problem, SmallGainStage
from dssc_jax.proofs.verifier.enclosed_loop import (
    control_rows,
    disturbance_effects,
    input_columns,
    sample_matrix,
    signal_bounds,
    signal_rows,
    start_columns,
    zeta_jump,
)
from dssc_jax.proofs.verifier.function_distances import StraightLines, function_distances, increment_error
from dssc_jax.proofs.verifier.gain_enclosures import depends_on_error, enclosed_start_ratio
from dssc_jax.proofs.verifier.held_plant import (
    flows,
    generator_over,
    held_sample,
    held_spread,
    state_places,
)
from dssc_jax.proofs.verifier.impulse_responses import ResponseBounds, response_bounds
from dssc_jax.proofs.verifier.slope_ratios import slide_gain
from dssc_jax.proofs.verifier.state_dependence import disturbance_by_state, motion_bounds

MIDDLE_GAINS: dict[str, tuple[str, ...]] = {
    "u_av": ("k_p", "k_i", "k_n", "slide_p", "slide_i"),
    "phi_1": ("mean", "k_i", "k_n", "slide_p", "slide_i"),
}
"""Gains of the middle loop, by the coordinate of the integrator: ``u_av`` for v, ``phi_1`` for q = v - phi_1(s)."""
CHANGE, SIGMA, ERROR, COMMAND, EQUIVALENT, STATES = range(6)
"""Places in a list of bounds of sigma - s, sigma, e, command + d_r, u_eq - d_r - f, and of the first state of z."""


class MiddleLoop(NamedTuple):
    """The linear loop in the middle of plant and gains.

    Args:
        a: A, shape (n, n).
        rows: Signals as rows over z, in the order of a stage's ``bounds``, shape (5 + n, n).
        w: Columns of the inputs of magnitude at most 1, shape (n, inputs).
        deviations: Columns of the inputs omega_v and omega_u. If a_p or mu has an interval, unit columns for the
            omega_i of all states follow.
        share: dk_p/k_p, half of the width of k_p's interval over the interval's middle.
        half_widths: For each state i of chi, the row of dPhi_ij over all j, followed by k_p dGamma_i. None if neither
            a_p nor mu has an interval.
    """

    a: arb_mat
    rows: arb_mat
    w: arb_mat
    deviations: arb_mat
    share: arb
    half_widths: list[list[arb]] | None


class LawDeviations(NamedTuple):
    """Bounds of the deviations of the control law from the linear law of the middle loop [m/s].

    Args:
        integral: Bound of |omega_v|, the deviation of the increment of v or q.
        command: Bound of |omega_u|, the deviation of the command, without the part that another k_p adds.
        slide: Bound of the deviation of the equivalent control, without the part of :func:`slide_deviation`.
    """

    integral: arb
    command: arb
    slide: arb


def middle_loop(problem: Problem, box: Box, coordinate: str, centre: Balls) -> MiddleLoop:
    """The linear loop with the plant in the middle of a box.

    Args:
        problem: The problem, in which the stage's own level and slope bound |d| and |d'|.
        box: Intervals of k_p, a_p and 1/mu.
        coordinate: The integrator state in z: ``u_av`` for v, ``phi_1`` for q = v - phi_1(s).
        centre: Gains of the loop, by their names in :data:`MIDDLE_GAINS`.
    """
    is_integrated = coordinate == "phi_1"
    middle = {name: ((arb(low) + arb(high)) / 2).mid() for name, (low, high) in box.items()}
    k_p = middle["k_p"]
    k_p_low, k_p_high = map(arb, box["k_p"])
    k_p_distance = maximum(k_p_high - k_p, k_p - k_p_low)  # dk_p
    gain = [centre[name] for name in MIDDLE_GAINS[coordinate][:3]]  # the others belong to u_eq
    held_matrix = held_sample(problem, middle["a_p"], middle.get("rate", arb(0)))
    unit = identity(state_places(problem).n).tolist()
    deviations = law_columns(problem, held_matrix, k_p)
    half_widths = None
    if any(low < high for name, (low, high) in box.items() if name != "k_p"):
        deviations += unit
        chi = held_matrix.ncols() - 1
        half_widths = [[*row[:chi], (row[chi] * k_p_high).upper()] for row in held_spread(problem, box)[:chi]]
    sizes = signal_bounds(problem, box)
    inputs = input_columns(problem, k_p, sizes, disturbance_effects(problem, box, arb(problem["sample_time"])))
    jump = jump_column(problem, arb(problem["sample_time"]) * sizes.slope * k_p_distance)
    return MiddleLoop(
        a=sample_matrix(problem, held_matrix, k_p, gain, is_integrated=is_integrated),
        rows=arb_mat([*bounded_signals(problem, centre, gain, is_integrated=is_integrated), *unit]),
        w=side_by_side(inputs, matrix_of_columns([jump])),
        deviations=matrix_of_columns(deviations),
        share=(k_p_distance / k_p).upper(),
        half_widths=half_widths,
    )


def bounded_signals(problem: Problem, centre: Balls, gain: list[arb], *, is_integrated: bool) -> list[list[arb]]:
    """sigma - s, sigma, e, command + d_r and u_eq - d_r - f of the middle loop, each as n entries of a row over z.

    u_eq = v + (1 + tau_av/T_s) (v+ - v), where the gains ``slide_p`` and ``slide_i`` contain the factor 1 + tau_av/T_s.

    Args:
        problem: The certificate's problem.
        centre: Gains of the loop, by their names in :data:`MIDDLE_GAINS`.
        gain: K_P, K_I and K_N of the loop; if z contains q, phi_1/sigma replaces K_P.
        is_integrated: Whether z contains q = v - phi_1(s) in place of v.
    """
    rows = signal_rows(problem)
    command = control_rows(problem, gain, is_integrated=is_integrated).command
    equivalent = rows.v + rows.change * centre["slide_p"] + rows.sigma * centre["slide_i"]
    if is_integrated:  # v = q + phi_1(s)
        equivalent = equivalent + rows.s * centre["mean"]
    return [row.tolist()[0] for row in (rows.change, rows.sigma, rows.e, command, equivalent)]


def law_columns(problem: Problem, held_matrix: arb_mat, k_p: arb) -> list[list[arb]]:
    """The columns b_v and b_u of the inputs omega_v and omega_u, with n entries each.

    omega_u adds to the command. omega_v adds to v (or q) and, through it, to the command with the opposite sign.

    Args:
        problem: The certificate's problem.
        held_matrix: [[Phi, Gamma], [0, 1]] of the middle loop.
        k_p: k_p of the middle loop [1/s].
    """
    chi = state_places(problem).n - 2
    by_command = [k_p * held_matrix[i, chi] for i in range(chi)]
    by_v = [-x for x in by_command]
    return [[*by_v, arb(1), arb(0)], [*by_command, arb(0), arb(0)]]  # the last two states are v and s


def jump_column(problem: Problem, change: arb) -> list[arb]:
    """The additional jump of zeta if k_p is not that of the middle loop, as a column over z, with n entries.

    zeta counts from its rest under the input -k_p d_r. So it jumps if d_r changes, by an amount that depends on k_p.

    Args:
        problem: The certificate's problem.
        change: T_s sup |d_r'| dk_p, where dk_p is the largest distance of k_p from that of the middle loop.
    """
    zeta, _, n = state_places(problem)
    entries = [arb(0)] * n
    for place, jump in zip(zeta, zeta_jump(problem), strict=True):
        entries[place] = change * jump
    return entries


def implied_bounds(
    problem: Problem, box: Box, stage: SmallGainStage, gains: Balls, from_start: bool, label: str
) -> StageLimits:
    """(P7) Show that the bounds of a stage imply themselves, and return the limits that the stage shows.

    Args:
        problem: The problem, in which the stage's own level and slope bound |d| and |d'|.
        box: Intervals of k_p, a_p and 1/mu.
        stage: The stage, with bounds of the signals and gains of the middle loop.
        gains: Balls of the gains in the stage's region.
        from_start: Whether the bounds are to hold from the start on; otherwise they bound upper limits.
        label: Place of the stage, for messages.

    Raises:
        Rejected: A premise cannot be shown.
    """
    coordinate = stage["coordinate"]
    centre = dict(zip(MIDDLE_GAINS[coordinate], map(arb, stage["gains"]), strict=True))
    loop = middle_loop(problem, box, coordinate, centre)
    bounds = [arb(bound) for bound in stage["bounds"]]
    states = bounds[STATES:]
    responses = middle_responses(problem, box, stage, loop, from_start, label)
    law = law_deviations(problem, stage, gains, centre, bounds)
    command = bounds[COMMAND] + law.integral + law.command  # bound of |command + d_r| of the true loop
    sizes = [arb(1)] * loop.w.ncols() + deviation_sizes(loop, law, command, states)
    for i, bound in enumerate(bounds):
        response = total([arb(float(responses.sums[i, j])) * size for j, size in enumerate(sizes)])
        peak = arb(float(responses.peaks[i].max(initial=0.0))) if from_start else arb(0)
        holds = response + peak < bound
        require_premise(holds, f"P7: the bound of signal {i} does not imply itself in {label}")
    error_change = arb(0)
    if depends_on_error(problem):
        error_change = arb(problem["sample_time"]) * motion_bounds(problem, box, [command, *states]).speed
    if from_start and problem["rho"] is not None:
        room = arb(problem["rho"]) - signal_bounds(problem, box).offset
        slack = law.slide + slide_deviation(problem, stage, gains, centre, bounds, error_change)
        require_premise(bounds[EQUIVALENT] + slack <= room, f"P5: the equivalent control may exceed rho in {label}")
    state_share = disturbance_by_state(problem, box, [bound * arb(ENTERED) for bound in (command, *states)])
    return StageLimits(
        sigma=bounds[SIGMA],
        e=bounds[ERROR],
        change=bounds[CHANGE],
        between=(states[0] + bend_between_samples(problem, box, states, command)).upper(),  # state 0 is e itself
        level=state_share.level,
        slope=state_share.slope,
        error_change=error_change,
    )


def middle_responses(
    problem: Problem, box: Box, stage: SmallGainStage, loop: MiddleLoop, from_start: bool, label: str
) -> ResponseBounds:
    """Bounds of the middle loop's responses to its inputs and, for the first stage, to the starts.

    V = z'Pz bounds the tails of the responses, so V has to fall by the share T_s lambda in each sample of the middle
    loop.

    Args:
        problem: The problem, in which the stage's own level and slope bound |d| and |d'|.
        box: Intervals of k_p, a_p and 1/mu.
        stage: The stage, with lambda and P.
        loop: The middle loop.
        from_start: Whether the responses to the starts are needed.
        label: Place of the stage, for messages.

    Raises:
        Rejected: P is not positive definite, V does not fall, or the responses decay too slowly.
    """
    lost_share = arb(problem["sample_time"]) * arb(stage["rate"])
    p = symmetric_matrix(stage["p"])
    require_premise(lost_share > 0 and lost_share < 1, f"P7: lambda is not in (0, 1/T_s) in {label}")
    require_premise(positive_definite(p), f"P2: P is not positive definite in {label}")
    decrease = p * (1 - lost_share) - loop.a.transpose() * p * loop.a
    require_premise(positive_definite(decrease), f"P7: V does not fall in {label}")
    starts = arb_mat(p.nrows(), 0)  # none
    if from_start:
        ratio = enclosed_start_ratio(problem, is_integrated=stage["coordinate"] == "phi_1")
        starts = start_columns(problem, box, ratio)
    inputs = side_by_side(loop.w, loop.deviations)
    responses = response_bounds(loop.a, loop.rows, inputs, starts, p, lost_share)
    if responses is None:
        raise Rejected(f"P7: the responses decay too slowly in {label}")
    return responses


def law_deviations(
    problem: Problem, stage: SmallGainStage, gains: Balls, centre: Balls, bounds: list[arb]
) -> LawDeviations:
    """Bounds of the deviations of the control law from the linear one, while the signals stay within a stage's bounds.

    If z contains v, the gains K_P, K_I and K_N deviate from those of the middle loop. If z contains q = v - phi_1, the
    functions phi_1, phi_2 and n deviate from straight lines. Their deviation is at most the spread of their ratio to
    sigma times |sigma|, and at most a largest distance; the smaller bound is taken. Each of both is affine in the
    bounds of the signals, as P7 needs. In the implicit form the increment of v is K_P(sigma) (sigma - s) in place of
    the change of phi_1. The difference of both, at most R(sigma), is added.

    Args:
        problem: The certificate's problem.
        stage: The stage.
        gains: Balls of the gains in the stage's region.
        centre: Gains of the middle loop, by name.
        bounds: Bounds of the signals, in the order of a stage's ``bounds``.
    """
    t = arb(problem["sample_time"])
    change = bounds[CHANGE]
    sigma = bounds[SIGMA]
    distance = {name: abs(gains[name] - value).upper() for name, value in centre.items()}  # of each gain
    if stage["coordinate"] == "u_av":
        return LawDeviations(
            integral=distance["k_p"] * change + t * distance["k_i"] * sigma,
            command=distance["k_n"] * sigma,
            slide=distance["slide_i"] * sigma,
        )
    integral_by_ratio = t * distance["k_i"] * sigma
    largest_change = None
    if problem["form"] == "implicit":
        largest_change = stage["change"]  # C
        largest_r = increment_error(problem, 0.0, largest_change)  # R(0)
        integral_by_ratio = integral_by_ratio + largest_r / arb(largest_change) * change
    lines = StraightLines(centre, change=largest_change)
    functions = function_distances(problem, stage["sigma"], stage["e"], lines)
    command_by_ratio = (distance["mean"] + distance["k_n"]) * sigma
    slide_by_ratio = distance["mean"] * sigma
    return LawDeviations(
        integral=minimum_bound(t * functions["phi_2"], integral_by_ratio),
        command=minimum_bound(functions["both"], command_by_ratio),
        slide=distance["slide_i"] * sigma + minimum_bound(functions["phi_1"], slide_by_ratio),
    )


def slide_deviation(
    problem: Problem, stage: SmallGainStage, gains: Balls, centre: Balls, bounds: list[arb], error_change: arb
) -> arb:
    """Bound of the deviation of u_eq from the middle loop's that the changes of sigma and e in a sample cause [m/s].

    Args:
        problem: The certificate's problem.
        stage: The stage.
        gains: Balls of the gains in the stage's region.
        centre: Gains of the middle loop, by name.
        bounds: Bounds of the signals, in the order of a stage's ``bounds``.
        error_change: Bound of the change of e in a sample [m].
    """
    slope_in_e = abs(gains.get("slide_e", arb(0))).upper()
    slide_p = slide_gain(problem, stage, gains, bounds[CHANGE], error_change)
    return abs(slide_p - centre["slide_p"]).upper() * bounds[CHANGE] + slope_in_e * error_change


def deviation_sizes(loop: MiddleLoop, law: LawDeviations, command: arb, states: list[arb]) -> list[arb]:
    """Bounds of the inputs omega, in the order of the columns ``loop.deviations``.

    The inputs are omega_v and omega_u of the control law and, if a_p or mu has an interval, omega_i of each state.

    Args:
        loop: The middle loop.
        law: Bounds of the deviations of the control law.
        command: Bound of |command + d_r| of the true loop.
        states: Bounds of the states.
    """
    sizes = [law.integral, law.command + loop.share * command]
    if loop.half_widths is not None:
        chi = len(loop.half_widths)
        for row in loop.half_widths:
            by_states = total([row[j] * states[j] for j in range(chi)])
            sizes.append(row[chi] * command + by_states)
        sizes += [arb(0), arb(0)]  # v and s do not depend on the plant
    return sizes


def bend_between_samples(problem: Problem, box: Box, states: list[arb], command: arb) -> arb:
    """Bound of the distance of e from the straight line between its values at two samples: (T_s^2/8) sup |e''| [m].

    Args:
        problem: The problem, in which the stage's own level and slope bound |d| and |d'|.
        box: Intervals of the plant.
        states: Bounds of the n states at the samples.
        command: Bound of |command + d_r| of the true loop.
    """
    chi = state_places(problem).n - 2
    t = arb(problem["sample_time"])
    k_p = arb(box["k_p"][1])
    generator = generator_over(problem, box)  # [[F, G], [0, 0]]
    flow = next(flows(generator, t, pieces=1))  # over the whole sample
    acceleration = (generator * flow).tolist()[1]  # e'' as a row over the states and U at the sample
    by_states = total([abs(acceleration[j]) * states[j] for j in range(chi)])
    # d_r changes by its slope times T_s, and what it has done to e' acts on e'' in turn
    by_disturbance = k_p * signal_bounds(problem, box).slope * t * (1 + t * abs(acceleration[1]))
    return t * t / 8 * (by_states + k_p * abs(acceleration[chi]) * command + by_disturbance)
