"""(P7) Bounds of all signals that imply themselves: responses of one middle loop, and a small gain around it.

At the middle of plant and gains, with c = sigma - s and the command r z,

    z+ = A z + B w + b_v omega_v + b_u omega_u + omega,    |omega_v| <= dK_P |c| + T_s dK_I |sigma|,
    |omega_u| <= dK_N |sigma| + share |command|,           |omega_i| <= k_p dGamma_i |command| + sum of dPhi_ij |z_j|,

where d is the largest deviation from the middle, and share that of k_p over it. A signal is bounded by the peak of its
response to the starts plus the sums of its absolute impulse responses times the bounds of the inputs. If that is at
most the bound that went in, for every signal, then by induction no signal ever exceeds its bound. docs/proofs.md has
the proof.
"""

from typing import Any, NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.balls import (
    ENTERED,
    Balls,
    StageLimits,
    enclosing,
    larger,
    positive_definite,
    require_premise,
    symmetric_ball,
)
from dssc_jax.proofs.enclosed_loop import (
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
from dssc_jax.proofs.impulse_responses import response_bounds
from dssc_jax.proofs.state_dependence import disturbance_by_state

MIDDLE_GAINS: tuple[str, ...] = ("k_p", "k_i", "k_n", "slide_p", "slide_i")
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


def middle_loop(problem: dict[str, Any], box: dict[str, Any], centre: Balls) -> MiddleLoop:
    """The loop of a box at its middle and at these gains."""
    zeta, _, n = state_places(problem)
    chi, t, rows = n - 2, arb(problem["sample_time"]), signal_rows(problem)
    low, high = map(arb, box["k_p"])
    middle = {name: ((arb(pair[0]) + arb(pair[1])) / 2).mid() for name, pair in box.items()}
    k_p, gain = middle["k_p"], [centre[name] for name in ("k_p", "k_i", "k_n")]
    held = held_sample(problem, middle["a_p"], middle.get("rate", arb(0)))
    a = sampled(problem, held, k_p, gain)
    _, command = control_rows(problem, gain, integrated=False)
    equivalent = rows["v"] + rows["change"] * centre["slide_p"] + rows["sigma"] * centre["slide_i"]
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
    centre = dict(zip(MIDDLE_GAINS, map(arb, stage["gains"]), strict=True))
    half = {name: abs(gains[name] - centre[name]).upper() for name in MIDDLE_GAINS}
    loop = middle_loop(problem, box, centre)
    p, bounds = symmetric_ball(stage["p"]), [arb(each) for each in stage["bounds"]]
    require_premise(rate > 0 and t * rate < 1, f"P7: lambda is not in (0, 1/T_s) in {where}")
    require_premise(positive_definite(p), f"P2: P is not positive definite in {where}")
    falls = p * (1 - t * rate) - loop.a.transpose() * p * loop.a
    require_premise(positive_definite(falls), f"P7: V does not fall in {where}")
    inputs = adjoined(loop.w, loop.deviations)
    starts = start_columns(problem, box) if started else arb_mat(p.nrows(), 0)
    responses = response_bounds(loop.a, loop.rows, inputs, starts, p, t * rate)
    require_premise(responses is not None, f"P7: the responses decay too slowly in {where}")
    assert responses is not None
    sizes = [arb(1)] * loop.w.ncols() + deviation_sizes(loop, half, bounds, t)
    for i, bound in enumerate(bounds):
        forced = sum((arb(float(responses.sums[i, j])) * size for j, size in enumerate(sizes)), arb(0))
        total = forced + (arb(float(responses.peaks[i])) if started else arb(0))
        require_premise(total <= bound, f"P7: the bound of signal {i} does not imply itself in {where}")
    if started and problem["rho"] is not None:
        room = arb(problem["rho"]) - signal_bounds(problem, box).offset
        slack = half["slide_p"] * bounds[CHANGE] + half["slide_i"] * bounds[SIGMA]
        require_premise(bounds[EQUIVALENT] + slack <= room, f"P5: the equivalent control may exceed rho in {where}")
    command = true_command(half, bounds, t)
    bend = bend_between_samples(problem, box, bounds, command)
    added = disturbance_by_state(problem, box, [each * arb(ENTERED) for each in (command, *bounds[STATES:])])
    return StageLimits(bounds[SIGMA], bounds[ERROR], (bounds[STATES] + bend).upper(), *added)


def adjoined(left: arb_mat, right: arb_mat) -> arb_mat:
    """Two matrices side by side."""
    return arb_mat(
        [
            [*(left[i, j] for j in range(left.ncols())), *(right[i, j] for j in range(right.ncols()))]
            for i in range(left.nrows())
        ]
    )


def true_command(half: Balls, bounds: list[arb], t: arb) -> arb:
    """Bound of the command with the gains that it has, not those of the middle."""
    by_sigma = t * half["k_i"] + half["k_n"]
    return bounds[COMMAND] + half["k_p"] * bounds[CHANGE] + by_sigma * bounds[SIGMA]


def deviation_sizes(loop: MiddleLoop, half: Balls, bounds: list[arb], t: arb) -> list[arb]:
    """Bounds of omega_v, omega_u and, unless there is one point, of each omega_i."""
    command, states = true_command(half, bounds, t), bounds[STATES:]
    by_v = half["k_p"] * bounds[CHANGE] + t * half["k_i"] * bounds[SIGMA]
    sizes = [by_v, half["k_n"] * bounds[SIGMA] + loop.share * command]
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
