"""(P7) Bounds of all signals that imply themselves: responses of one middle loop, and a small gain around it.

At the middle of plant and gains, with c = sigma - s and the command r z,

    z+ = A z + B w + b_v omega_v + b_u omega_u + omega,    |omega_i| <= k_p dGamma_i |command| + sum of dPhi_ij |z_j|.

omega_v is what the law's increment deviates by, omega_u what the command deviates by besides: :func:`law_deviations`
bounds both. A signal is bounded by the peak of its response to the starts plus the sums of its absolute impulse
responses times the bounds of the inputs. If that is less than the bound that went in, for every signal, then by
induction no signal ever exceeds its bound. docs/proofs.md has the proof.
"""

from typing import Any, NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import (
    ENTERED,
    Balls,
    StageLimits,
    enclosing,
    larger,
    positive_definite,
    require_premise,
    symmetric_ball,
)
from dssc_jax.proofs.verifier.enclosed_loop import (
    control_rows,
    held_generator,
    held_sample,
    held_spread,
    input_columns,
    inside_bounds,
    sampled,
    signal_bounds,
    signal_rows,
    start_columns,
    state_places,
    zeta_jump,
)
from dssc_jax.proofs.verifier.function_distances import function_distances
from dssc_jax.proofs.verifier.gain_enclosures import depends_on_error, enclosed_start_ratio
from dssc_jax.proofs.verifier.impulse_responses import response_bounds
from dssc_jax.proofs.verifier.slope_ratios import slide_gain
from dssc_jax.proofs.verifier.state_dependence import disturbance_by_state, motion_bounds

MIDDLE_GAINS: dict[str, tuple[str, ...]] = {
    "implicit": ("k_p", "k_i", "k_n", "slide_p", "slide_i"),
    "conservative": ("mean", "k_i", "k_n", "slide_p", "slide_i"),
}
"""Gains of the middle loop, by form; in the conservative one the first is that of phi_1, over sigma."""
CHANGE, SIGMA, ERROR, COMMAND, EQUIVALENT, STATES = range(6)
"""Places of the signals in a list of bounds; the states follow."""


class MiddleLoop(NamedTuple):
    """The loop at the middle of plant and gains.

    Args:
        a: A, (n, n).
        rows: Rows of the signals, (5 + n, n).
        w: Columns of the inputs, of magnitude at most 1.
        deviations: Columns b_v, b_u, and, unless plant and lag are one point, the unit columns.
        share: Half of k_p's width over its middle.
        held: Half widths of Phi's entries and, last, of k_p Gamma's at fixed k_p; None for one point.
    """

    a: arb_mat
    rows: arb_mat
    w: arb_mat
    deviations: arb_mat
    share: arb
    held: list[list[arb]] | None


class LawDeviations(NamedTuple):
    """Bounds of what the law deviates by from that of the middle loop.

    Args:
        integral: Of omega_v, in the increment of v or q.
        command: Of the command besides, at one k_p.
        slide: Of the equivalent control, without what deviates by the changes of sigma and e in a sample.
    """

    integral: arb
    command: arb
    slide: arb


def middle_loop(problem: dict[str, Any], box: dict[str, Any], centre: Balls) -> MiddleLoop:
    """The loop of a box at its middle and at these gains."""
    zeta, _, n = state_places(problem)
    chi, t, rows = n - 2, arb(problem["sample_time"]), signal_rows(problem)
    low, high = map(arb, box["k_p"])
    middle = {name: ((arb(pair[0]) + arb(pair[1])) / 2).mid() for name, pair in box.items()}
    integrated = problem["form"] == "conservative"
    k_p, gain = middle["k_p"], [centre[name] for name in MIDDLE_GAINS[problem["form"]][:3]]
    held = held_sample(problem, middle["a_p"], middle.get("rate", arb(0)))
    a = sampled(problem, held, k_p, gain, integrated=integrated)
    _, command = control_rows(problem, gain, integrated=integrated)
    equivalent = rows["v"] + rows["change"] * centre["slide_p"] + rows["sigma"] * centre["slide_i"]
    if integrated:
        equivalent = equivalent + rows["s"] * centre["mean"]
    signals = [rows["change"], rows["sigma"], rows["e"], command, equivalent]
    unit = [[arb(int(i == j)) for j in range(n)] for i in range(n)]
    by_command = [k_p * held[i, chi] if i < chi else arb(0) for i in range(n)]
    by_v = [-x for x in by_command[:chi]] + [arb(1), arb(0)]
    columns, spread = [by_v, by_command], None
    if any(box[name][0] < box[name][1] for name in box if name != "k_p"):
        spread = [[*row[:chi], (row[chi] * high).upper()] for row in held_spread(problem, box)[:chi]]
        columns += unit
    sizes = signal_bounds(problem, box)
    inputs = input_columns(problem, k_p, sizes, inside_bounds(problem, box, t))
    other = [arb(0)] * n  # zeta's jump at other values of k_p
    for at, jump in zip(zeta, zeta_jump(problem), strict=True):
        other[at] = t * sizes.slope * larger(high - k_p, k_p - low) * jump
    w = [[*(inputs[i, j] for j in range(inputs.ncols())), other[i]] for i in range(n)]
    return MiddleLoop(
        a,
        arb_mat([*([row[0, j] for j in range(n)] for row in signals), *unit]),
        arb_mat(w),
        arb_mat([[column[i] for column in columns] for i in range(n)]),
        (larger(high - k_p, k_p - low) / k_p).upper(),
        spread,
    )


def implied_bounds(
    problem: dict[str, Any], box: dict[str, Any], stage: dict[str, Any], gains: Balls, started: bool, where: str
) -> StageLimits:
    """Show that the stage's bounds imply themselves.

    Args:
        problem: The certificate's problem.
        box: Its box.
        stage: The stage, whose ``bounds`` are those of the signals.
        gains: Balls of the gains in the stage's region; the stage has those of the middle loop.
        started: Whether the bounds hold from the start on; otherwise of every upper limit.
        where: The stage's place, for messages.
    """
    t, rate = arb(problem["sample_time"]), arb(stage["rate"])
    centre = dict(zip(MIDDLE_GAINS[problem["form"]], map(arb, stage["gains"]), strict=True))
    loop = middle_loop(problem, box, centre)
    p, bounds = symmetric_ball(stage["p"]), [arb(each) for each in stage["bounds"]]
    require_premise(rate > 0 and t * rate < 1, f"P7: lambda is not in (0, 1/T_s) in {where}")
    require_premise(positive_definite(p), f"P2: P is not positive definite in {where}")
    falls = p * (1 - t * rate) - loop.a.transpose() * p * loop.a
    require_premise(positive_definite(falls), f"P7: V does not fall in {where}")
    inputs = adjoined(loop.w, loop.deviations)
    starts = (
        start_columns(problem, box, enclosed_start_ratio(problem, integrated=problem["form"] == "conservative"))
        if started
        else arb_mat(p.nrows(), 0)
    )
    responses = response_bounds(loop.a, loop.rows, inputs, starts, p, t * rate)
    require_premise(responses is not None, f"P7: the responses decay too slowly in {where}")
    assert responses is not None
    law = law_deviations(problem, stage, gains, centre, bounds)
    command, moved = bounds[COMMAND] + law.integral + law.command, arb(0)
    if depends_on_error(problem):
        moved = t * motion_bounds(problem, box, [command, *bounds[STATES:]])[1]
    sizes = [arb(1)] * loop.w.ncols() + deviation_sizes(loop, law, command, bounds[STATES:])
    for i, bound in enumerate(bounds):
        forced = sum((arb(float(responses.sums[i, j])) * size for j, size in enumerate(sizes)), arb(0))
        total = forced + (arb(float(responses.peaks[i])) if started else arb(0))
        require_premise(total < bound, f"P7: the bound of signal {i} does not imply itself in {where}")
    if started and problem["rho"] is not None:
        room = arb(problem["rho"]) - signal_bounds(problem, box).offset
        slack = law.slide + slide_deviation(problem, stage, gains, centre, bounds, moved)
        require_premise(bounds[EQUIVALENT] + slack <= room, f"P5: the equivalent control may exceed rho in {where}")
    bend = bend_between_samples(problem, box, bounds, command)
    added = disturbance_by_state(problem, box, [each * arb(ENTERED) for each in (command, *bounds[STATES:])])
    return StageLimits(bounds[SIGMA], bounds[ERROR], (bounds[STATES] + bend).upper(), *added, moved)


def law_deviations(
    problem: dict[str, Any], stage: dict[str, Any], gains: Balls, centre: Balls, bounds: list[arb]
) -> LawDeviations:
    """What the law deviates by, under the stage's bounds.

    In the implicit form the gains K_P, K_I and K_N deviate. In the conservative form the functions phi_1, phi_2 and n
    of sigma and e do: by the spread of their ratios to sigma, or by their distance from straight lines, whichever is
    less. Both are affine in the bounds, so that either may stand in P7.

    Args:
        problem: The certificate's problem.
        stage: The stage with its region.
        gains: Balls of the gains there.
        centre: Those of the middle loop.
        bounds: Of the signals.
    """
    t, change, sigma = arb(problem["sample_time"]), bounds[CHANGE], bounds[SIGMA]
    half = {name: abs(gains[name] - value).upper() for name, value in centre.items()}
    slide = half["slide_i"] * sigma
    if problem["form"] == "implicit":
        by_v = half["k_p"] * change + t * half["k_i"] * sigma
        return LawDeviations(by_v, half["k_n"] * sigma, slide)
    far = function_distances(problem, stage["sigma"], stage["e"], centre)
    return LawDeviations(
        t * smaller(far["phi_2"], half["k_i"] * sigma),
        smaller(far["both"], (half["mean"] + half["k_n"]) * sigma),
        slide + smaller(far["phi_1"], half["mean"] * sigma),
    )


def slide_deviation(
    problem: dict[str, Any], stage: dict[str, Any], gains: Balls, centre: Balls, bounds: list[arb], moved: arb
) -> arb:
    """What the equivalent control deviates by, through the changes of sigma and, by ``moved``, of e in a sample."""
    by_e = abs(gains.get("slide_e", arb(0))).upper()
    slide_p = slide_gain(problem, stage, gains, bounds[CHANGE], moved)
    return abs(slide_p - centre["slide_p"]).upper() * bounds[CHANGE] + by_e * moved


def smaller(a: arb, b: arb) -> arb:
    """An upper bound of the smaller of two numbers."""
    low, high = a.upper(), b.upper()
    return low if low <= high else high


def adjoined(left: arb_mat, right: arb_mat) -> arb_mat:
    """Two matrices side by side."""
    return arb_mat(
        [
            [*(left[i, j] for j in range(left.ncols())), *(right[i, j] for j in range(right.ncols()))]
            for i in range(left.nrows())
        ]
    )


def deviation_sizes(loop: MiddleLoop, law: LawDeviations, command: arb, states: list[arb]) -> list[arb]:
    """Bounds of omega_v, omega_u and, unless there is one point, of each omega_i; ``command`` bounds the true one."""
    sizes = [law.integral, law.command + loop.share * command]
    if loop.held is not None:
        chi = len(loop.held)
        for row in loop.held:
            sizes.append(row[chi] * command + sum((row[j] * states[j] for j in range(chi)), arb(0)))
        sizes += [arb(0)] * (len(states) - chi)
    return sizes


def bend_between_samples(problem: dict[str, Any], box: dict[str, Any], bounds: list[arb], command: arb) -> arb:
    """How far e can deviate from the straight line between two samples: T_s^2/8 sup |e''|."""
    _, _, n = state_places(problem)
    t, k_p = arb(problem["sample_time"]), arb(box["k_p"][1])
    f = held_generator(problem, enclosing(*box["a_p"]), enclosing(*box.get("rate", (0.0, 0.0))))
    bent = f * (f * (t * enclosing(0.0, 1.0))).exp()
    by_states = sum((abs(bent[1, j]) * bounds[STATES + j] for j in range(n - 2)), arb(0))
    disturbed = k_p * signal_bounds(problem, box).slope * t * (1 + t * abs(bent[1, 1]))
    return t * t / 8 * (by_states + k_p * abs(bent[1, n - 2]) * command + disturbed)
