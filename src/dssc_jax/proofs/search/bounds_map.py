"""The map y -> h + M y from bounds y of all signals to the bounds that follow from y, in floating point.

The loop is a linear middle loop plus deviations (method 2 of docs/proofs.md). Bounds of the signals bound the
deviations, and the middle loop's responses to the deviations give new bounds of the signals.
"""

from itertools import product
from typing import NamedTuple

import numpy as np

from dssc_jax.proofs.problem import Box, ProofProblem, middle
from dssc_jax.proofs.search.gains import start_ratio
from dssc_jax.proofs.search.held_plant import held_matrices
from dssc_jax.proofs.search.impulse_responses import responses, spectral_radius
from dssc_jax.proofs.search.law_spread import Deviation, LawSpread
from dssc_jax.proofs.search.sampled_loop import (
    LoopPoint,
    Step,
    box_middle,
    signal_sizes,
    start_corners,
    step_of,
)

CHANGE, SIGMA, ERROR, COMMAND, EQUIVALENT, STATES = range(6)
"""Places in a list of bounds of sigma - s, sigma, e, command + d_r, u_eq - d_r - f, and of the first state of z."""
CORNER_ROOM = 1.2
"""Factor that widens the deviations of Phi and Gamma at the corners of a box, for plants between the corners."""


class BoundsMap(NamedTuple):
    """The affine map y -> h + M y from bounds y of the signals in one region to the bounds that follow from y.

    For bounds that hold from the start on, h is ``forced + peaks``; for bounds of upper limits, h is ``forced``.

    Args:
        step: One sample of the middle loop.
        spread: The law in the region: the gains of the middle loop, and the law's deviations from the middle loop.
        forced: Bounds of the responses to disturbance, reference and the constant parts of the deviations,
            shape (signals,).
        peaks: Bounds of the responses to the starts, shape (signals,).
        matrix: M, bounds of the responses to the parts of the deviations that grow with the bounds,
            shape (signals, signals).
        command: Row of the bound of |command + d_r|: a coefficient for each signal's bound, and a constant at the end;
            shape (signals + 1,).
    """

    step: Step
    spread: LawSpread
    forced: np.ndarray
    peaks: np.ndarray
    matrix: np.ndarray
    command: np.ndarray


def bounds_map(problem: ProofProblem, box: Box, spread: LawSpread) -> BoundsMap | None:
    """Make the map of bounds to bounds for a law in a region.

    The deviations enter z+ = A z + B w + b_v omega_v + b_u omega_u + omega. Each of them is bounded by a row: a
    coefficient for each signal's bound, and a constant at the end.

    Args:
        problem: The problem, with bounds of the disturbance.
        box: Intervals of k_p, a_p and 1/mu.
        spread: The gains of the middle loop, and the law's deviations from the middle loop.

    Returns:
        The map; None if the middle loop is not stable, or its responses decay too slowly.
    """
    is_integrated = spread.is_integrated
    point = box_middle(box, spread.gains)
    step = step_of(problem, point, box, is_integrated=is_integrated)
    if spectral_radius(step.a) >= 1.0:
        return None
    unit = np.eye(step.a.shape[0])
    _, largest_k_p = box["k_p"]
    share = (largest_k_p - point.k_p) / point.k_p  # dk_p/k_p
    v_column = unit[-2] - step.push  # b_v: a change of v (or q) changes the state itself and, through -v, the command
    jump = problem.sample_time * signal_sizes(problem, box).slope * share * step.jump  # zeta's at other values of k_p
    inputs = np.concatenate([step.b, jump[:, None], v_column[:, None], step.push[:, None], unit], axis=1)
    inputs_of_constant_size = step.b.shape[1] + 1  # the columns of w and of the jump; the omegas follow
    starts = start_corners(problem, box, start_ratio(problem, is_integrated=is_integrated))
    rows = bounded_signals(step, spread, point)
    middle_responses = responses(step.a, rows, inputs, np.stack(starts, axis=1))
    if middle_responses is None:
        return None
    signals = rows.shape[0]
    integral_deviation = deviation_row(spread.integral, signals)  # |omega_v|
    command_deviation = deviation_row(spread.command, signals)
    command = np.eye(signals + 1)[COMMAND] + integral_deviation + command_deviation
    deviations = np.concatenate(
        [
            integral_deviation[None],
            (command_deviation + share * command)[None],  # |omega_u|
            held_deviations(problem, box, command),  # |omega_i| of each state
        ]
    )
    effects = middle_responses.sums[:, inputs_of_constant_size:] @ deviations
    return BoundsMap(
        step=step,
        spread=spread,
        forced=middle_responses.sums[:, :inputs_of_constant_size].sum(axis=1) + effects[:, signals],
        peaks=middle_responses.peaks,
        matrix=effects[:, :signals],
        command=command,
    )


def bounded_signals(step: Step, spread: LawSpread, point: LoopPoint) -> np.ndarray:
    """Make the rows that give the bounded signals from the state z of the middle loop, shape (signals, n).

    Args:
        step: One sample of the middle loop.
        spread: The law in the region, of which the gains of the equivalent control are used.
        point: Plant and gains of the middle loop.

    Returns:
        The rows of sigma - s, sigma, e, command + d_r, u_eq - d_r - f and of the n states.
    """
    rows = step.rows
    unit = np.eye(step.a.shape[0])
    # u_eq = v + (1 + tau_av/T_s) (v+ - v), where the slide gains hold the factor 1 + tau_av/T_s
    slide_p = middle(spread.gains["slide_p"])
    slide_i = middle(spread.gains["slide_i"])
    equivalent = unit[-2] + slide_p * rows.change + slide_i * rows.sigma
    if spread.is_integrated:
        equivalent = equivalent + point.gains.k_p * unit[-1]  # v = q + (phi_1/sigma) s
    return np.concatenate([[rows.change, rows.sigma, rows.e, step.command, equivalent], unit])


def deviation_row(deviation: Deviation, signals: int) -> np.ndarray:
    """Write the bound of a deviation as a row: a coefficient for each signal's bound, and a constant at the end.

    Args:
        deviation: The bound.
        signals: Number of signals; the row has the shape (signals + 1,).
    """
    row = np.zeros(signals + 1)
    row[CHANGE], row[SIGMA], row[signals] = deviation
    return row


def held_deviations(problem: ProofProblem, box: Box, command: np.ndarray) -> np.ndarray:
    """Bound the deviation of each state after a sample from that of the middle loop, over all a_p and 1/mu in the box.

    |omega_i| <= k_p dGamma_i |command| + sum of dPhi_ij |z_j|, where dPhi and dGamma are the distances of Phi and Gamma
    from those in the middle of the box. They are evaluated at the corners of the box; ``CORNER_ROOM`` covers the plants
    between the corners.

    Args:
        problem: The loop and its uncertain numbers.
        box: Intervals of k_p, a_p and 1/mu.
        command: Coefficients of the bound of |command + d_r|, shape (signals + 1,).

    Returns:
        A row for each state, with coefficients of the signals' bounds and a constant at the end; shape (n, signals +
        1). The rows of v and s are 0.
    """
    n = command.size - 1 - STATES
    largest = np.zeros((n, command.size))
    phi, gamma = held_matrices(problem, middle(box["a_p"]), middle(box.get("rate", (0.0, 0.0))))
    chi = phi.shape[0]
    _, largest_k_p = box["k_p"]
    for a_p, rate in product(set(box["a_p"]), set(box.get("rate", (0.0, 0.0)))):  # equal ends count once
        corner_phi, corner_gamma = held_matrices(problem, a_p, rate)
        deviation = np.zeros((n, command.size))
        deviation[:chi, STATES : STATES + chi] = np.abs(corner_phi - phi)
        deviation[:chi] += largest_k_p * np.abs(corner_gamma - gamma)[:, None] * command
        largest = np.maximum(largest, deviation)
    return CORNER_ROOM * largest
