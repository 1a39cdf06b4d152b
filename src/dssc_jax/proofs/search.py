"""The search for a proof: boxes of uncertain numbers, and in each a region, a set in it and a residual.

Nothing that is found here counts as proved before :mod:`dssc_jax.proofs.verifier` has accepted it.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from dssc_jax.proofs.gains import gain_hull
from dssc_jax.proofs.problem import Interval, ProofProblem
from dssc_jax.proofs.programs import Bounded, Solution, invariant_set, largest_in_set, scaling
from dssc_jax.proofs.sampled_loop import LoopGains, LoopPoint, Step, box_corners, start_corners, state_sizes, step_of

Box = dict[str, Interval]
REGIONS = (1.02, 1.2, 1.6, 2.5, 4.0, 7.0, 12.0)
"""Sizes of the region that are tried, in sizes of the start."""
RATES = (0.3, 0.6, 0.12, 0.04)
"""Values of lambda that are tried, in units of the loop's slowest decay."""
SHRINKING, ENOUGH = 8, 0.98
"""Largest number of residual stages, and the least improvement that is worth another."""
INFLATION = 1.001
"""A set attracts; its trajectories enter this multiple of it in finite time."""
LONGEST = 20_000
"""Samples of the excursion that sizes the regions."""
SPARE, SPARE_OF_BOXES = 0.01, 0.5
"""Share of the decay that is left to the verifier's balls, for one plant and for a box of a_p or mu."""
E, SPEED, SIGMA, CHANGE = range(4)  # rows of a step


@dataclass(frozen=True)
class Stage:
    """A set {z'Pz <= 1} that is invariant while |sigma| and |e| stay within a region.

    Args:
        sigma: Bound of |sigma| in which the gains are taken [m/s].
        e: Bound of |e| there [m].
        rate: lambda [1/s].
        multipliers: mu_j of the inputs, with a sum of at most lambda.
        p: P, row by row.
    """

    sigma: float
    e: float
    rate: float
    multipliers: list[float]
    p: list[list[float]]


@dataclass(frozen=True)
class Proof:
    """The proof in one box: the first stage holds the start and keeps sliding, the others shrink to the residual.

    Args:
        box: Intervals of k_p, a_p and 1/mu.
        stages: The sets, from the region to the residual.
    """

    box: Box
    stages: list[Stage]

    def to_dict(self) -> dict[str, Any]:
        """As JSON's types."""
        return asdict(self)


class Failure(NamedTuple):
    """A box without a proof, and the reason: ``origin``, ``decay``, ``region`` or ``sliding``."""

    box: Box
    reason: str


def middle(interval: Interval) -> float:
    """The middle of an interval."""
    return 0.5 * (interval[0] + interval[1])


def slide_rows(problem: ProofProblem, hull: dict[str, Interval], step: Step) -> list[np.ndarray]:
    """Rows of u_eq - d at every corner of the gains; empty without a bound of the command."""
    if problem.rho is None:
        return []
    _, _, n = state_sizes(problem)
    v, change, sigma = np.eye(n)[n - 2], step.rows[CHANGE], step.rows[SIGMA]
    return [v + p * change + i * sigma for p in set(hull["slide_p"]) for i in set(hull["slide_i"])]


def decay_rate(step: Step, sample_time: float) -> float:
    """The slowest decay of one step [1/s]; negative if it grows."""
    return float(-np.log(np.max(np.abs(np.linalg.eigvals(step.a)))) / sample_time)


def prove_box(problem: ProofProblem, box: Box) -> Proof | Failure:
    """Search a proof for every plant of a box."""
    first = start_corners(problem)
    bound = 0.0 if problem.rho is None else problem.rho - problem.level
    if problem.rho is not None and bound <= 0.0:
        return Failure(box, "sliding")
    origin = gain_hull(problem, 1e-9, 1e-9)
    gains = LoopGains(middle(origin["k_p"]), middle(origin["k_i"]), middle(origin["k_n"]))
    rate = middle(box.get("rate", (0.0, 0.0)))
    centre = LoopPoint(middle(box["k_p"]), middle(box["a_p"]), rate, gains, box["k_p"][1])
    at_origin = step_of(problem, centre)
    speed = decay_rate(at_origin, problem.sample_time)
    scale = scaling(at_origin, first, speed * problem.sample_time)
    if speed <= 0.0 or scale is None:
        return Failure(box, "origin")
    least_e, least_sigma = excursion(at_origin, first, min(LONGEST, int(5.0 / (speed * problem.sample_time))))
    spare = SPARE if all(low == high for name, (low, high) in box.items() if name != "k_p") else SPARE_OF_BOXES
    reason = "region"
    for size in REGIONS:
        sigma, e = size * max(least_sigma, 1e-9), size * max(least_e, 1e-9)
        hull = gain_hull(problem, sigma, e)
        steps = [step_of(problem, point) for point in box_corners(box, hull)]
        inside = [Bounded(at_origin.rows[SIGMA], sigma, 1.0), Bounded(at_origin.rows[E], e, 1.0)]
        slides = [Bounded(row, bound, 1.0) for row in slide_rows(problem, hull, at_origin)]
        result = best_of(problem, steps, [*inside, *slides], first, scale, speed, spare)
        if result is not None:
            rest = residuals(problem, box, result, at_origin, scale, speed, spare)
            return Proof(box, [stage(result, sigma, e), *rest])
        if size == REGIONS[0] and best_of(problem, steps, [], [], scale, speed, spare) is None:
            reason = "decay"
        elif slides and reason == "region" and best_of(problem, steps, inside, first, scale, speed, spare) is not None:
            reason = "sliding"
        if reason == "decay":
            break
    return Failure(box, reason)


def excursion(step: Step, first: list[np.ndarray], samples: int) -> tuple[float, float]:
    """The largest |e| and |sigma| of the loop at one point, from the starts and under inputs of size one."""
    rows, z, inputs = step.rows[[E, SIGMA]], np.stack(first, axis=1), step.b
    from_start, from_inputs = np.zeros(2), np.zeros(2)
    for _ in range(samples):
        from_start = np.maximum(from_start, np.abs(rows @ z).max(axis=1))
        from_inputs += np.abs(rows @ inputs).sum(axis=1)
        z, inputs = step.a @ z, step.a @ inputs
    e, sigma = from_start + from_inputs
    return float(e), float(sigma)


def best_of(
    problem: ProofProblem,
    steps: list[Step],
    rows: list[Bounded],
    first: list[np.ndarray],
    scale: np.ndarray,
    speed: float,
    spare: float,
    keep: Callable[[Solution], float] | None = None,
) -> Solution | None:
    """The first solution over the rates; with a measure, the one for which it is smallest."""
    best, least = None, np.inf
    for share in RATES:
        result = invariant_set(steps, problem.sample_time, share * speed, rows, first, scale, spare)
        if result is None:
            continue
        if keep is None:
            return result
        if (size := keep(result)) < least:
            best, least = result, size
    return best


def stage(result: Solution, sigma: float, e: float) -> Stage:
    """A stage from a solution."""
    return Stage(sigma, e, result.rate, result.multipliers.tolist(), result.p.tolist())


def residuals(
    problem: ProofProblem, box: Box, result: Solution, at: Step, scale: np.ndarray, speed: float, spare: float
) -> list[Stage]:
    """Stages that shrink the region to what attracts in it, as long as |e| becomes smaller."""
    stages: list[Stage] = []
    if not problem.slope:
        return stages
    size = largest_in_set(result.p, at.rows[E])
    for _ in range(SHRINKING):
        sigma, e = (INFLATION * largest_in_set(result.p, at.rows[row]) for row in (SIGMA, E))
        steps = [step_of(problem, point) for point in box_corners(box, gain_hull(problem, sigma, e))]
        rows = [Bounded(at.rows[E], e, 1.0), Bounded(at.rows[SIGMA], sigma, 0.05)]
        better = best_of(problem, steps, rows, [], scale, speed, spare, lambda one: largest_in_set(one.p, at.rows[E]))
        if better is None:
            break
        smaller = largest_in_set(better.p, at.rows[E])
        if smaller > ENOUGH * size:
            break
        stages.append(stage(better, sigma, e))
        result, size = better, smaller
    return stages


def halves(box: Box, problem: ProofProblem) -> list[Box]:
    """Both halves of a box along its longest side, relative to the whole problem's; k_p last, being exact."""
    whole = problem.box
    sides = {
        name: (high - low) / (abs(whole[name][0]) + abs(whole[name][1])) * (0.25 if name == "k_p" else 1.0)
        for name, (low, high) in box.items()
    }
    name = max(sides, key=lambda each: sides[each])
    low, high = box[name]
    cut = float(np.sqrt(low * high)) if low > 0.0 else 0.5 * (low + high)
    return [box | {name: (low, cut)}, box | {name: (cut, high)}]


def volume(box: Box, problem: ProofProblem) -> float:
    """Share of the problem's box, with 1/mu on a logarithmic scale."""
    share = 1.0
    for name, (low, high) in problem.box.items():
        if low < high:
            measure = np.log if name == "rate" else float
            share *= (measure(box[name][1]) - measure(box[name][0])) / (measure(high) - measure(low))
    return float(share)
