"""The map from bounds of all signals in a region to the bounds that follow from them, in floating point.

The bounds go in through what deviates from the middle loop, and come out through its responses.
"""

from typing import NamedTuple

import numpy as np

from dssc_jax.proofs.problem import Box, ProofProblem
from dssc_jax.proofs.search.gains import start_ratio
from dssc_jax.proofs.search.impulse_responses import responses, spectral_radius
from dssc_jax.proofs.search.law_spread import Deviation, LawSpread
from dssc_jax.proofs.search.sampled_loop import (
    Step,
    box_middle,
    held_matrices,
    middle,
    signal_sizes,
    start_corners,
    step_of,
)

CHANGE, SIGMA, ERROR, COMMAND, EQUIVALENT, STATES = range(6)
"""Places of the signals in a list of bounds; the states follow."""
CORNER_ROOM = 1.2
"""Widening of what Phi and Gamma at the corners of a box deviate by, for what lies between."""


class BoundsMap(NamedTuple):
    """The affine map from bounds of the signals in one region to the bounds that follow from them.

    It is bounds -> forced (+ peaks, with the start) + matrix @ bounds.

    Args:
        step: One sample of the middle loop.
        spread: The law in the region: the gains of the middle loop, and the deviations from it.
        forced: Bounds of the responses to disturbance, reference and deviations of a constant bound, (signals,).
        peaks: Bounds of the responses to the starts, (signals,).
        matrix: Bounds of the responses to deviations that are proportional to the bounds, (signals, signals).
        command: Row over the bounds, and a constant, that bound the true command, (signals + 1,).
    """

    step: Step
    spread: LawSpread
    forced: np.ndarray
    peaks: np.ndarray
    matrix: np.ndarray
    command: np.ndarray


def bounds_map(problem: ProofProblem, box: Box, spread: LawSpread) -> BoundsMap | None:
    """The map of bounds to bounds for a law in a region; None if the middle loop is not stable.

    Args:
        problem: The problem, with bounds of the disturbance.
        box: Intervals of k_p, a_p and 1/mu.
        spread: The gains of the middle loop, and how far the law deviates from it.
    """
    is_integrated = spread.is_integrated
    point = box_middle(box, spread.gains)
    step = step_of(problem, point, box, is_integrated=is_integrated)
    n = step.a.shape[0]
    t = problem.sample_time
    if spectral_radius(step.a) >= 1.0:
        return None
    e, _, sigma, change = step.rows
    slide_p, slide_i = (middle(spread.gains[name]) for name in ("slide_p", "slide_i"))
    equivalent = np.eye(n)[n - 2] + slide_p * change + slide_i * sigma
    if is_integrated:
        equivalent = equivalent + point.gains.k_p * np.eye(n)[n - 1]
    rows = np.concatenate([[change, sigma, e, step.command, equivalent], np.eye(n)])
    share = (box["k_p"][1] - point.k_p) / point.k_p
    v_column = np.eye(n)[n - 2] - step.push
    jump = t * signal_sizes(problem, box).slope * share * step.jump  # zeta's at other values of k_p
    inputs = np.concatenate([step.b, jump[:, None], v_column[:, None], step.push[:, None], np.eye(n)], axis=1)
    starts = start_corners(problem, box, start_ratio(problem, is_integrated=is_integrated))
    result = responses(step.a, rows, inputs, np.stack(starts, axis=1))
    if result is None:
        return None
    m = rows.shape[0]
    w = step.b.shape[1] + 1
    integral_deviation = deviation_row(spread.integral, m)
    command_deviation = deviation_row(spread.command, m)
    command = np.eye(m + 1)[COMMAND] + integral_deviation + command_deviation
    sizes = np.zeros((2 + n, m + 1))
    sizes[0] = integral_deviation
    sizes[1] = command_deviation + share * command
    sizes[2:] = held_deviations(problem, box, point.k_p, command)
    effects = result.sums[:, w:] @ sizes
    forced = result.sums[:, :w].sum(axis=1) + effects[:, m]
    return BoundsMap(
        step=step, spread=spread, forced=forced, peaks=result.peaks, matrix=effects[:, :m], command=command
    )


def deviation_row(deviation: Deviation, signals: int) -> np.ndarray:
    """The bound of a deviation as a row over the bounds of the signals, and a constant, (signals + 1,)."""
    row = np.zeros(signals + 1)
    row[CHANGE], row[SIGMA], row[signals] = deviation
    return row


def held_deviations(problem: ProofProblem, box: Box, k_p: float, command: np.ndarray) -> np.ndarray:
    """What the deviations of Phi and Gamma from the box's middle add to each state, (n, signals + 1).

    Args:
        problem: The problem.
        box: Intervals of k_p, a_p and 1/mu.
        k_p: k_p of the middle loop [1/s].
        command: Row over the bounds, and a constant, that bound the true command, (signals + 1,).

    Returns:
        Rows over the bounds of the signals, and constants.
    """
    n = command.size - 1 - STATES
    result = np.zeros((n, command.size))
    phi, gamma = held_matrices(problem, middle(box["a_p"]), middle(box.get("rate", (0.0, 0.0))))
    chi = phi.shape[0]
    for a_p in set(box["a_p"]):
        for rate in set(box.get("rate", (0.0, 0.0))):
            corner_phi, corner_gamma = held_matrices(problem, a_p, rate)
            deviation = np.zeros((n, command.size))
            deviation[:chi, STATES : STATES + chi] = np.abs(corner_phi - phi)
            deviation[:chi] += box["k_p"][1] * np.abs(corner_gamma - gamma)[:, None] * command
            result = np.maximum(result, deviation)
    return CORNER_ROOM * result
