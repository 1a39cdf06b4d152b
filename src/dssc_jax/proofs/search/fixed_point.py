"""Bounds of all signals that imply themselves (P7), searched in floating point as fixed points.

The bounds go in through the gains of their region and through what deviates from the middle loop, and come out through
its responses. :mod:`dssc_jax.proofs.verifier.small_gain` states the inequality and verifies it.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from dssc_jax.proofs.problem import Box, ProofProblem
from dssc_jax.proofs.search.bounds_map import (
    CHANGE,
    EQUIVALENT,
    ERROR,
    SIGMA,
    STATES,
    BoundsMap,
    bounds_map,
)
from dssc_jax.proofs.search.impulse_responses import decay_of, spectral_radius
from dssc_jax.proofs.search.law_spread import (
    StageRegion,
    law_spreads,
    middle_gains,
    slide_hull,
)
from dssc_jax.proofs.search.obstacles import Obstacle
from dssc_jax.proofs.search.sampled_loop import (
    INNER_STEPS,
    flow,
    held_matrix,
    middle,
    signal_sizes,
)

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
    """A stage of a proof: bounds that the middle loop maps into themselves while sigma and e stay within a region.

    Args:
        sigma: Bound of |sigma| in which the gains are taken [m/s].
        e: Bound of |e| there [m].
        change: Bound of the change of sigma in a sample there [m/s].
        level: Bound of |d| [m/s], with what the state adds under the bounds of the signals.
        slope: Bound of |d'| [m/s^2], with the same.
        rate: lambda [1/s], with which V = z'Pz of the middle loop falls.
        gains: Gains of the middle loop: K_P, K_I, K_N, K_P (1 + tau_av/T_s) and T_s K_I (1 + tau_av/T_s), in this
            order; with the coordinate ``phi_1`` the first is the slope that stands for phi_1.
        bounds: Bounds of sigma - s, sigma, e, the command, u_eq - d, and of all states.
        p: P, row by row.
        coordinate: What z holds_bounds, ``u_av`` or ``phi_1`` for q = v - phi_1(s).
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


def fixed_point(origin: np.ndarray, matrix: np.ndarray) -> np.ndarray | None:
    """The smallest bounds with origin + matrix bounds <= bounds, (signals,); None if the gain is not small."""
    if spectral_radius(matrix) >= 1.0 - 1e-6:
        return None
    return np.linalg.solve(np.eye(origin.size) - matrix, origin + SMALLEST_BOUND)


def bounds_stage(problem: ProofProblem, region: StageRegion, mapping: BoundsMap, bounds: np.ndarray) -> BoundsStage:
    """The stage of a proof with these bounds of the signals; ``mapping`` is the map that led to them."""
    decay, p = decay_of(mapping.step.a)
    rate = decay / problem.sample_time
    inflated_bounds = (INFLATION * bounds).tolist()
    return BoundsStage(
        sigma=float(region.sigma),
        e=float(region.e),
        change=float(region.change),
        level=problem.level,
        slope=problem.slope,
        rate=rate,
        gains=middle_gains(mapping.spread),
        bounds=inflated_bounds,
        p=p.tolist(),
        coordinate="phi_1" if mapping.spread.is_integrated else "u_av",
    )


def allowed_disturbance(
    problem: ProofProblem, current_problem: ProofProblem, box: Box, mapping: BoundsMap, bounds: np.ndarray
) -> ProofProblem:
    """The problem with the largest disturbance that bounds of the signals allow, with k_d1 to k_d5 of (30).

    Args:
        problem: The problem, with bounds of the disturbance without the state.
        current_problem: The problem with the level and slope that led to the bounds.
        box: Intervals of k_p, a_p and 1/mu.
        mapping: The map that led to the bounds.
        bounds: Bounds of the signals.
    """
    k_1, k_2, k_3, k_4, k_5 = problem.by_state
    if not any(problem.by_state):
        return problem
    e, speed, acceleration = motion_between_samples(current_problem, box, motion_sizes(mapping, bounds))
    reference_rate, reference_acceleration, _ = problem.reference
    y = e + problem.reference_size
    y_dot = speed + reference_rate
    y_ddot = acceleration + reference_acceleration
    s = speed + problem.l0 * e
    s_dot = acceleration + problem.l0 * speed
    growth = k_1 * y + k_2 * y_dot + k_3
    slope = k_5 * y + k_4 * y_dot + (k_1 * y_dot + k_2 * y_ddot) * s + growth * s_dot
    return replace(problem, level=float(problem.level + k_4 * y + growth * s), slope=float(problem.slope + slope))


def motion_sizes(mapping: BoundsMap, bounds: np.ndarray) -> np.ndarray:
    """Bounds of the true command and of each state, (1 + n,), widened for enclosures of a sample's inside."""
    return STATE_ROOM * np.array([mapping.command[:-1] @ bounds + mapping.command[-1], *bounds[STATES:]])


def slide_slack(problem: ProofProblem, box: Box, mapping: BoundsMap, bounds: np.ndarray, region: StageRegion) -> float:
    """Bound of the difference between the equivalent control and that of the middle loop [m/s].

    Args:
        problem: The problem, with bounds of the disturbance.
        box: Intervals of k_p, a_p and 1/mu.
        mapping: The map that led to the bounds.
        bounds: Bounds of the signals.
        region: Region of sigma and e.
    """
    change, sigma, constant = mapping.spread.slide
    slack = change * bounds[CHANGE] + sigma * bounds[SIGMA] + constant
    if problem.form == "implicit":
        return slack
    error_change = 0.0
    if mapping.spread.slide_e:
        error_change = problem.sample_time * motion_between_samples(problem, box, motion_sizes(mapping, bounds))[1]
    low, high = slide_hull(problem, region[:2], INFLATION * bounds[CHANGE], error_change)
    centre = middle(mapping.spread.gains["slide_p"])
    return slack + max(high - centre, centre - low) * bounds[CHANGE] + mapping.spread.slide_e * error_change


def motion_between_samples(problem: ProofProblem, box: Box, bounds: np.ndarray) -> tuple[float, float, float]:
    """Bounds of |e| [m], |e'| [m/s] and |e''| [m/s^2] at all times.

    Args:
        problem: The problem, with bounds of the disturbance.
        box: Intervals of k_p, a_p and 1/mu.
        bounds: Bounds of the true command and of each state at the samples, (1 + n,).
    """
    command = bounds[0] * box["k_p"][1]
    states = bounds[1:]
    largest_motion = np.zeros(2)
    acceleration = 0.0
    for a_p, rate in product(set(box["a_p"]), set(box.get("rate", (0.0, 0.0)))):
        generator = np.abs(held_matrix(problem, a_p, rate))
        chi = generator.shape[0] - 1
        state_bounds = np.zeros(chi)
        for substep in range(INNER_STEPS + 1):
            phi, gamma = flow(problem, a_p, rate, problem.sample_time * substep / INNER_STEPS)
            state_bounds = np.maximum(state_bounds, np.abs(phi) @ states[:chi] + np.abs(gamma) * command)
        disturbance_effect = signal_sizes(problem, box).slope * problem.sample_time * box["k_p"][1]
        largest_motion = np.maximum(largest_motion, state_bounds[:2] + 0.5 * problem.sample_time * disturbance_effect)
        corner_acceleration = generator[1, :chi] @ state_bounds + generator[1, chi] * command + disturbance_effect
        acceleration = max(acceleration, corner_acceleration)
    return float(largest_motion[0]), float(largest_motion[1]), float(acceleration)


def from_start(problem: ProofProblem, box: Box) -> tuple[BoundsStage, ProofProblem] | Obstacle:
    """Search bounds that hold from the start on, in regions that grow with the bounds.

    Returns:
        A stage with the bounds, and the problem with the largest disturbance that they allow; or why there are none:
        ``GAIN``, ``REGION`` or ``SLIDING``.
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
        if is_within and holds_bounds(problem, region, result, INFLATION * bounds):
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


def holds_bounds(problem: ProofProblem, region: StageRegion, mapping: BoundsMap, bounds: np.ndarray) -> bool:
    """Whether bounds of the signals lie within a region; the change of sigma counts if a deviation depends on it."""
    is_within = bounds[SIGMA] <= region.sigma and bounds[ERROR] <= region.e
    depends_on_change = problem.form == "implicit" and mapping.spread.is_integrated
    return bool(is_within and not (depends_on_change and bounds[CHANGE] > region.change))


def least_bounds(
    problem: ProofProblem, box: Box, region: StageRegion, signal: int, *, with_start: bool
) -> tuple[BoundsMap, np.ndarray] | None:
    """The bounds that imply themselves with the law of a region, in the way of bounding it that is best for a signal.

    Args:
        problem: The problem, with bounds of the disturbance.
        box: Intervals of k_p, a_p and 1/mu.
        region: Region of sigma and e.
        signal: Place of the signal whose bound is to be small.
        with_start: Whether the bounds hold from the start on; otherwise they are those of the upper limits.

    Returns:
        The map and the bounds; None if there are none.
    """
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
    """Search further stages of a proof, with bounds of upper limits, as long as that of |e| becomes smaller.

    Args:
        problem: The problem.
        box: Intervals of k_p, a_p and 1/mu.
        limits: Bounds so far of sigma, e and the change of sigma.
        error: Bound of |e| so far [m].
        allowed_problem: The problem with the largest disturbance that the bounds so far allow.
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
