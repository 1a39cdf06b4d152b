"""The search for a proof: boxes of uncertain numbers, and in each a region, a set in it and a residual.

Nothing that is found here counts as proved before :mod:`dssc_jax.proofs.verifier.verdict` has accepted it.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import product
from math import factorial
from typing import Any, NamedTuple

import numpy as np

from dssc_jax.proofs.problem import ProofProblem
from dssc_jax.proofs.search import fixed_point
from dssc_jax.proofs.search.boxes import Box
from dssc_jax.proofs.search.fixed_point import BoundsStage, from_start, responses, towards_residual
from dssc_jax.proofs.search.gains import Hull, Region, gain_hull, region_of, start_ratio
from dssc_jax.proofs.search.law_spread import slide_hull
from dssc_jax.proofs.search.programs import (
    TIGHT,
    Bounded,
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

FIRST_REGION, LARGEST_REGION, MOST_REGIONS = 1.02, 30.0, 20
"""Smallest and largest region that are tried, in sizes of the start, and the largest number of regions."""
CURVE_SHARE, MOST_DEGREE = 1e-3, 6
"""Share of the decay that the rest of a polynomial in 1/mu may take, and its largest degree."""
REGION_ROOM = 1.03
"""Room around the set that sizes the next region."""
START_RATES, RATES = (0.3, 0.12, 0.04), (0.3, 0.6, 0.12, 0.04)
"""Values of lambda that are tried for a set that holds the start, and for others; in the loop's slowest decay."""
SHRINKING, ENOUGH = 8, 0.98
"""Largest number of residual stages, and the least improvement that is worth another."""
ENOUGH_RATES = 2
"""Number of rates with a set after which no other is tried."""
INFLATION = 1.001
"""A set attracts; its trajectories enter this multiple of it in finite time."""
SPARE, SPARE_OF_BOXES = 0.01, 0.1
"""Share of the decay that is left to the verifier's balls, for one plant and for a box of a_p or mu."""
LOOSE = 1.3
"""A bound of |e| on the way, over what the loop at sigma = e = 0 reaches, from which a set is tried, too."""
CHANGE_ROOM, CHANGE_WEIGHT = 8.0, 1e-3
"""Room of a set for the change of sigma in a sample, over what the loop at sigma = e = 0 reaches, and its weight."""
GAIN_ROOM = 1.03
"""Widening of what phi_1 changes by with e, for the verifier's enclosures."""
SPEED_ROOM = 1.05
"""Widening of |e'| at the samples for the time between them."""
E, TRUE_E, SIGMA, CHANGE = range(4)  # rows of a step


@dataclass(frozen=True)
class SetStage:
    """A set {z'Pz <= 1} that is invariant while |sigma| and |e| stay within a region.

    Args:
        sigma: Bound of |sigma| in which the gains are selected [m/s].
        e: Bound of |e| there [m].
        level: Bound of |d| [m/s].
        slope: Bound of |d'| [m/s^2].
        pieces: Number of pieces of |sigma|, equal in its root, in each of which the gains have their own intervals.
        degree: Of the polynomial in 1/mu that stands for the held plant.
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


@dataclass(frozen=True)
class Proof:
    """The proof in one box: the first stage holds the start and keeps sliding, the others shrink to the residual.

    Args:
        box: Intervals of k_p, a_p and 1/mu.
        stages: The sets, from the region to the residual.
    """

    box: Box
    stages: Sequence[SetStage | BoundsStage]

    def to_dict(self) -> dict[str, Any]:
        """As JSON's types."""
        return asdict(self)


class Failure(NamedTuple):
    """A box without a proof, and the reason, as in ``REASONS`` of :mod:`dssc_jax.proofs.prove`."""

    box: Box
    reason: str


def slide_rows(setting: "Setting", region: Region) -> list[Bounded]:
    """Rows of u_eq - d_r - f at every corner of the gains, with their bound; empty without a bound of the command.

    In the conservative form u_av = q + phi_1(s), of which phi_1(s) - mean s is bounded by itself, and so is what phi_1
    changes by with e. The change of sigma in a sample stays within a bound of its own.
    """
    problem, step = setting.problem, setting.at
    if problem.rho is None:
        return []
    unit, hull, room = np.eye(step.a.shape[0]), region.hull, problem.rho - signal_sizes(problem, setting.box).offset
    change, sigma, held, slide_p = step.rows[CHANGE], step.rows[SIGMA], unit[-2], hull["slide_p"]
    rows = []
    if setting.integrated:
        mean = middle(hull["mean"])
        far = [max(abs(end - mean) for end in piece["mean"]) for piece in region.pieces]
        room -= max(each * end for each, end in zip(far, region.ends, strict=True))
        held = held + mean * unit[-1]
        room -= hull["slide_e"][1] * setting.moved(region)
    else:
        hull = setting.increments(region, hull)
    if problem.form == "conservative":
        moved = setting.moved(region)
        largest = CHANGE_ROOM * excursion(step, setting.programs.starts, CHANGE)
        slide_p = slide_hull(problem, (region.sigma, region.e), largest, moved)
        rows = [Bounded(change, largest, CHANGE_WEIGHT)] if slide_p != hull["slide_p"] else []
    corners = product(set(slide_p), set(hull["slide_i"]))
    return rows + [Bounded(held + p * change + i * sigma, max(room, 0.0), 1.0) for p, i in corners]


def decay_rate(step: Step, sample_time: float) -> float:
    """The slowest decay of one step [1/s]; negative if it grows."""
    return float(-np.log(np.max(np.abs(np.linalg.eigvals(step.a)))) / sample_time)


def prove_box(problem: ProofProblem, box: Box) -> Proof | Failure:
    """Search a proof for every plant of a box: bounds that imply themselves, or else sets to begin with."""
    if problem.rho is not None and problem.rho <= signal_sizes(problem, box).offset:
        return Failure(box, "sliding")
    first = from_start(problem, box)
    if not isinstance(first, str):
        stage, allowed = first
        sigma, e = stage.bounds[fixed_point.SIGMA], stage.bounds[fixed_point.ERROR]
        proof = Proof(box, [stage, *towards_residual(problem, box, (sigma, e), e, allowed)])
        return tighter_start(problem, proof)
    if any(problem.by_state):  # of which the sets know no bound
        return Failure(box, "sliding" if first == "sliding" else "gain")
    return proof_by_sets(problem, box)


def tighter_start(problem: ProofProblem, proof: Proof) -> Proof:
    """A proof that begins with a set instead, where bounds of signals are loose on the way and a set does better."""
    if any(problem.by_state) or (setting := setting_of(problem, proof.box)) is None:
        return proof
    first = reached_error(proof.stages[0], setting)
    if first <= LOOSE * excursion(setting.at, setting.programs.starts, E):
        return proof
    other = proof_by_sets(problem, proof.box)
    if isinstance(other, Failure) or reached_error(other.stages[0], setting) >= first:
        return proof
    ends = [min(reached_error(stage, setting) for stage in each.stages) for each in (proof, other)]
    return other if ends[1] <= ends[0] / ENOUGH else proof


def reached_error(stage: SetStage | BoundsStage, setting: "Setting") -> float:
    """The bound of |e| at the samples."""
    if isinstance(stage, BoundsStage):
        return stage.bounds[fixed_point.ERROR]
    return largest_in_set(np.array(stage.p), setting.at.rows[E])


class Setting(NamedTuple):
    """What the programs of one box share.

    Args:
        problem: What is to be proved.
        box: The box.
        at: One sample at the box's middle, with the gains at sigma = e = 0.
        speed: Decay of the slowest mode [1/s].
        integrated: Whether z holds q = v - phi_1(s) in place of v.
        programs: Starts, coordinates and precision of the programs.
    """

    problem: ProofProblem
    box: Box
    at: Step
    speed: float
    integrated: bool
    programs: SetPrograms

    def steps(self, region: Region) -> list[Step]:
        """One sample at every corner of the box and of the gains in each piece of a region."""
        steps: list[Step] = []
        for hull in region.pieces:
            gains = hull if self.integrated else self.increments(region, hull)
            steps += box_steps(self.problem, self.box, gains, self.degree, integrated=self.integrated)
        return steps

    def increments(self, region: Region, hull: Hull) -> Hull:
        """The gains of the increments of u_av.

        In the conservative form K_P is a mean over a sample, which may have begun in another piece, and K_I holds what
        phi_1 changes by with e.
        """
        if self.problem.form == "implicit":
            return hull
        reach, t = hull["slide_p"][1] / hull["k_p"][1], self.problem.sample_time
        joins = GAIN_ROOM * hull["by_e"][1] * self.moved(region)
        k_i = hull["k_i"][0] - joins / t, hull["k_i"][1] + joins / t
        slide_i = hull["slide_i"][0] - joins * reach, hull["slide_i"][1] + joins * reach
        return hull | {"k_p": region.hull["k_p"], "k_i": k_i, "slide_i": slide_i}

    def moved(self, region: Region) -> float:
        """Bound of the change of e in a sample, with room for the time between the samples."""
        return self.problem.sample_time * SPEED_ROOM * (region.sigma + self.problem.l0 * region.e)

    @property
    def degree(self) -> int:
        """Degree of the polynomial in 1/mu, such that its rest is far below what V falls by in a sample."""
        low, high = self.box.get("rate", (0.0, 0.0))
        half = 0.5 * (high - low) * self.problem.sample_time
        falls = CURVE_SHARE * min(RATES) * self.speed * self.problem.sample_time
        return next((d for d in range(1, MOST_DEGREE) if half ** (d + 1) / factorial(d + 1) <= falls), MOST_DEGREE)

    def solve(self, steps: list[Step], rows: list[Bounded], share: float, *, started: bool) -> Solution | None:
        """The set for lambda as a share of the slowest decay."""
        return invariant_set(self.programs, steps, share * self.speed, rows, started=started)

    def falls(self, steps: list[Step]) -> bool:
        """Whether any V falls at every step, slowly and without inputs' bounds or starts."""
        return self.solve(steps, [], min(RATES), started=False) is not None


def setting_of(problem: ProofProblem, box: Box, *, integrated: bool = False) -> Setting | None:
    """The setting of a box; None if the loop is not stable at sigma = e = 0."""
    origin = gain_hull(problem, 1e-9, 1e-9)
    at = step_of(problem, box_middle(box, origin), box, integrated=integrated)
    starts = start_corners(problem, box, start_ratio(problem, integrated=integrated))
    speed = decay_rate(at, problem.sample_time)
    if speed <= 0.0 or (scale := scaling(at, starts, speed * problem.sample_time)) is None:
        return None
    point = all(low == high for name, (low, high) in box.items() if name != "k_p")
    programs = SetPrograms(problem.sample_time, starts, scale, SPARE if point else SPARE_OF_BOXES, [])
    return Setting(problem, box, at, speed, integrated, programs)


def proof_by_sets(problem: ProofProblem, box: Box) -> Proof | Failure:
    """Sets from the start on.

    In the conservative form the coordinate is phi_1 where K_P varies much over the first region, else u_av; and the
    other one where that does not lead to a proof.
    """
    if problem.form == "implicit":
        return proof_in_coordinate(problem, box, integrated=False)
    wide = False
    if (setting := setting_of(problem, box)) is not None:
        first = [excursion(setting.at, setting.programs.starts, row) for row in (SIGMA, E)]
        wide = bool(np.all(np.isfinite(first))) and len(region_of(problem, first[0], first[1]).pieces) > 1
    result = proof_in_coordinate(problem, box, integrated=wide)
    if isinstance(result, Failure) and result.reason != "origin":
        other = proof_in_coordinate(problem, box, integrated=not wide)
        return result if isinstance(other, Failure) else other
    return result


def proof_in_coordinate(problem: ProofProblem, box: Box, *, integrated: bool) -> Proof | Failure:
    """Sets from the start to a region in which bounds imply themselves."""
    if (setting := setting_of(problem, box, integrated=integrated)) is None:
        return Failure(box, "origin")
    at = setting.at
    first = first_set(setting)
    if isinstance(first, str):
        return Failure(box, first)
    stages = [first]
    for _ in range(SHRINKING):
        sigma, e = (INFLATION * largest_in_set(np.array(stages[-1].p), at.rows[row]) for row in (SIGMA, E))
        if rest := towards_residual(problem, box, (sigma, e), e, problem):
            return Proof(box, [*stages, *rest])
        shares = RATES if len(stages) == 1 else (stages[-1].rate / setting.speed,)
        if (smaller := smaller_set(setting, sigma, e, shares)) is None:
            break
        stages.append(smaller)
    return Proof(box, stages)


def first_set(setting: Setting) -> SetStage | str:
    """A set that holds the start and keeps sliding; otherwise the reason why there is none."""
    least = [excursion(setting.at, setting.programs.starts, row) for row in (SIGMA, E)]
    if not all(np.isfinite(least)):
        return "region"
    first = [FIRST_REGION * max(each, 1e-9) for each in least]
    if (solution := held_start(setting, first, slides=True)) is not None:
        return solution
    if not setting.falls(setting.steps(region_of(setting.problem, first[0], first[1]))):
        return "decay"
    return "region" if setting.problem.rho is None or held_start(setting, first, slides=False) is None else "sliding"


def held_start(setting: Setting, first: Sequence[float], *, slides: bool) -> SetStage | None:
    """A set that holds the start, and stays in a region whose gains it allows.

    Of the sets of a region's gains, the one that exceeds the region by the least sizes the next region.

    Args:
        setting: The box.
        first: Bounds of |sigma| and |e| of the first region.
        slides: Whether the set has to keep sliding, too.
    """
    at, by_e = setting.at, setting.problem.functions["kind"] == "vgsta"
    shares = START_RATES if slides else START_RATES[:1]  # else it is about the reason of a failure
    limits = np.array(first)
    for _ in range(MOST_REGIONS):
        region = region_of(setting.problem, float(limits[0]), float(limits[1]))
        steps = setting.steps(region)
        inside = [Bounded(at.rows[SIGMA], region.sigma, None)]
        inside += [Bounded(at.rows[E], region.e, None)] if by_e else []
        sliding = slide_rows(setting, region) if slides else []
        if not all(each.bound > 0.0 for each in sliding):
            return None
        if (solution := started_set(setting, steps, [*inside, *sliding], shares)) is None:
            return None
        sizes = np.array([largest_in_set(solution.p, at.rows[row]) for row in (SIGMA, E)])
        if np.all((sizes <= (1.0 - TIGHT) * limits)[: len(inside)]):
            return set_stage(solution, region, setting)
        limits = REGION_ROOM * sizes
        if np.any(limits > LARGEST_REGION * np.array(first)):
            return None
        shares = [share for share in shares if share * setting.speed <= solution.rate * (1.0 + TIGHT)]
    return None


def started_set(setting: Setting, steps: list[Step], rows: list[Bounded], shares: Sequence[float]) -> Solution | None:
    """A set that holds the start, with the first rate that allows one; its excursion hardly depends on the rate."""
    for number, share in enumerate(shares):
        if (solution := setting.solve(steps, rows, share, started=True)) is not None:
            return solution
        if number == 0 and not setting.falls(steps):
            return None
    return None


def smaller_set(setting: Setting, sigma: float, e: float, shares: Sequence[float] = RATES) -> SetStage | None:
    """The set with the least |e| that attracts within a region, for some rates; None if it is not worth it."""
    at, region = setting.at, region_of(setting.problem, sigma, e)
    steps = setting.steps(region)
    rows = [Bounded(at.rows[E], e, 1.0), Bounded(at.rows[SIGMA], sigma, 0.05)]
    solutions: list[Solution] = []
    for share in shares:
        if (solution := setting.solve(steps, rows, share, started=False)) is not None:
            solutions.append(solution)
        if len(solutions) == ENOUGH_RATES:
            break
    best = min(solutions, key=lambda each: largest_in_set(each.p, at.rows[E]), default=None)
    if best is None or largest_in_set(best.p, at.rows[E]) > ENOUGH * e:
        return None
    return set_stage(best, region, setting)


def excursion(step: Step, starts: Sequence[np.ndarray], row: int) -> float:
    """The largest value of a row in the loop at one point, from the starts and under inputs of size one."""
    response = responses(step.a, step.rows[[row]], step.b, np.stack(starts, axis=1))
    return np.inf if response is None else float((response.peaks + response.sums.sum(axis=1))[0])


def set_stage(result: Solution, region: Region, setting: Setting) -> SetStage:
    """The stage of a solution; where the gains do not depend on e, its region holds any e of the set."""
    e, pieces = max(region.e, INFLATION * largest_in_set(result.p, setting.at.rows[E])), len(region.pieces)
    multipliers, p = result.multipliers.tolist(), result.p.tolist()
    sizes = region.sigma, e, setting.problem.level, setting.problem.slope
    coordinate = "phi_1" if setting.integrated else "u_av"
    shape = pieces, setting.degree, result.rate, multipliers, p, coordinate, setting.moved(region)
    return SetStage(*sizes, *shape)
