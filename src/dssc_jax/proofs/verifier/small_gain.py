"""(P7) Bounds of all signals that imply themselves: responses of one middle loop, and a small gain around it.

At the middle of plant and gains, with c = sigma - s and the command r z,

    z+ = A z + B w + b_v omega_v + b_u omega_u + omega,    |omega_i| <= k_p dGamma_i |command| + sum of dPhi_ij |z_j|.

omega_v is what the law's increment deviates by, omega_u what the command deviates by besides: :func:`law_deviations`
bounds both. A signal is bounded by the peak of its response to the starts plus the sums of its absolute impulse
responses times the bounds of the inputs. If that is less than the bound that went in, for every signal, then by
induction no signal ever exceeds its bound. docs/proofs.md has the proof.
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
    input_columns,
    inside_bounds,
    sample_matrix,
    signal_bounds,
    signal_rows,
    start_columns,
    zeta_jump,
)
from dssc_jax.proofs.verifier.function_distances import function_distances, increment_error
from dssc_jax.proofs.verifier.gain_enclosures import depends_on_error, enclosed_start_ratio
from dssc_jax.proofs.verifier.held_plant import (
    flows,
    generator_over,
    held_sample,
    held_spread,
    state_places,
)
from dssc_jax.proofs.verifier.impulse_responses import response_bounds
from dssc_jax.proofs.verifier.slope_ratios import slide_gain
from dssc_jax.proofs.verifier.state_dependence import disturbance_by_state, motion_bounds

MIDDLE_GAINS: dict[str, tuple[str, ...]] = {
    "u_av": ("k_p", "k_i", "k_n", "slide_p", "slide_i"),
    "phi_1": ("mean", "k_i", "k_n", "slide_p", "slide_i"),
}
"""Gains of the middle loop, by coordinate; with q = v - phi_1 the first is that of phi_1, over sigma."""
CHANGE, SIGMA, ERROR, COMMAND, EQUIVALENT, STATES = range(6)
"""Places of the signals in a list of bounds; the states follow."""


class MiddleLoop(NamedTuple):
    """The linear loop at the middle of plant and gains, around which the small gain is shown.

    Args:
        a: A, (n, n).
        rows: Rows of the signals, in the order of ``bounds`` of a stage, (5 + n, n).
        w: Columns of the inputs of magnitude at most 1, (n, inputs).
        deviations: Columns b_v and b_u of what the law deviates by; unless a_p and mu are one point, also the unit
            columns, of what the held plant deviates by.
        share: Half of k_p's width over its middle.
        half_widths: Half widths of the entries of Phi and, last in each row, of k_p Gamma at a fixed k_p; None if a_p
            and mu are one point.
    """

    a: arb_mat
    rows: arb_mat
    w: arb_mat
    deviations: arb_mat
    share: arb
    half_widths: list[list[arb]] | None


class LawDeviations(NamedTuple):
    """Bounds of what the control law deviates by from the law of the middle loop [m/s].

    Args:
        integral: Bound of omega_v, the deviation of the increment of v or q.
        command: Bound of the command's deviation, without that by omega_v and by k_p.
        slide: Bound of the equivalent control's deviation, without that by the changes of sigma and e in a sample.
    """

    integral: arb
    command: arb
    slide: arb


def middle_loop(problem: Problem, box: Box, coordinate: str, centre: Balls) -> MiddleLoop:
    """The linear loop at the middle of a box of plants.

    Args:
        problem: The problem, with the level and slope of the stage.
        box: Intervals of k_p, a_p and 1/mu.
        coordinate: What z holds: ``u_av``, or ``phi_1`` for q = v - phi_1(s).
        centre: Gains of the loop, by their names in :data:`MIDDLE_GAINS`.
    """
    zeta, _, n = state_places(problem)
    chi = n - 2
    t = arb(problem["sample_time"])
    rows = signal_rows(problem)
    is_integrated = coordinate == "phi_1"
    middle = {name: ((arb(low) + arb(high)) / 2).mid() for name, (low, high) in box.items()}
    k_p = middle["k_p"]
    low, high = map(arb, box["k_p"])
    gain = [centre[name] for name in MIDDLE_GAINS[coordinate][:3]]
    held_matrix = held_sample(problem, middle["a_p"], middle.get("rate", arb(0)))
    a = sample_matrix(problem, held_matrix, k_p, gain, is_integrated=is_integrated)
    _, command = control_rows(problem, gain, is_integrated=is_integrated)
    equivalent = rows.v + rows.change * centre["slide_p"] + rows.sigma * centre["slide_i"]
    if is_integrated:
        equivalent = equivalent + rows.s * centre["mean"]
    signals = [row.tolist()[0] for row in (rows.change, rows.sigma, rows.e, command, equivalent)]
    unit = identity(n).tolist()
    by_command = [k_p * held_matrix[i, chi] if i < chi else arb(0) for i in range(n)]
    by_v = [-x for x in by_command[:chi]] + [arb(1), arb(0)]
    deviations = [by_v, by_command]
    half_widths = None
    if any(box[name][0] < box[name][1] for name in box if name != "k_p"):
        half_widths = [[*row[:chi], (row[chi] * high).upper()] for row in held_spread(problem, box)[:chi]]
        deviations += unit
    sizes = signal_bounds(problem, box)
    inputs = input_columns(problem, k_p, sizes, inside_bounds(problem, box, t))
    k_p_distance = maximum(high - k_p, k_p - low)
    jump_distance = [arb(0)] * n  # of zeta at other values of k_p
    for place, jump in zip(zeta, zeta_jump(problem), strict=True):
        jump_distance[place] = t * sizes.slope * k_p_distance * jump
    return MiddleLoop(
        a=a,
        rows=arb_mat([*signals, *unit]),
        w=side_by_side(inputs, matrix_of_columns([jump_distance])),
        deviations=matrix_of_columns(deviations),
        share=(k_p_distance / k_p).upper(),
        half_widths=half_widths,
    )


def implied_bounds(
    problem: Problem, box: Box, stage: SmallGainStage, gains: Balls, from_start: bool, label: str
) -> StageLimits:
    """(P7) Show that the bounds of a stage imply themselves, and return what they bound.

    Args:
        problem: The problem, with the level and slope of the stage.
        box: Intervals of k_p, a_p and 1/mu.
        stage: The stage, with bounds of the signals and gains of the middle loop.
        gains: Balls of the gains in the stage's region.
        from_start: Whether the bounds are to hold from the start on; otherwise they are those of the upper limits.
        label: Place of the stage, for messages.

    Raises:
        Rejected: A premise cannot be shown.
    """
    t = arb(problem["sample_time"])
    rate = arb(stage["rate"])
    coordinate = stage["coordinate"]
    centre = dict(zip(MIDDLE_GAINS[coordinate], map(arb, stage["gains"]), strict=True))
    loop = middle_loop(problem, box, coordinate, centre)
    p = symmetric_matrix(stage["p"])
    bounds = [arb(bound) for bound in stage["bounds"]]
    states = bounds[STATES:]
    require_premise(rate > 0 and t * rate < 1, f"P7: lambda is not in (0, 1/T_s) in {label}")
    require_premise(positive_definite(p), f"P2: P is not positive definite in {label}")
    decrease = p * (1 - t * rate) - loop.a.transpose() * p * loop.a
    require_premise(positive_definite(decrease), f"P7: V does not fall in {label}")
    inputs = side_by_side(loop.w, loop.deviations)
    starts = arb_mat(p.nrows(), 0)
    if from_start:
        ratio = enclosed_start_ratio(problem, is_integrated=coordinate == "phi_1")
        starts = start_columns(problem, box, ratio)
    responses = response_bounds(loop.a, loop.rows, inputs, starts, p, t * rate)
    if responses is None:
        raise Rejected(f"P7: the responses decay too slowly in {label}")
    law = law_deviations(problem, stage, gains, centre, bounds)
    command = bounds[COMMAND] + law.integral + law.command
    error_change = arb(0)
    if depends_on_error(problem):
        error_change = t * motion_bounds(problem, box, [command, *states])[1]
    sizes = [arb(1)] * loop.w.ncols() + deviation_sizes(loop, law, command, states)
    for i, bound in enumerate(bounds):
        response = total([arb(float(responses.sums[i, j])) * size for j, size in enumerate(sizes)])
        peak = arb(float(responses.peaks[i].max(initial=0.0))) if from_start else arb(0)
        holds = response + peak < bound
        require_premise(holds, f"P7: the bound of signal {i} does not imply itself in {label}")
    if from_start and problem["rho"] is not None:
        room = arb(problem["rho"]) - signal_bounds(problem, box).offset
        slack = law.slide + slide_deviation(problem, stage, gains, centre, bounds, error_change)
        require_premise(bounds[EQUIVALENT] + slack <= room, f"P5: the equivalent control may exceed rho in {label}")
    bend = bend_between_samples(problem, box, states, command)
    entered_bounds = [bound * arb(ENTERED) for bound in (command, *states)]
    level, slope = disturbance_by_state(problem, box, entered_bounds)
    return StageLimits(
        sigma=bounds[SIGMA],
        e=bounds[ERROR],
        change=bounds[CHANGE],
        between=(states[0] + bend).upper(),
        level=level,
        slope=slope,
        error_change=error_change,
    )


def law_deviations(
    problem: Problem, stage: SmallGainStage, gains: Balls, centre: Balls, bounds: list[arb]
) -> LawDeviations:
    """Bounds of what the law deviates by from that of the middle loop, under the bounds of a stage.

    With the coordinate v the gains K_P, K_I and K_N deviate. With q = v - phi_1 the functions phi_1, phi_2 and n of
    sigma and e do: by the spread of their ratios to sigma, or by their distance from straight lines, whichever is
    less. Both are affine in the bounds, so that either may stand in P7. In the implicit form the increment K_P(sigma)
    (sigma - s) deviates from that of phi_1, too.

    Args:
        problem: The certificate's problem.
        stage: The stage.
        gains: Balls of the gains in its region.
        centre: Gains of the middle loop.
        bounds: Bounds of the signals.
    """
    t = arb(problem["sample_time"])
    change = bounds[CHANGE]
    sigma = bounds[SIGMA]
    gain_distances = {name: abs(gains[name] - value).upper() for name, value in centre.items()}
    slide = gain_distances["slide_i"] * sigma
    if stage["coordinate"] == "u_av":
        by_v = gain_distances["k_p"] * change + t * gain_distances["k_i"] * sigma
        return LawDeviations(by_v, gain_distances["k_n"] * sigma, slide)
    by_ratio = t * gain_distances["k_i"] * sigma
    change_bound = None
    if problem["form"] == "implicit":
        change_bound = stage["change"]
        by_ratio = by_ratio + increment_error(problem, 0.0, change_bound) / arb(change_bound) * change
    distances = function_distances(problem, stage["sigma"], stage["e"], centre, change=change_bound)
    return LawDeviations(
        minimum_bound(t * distances["phi_2"], by_ratio),
        minimum_bound(distances["both"], (gain_distances["mean"] + gain_distances["k_n"]) * sigma),
        slide + minimum_bound(distances["phi_1"], gain_distances["mean"] * sigma),
    )


def slide_deviation(
    problem: Problem, stage: SmallGainStage, gains: Balls, centre: Balls, bounds: list[arb], error_change: arb
) -> arb:
    """Bound of what the equivalent control deviates by due to the changes of sigma and of e in a sample [m/s]."""
    slope_in_e = abs(gains.get("slide_e", arb(0))).upper()
    slide_p = slide_gain(problem, stage, gains, bounds[CHANGE], error_change)
    return abs(slide_p - centre["slide_p"]).upper() * bounds[CHANGE] + slope_in_e * error_change


def deviation_sizes(loop: MiddleLoop, law: LawDeviations, command: arb, states: list[arb]) -> list[arb]:
    """Bounds of what the true loop deviates by, in the order of the columns ``loop.deviations``.

    These are omega_v and omega_u of the law and, unless a_p and mu are one point, omega_i of each state.

    Args:
        loop: The middle loop.
        law: Bounds of the law's deviations.
        command: Bound of the true command plus d_r.
        states: Bounds of the states.
    """
    sizes = [law.integral, law.command + loop.share * command]
    if loop.half_widths is not None:
        chi = len(loop.half_widths)
        for row in loop.half_widths:
            by_states = total([row[j] * states[j] for j in range(chi)])
            sizes.append(row[chi] * command + by_states)
        sizes += [arb(0)] * (len(states) - chi)
    return sizes


def bend_between_samples(problem: Problem, box: Box, states: list[arb], command: arb) -> arb:
    """Bound of how far e is from the straight line between its values at two samples: T_s^2/8 sup |e''| [m].

    Args:
        problem: The problem, with the level and slope of the stage.
        box: Intervals of the plant.
        states: Bounds of the states at the samples.
        command: Bound of the command plus d_r.
    """
    chi = state_places(problem).n - 2
    t = arb(problem["sample_time"])
    k_p = arb(box["k_p"][1])
    f = generator_over(problem, box)
    (flow,) = flows(f, t, 1)
    second_derivative = (f * flow).tolist()[1]
    by_states = total([abs(second_derivative[j]) * states[j] for j in range(chi)])
    disturbance_effect = k_p * signal_bounds(problem, box).slope * t * (1 + t * abs(second_derivative[1]))
    return t * t / 8 * (by_states + k_p * abs(second_derivative[chi]) * command + disturbance_effect)
