"""Sets {z'Pz <= 1} that are invariant and attract (method 1), found by semidefinite programs in one box of plants."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import factorial
from typing import NamedTuple

import numpy as np

from dssc_jax.proofs.problem import Box, ProofProblem, middle
from dssc_jax.proofs.search.gains import NEAR_ORIGIN, Hull, Region, gain_hull, region_of, start_ratio
from dssc_jax.proofs.search.impulse_responses import responses, spectral_radius
from dssc_jax.proofs.search.law_spread import StageRegion, slide_hull
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
    signal_sizes,
    start_corners,
    step_of,
)

FIRST_REGION = 1.02
"""Ratio of the first region to the region that the loop linearised at sigma = e = 0 reaches from its starts."""
LARGEST_REGION = 30.0
"""Ratio of the largest region that is tried to the first one."""
MOST_REGIONS = 20
"""Largest number of regions that are tried."""
CURVE_SHARE = 1e-3
"""Share of V's fall in a sample that the remainder of the polynomial in 1/mu may take."""
MOST_DEGREE = 6
"""Largest degree of the polynomial in 1/mu."""
REGION_ROOM = 1.03
"""Ratio of the next region to the set that did not fit into the last one."""
START_RATES = (0.3, 0.12, 0.04)
"""Values of lambda, over the decay of the loop's slowest mode, that are tried for a set that holds the start."""
RATES = (0.3, 0.6, 0.12, 0.04)
"""Values of lambda, over the decay of the loop's slowest mode, that are tried for a set after the first one."""
ENOUGH = 0.98
"""Largest ratio of a set's bound of |e| to the last bound at which the set is worth its time."""
ENOUGH_RATES = 2
"""Number of rates with a set after which no further rate is tried."""
INFLATION = 1.001
"""Factor of a set that attracts, which every trajectory enters in finite time."""
SPARE = 0.01
"""Share of V's fall that is left for the widths of the verifier's balls, for one plant."""
SPARE_OF_BOXES = 0.1
"""Share of V's fall that is left for the widths of the verifier's balls, for an interval of a_p or mu."""
CHANGE_ROOM = 8.0
"""Bound of the change of sigma in a sample within a set, over its largest in the loop linearised at sigma = e = 0."""
CHANGE_WEIGHT = 1e-3
"""Weight of the change of sigma in a sample in the cost of a program."""
GAIN_ROOM = 1.03
"""Factor that widens the change of phi_1 through e, for the verifier's enclosure."""
SPEED_ROOM = 1.05
"""Factor that widens |e'| at the samples, for the time between them."""


@dataclass(frozen=True)
class SetStage:
    """A stage of a proof: a set {z'Pz <= 1} that is invariant while sigma and e stay within a region.

    Args:
        sigma: Bound of |sigma| [m/s] in the region.
        e: Bound of |e| [m] in the region.
        level: Bound of |d| [m/s].
        slope: Bound of |d'| [m/s^2].
        pieces: Number of pieces of |sigma|, each with its own intervals of the gains; they are equal in |sigma|^(1/2).
        degree: Degree of the polynomial in 1/mu that stands for the held plant.
        rate: lambda [1/s].
        multipliers: mu_j [1/s] of the inputs, with a sum of at most lambda.
        p: P, row by row.
        coordinate: Which integrator state z contains: ``u_av`` for v; in the conservative form also ``phi_1`` for q =
            v - phi_1(s).
        moved: Bound of the change of e in a sample [m], by which phi_1 may change through e.
        method: Name of the method of docs/proofs.md by which the verifier checks the stage.
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
        problem: The loop and its uncertain numbers.
        box: Intervals of k_p, a_p and 1/mu.
        origin: One sample at the box's middle, with the gains at sigma = e = 0.
        speed: Decay of the slowest mode of ``origin`` [1/s].
        is_integrated: Whether z contains q = v - phi_1(s) in place of v.
        programs: Starts, coordinates and precision of the programs.
    """

    problem: ProofProblem
    box: Box
    origin: Step
    speed: float
    is_integrated: bool
    programs: SetPrograms

    def steps(self, region: Region) -> list[Step]:
        """One sample at every vertex of plant and gains, for each piece of a region; V has to fall over all of them.

        If z contains q, the intervals of the gains in a piece suffice. If z contains v, :meth:`increments` widens them.
        """
        steps: list[Step] = []
        for hull in region.pieces:
            gains = hull if self.is_integrated else self.increments(region, hull)
            steps += box_steps(self.problem, self.box, gains, self.degree, is_integrated=self.is_integrated)
        return steps

    def increments(self, region: Region, hull: Hull) -> Hull:
        """The intervals of the gains in v+ = v + K_P (sigma - s) + T_s K_I sigma, in a piece of a region.

        In the conservative form K_P is a mean over the sample, which may have begun in another piece, so it has the
        interval of the whole region. K_I is phi_2/sigma plus theta/T_s, where |theta sigma| bounds the change of phi_1
        through e.

        Args:
            region: The region; K_P is taken over all of it, and its |sigma| and |e| bound the change of e in a sample.
            hull: Intervals of the gains in the piece.
        """
        if self.problem.form == "implicit":
            return hull
        theta = GAIN_ROOM * hull["by_e"][1] * self.error_change(region)
        t = self.problem.sample_time
        reach = hull["slide_p"][1] / hull["k_p"][1]  # the largest 1 + tau_av/T_s
        k_i_low, k_i_high = hull["k_i"]
        slide_i_low, slide_i_high = hull["slide_i"]
        return hull | {
            "k_p": region.hull["k_p"],
            "k_i": (k_i_low - theta / t, k_i_high + theta / t),
            "slide_i": (slide_i_low - theta * reach, slide_i_high + theta * reach),
        }

    def error_change(self, region: Region) -> float:
        """Bound of the change of e in a sample [m] within a region, T_s sup |e'| with e' = sigma - l_0 e."""
        return self.problem.sample_time * SPEED_ROOM * (region.sigma + self.problem.l0 * region.e)

    @property
    def degree(self) -> int:
        """Degree of the Taylor polynomial in 1/mu, for which the remainder is far below the fall of V in a sample.

        It is the smallest such degree, and at most ``MOST_DEGREE``.
        """
        low, high = self.box.get("rate", (0.0, 0.0))
        radius = 0.5 * (high - low) * self.problem.sample_time  # half of the width of T_s/mu
        allowed_remainder = CURVE_SHARE * min(RATES) * self.speed * self.problem.sample_time
        for degree in range(1, MOST_DEGREE):
            remainder = radius ** (degree + 1) / factorial(degree + 1)
            if remainder <= allowed_remainder:
                return degree
        return MOST_DEGREE

    def solve(self, steps: list[Step], rows: list[BoundedRow], share: float, *, holds_start: bool) -> Solution | None:
        """Solve a semidefinite program for an invariant set; None if it has no solution.

        Args:
            steps: One sample at every vertex.
            rows: Signals to bound in the set.
            share: lambda over the decay of the slowest mode.
            holds_start: Whether the set has to hold every start.
        """
        return invariant_set(self.programs, steps, share * self.speed, rows, holds_start=holds_start)

    def has_common_v(self, steps: list[Step]) -> bool:
        """Whether some V falls over every step at the smallest lambda, without any start to hold or signal to bound."""
        return self.solve(steps, [], min(RATES), holds_start=False) is not None


def slide_rows(setting: Setting, region: Region) -> list[BoundedRow]:
    """The rows and bounds that keep the loop sliding, |u_eq - d_r - f| <= rho - sup |d_r + f| (P5); none without rho.

    u_eq = v + slide_p (sigma - s) + slide_i sigma gives a row over z for every pair of ends of the two gains. In the
    conservative form slide_p depends on the change of sigma in a sample, so this change may get a bound, too.

    Args:
        setting: The data that the programs of the box share.
        region: The region in which the gains are taken.
    """
    problem = setting.problem
    if problem.rho is None:
        return []
    step = setting.origin
    change = step.rows.change
    sigma = step.rows.sigma
    *_, integrator, s = np.eye(step.a.shape[0])
    room = problem.rho - signal_sizes(problem, setting.box).offset
    if setting.is_integrated:  # v = q + phi_1(s), where phi_1(s) is near mean s
        hull = region.hull
        mean = middle(hull["mean"])
        v_row = integrator + mean * s
        phi_1_deviations = []  # of phi_1(s) from mean s
        for piece, largest_s in zip(region.pieces, region.ends, strict=True):
            low, high = piece["mean"]
            phi_1_deviations.append(max(abs(low - mean), abs(high - mean)) * largest_s)
        room -= max(phi_1_deviations)
        room -= hull["slide_e"][1] * setting.error_change(region)  # the change of phi_1 through e
    else:
        hull = setting.increments(region, region.hull)
        v_row = integrator
    slide_p = hull["slide_p"]
    change_rows = []
    if problem.form == "conservative":
        largest_change = CHANGE_ROOM * excursion(step, setting.programs.starts, change)
        slide_p = slide_hull(problem, StageRegion(region.sigma, region.e, largest_change), setting.error_change(region))
        if slide_p != hull["slide_p"]:
            change_rows = [BoundedRow(change, largest_change, CHANGE_WEIGHT)]
    corners = product(set(slide_p), set(hull["slide_i"]))
    equivalent_rows = [v_row + p * change + i * sigma for p, i in corners]
    return change_rows + [BoundedRow(row, bound=max(room, 0.0), weight=1.0) for row in equivalent_rows]


def setting_of(problem: ProofProblem, box: Box, *, is_integrated: bool = False) -> Setting | None:
    """Make the data that all programs of a box share; None if the loop linearised at sigma = e = 0 is not stable.

    Args:
        problem: The loop and its uncertain numbers.
        box: Intervals of k_p, a_p and 1/mu.
        is_integrated: Whether z contains q = v - phi_1(s) in place of v.
    """
    gains = gain_hull(problem, NEAR_ORIGIN, NEAR_ORIGIN)
    origin = step_of(problem, box_middle(box, gains), box, is_integrated=is_integrated)
    starts = start_corners(problem, box, start_ratio(problem, is_integrated=is_integrated))
    radius = spectral_radius(origin.a)
    speed = float(-np.log(radius) / problem.sample_time)
    if speed <= 0.0 or (scale := scaling(origin, starts, speed * problem.sample_time)) is None:
        return None
    is_one_plant = all(low == high for name, (low, high) in box.items() if name != "k_p")  # k_p adds no remainder
    spare = SPARE if is_one_plant else SPARE_OF_BOXES
    programs = SetPrograms(problem.sample_time, starts, scale, spare, active=[])
    return Setting(problem, box, origin, speed, is_integrated, programs)


def first_set(setting: Setting) -> SetStage | Obstacle:
    """Search for an invariant set that holds every start and keeps the loop sliding, the first stage of a proof.

    If there is none, further programs without some of the conditions find out which condition cannot be met.

    Returns:
        The stage; or ``DECAY``, ``REGION`` or ``SLIDING``.
    """
    rows = setting.origin.rows
    excursions = [excursion(setting.origin, setting.programs.starts, row) for row in (rows.sigma, rows.e)]
    if not all(np.isfinite(excursions)):
        return Obstacle.REGION
    first_sizes = [FIRST_REGION * max(size, NEAR_ORIGIN) for size in excursions]
    if (stage := set_from_start(setting, first_sizes, slides=True)) is not None:
        return stage
    if not setting.has_common_v(setting.steps(region_of(setting.problem, first_sizes[0], first_sizes[1]))):
        return Obstacle.DECAY
    if setting.problem.rho is None or set_from_start(setting, first_sizes, slides=False) is None:
        return Obstacle.REGION
    return Obstacle.SLIDING


def set_from_start(setting: Setting, first_sizes: Sequence[float], *, slides: bool) -> SetStage | None:
    """Search for an invariant set that holds every start and lies in the region for whose gains it is invariant.

    If the set for a region exceeds the region, the next region has the size of this set, with some room.

    Args:
        setting: The data that the programs of the box share.
        first_sizes: Bounds of |sigma| [m/s] and |e| [m] in the first region.
        slides: Whether the set has to keep the loop sliding.
    """
    rows = setting.origin.rows
    depends_on_e = setting.problem.functions["kind"] == "vgsta"
    shares = START_RATES if slides else START_RATES[:1]  # without sliding it only matters whether a set exists
    limits = np.array(first_sizes)
    for _ in range(MOST_REGIONS):
        region = region_of(setting.problem, float(limits[0]), float(limits[1]))
        steps = setting.steps(region)
        region_rows = [BoundedRow(rows.sigma, region.sigma, weight=None)]
        if depends_on_e:
            region_rows.append(BoundedRow(rows.e, region.e, weight=None))
        sliding_rows = slide_rows(setting, region) if slides else []
        if not all(bounded.bound > 0.0 for bounded in sliding_rows):
            return None
        if (solution := set_with_start(setting, steps, [*region_rows, *sliding_rows], shares)) is None:
            return None
        sizes = np.array([largest_in_set(solution.p, rows.sigma), largest_in_set(solution.p, rows.e)])
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
    """Find a set that holds every start, with the first of several rates lambda that allows one.

    The size of the set hardly depends on lambda, so the first lambda with a set is good enough.

    Args:
        setting: The data that the programs of the box share.
        steps: One sample at every vertex.
        rows: Signals to bound in the set.
        shares: Values of lambda over the decay of the slowest mode.
    """
    for number, share in enumerate(shares):
        if (solution := setting.solve(steps, rows, share, holds_start=True)) is not None:
            return solution
        if number == 0 and not setting.has_common_v(steps):
            return None
    return None


def smaller_set(setting: Setting, sigma: float, e: float, shares: Sequence[float]) -> SetStage | None:
    """Search for a smaller set that attracts all of a region; None if its |e| is hardly smaller than the region's.

    The first ``ENOUGH_RATES`` rates that allow a set are compared, and the set with the smallest |e| is taken.

    Args:
        setting: The data that the programs of the box share.
        sigma: Bound of |sigma| [m/s] in the region.
        e: Bound of |e| [m] in the region.
        shares: Values of lambda over the decay of the slowest mode.
    """
    region = region_of(setting.problem, sigma, e)
    steps = setting.steps(region)
    e_row = setting.origin.rows.e
    sigma_row = setting.origin.rows.sigma
    rows = [BoundedRow(e_row, e, weight=1.0), BoundedRow(sigma_row, sigma, weight=0.05)]
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


def excursion(step: Step, starts: Sequence[np.ndarray], row: np.ndarray) -> float:
    """The largest |signal| that a linear loop reaches from its starts under inputs of size 1; infinite if unstable.

    Args:
        step: One sample of the loop.
        starts: States in which the loop may start, shape (n,) each.
        row: The signal as a row over z, shape (n,).
    """
    response = responses(step.a, row[None], step.b, np.stack(starts, axis=1))
    if response is None:
        return np.inf
    return (response.peaks + response.sums.sum(axis=1)).item()


def set_stage(result: Solution, region: Region, setting: Setting) -> SetStage:
    """Make a certificate's stage from a set.

    If no gain depends on e, the set may exceed the region in e. So the stage's bound of |e| is at least the set's.

    Args:
        result: The set.
        region: The region in which the gains were taken.
        setting: The data that the programs of the box share.
    """
    return SetStage(
        sigma=region.sigma,
        e=max(region.e, INFLATION * largest_in_set(result.p, setting.origin.rows.e)),
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
