"""(P8) Bounds of the share of |d| and |d'| by which a disturbance as in (30) depends on the state.

With y = e + y_m, and s = e' + l_0 e taken at any time, not only at the samples,

    |d|  <= alpha + k_d4 |y| + (k_d1 |y| + k_d2 |y'| + k_d3) |s|
    |d'| <= alpha' + k_d5 |y| + k_d4 |y'| + (k_d1 |y'| + k_d2 |y''|) |s| + (k_d1 |y| + k_d2 |y'| + k_d3) |s'|

where alpha and alpha' bound the disturbance without the state. Bounds of |e|, |e'| and |e''| within a sample follow
from bounds of the states and the command at the sample's beginning.
"""

from typing import NamedTuple

from flint import arb

from dssc_jax.proofs.verifier.balls import maximum, total
from dssc_jax.proofs.verifier.certificate import Box, Problem
from dssc_jax.proofs.verifier.enclosed_loop import disturbance_effects, signal_bounds
from dssc_jax.proofs.verifier.held_plant import flows, generator_over, state_places

PIECES = 64
"""Number of equal pieces of a sample, over each of which the plant is enclosed."""


class StateShare(NamedTuple):
    """Bounds of the state's share of a disturbance, which depends on the state as in (30).

    Args:
        level: Bound of the state's share of |d| [m/s].
        slope: Bound of the state's share of |d'| [m/s^2].
    """

    level: arb
    slope: arb


class Motion(NamedTuple):
    """Bounds of |e| [m], of the speed |e'| [m/s] and of the acceleration |e''| [m/s^2] at all times."""

    e: arb
    speed: arb
    acceleration: arb


def disturbance_by_state(problem: Problem, box: Box, bounds: list[arb]) -> StateShare:
    """Bounds of the state's share of the disturbance, by the inequalities at the module's top; 0 without k_d1 to k_d5.

    Args:
        problem: The problem, in which the stage's own level and slope bound |d| and |d'|.
        box: Intervals of the plant.
        bounds: Bounds at the samples: first that of |command + d_r|, then that of each state.
    """
    k_1, k_2, k_3, k_4, k_5 = map(arb, problem["by_state"])  # k_d1 to k_d5
    if not any(problem["by_state"]):
        return StateShare(arb(0), arb(0))
    e, speed, acceleration = motion_bounds(problem, box, bounds)
    reference_rate, reference_acceleration, _ = map(arb, problem["reference"])
    l0 = arb(problem["l0"])
    y = e + arb(problem["reference_size"])  # |y| <= |e| + |y_m|, and likewise its derivatives
    y_dot = speed + reference_rate
    y_ddot = acceleration + reference_acceleration
    s = speed + l0 * e
    s_dot = acceleration + l0 * speed
    growth = k_1 * y + k_2 * y_dot + k_3  # the factor of |s| in |d|
    level = k_4 * y + growth * s
    slope = k_5 * y + k_4 * y_dot + (k_1 * y_dot + k_2 * y_ddot) * s + growth * s_dot
    return StateShare(level.upper(), slope.upper())


def motion_bounds(problem: Problem, box: Box, bounds: list[arb]) -> Motion:
    """Bounds of the error and its derivatives at all times, from bounds at the samples.

    Between samples chi(t) = exp(F t) chi + gamma(t) U + theta(t), where U = k_p (command + d_r), and theta is the
    effect of d_r's change since the sample.

    Args:
        problem: The problem, in which the stage's own level and slope bound |d| and |d'|.
        box: Intervals of the plant.
        bounds: Bounds at the samples: first that of |command + d_r|, then that of each state.
    """
    command, *states = bounds
    chi = state_places(problem).n - 2
    t = arb(problem["sample_time"])
    k_p = arb(box["k_p"][1])
    generator = generator_over(problem, box)
    disturbance_bounds = disturbance_effects(problem, box, t)  # of theta
    largest = [arb(0)] * chi  # of each component of chi
    for flow in flows(generator, t, PIECES):
        for i in range(chi):
            input_bound = disturbance_bounds[i] + abs(flow[i, chi]) * k_p * command
            state_bound = input_bound + total([abs(flow[i, j]) * states[j] for j in range(chi)])
            largest[i] = maximum(largest[i], state_bound.upper())
    # row 1 of [[F, G], [0, 0]] gives e''; d_r changes by its slope times T_s within a sample
    input_bound = abs(generator[1, chi]) * k_p * command + signal_bounds(problem, box).slope * t * k_p
    acceleration = input_bound + total([abs(generator[1, j]) * largest[j] for j in range(chi)])
    e, speed, *_ = largest
    return Motion(e, speed, acceleration.upper())
