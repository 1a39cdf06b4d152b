"""Bounds y of all signals that imply themselves, h + M y <= y (premise P7), searched in floating point.

While the signals stay within y, the deviations from a linear middle loop are bounded. The responses of this loop then
keep the signals within h + M y. :mod:`dssc_jax.proofs.verifier.small_gain` verifies that h + M y is less than y.
"""

from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from dssc_jax.proofs.problem import Box, ProofProblem, middle
from dssc_jax.proofs.search.bounds_map import (
    CHANGE,
    EQUIVALENT,
    ERROR,
    SIGMA,
    STATES,
    BoundsMap,
    bounds_map,
)
from dssc_jax.proofs.search.held_plant import flow, held_matrix
from dssc_jax.proofs.search.impulse_responses import decay_of, spectral_radius
from dssc_jax.proofs.search.law_spread import (
    StageRegion,
    law_spreads,
    middle_gains,
    slide_hull,
)
from dssc_jax.proofs.search.obstacles import Obstacle
from dssc_jax.proofs.search.sampled_loop import INNER_STEPS, signal_sizes

ROUNDS = 16
"""Largest number of regions that are tried for bounds from the start on; each is larger than the one before."""
SHRINKINGS = 6
"""Number of smaller regions of which each need only improve the bound of |e| to ``WORTH`` times the last one."""
MOST_SHRINKINGS = 40
"""Largest number of smaller regions; those after ``SHRINKINGS`` must improve the bound of |e| to ``FURTHER_WORTH``."""
GROWTH = 1.1
"""Ratio of the next region to the bounds that did not fit into the last one."""
INFLATION = 1.0 + 2e-4
"""Factor that widens bounds, because the verifier's balls and tails add to them."""
ENTERED = 1.0001 * (1.0 + 1e-9)
"""Factor of an upper limit (limit superior) below which the signal is from some time on, as P4 takes it."""
STATE_ROOM = 1.02
"""Factor that widens bounds of the states, because the verifier's enclosure of the time between samples is wider."""
SMALLEST_BOUND = 1e-15
"""Addition to the bounds of the signals, so that none of them is 0."""
SMALLEST_REGION = 1e-12
"""Smallest bound of |sigma| [m/s] and of |e| [m] in a region, so that none of them is 0."""
WORTH = 0.997
"""Ratio of the next bound of |e| to the last one, below which another stage is worth its time."""
FURTHER_WORTH = 0.9
"""The same ratio after ``SHRINKINGS`` stages."""


@dataclass(frozen=True)
class BoundsStage:
    """A stage of a proof: bounds that the middle loop maps into themselves while sigma and e stay within a region.

    Args:
        sigma: Bound of |sigma| in the region over which the gains are taken [m/s].
        e: Bound of |e| in this region [m].
        change: Bound of the change of sigma in a sample in this region [m/s].
        level: Bound of |d| [m/s], including the state's share of the disturbance while the signals are in ``bounds``.
        slope: Bound of |d'| [m/s^2], including the state's share.
        rate: lambda [1/s], with which V = z'Pz of the middle loop falls.
        gains: Gains of the middle loop: K_P, K_I, K_N, K_P (1 + tau_av/T_s) and T_s K_I (1 + tau_av/T_s), in this
            order; with the coordinate ``phi_1`` the first one is the slope of the straight line in place of phi_1.
        bounds: Bounds of sigma - s, sigma, e, command + d_r, u_eq - d_r - f, and of each state in z.
        p: P, row by row.
        coordinate: Which integrator state z contains: ``u_av`` for v, ``phi_1`` for q = v - phi_1(s).
        method: Name of the method of docs/proofs.md by which the verifier checks the stage.
    """

    sigma: float
    e: float
    change: float
    level: float
    slope: float
    rate: float
    gains: list[float]
    bounds: list[float]
    p: list[list[float]]
    coordinate: str
    method: str = "small gain"


class FittedBounds(NamedTuple):
    """Bounds of the signals that imply themselves under the control law of a region.

    Args:
        mapping: The map y -> h + M y.
        bounds: y, the fixed point of this map, shape (signals,).
    """

    mapping: BoundsMap
    bounds: np.ndarray


def fixed_point(origin: np.ndarray, matrix: np.ndarray) -> np.ndarray | None:
    """The smallest bounds y with h + M y <= y, enlarged a little so that all are positive, shape (signals,).

    Args:
        origin: h, bounds of the responses to the inputs and, from the start on, to the start, shape (signals,).
        matrix: M, the factors by which bounds of the signals increase the implied bounds, shape (signals, signals).

    Returns:
        The bounds; None if M's spectral radius is not below 1, so that no bounds imply themselves.
    """
    if spectral_radius(matrix) >= 1.0 - 1e-6:
        return None
    return np.linalg.solve(np.eye(origin.size) - matrix, origin + SMALLEST_BOUND)


def bounds_stage(problem: ProofProblem, region: StageRegion, fitted: FittedBounds) -> BoundsStage:
    """Make a certificate's stage from bounds of the signals, with a V = z'Pz that bounds the tails of the responses.

    Args:
        problem: The problem, with bounds of the disturbance including the state's share.
        region: Region in which the gains were taken.
        fitted: The bounds.
    """
    lost_share, p = decay_of(fitted.mapping.step.a)  # of V = z'Pz in a sample
    return BoundsStage(
        sigma=float(region.sigma),
        e=float(region.e),
        change=float(region.change),
        level=problem.level,
        slope=problem.slope,
        rate=lost_share / problem.sample_time,
        gains=middle_gains(fitted.mapping.spread),
        bounds=(INFLATION * fitted.bounds).tolist(),
        p=p.tolist(),
        coordinate="phi_1" if fitted.mapping.spread.is_integrated else "u_av",
    )


def allowed_disturbance(
    problem: ProofProblem, current_problem: ProofProblem, box: Box, fitted: FittedBounds
) -> ProofProblem:
    """Replace the bounds of |d| and |d'| in a problem by bounds that include the state's share.

    A disturbance as in (30) grows with the state, so bounds of the signals bound the state's share. docs/proofs.md has
    the inequalities. Without k_d1 to k_d5 the problem is returned as it is.

    Args:
        problem: The problem, with bounds alpha and alpha' of the disturbance without the state.
        current_problem: The problem with the level and slope that led to ``fitted``.
        box: Intervals of k_p, a_p and 1/mu.
        fitted: Bounds of the signals.
    """
    k_1, k_2, k_3, k_4, k_5 = problem.by_state  # k_d1 to k_d5
    if not any(problem.by_state):
        return problem
    e, speed, acceleration = motion_between_samples(current_problem, box, motion_sizes(fitted))
    reference_rate, reference_acceleration, _ = problem.reference
    y = e + problem.reference_size  # |y| <= |e| + |y_m|, and likewise its derivatives
    y_dot = speed + reference_rate
    y_ddot = acceleration + reference_acceleration
    s = speed + problem.l0 * e  # s = e' + l_0 e
    s_dot = acceleration + problem.l0 * speed
    growth = k_1 * y + k_2 * y_dot + k_3  # g, the factor of |s| in |d|
    slope = k_5 * y + k_4 * y_dot + (k_1 * y_dot + k_2 * y_ddot) * s + growth * s_dot
    return replace(problem, level=float(problem.level + k_4 * y + growth * s), slope=float(problem.slope + slope))


def motion_sizes(fitted: FittedBounds) -> np.ndarray:
    """Bounds at the samples of |command + d_r| [m/s] and of each state, shape (1 + n,).

    The bounds are widened by ``STATE_ROOM``, because the verifier's bounds between the samples are a little wider.

    Args:
        fitted: Bounds of the signals, with the row that gives the command's bound.
    """
    command = fitted.mapping.command
    command_bound = command[:-1] @ fitted.bounds + command[-1]
    return STATE_ROOM * np.array([command_bound, *fitted.bounds[STATES:]])


def slide_slack(problem: ProofProblem, box: Box, fitted: FittedBounds, region: StageRegion) -> float:
    """Bound of the deviation of the equivalent control u_eq from the middle loop's [m/s], for which rho needs room.

    Args:
        problem: The problem, with bounds of the disturbance.
        box: Intervals of k_p, a_p and 1/mu.
        fitted: Bounds of the signals.
        region: Region in which the gains are taken.
    """
    spread = fitted.mapping.spread
    change_bound = fitted.bounds[CHANGE]
    slack = spread.slide.change * change_bound + spread.slide.sigma * fitted.bounds[SIGMA] + spread.slide.constant
    if problem.form == "implicit":
        return slack
    # in the conservative form the gain of sigma - s is a mean over the sample, and e may add to u_eq
    error_change = 0.0
    if spread.slide_e:
        error_change = problem.sample_time * motion_between_samples(problem, box, motion_sizes(fitted)).speed
    low, high = slide_hull(problem, region._replace(change=INFLATION * change_bound), error_change)
    centre = middle(spread.gains["slide_p"])
    return slack + max(high - centre, centre - low) * change_bound + spread.slide_e * error_change


class Motion(NamedTuple):
    """Bounds at all times of |e| [m], of the speed |e'| [m/s] and of the acceleration |e''| [m/s^2]."""

    e: float
    speed: float
    acceleration: float


def motion_between_samples(problem: ProofProblem, box: Box, bounds: np.ndarray) -> Motion:
    """Bounds of the error and its derivatives at all times, from bounds at the samples.

    The held plant chi' = F chi + G U is followed through a sample at the ends of a_p and 1/mu.

    Args:
        problem: The problem, with bounds of the disturbance.
        box: Intervals of k_p, a_p and 1/mu.
        bounds: Bounds at the samples of |command + d_r| and of each state, shape (1 + n,).
    """
    command = bounds[0] * box["k_p"][1]  # of |U|, where U = k_p (command + d_r)
    states = bounds[1:]
    # bound of |k_p (d_r(t) - d_r(t_k))|, k_p times the change of the disturbance within a sample
    disturbance_effect = signal_sizes(problem, box).slope * problem.sample_time * box["k_p"][1]
    largest_motion = np.zeros(2)  # of |e| and |e'|
    acceleration = 0.0
    for a_p, rate in product(set(box["a_p"]), set(box.get("rate", (0.0, 0.0)))):
        generator = np.abs(held_matrix(problem, a_p, rate))  # [[|F|, |G|], [0, 0]]
        chi = generator.shape[0] - 1
        state_bounds = np.zeros(chi)
        for substep in range(INNER_STEPS + 1):
            phi, gamma = flow(problem, a_p, rate, problem.sample_time * substep / INNER_STEPS)
            state_bounds = np.maximum(state_bounds, np.abs(phi) @ states[:chi] + np.abs(gamma) * command)
        largest_motion = np.maximum(largest_motion, state_bounds[:2] + 0.5 * problem.sample_time * disturbance_effect)
        # row 1 of F and G is that of e''
        corner_acceleration = generator[1, :chi] @ state_bounds + generator[1, chi] * command + disturbance_effect
        acceleration = max(acceleration, corner_acceleration)
    e, speed = largest_motion
    return Motion(float(e), float(speed), float(acceleration))


class StartStage(NamedTuple):
    """The first stage of a proof, with bounds that hold from the start on.

    Args:
        stage: The stage.
        allowed_problem: The problem with the largest disturbance that the bounds allow.
    """

    stage: BoundsStage
    allowed_problem: ProofProblem


def from_start(problem: ProofProblem, box: Box) -> StartStage | Obstacle:
    """Search for bounds of all signals that hold from the start on and imply themselves.

    The bounds are computed for a region, and must lie within this region. If they do not, the region grows to hold
    them. If the bounds allow a larger disturbance than was assumed, the assumed level and slope grow, too.

    Returns:
        The first stage of a proof; or why there is none: ``GAIN``, ``REGION`` or ``SLIDING``.
    """
    region = StageRegion(SMALLEST_REGION, SMALLEST_REGION, SMALLEST_REGION)
    current_problem = problem
    for _ in range(ROUNDS):
        fitted = least_bounds(current_problem, box, region, SIGMA, with_start=True)
        if fitted is None:
            return Obstacle.GAIN
        bounds = fitted.bounds
        allowed_problem = allowed_disturbance(problem, current_problem, box, fitted)
        disturbance_fits = (
            allowed_problem.level <= current_problem.level and allowed_problem.slope <= current_problem.slope
        )
        if disturbance_fits and bounds_fit(problem, region, fitted):
            if not keeps_sliding(current_problem, box, fitted, region):
                return Obstacle.SLIDING
            region = region._replace(change=max(region.change, INFLATION * float(bounds[CHANGE])))
            return StartStage(bounds_stage(current_problem, region, fitted), allowed_problem)
        sigma, e, change = (GROWTH * bounds[[SIGMA, ERROR, CHANGE]]).tolist()
        region = StageRegion(max(region.sigma, sigma), max(region.e, e), change)
        if not disturbance_fits:
            level = max(current_problem.level, GROWTH * allowed_problem.level)
            slope = max(current_problem.slope, GROWTH * allowed_problem.slope)
            current_problem = replace(current_problem, level=level, slope=slope)
    return Obstacle.REGION


def bounds_fit(problem: ProofProblem, region: StageRegion, fitted: FittedBounds) -> bool:
    """Whether bounds of the signals, widened for the verifier, lie within the region for which they were computed.

    The region's bound of the change of sigma is used only in the implicit form with q, where the deviation R depends
    on it.

    Args:
        problem: The problem, of which the sampled form is used.
        region: The region.
        fitted: The bounds.
    """
    bounds = INFLATION * fitted.bounds
    sigma_and_error_fit = bounds[SIGMA] <= region.sigma and bounds[ERROR] <= region.e
    if problem.form == "implicit" and fitted.mapping.spread.is_integrated:
        return bool(sigma_and_error_fit and bounds[CHANGE] <= region.change)
    return bool(sigma_and_error_fit)


def keeps_sliding(problem: ProofProblem, box: Box, fitted: FittedBounds, region: StageRegion) -> bool:
    """Whether |u_eq - d_r - f| stays within rho - sup |d_r + f| (premise P5); true if the command has no bound.

    Args:
        problem: The problem, with bounds of the disturbance.
        box: Intervals of k_p, a_p and 1/mu.
        fitted: Bounds of the signals.
        region: Region in which the gains are taken.
    """
    if problem.rho is None:
        return True
    room = problem.rho - signal_sizes(problem, box).offset  # [m/s]
    slack = slide_slack(problem, box, fitted, region)
    return bool(INFLATION * (fitted.bounds[EQUIVALENT] + slack) <= room)


def least_bounds(
    problem: ProofProblem, box: Box, region: StageRegion, signal: int, *, with_start: bool
) -> FittedBounds | None:
    """The smallest bounds of the signals that imply themselves under the control law of a region.

    The law's deviation from a linear law can be bounded in several ways. Each way gives bounds of all signals, and the
    bounds with the smallest bound of ``signal`` are returned.

    Args:
        problem: The problem, with bounds of the disturbance.
        box: Intervals of k_p, a_p and 1/mu.
        region: Region of sigma and e.
        signal: Place of the signal whose bound is to be small.
        with_start: Whether the bounds hold from the start on; otherwise they bound upper limits (limits superior).

    Returns:
        The bounds; None if no bounds imply themselves.
    """
    candidates: list[FittedBounds] = []
    for spread in law_spreads(problem, region):
        mapping = bounds_map(problem, box, spread)
        if mapping is None:
            continue
        origin = mapping.forced + mapping.peaks if with_start else mapping.forced
        bounds = fixed_point(origin, mapping.matrix)
        if bounds is not None:
            candidates.append(FittedBounds(mapping, bounds))
    return min(candidates, key=lambda candidate: float(candidate.bounds[signal]), default=None)


def towards_residual(
    problem: ProofProblem, box: Box, limits: StageRegion, allowed_problem: ProofProblem
) -> list[BoundsStage]:
    """Search for further stages of a proof, each with a smaller bound of the upper limit (limit superior) of |e|.

    In a smaller region the gains vary less, so that smaller bounds imply themselves.

    Args:
        problem: The loop and its uncertain numbers.
        box: Intervals of k_p, a_p and 1/mu.
        limits: The last bounds found before, of |sigma|, |e| and the change of sigma in a sample.
        allowed_problem: The problem with the largest disturbance that these bounds allow.

    Returns:
        The stages in their order; empty if not even one improves the bound of |e| enough.
    """
    stages: list[BoundsStage] = []
    for number in range(MOST_SHRINKINGS):
        worthwhile_ratio = WORTH if number < SHRINKINGS else FURTHER_WORTH
        region = StageRegion(*np.maximum(ENTERED * INFLATION * np.array(limits), SMALLEST_REGION).tolist())
        fitted = least_bounds(allowed_problem, box, region, ERROR, with_start=False)
        if fitted is None or not fitted.bounds[ERROR] < worthwhile_ratio * limits.e:
            break
        stages.append(bounds_stage(allowed_problem, region, fitted))
        allowed_problem = allowed_disturbance(problem, allowed_problem, box, fitted)
        limits = StageRegion(*fitted.bounds[[SIGMA, ERROR, CHANGE]].tolist())
    return stages
