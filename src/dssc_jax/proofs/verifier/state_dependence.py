"""(P8) What a disturbance as in (30) adds to its level and slope by depending on the state.

With y = e + y_m, and s = e' + l_0 e taken at any time, not only at the samples,

    |d|  <= alpha + k_d4 |y| + (k_d1 |y| + k_d2 |y'| + k_d3) |s|
    |d'| <= alpha' + k_d5 |y| + k_d4 |y'| + (k_d1 |y'| + k_d2 |y''|) |s| + (k_d1 |y| + k_d2 |y'| + k_d3) |s'|

Bounds of |e|, |e'| and |e''| within a sample follow from those of the states and the command at its beginning.
"""

from flint import arb

from dssc_jax.proofs.verifier.balls import maximum, total
from dssc_jax.proofs.verifier.certificate import Box, Problem
from dssc_jax.proofs.verifier.enclosed_loop import inside_bounds, signal_bounds
from dssc_jax.proofs.verifier.held_plant import flows, generator_over, state_places

PIECES = 64  # of a sample, on which its inside is enclosed


def disturbance_by_state(problem: Problem, box: Box, bounds: list[arb]) -> tuple[arb, arb]:
    """Bounds of what the state adds to |d| [m/s] and to |d'| [m/s^2].

    Args:
        problem: The problem, with the level and slope of the stage.
        box: Intervals of the plant.
        bounds: Bounds of the command plus d_r, and of each state at the samples.
    """
    k_1, k_2, k_3, k_4, k_5 = map(arb, problem["by_state"])
    if not any(problem["by_state"]):
        return arb(0), arb(0)
    e, speed, acceleration = motion_bounds(problem, box, bounds)
    reference_rate, reference_acceleration, _ = map(arb, problem["reference"])
    l0 = arb(problem["l0"])
    y = e + arb(problem["reference_size"])
    y_dot = speed + reference_rate
    y_ddot = acceleration + reference_acceleration
    s = speed + l0 * e
    s_dot = acceleration + l0 * speed
    growth = k_1 * y + k_2 * y_dot + k_3
    level = k_4 * y + growth * s
    slope = k_5 * y + k_4 * y_dot + (k_1 * y_dot + k_2 * y_ddot) * s + growth * s_dot
    return level.upper(), slope.upper()


def motion_bounds(problem: Problem, box: Box, bounds: list[arb]) -> tuple[arb, arb, arb]:
    """Bounds of |e| [m], |e'| [m/s] and |e''| [m/s^2] at all times, from bounds at the samples.

    Args:
        problem: The problem, with the level and slope of the stage.
        box: Intervals of the plant.
        bounds: Bounds of the command plus d_r, and of each state at the samples.
    """
    command, *states = bounds
    chi = state_places(problem).n - 2
    t = arb(problem["sample_time"])
    k_p = arb(box["k_p"][1])
    generator = generator_over(problem, box)
    disturbance_bounds = inside_bounds(problem, box, t)
    largest = [arb(0)] * chi
    for flow in flows(generator, t, PIECES):
        for i in range(chi):
            input_bound = disturbance_bounds[i] + abs(flow[i, chi]) * k_p * command
            state_bound = input_bound + total([abs(flow[i, j]) * states[j] for j in range(chi)])
            largest[i] = maximum(largest[i], state_bound.upper())
    input_bound = abs(generator[1, chi]) * k_p * command + signal_bounds(problem, box).slope * t * k_p
    acceleration = input_bound + total([abs(generator[1, j]) * largest[j] for j in range(chi)])
    return largest[0], largest[1], acceleration.upper()
