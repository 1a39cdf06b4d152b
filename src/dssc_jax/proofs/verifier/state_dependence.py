"""(P8) What a disturbance as in (30) adds to its level and slope by depending on the state.

With y = e + y_m, and s = e' + l_0 e taken at any time, not only at the samples,

    |d|  <= alpha + k_d4 |y| + (k_d1 |y| + k_d2 |y'| + k_d3) |s|
    |d'| <= alpha' + k_d5 |y| + k_d4 |y'| + (k_d1 |y'| + k_d2 |y''|) |s| + (k_d1 |y| + k_d2 |y'| + k_d3) |s'|

Bounds of |e|, |e'| and |e''| within a sample follow from those of the states and the command at its beginning.
"""

from typing import Any

from flint import arb

from dssc_jax.proofs.verifier.balls import enclosing, larger
from dssc_jax.proofs.verifier.enclosed_loop import held_generator, inside_bounds, signal_bounds, state_places

PIECES = 64  # of a sample, on which its inside is enclosed


def disturbance_by_state(problem: dict[str, Any], box: dict[str, Any], bounds: list[arb]) -> tuple[arb, arb]:
    """Bounds of what the state adds to |d| and to |d'|.

    Args:
        problem: The certificate's problem, with the level and slope of the stage.
        box: Its box.
        bounds: Bounds of the command plus d_r and of each state at the samples.
    """
    k_1, k_2, k_3, k_4, k_5 = map(arb, problem["by_state"])
    if not any(problem["by_state"]):
        return arb(0), arb(0)
    e, speed, bend = motion_bounds(problem, box, bounds)
    size, (v, a, _) = arb(problem["reference_size"]), map(arb, problem["reference"])
    y, y_dot, y_ddot, l0 = e + size, speed + v, bend + a, arb(problem["l0"])
    s, s_dot, growth = speed + l0 * e, bend + l0 * speed, k_1 * y + k_2 * y_dot + k_3
    level = k_4 * y + growth * s
    slope = k_5 * y + k_4 * y_dot + (k_1 * y_dot + k_2 * y_ddot) * s + growth * s_dot
    return level.upper(), slope.upper()


def motion_bounds(problem: dict[str, Any], box: dict[str, Any], bounds: list[arb]) -> tuple[arb, arb, arb]:
    """Bounds of |e|, |e'| and |e''| at all times."""
    command, *states = bounds
    places = state_places(problem)
    chi, t, k_p = places.n - 2, arb(problem["sample_time"]), arb(box["k_p"][1])
    generator = held_generator(problem, enclosing(*box["a_p"]), enclosing(*box.get("rate", (0.0, 0.0))))
    inside, largest = inside_bounds(problem, box, t), [arb(0)] * chi
    for piece in range(PIECES):
        flow = (generator * (t * enclosing(piece / PIECES, (piece + 1) / PIECES))).exp()
        for i in range(chi):
            reached = inside[i] + abs(flow[i, chi]) * k_p * command
            reached = reached + sum((abs(flow[i, j]) * states[j] for j in range(chi)), arb(0))
            largest[i] = larger(largest[i], reached.upper())
    bend = abs(generator[1, chi]) * k_p * command + signal_bounds(problem, box).slope * t * k_p
    bend = bend + sum((abs(generator[1, j]) * largest[j] for j in range(chi)), arb(0))
    return largest[0], largest[1], bend.upper()
