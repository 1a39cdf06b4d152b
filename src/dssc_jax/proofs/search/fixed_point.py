"""Bounds of all signals that imply themselves (P7), searched in floating point as fixed points.

The bounds go in through the gains of their region and through what deviates from the middle loop, and come out through
its responses. :mod:`dssc_jax.proofs.verifier.small_gain` states the inequality and verifies it.
"""

from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from dssc_jax.proofs.problem import Box, ProofProblem
from dssc_jax.proofs.search.gains import start_ratio
from dssc_jax.proofs.search.law_spread import (
    Deviation,
    LawSpread,
    StageRegion,
    law_spreads,
    middle_gains,
    slide_hull,
)
from dssc_jax.proofs.search.obstacles import Obstacle
from dssc_jax.proofs.search.sampled_loop import (
    INNER_STEPS,
    Step,
    box_middle,
    flow,
    held_matrices,
    held_matrix,
    middle,
    signal_sizes,
    start_corners,
    step_of,
)

CHANGE, SIGMA, ERROR, COMMAND, EQUIVALENT, STATES = range(6)
"""Places of the signals in a list of bounds; the states follow."""
SIDE = 32
"""Root of the number of samples that are summed at a time."""
MOST_SAMPLES = 400_000
TAIL_LEFT_OUT = 1e-5
"""Share of a sum at which its tail is left out."""
ROUNDS = 16
"""Times that the region may grow from the start's."""
SHRINKINGS = 6
"""Times that the region may shrink towards the residual's, even by little."""
MOST_SHRINKINGS = 40
"""Times that it may shrink, if every further stage is worth ``FURTHER_WORTH``."""
GROWTH = 1.1
"""Room of a region around the bounds that led to it."""
INFLATION = 1.0 + 2e-4
"""Widening of bounds for what the verifier's balls and tails add."""
ENTERED = 1.0001 * (1.0 + 1e-9)
"""The multiple of a limit that is entered."""
STATE_ROOM = 1.02
"""Widening of bounds from which those of the disturbance follow, for enclosures of a sample's inside."""
SMALLEST_BOUND = 1e-15
"""Smallest bound, so that all are positive."""
SMALLEST_REGION = 1e-12
"""Smallest bound of a region, so that it is positive."""
WORTH = 0.997
"""Improvement of |e| for which another stage is worth its time."""
FURTHER_WORTH = 0.9
"""Improvement of |e| for which another stage is worth its time, after ``SHRINKINGS`` stages."""


@dataclass(frozen=True)
class BoundsStage:
    """Bounds that the middle loop maps into themselves while |sigma| and |e| stay within a region.

    Args:
        sigma: Bound of |sigma| in which the gains are taken [m/s].
        e: Bound of |e| there [m].
        change: Bound of the change of sigma in a sample there [m/s].
        level: Bound of |d| [m/s] under the bounds of the signals.
        slope: Bound of |d'| [m/s^2] under the same bounds.
        rate: lambda [1/s], with which V = z'Pz of the middle loop falls.
        gains: Gains of the middle loop: K_P, K_I, K_N, K_P (1 + tau_av/T_s) and T_s K_I (1 + tau_av/T_s), in this
            order; with the coordinate ``phi_1`` the first is the slope that stands for phi_1.
        bounds: Bounds of sigma - s, sigma, e, the command, u_eq - d, and of all states.
        p: P, row by row.
        coordinate: What z holds, ``u_av`` or ``phi_1`` for q = v - phi_1(s).
        method: The verifier's method.
    """

    sigma: float
    e: float
    change: float
    level: float
    slope: float
    rate: float
    gains: list[float]  # in the order of GAIN_NAMES
    bounds: list[float]  # at CHANGE, SIGMA, ERROR, COMMAND and EQUIVALENT, and of the states from STATES on
    p: list[list[float]]
    coordinate: str
    method: str = "small gain"


class Responses(NamedTuple):
    """Sums of absolute impulse responses (signals, inputs), and peaks of the responses to the starts (signals,)."""

    sums: np.ndarray
    peaks: np.ndarray


class BoundsMap(NamedTuple):
    """The map of bounds to bounds of one region: bounds -> forced (+ peaks, with the start) + matrix @ bounds.

    Args:
        step: One sample of the middle loop.
        spread: The law in the region: the gains of the middle loop, and the deviations from it.
        forced: Bounds of the responses to disturbance, reference and deviations of a constant bound, (signals,).
        peaks: Bounds of the responses to the starts, (signals,).
        matrix: Bounds of the responses to the deviations that grow with the bounds, (signals, signals).
        command: The bound of the true command: a row for the bounds, and a constant, (signals + 1,).
    """

    step: Step
    spread: LawSpread
    forced: np.ndarray
    peaks: np.ndarray
    matrix: np.ndarray
    command: np.ndarray


def responses(a: np.ndarray, rows: np.ndarray, inputs: np.ndarray, starts: np.ndarray) -> Responses | None:
    """The responses of z+ = a z; None if they last too long."""
    n, q, m = a.shape[0], inputs.shape[1], rows.shape[0]
    short = [rows]
    long = [np.eye(n)]
    jump = np.linalg.matrix_power(a, SIDE)
    for _ in range(SIDE - 1):
        short.append(short[-1] @ a)
        long.append(jump @ long[-1])
    block_jump = jump @ long[-1]
    short_rows = np.concatenate(short)
    long_jumps = np.concatenate(long)
    decay_share = 1.0 - np.max(np.abs(np.linalg.eigvals(block_jump)))
    z = np.concatenate([inputs, starts], axis=1)
    sums = np.zeros((m, q))
    peaks = np.zeros((m, starts.shape[1]))
    for _ in range(MOST_SAMPLES // SIDE**2):
        block = short_rows @ (long_jumps @ z).reshape(SIDE, n, -1)
        block = np.abs(block, out=block).reshape(SIDE**2, m, -1)
        block_sums = block.sum(axis=0)[:, :q]  # of all columns, which lie together
        sums = sums + block_sums
        peaks = np.maximum(peaks, block[..., q:].max(axis=0))
        if not np.all(np.isfinite(block_sums)):
            return None
        z = block_jump @ z
        tails = np.abs(rows @ z[:, q:])
        sums_converge = np.all(block_sums <= TAIL_LEFT_OUT * decay_share * sums)
        if sums_converge and np.all(tails <= np.maximum(1e-3 * peaks, 1e-300)):
            return Responses(sums, peaks.max(axis=1, initial=0.0))
    return None


def bounds_map(problem: ProofProblem, box: Box, spread: LawSpread) -> BoundsMap | None:
    """The map of bounds to bounds for a law with such deviations; None if the middle loop is not stable."""
    is_integrated = spread.is_integrated
    point = box_middle(box, spread.gains)
    step = step_of(problem, point, box, is_integrated=is_integrated)
    n = step.a.shape[0]
    t = problem.sample_time
    if np.max(np.abs(np.linalg.eigvals(step.a))) >= 1.0:
        return None
    e, _, sigma, change = step.rows
    slide_p, slide_i = (middle(spread.gains[name]) for name in ("slide_p", "slide_i"))
    equivalent = np.eye(n)[n - 2] + slide_p * change + slide_i * sigma
    if is_integrated:
        equivalent = equivalent + point.gains.k_p * np.eye(n)[n - 1]
    rows = np.concatenate([[change, sigma, e, step.command, equivalent], np.eye(n)])
    share = (box["k_p"][1] - point.k_p) / point.k_p
    by_v = np.eye(n)[n - 2] - step.push
    jump = t * signal_sizes(problem, box).slope * share * step.jump  # zeta's at other values of k_p
    inputs = np.concatenate([step.b, jump[:, None], by_v[:, None], step.push[:, None], np.eye(n)], axis=1)
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
    """A deviation as a row for the signals' bounds, and a constant, (signals + 1,)."""
    row = np.zeros(signals + 1)
    row[CHANGE], row[SIGMA], row[signals] = deviation
    return row


def held_deviations(problem: ProofProblem, box: Box, k_p: float, command: np.ndarray) -> np.ndarray:
    """How the bounds act through the deviations of Phi and Gamma from the middle, (n, signals + 1)."""
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
    return 1.2 * result


def fixed_point(origin: np.ndarray, matrix: np.ndarray) -> np.ndarray | None:
    """The least bounds with origin + matrix bounds <= bounds; None if the gain is not small."""
    if np.max(np.abs(np.linalg.eigvals(matrix))) >= 1.0 - 1e-6:
        return None
    return np.linalg.solve(np.eye(origin.size) - matrix, origin + SMALLEST_BOUND)


def bounds_stage(problem: ProofProblem, region: StageRegion, by: BoundsMap, bounds: np.ndarray) -> BoundsStage:
    """The stage of these bounds."""
    decay, p = decay_of(by.step.a)
    rate = decay / problem.sample_time
    inflated_bounds = (INFLATION * bounds).tolist()
    return BoundsStage(
        sigma=float(region.sigma),
        e=float(region.e),
        change=float(region.change),
        level=problem.level,
        slope=problem.slope,
        rate=rate,
        gains=middle_gains(by.spread),
        bounds=inflated_bounds,
        p=p.tolist(),
        coordinate="phi_1" if by.spread.is_integrated else "u_av",
    )


def decay_of(a: np.ndarray) -> tuple[float, np.ndarray]:
    """A share, and P with which z'Pz falls by it in a sample of z+ = a z; half as fast as the slowest mode."""
    n = a.shape[0]
    radius = np.max(np.abs(np.linalg.eigvals(a)))
    contraction = 0.5 * (1.0 + radius)
    gramian = solve_discrete_lyapunov(a / contraction, np.eye(n))
    scale = np.linalg.cholesky(0.5 * (gramian + gramian.T))
    inverse = np.linalg.inv(scale)
    scaled_p = solve_discrete_lyapunov((inverse @ a @ scale / contraction).T, np.eye(n))
    p = inverse.T @ scaled_p @ inverse
    return float(1.0 - contraction**2), 0.5 * (p + p.T)


def allowed_disturbance(
    problem: ProofProblem, current_problem: ProofProblem, box: Box, by: BoundsMap, bounds: np.ndarray
) -> ProofProblem:
    """The problem with the largest disturbance that bounds of the signals allow, with k_d1 to k_d5 of (30).

    ``current_problem`` has the level and slope of the disturbance that led to the bounds, and ``by`` is the map that
    did.
    """
    k_1, k_2, k_3, k_4, k_5 = problem.by_state
    if not any(problem.by_state):
        return problem
    e, speed, acceleration = motion(current_problem, box, motion_sizes(by, bounds))
    reference_rate, reference_acceleration, _ = problem.reference
    y = e + problem.reference_size
    y_dot = speed + reference_rate
    y_ddot = acceleration + reference_acceleration
    s = speed + problem.l0 * e
    s_dot = acceleration + problem.l0 * speed
    growth = k_1 * y + k_2 * y_dot + k_3
    slope = k_5 * y + k_4 * y_dot + (k_1 * y_dot + k_2 * y_ddot) * s + growth * s_dot
    return replace(problem, level=float(problem.level + k_4 * y + growth * s), slope=float(problem.slope + slope))


def motion_sizes(by: BoundsMap, bounds: np.ndarray) -> np.ndarray:
    """Bounds of the true command and of each state, with room for enclosures."""
    return STATE_ROOM * np.array([by.command[:-1] @ bounds + by.command[-1], *bounds[STATES:]])


def slide_slack(problem: ProofProblem, box: Box, by: BoundsMap, bounds: np.ndarray, region: StageRegion) -> float:
    """Bound of the difference between the equivalent control and that of the middle loop."""
    change, sigma, constant = by.spread.slide
    slack = change * bounds[CHANGE] + sigma * bounds[SIGMA] + constant
    if problem.form == "implicit":
        return slack
    error_change = 0.0
    if by.spread.slide_e:
        error_change = problem.sample_time * motion(problem, box, motion_sizes(by, bounds))[1]
    low, high = slide_hull(problem, region[:2], INFLATION * bounds[CHANGE], error_change)
    centre = middle(by.spread.gains["slide_p"])
    return slack + max(high - centre, centre - low) * bounds[CHANGE] + by.spread.slide_e * error_change


def motion(problem: ProofProblem, box: Box, bounds: np.ndarray) -> tuple[float, float, float]:
    """Bounds of |e|, |e'| and |e''| at all times, from those of the command and the states at the samples."""
    command = bounds[0] * box["k_p"][1]
    states = bounds[1:]
    motion_bounds = np.zeros(2)
    acceleration = 0.0
    for a_p, rate in product(set(box["a_p"]), set(box.get("rate", (0.0, 0.0)))):
        generator = np.abs(held_matrix(problem, a_p, rate))
        chi = generator.shape[0] - 1
        state_bounds = np.zeros(chi)
        for substep in range(INNER_STEPS + 1):
            phi, gamma = flow(problem, a_p, rate, problem.sample_time * substep / INNER_STEPS)
            state_bounds = np.maximum(state_bounds, np.abs(phi) @ states[:chi] + np.abs(gamma) * command)
        disturbance_effect = signal_sizes(problem, box).slope * problem.sample_time * box["k_p"][1]
        motion_bounds = np.maximum(motion_bounds, state_bounds[:2] + 0.5 * problem.sample_time * disturbance_effect)
        corner_acceleration = generator[1, :chi] @ state_bounds + generator[1, chi] * command + disturbance_effect
        acceleration = max(acceleration, corner_acceleration)
    return float(motion_bounds[0]), float(motion_bounds[1]), float(acceleration)


def from_start(problem: ProofProblem, box: Box) -> tuple[BoundsStage, ProofProblem] | Obstacle:
    """Bounds from the start on, with the disturbance that they allow; or why there are none.

    The reasons are ``GAIN``, ``REGION`` and ``SLIDING``.
    """
    region = StageRegion(SMALLEST_REGION, SMALLEST_REGION, SMALLEST_REGION)
    current_problem = problem
    for _ in range(ROUNDS):
        start_bounds = least_bounds(current_problem, box, region, SIGMA, with_start=True)
        if start_bounds is None:
            return Obstacle.GAIN
        result, bounds = start_bounds
        allowed_problem = allowed_disturbance(problem, current_problem, box, result, bounds)
        is_within = allowed_problem.level <= current_problem.level and allowed_problem.slope <= current_problem.slope
        if is_within and holds(problem, region, result, INFLATION * bounds):
            room = np.inf if problem.rho is None else problem.rho - signal_sizes(current_problem, box).offset
            slack = slide_slack(current_problem, box, result, bounds, region)
            if INFLATION * (bounds[EQUIVALENT] + slack) > room:
                return Obstacle.SLIDING
            region = region._replace(change=max(region.change, INFLATION * float(bounds[CHANGE])))
            return bounds_stage(current_problem, region, result, bounds), allowed_problem
        sigma, e, change = (GROWTH * bounds[[SIGMA, ERROR, CHANGE]]).tolist()
        region = StageRegion(max(region.sigma, sigma), max(region.e, e), change)
        if not is_within:
            level = max(current_problem.level, GROWTH * allowed_problem.level)
            slope = max(current_problem.slope, GROWTH * allowed_problem.slope)
            current_problem = replace(current_problem, level=level, slope=slope)
    return Obstacle.REGION


def holds(problem: ProofProblem, region: StageRegion, by: BoundsMap, bounds: np.ndarray) -> bool:
    """Whether a region holds these bounds; that of the change of sigma matters where a deviation depends on it."""
    is_within = bounds[SIGMA] <= region.sigma and bounds[ERROR] <= region.e
    depends_on_change = problem.form == "implicit" and by.spread.is_integrated
    return bool(is_within and not (depends_on_change and bounds[CHANGE] > region.change))


def least_bounds(
    problem: ProofProblem, box: Box, region: StageRegion, signal: int, *, with_start: bool
) -> tuple[BoundsMap, np.ndarray] | None:
    """The bounds that imply themselves with the deviations of a region, as small as can be for one signal."""
    candidates = []
    for spread in law_spreads(problem, region):
        if (result := bounds_map(problem, box, spread)) is None:
            continue
        origin = result.forced + result.peaks if with_start else result.forced
        if (bounds := fixed_point(origin, result.matrix)) is not None:
            candidates.append((result, bounds))
    return min(candidates, key=lambda pair: float(pair[1][signal]), default=None)


def towards_residual(
    problem: ProofProblem, box: Box, limits: StageRegion, error: float, allowed_problem: ProofProblem
) -> list[BoundsStage]:
    """Stages that follow, from upper limits, as long as the bound of |e| becomes smaller.

    ``error`` is the bound of |e| so far, ``allowed_problem`` the problem with the largest disturbance that the bounds
    so far allow.
    """
    stages: list[BoundsStage] = []
    for number in range(MOST_SHRINKINGS):
        worthwhile_ratio = WORTH if number < SHRINKINGS else FURTHER_WORTH
        region = StageRegion(*np.maximum(ENTERED * INFLATION * np.array(limits), SMALLEST_REGION).tolist())
        residual_bounds = least_bounds(allowed_problem, box, region, ERROR, with_start=False)
        if residual_bounds is None:
            break
        result, bounds = residual_bounds
        if not bounds[ERROR] < worthwhile_ratio * error:
            break
        stages.append(bounds_stage(allowed_problem, region, result, bounds))
        allowed_problem = allowed_disturbance(problem, allowed_problem, box, result, bounds)
        limits = StageRegion(*bounds[[SIGMA, ERROR, CHANGE]].tolist())
        error = limits.e
    return stages
