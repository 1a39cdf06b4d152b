"""Sets {z'Pz <= 1} that are invariant and attract, found by semidefinite programs in one box of plants."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import factorial
from typing import NamedTuple

import numpy as np

from dssc_jax.proofs.problem import Box, ProofProblem
from dssc_jax.proofs.search.gains import Hull, Region, gain_hull, region_of, start_ratio
from dssc_jax.proofs.search.impulse_responses import responses, spectral_radius
from dssc_jax.proofs.search.law_spread import slide_hull
from dssc_jax.proofs.search.obstacles import Obstacle
from dssc_jax.proofs.search.programs import (
    TIGHT,
    BoundedRow,
    SetPrograms,
    Solution,
    invariant_set,
    largest_in_set,
    scaling,
)
from dssc_jax.proofs.search.sampled_loop import (
    Step,
    box_middle,
    box_steps,
    middle,
    signal_sizes,
    start_corners,
    step_of,
)

FIRST_REGION = 1.02
"""Smallest region that is tried, in sizes of the start."""
LARGEST_REGION = 30.0
"""Largest region that is tried, in sizes of the first one."""
MOST_REGIONS = 20
"""Largest number of regions."""
CURVE_SHARE = 1e-3
"""Share of the decay that the remainder of a polynomial in 1/mu may take."""
MOST_DEGREE = 6
"""Largest degree of a polynomial in 1/mu."""
REGION_ROOM = 1.03
"""Room around the set that sizes the next region."""
START_RATES = (0.3, 0.12, 0.04)
"""Values of lambda that are tried for a set that holds the start; in the loop's slowest decay."""
RATES = (0.3, 0.6, 0.12, 0.04)
"""Values of lambda that are tried for a set that need not hold the start; in the loop's slowest decay."""
ENOUGH = 0.98
"""Another set is worth its time if its |e| is at most this share of the last bound."""
ENOUGH_RATES = 2
"""Number of rates with a set after which no other is tried."""
INFLATION = 1.001
"""A set attracts; its trajectories enter this multiple of it in finite time."""
SPARE = 0.01
"""Share of the decay that is left to the verifier's balls, for one plant."""
SPARE_OF_BOXES = 0.1
"""Share of the decay that is left to the verifier's balls, for a box of a_p or mu."""
CHANGE_ROOM = 8.0
"""Room of a set for the change of sigma in a sample, over what the loop at sigma = e = 0 reaches."""
CHANGE_WEIGHT = 1e-3
"""Weight of that change in the cost."""
GAIN_ROOM = 1.03
"""Widening of what phi_1 changes by with e, for the verifier's enclosures."""
SPEED_ROOM = 1.05
"""Widening of |e'| at the samples for the time between them."""
E, TRUE_E, SIGMA, CHANGE = range(4)  # rows of a step


@dataclass(frozen=True)
class SetStage:
    """A stage of a proof: a set {z'Pz <= 1} that is invariant while sigma and e stay within a region.

    Args:
        sigma: Bound of |sigma| in which the gains are selected [m/s].
        e: Bound of |e| there [m].
        level: Bound of |d| [m/s].
        slope: Bound of |d'| [m/s^2].
        pieces: Number of pieces of |sigma|, equal in its root, in each of which the gains have their own intervals.
        degree: Degree of the polynomial in 1/mu that stands for the held plant.
        rate: lambda [1/s].
        multipliers: mu_j of the inputs, with a sum of at most lambda.
        p: P, row by row.
        coordinate: What z holds, ``u_av`` or, in the conservative form, ``phi_1`` for q = v - phi_1(s).
        moved: Bound of the change of e in a sample [m], where phi_1 depends on e.
        method: The verifier's method.
    """

    sigma: float
    e: float
    level: float
    slope: float
    pieces: int
    degree: int
    rate: float
    multipliers: list[float]
    p: list[list[float]]
    coordinate: str
    moved: float
    method: str = "invariant set"


class Setting(NamedTuple):
    """The data that all semidefinite programs of one box share.

    Args:
        problem: The problem.
        box: Intervals of k_p, a_p and 1/mu.
        origin: One sample at the box's middle, with the gains at sigma = e = 0.
        speed: Decay of the slowest mode [1/s].
        is_integrated: Whether z holds q = v - phi_1(s) in place of v.
        programs: Starts, coordinates and precision of the programs.
    """

    problem: ProofProblem
    box: Box
    origin: Step
    speed: float
    is_integrated: bool
    programs: SetPrograms

    def steps(self, region: Region) -> list[Step]:
        """One sample at every corner of plant and gains, for each piece of a region.

        Where z holds q = v - phi_1(s), a sample needs the gains themselves; where it holds v, those of the increments.
        """
        steps: list[Step] = []
        for hull in region.pieces:
            gains = hull if self.is_integrated else self.increments(region, hull)
            steps += box_steps(self.problem, self.box, gains, self.degree, is_integrated=self.is_integrated)
        return steps

    def increments(self, region: Region, hull: Hull) -> Hull:
        """The gains of the increments of u_av in a piece ``hull`` of a region.

        In the conservative form K_P is a mean over a sample, which may have begun in another piece, and K_I holds what
        phi_1 changes by with e.
        """
        if self.problem.form == "implicit":
            return hull
        reach = hull["slide_p"][1] / hull["k_p"][1]  # the largest 1 + tau_av/T_s
        t = self.problem.sample_time
        slope_change = GAIN_ROOM * hull["by_e"][1] * self.error_change(region)
        k_i = hull["k_i"][0] - slope_change / t, hull["k_i"][1] + slope_change / t
        slide_i = hull["slide_i"][0] - slope_change * reach, hull["slide_i"][1] + slope_change * reach
        return hull | {"k_p": region.hull["k_p"], "k_i": k_i, "slide_i": slide_i}

    def error_change(self, region: Region) -> float:
        """Bound of the change of e in a sample [m], with room for the time between the samples."""
        return self.problem.sample_time * SPEED_ROOM * (region.sigma + self.problem.l0 * region.e)

    @property
    def degree(self) -> int:
        """Degree of the Taylor polynomial in 1/mu whose remainder is far below what V falls by in a sample."""
        low, high = self.box.get("rate", (0.0, 0.0))
        radius = 0.5 * (high - low) * self.problem.sample_time
        falls = CURVE_SHARE * min(RATES) * self.speed * self.problem.sample_time
        for degree in range(1, MOST_DEGREE):
            if radius ** (degree + 1) / factorial(degree + 1) <= falls:
                return degree
        return MOST_DEGREE

    def solve(self, steps: list[Step], rows: list[BoundedRow], share: float, *, holds_start: bool) -> Solution | None:
        """The set of one semidefinite program; None if it has no solution.

        Args:
            steps: One sample at every corner.
            rows: Rows whose values in the set are bounded.
            share: lambda, as a share of the slowest decay.
            holds_start: Whether the set has to hold every start.
        """
        return invariant_set(self.programs, steps, share * self.speed, rows, holds_start=holds_start)

    def falls(self, steps: list[Step]) -> bool:
        """Whether some V falls at every step, at the slowest rate and without starts or bounded rows."""
        return self.solve(steps, [], min(RATES), holds_start=False) is not None


def slide_rows(setting: Setting, region: Region) -> list[BoundedRow]:
    """Rows of u_eq - d_r - f at every corner of the gains, with their bound; empty if the command has no bound.

    In the coordinate q, u_av = q + phi_1(s). There phi_1(s) - mean s counts by its bound, and so does what phi_1
    changes by with e. In the conservative form there may be a bounded row for the change of sigma in a sample, too.
    """
    problem = setting.problem
    step = setting.origin
    if problem.rho is None:
        return []
    unit = np.eye(step.a.shape[0])
    hull = region.hull
    room = problem.rho - signal_sizes(problem, setting.box).offset
    change = step.rows[CHANGE]
    sigma = step.rows[SIGMA]
    u_av_row = unit[-2]
    slide_p = hull["slide_p"]
    rows = []
    if setting.is_integrated:
        mean = middle(hull["mean"])
        spreads = [max(abs(end - mean) for end in piece["mean"]) for piece in region.pieces]
        room -= max(spread * end for spread, end in zip(spreads, region.ends, strict=True))
        u_av_row = u_av_row + mean * unit[-1]
        room -= hull["slide_e"][1] * setting.error_change(region)
    else:
        hull = setting.increments(region, hull)
    if problem.form == "conservative":
        error_change = setting.error_change(region)
        largest = CHANGE_ROOM * excursion(step, setting.programs.starts, CHANGE)
        slide_p = slide_hull(problem, (region.sigma, region.e), largest, error_change)
        rows = [BoundedRow(change, largest, CHANGE_WEIGHT)] if slide_p != hull["slide_p"] else []
    corners = product(set(slide_p), set(hull["slide_i"]))
    return rows + [BoundedRow(u_av_row + p * change + i * sigma, max(room, 0.0), 1.0) for p, i in corners]


def setting_of(problem: ProofProblem, box: Box, *, is_integrated: bool = False) -> Setting | None:
    """The setting of a box; None if the loop is not stable at sigma = e = 0.

    ``is_integrated`` tells whether z holds q = v - phi_1(s) in place of v.
    """
    gains = gain_hull(problem, 1e-9, 1e-9)
    origin = step_of(problem, box_middle(box, gains), box, is_integrated=is_integrated)
    starts = start_corners(problem, box, start_ratio(problem, is_integrated=is_integrated))
    radius = spectral_radius(origin.a)
    speed = float(-np.log(radius) / problem.sample_time)
    if speed <= 0.0 or (scale := scaling(origin, starts, speed * problem.sample_time)) is None:
        return None
    point = all(low == high for name, (low, high) in box.items() if name != "k_p")
    programs = SetPrograms(problem.sample_time, starts, scale, SPARE if point else SPARE_OF_BOXES, [])
    return Setting(problem, box, origin, speed, is_integrated, programs)


def first_set(setting: Setting) -> SetStage | Obstacle:
    """Search a set that holds the start and keeps sliding.

    If there is none, further programs without some of the conditions tell which one is the obstacle.
    """
    excursions = [excursion(setting.origin, setting.programs.starts, row) for row in (SIGMA, E)]
    if not all(np.isfinite(excursions)):
        return Obstacle.REGION
    first_sizes = [FIRST_REGION * max(size, 1e-9) for size in excursions]
    if (solution := set_from_start(setting, first_sizes, slides=True)) is not None:
        return solution
    if not setting.falls(setting.steps(region_of(setting.problem, first_sizes[0], first_sizes[1]))):
        return Obstacle.DECAY
    if setting.problem.rho is None or set_from_start(setting, first_sizes, slides=False) is None:
        return Obstacle.REGION
    return Obstacle.SLIDING


def set_from_start(setting: Setting, first_sizes: Sequence[float], *, slides: bool) -> SetStage | None:
    """Search a set that holds the start, and lies in the region from which its gains are taken.

    If the set found for a region exceeds it, the next region has that set's size, with some room.

    Args:
        setting: The setting.
        first_sizes: Bounds of |sigma| [m/s] and |e| [m] in the first region.
        slides: Whether the set has to keep sliding.
    """
    rows = setting.origin.rows
    depends_on_e = setting.problem.functions["kind"] == "vgsta"
    shares = START_RATES if slides else START_RATES[:1]  # only the set's existence tells the reason of a failure
    limits = np.array(first_sizes)
    for _ in range(MOST_REGIONS):
        region = region_of(setting.problem, float(limits[0]), float(limits[1]))
        steps = setting.steps(region)
        region_rows = [BoundedRow(rows[SIGMA], region.sigma, None)]
        if depends_on_e:
            region_rows.append(BoundedRow(rows[E], region.e, None))
        sliding_rows = slide_rows(setting, region) if slides else []
        if not all(bounded.bound > 0.0 for bounded in sliding_rows):
            return None
        if (solution := set_with_start(setting, steps, [*region_rows, *sliding_rows], shares)) is None:
            return None
        sizes = np.array([largest_in_set(solution.p, rows[row]) for row in (SIGMA, E)])
        sigma_fits, e_fits = sizes <= (1.0 - TIGHT) * limits
        if sigma_fits and (e_fits or not depends_on_e):
            return set_stage(solution, region, setting)
        limits = REGION_ROOM * sizes
        if np.any(limits > LARGEST_REGION * np.array(first_sizes)):
            return None
        shares = [share for share in shares if share * setting.speed <= solution.rate * (1.0 + TIGHT)]
    return None


def set_with_start(
    setting: Setting, steps: list[Step], rows: list[BoundedRow], shares: Sequence[float]
) -> Solution | None:
    """Search a set that holds the start, with the first of several rates that allows one.

    The set's size hardly depends on the rate.

    Args:
        setting: The setting.
        steps: One sample at every corner.
        rows: Rows whose values in the set are bounded.
        shares: Values of lambda, as shares of the slowest decay.
    """
    for number, share in enumerate(shares):
        if (solution := setting.solve(steps, rows, share, holds_start=True)) is not None:
            return solution
        if number == 0 and not setting.falls(steps):
            return None
    return None


def smaller_set(setting: Setting, sigma: float, e: float, shares: Sequence[float]) -> SetStage | None:
    """Search a smaller set that attracts all of a region; None if its |e| is not much smaller.

    Args:
        setting: The setting.
        sigma: Bound of |sigma| in the region [m/s].
        e: Bound of |e| in the region [m].
        shares: Values of lambda that are tried, as shares of the slowest decay.
    """
    region = region_of(setting.problem, sigma, e)
    steps = setting.steps(region)
    e_row = setting.origin.rows[E]
    rows = [BoundedRow(e_row, e, 1.0), BoundedRow(setting.origin.rows[SIGMA], sigma, 0.05)]
    solutions: list[Solution] = []
    for share in shares:
        if (solution := setting.solve(steps, rows, share, holds_start=False)) is not None:
            solutions.append(solution)
        if len(solutions) == ENOUGH_RATES:
            break
    best_solution = min(solutions, key=lambda solution: largest_in_set(solution.p, e_row), default=None)
    if best_solution is None or largest_in_set(best_solution.p, e_row) > ENOUGH * e:
        return None
    return set_stage(best_solution, region, setting)


def excursion(step: Step, starts: Sequence[np.ndarray], row: int) -> float:
    """The largest |row z| in the loop of one step, from the starts and under inputs of size 1; ``row`` is its place."""
    response = responses(step.a, step.rows[[row]], step.b, np.stack(starts, axis=1))
    if response is None:
        return np.inf
    return float((response.peaks + response.sums.sum(axis=1))[0])


def set_stage(result: Solution, region: Region, setting: Setting) -> SetStage:
    """The stage of a solution. Where the gains do not depend on e, its region is as large in e as the set."""
    return SetStage(
        sigma=region.sigma,
        e=max(region.e, INFLATION * largest_in_set(result.p, setting.origin.rows[E])),
        level=setting.problem.level,
        slope=setting.problem.slope,
        pieces=len(region.pieces),
        degree=setting.degree,
        rate=result.rate,
        multipliers=result.multipliers.tolist(),
        p=result.p.tolist(),
        coordinate="phi_1" if setting.is_integrated else "u_av",
        moved=setting.error_change(region),
    )
