"""The search for a proof: boxes of uncertain numbers, and in each a region, a set in it and a residual.

Nothing that is found here counts as proved before :mod:`dssc_jax.proofs.verifier.verdict` has accepted it.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np

from dssc_jax.proofs.problem import Box, ProofProblem
from dssc_jax.proofs.search import bounds_map
from dssc_jax.proofs.search.fixed_point import BoundsStage, from_start, towards_residual
from dssc_jax.proofs.search.gains import gain_hull, region_of
from dssc_jax.proofs.search.law_spread import StageRegion
from dssc_jax.proofs.search.obstacles import Obstacle
from dssc_jax.proofs.search.programs import largest_in_set
from dssc_jax.proofs.search.sampled_loop import box_middle, signal_sizes, step_of
from dssc_jax.proofs.search.set_stages import (
    CHANGE,
    ENOUGH,
    INFLATION,
    RATES,
    SIGMA,
    E,
    SetStage,
    Setting,
    excursion,
    first_set,
    setting_of,
    smaller_set,
)

SHRINKING = 8
"""Largest number of residual stages."""
LOOSE = 1.3
"""A bound of |e| on the way, over what the loop at sigma = e = 0 reaches, from which a set is tried, too."""


@dataclass(frozen=True)
class Proof:
    """The proof in one box: the first stage holds the start and keeps sliding, the others shrink to the residual.

    Args:
        box: Intervals of k_p, a_p and 1/mu.
        stages: Invariant sets, or bounds that imply themselves, from the first region to the residual.
    """

    box: Box
    stages: Sequence[SetStage | BoundsStage]

    def to_dict(self) -> dict[str, object]:
        """The proof as JSON's types, with the arrays of numbers as lists."""
        return asdict(self)


class Failure(NamedTuple):
    """A box for which no proof is found, and what keeps the search from one."""

    box: Box
    reason: Obstacle


def prove_box(problem: ProofProblem, box: Box) -> Proof | Failure:
    """Search a proof for every plant of a box: bounds that imply themselves, or else invariant sets to begin with."""
    if problem.rho is not None and problem.rho <= signal_sizes(problem, box).offset:
        return Failure(box, Obstacle.SLIDING)
    start_result = from_start(problem, box)
    if not isinstance(start_result, Obstacle):
        stage, allowed_problem = start_result
        limits = StageRegion(*(stage.bounds[i] for i in (bounds_map.SIGMA, bounds_map.ERROR, bounds_map.CHANGE)))
        proof = Proof(box, [stage, *towards_residual(problem, box, limits, limits.e, allowed_problem)])
        return tighter_start(problem, proof)
    if any(problem.by_state):  # of which the sets know no bound
        return Failure(box, Obstacle.SLIDING if start_result == Obstacle.SLIDING else Obstacle.GAIN)
    result = proof_by_sets(problem, box)
    if isinstance(result, Failure) and start_result == Obstacle.SLIDING:  # bounds imply themselves, but exceed rho
        return Failure(box, Obstacle.SLIDING)
    return result


def tighter_start(problem: ProofProblem, proof: Proof) -> Proof:
    """A proof that begins with an invariant set instead, if bounds of |e| are loose on the way and a set's is smaller.

    A set costs more time, so that it is only tried where the bound of |e| exceeds by ``LOOSE`` what the loop at sigma =
    e = 0 reaches.
    """
    if any(problem.by_state) or (setting := setting_of(problem, proof.box)) is None:
        return proof
    start_error = reached_error(proof.stages[0], setting)
    if start_error <= LOOSE * excursion(setting.origin, setting.programs.starts, E):
        return proof
    set_proof = proof_by_sets(problem, proof.box)
    if isinstance(set_proof, Failure) or reached_error(set_proof.stages[0], setting) >= start_error:
        return proof
    return set_proof if smallest_error(set_proof, setting) <= smallest_error(proof, setting) / ENOUGH else proof


def reached_error(stage: SetStage | BoundsStage, setting: Setting) -> float:
    """The bound of |e| at the samples that a stage shows [m]."""
    if isinstance(stage, BoundsStage):
        return stage.bounds[bounds_map.ERROR]
    return largest_in_set(np.array(stage.p), setting.origin.rows[E])


def smallest_error(proof: Proof, setting: Setting) -> float:
    """The smallest bound of |e| at the samples that a stage of a proof shows [m]."""
    return min(reached_error(stage, setting) for stage in proof.stages)


def proof_by_sets(problem: ProofProblem, box: Box) -> Proof | Failure:
    """Search a proof that begins with an invariant set which holds the start.

    In the conservative form the coordinate is phi_1 where K_P varies much over the first region, else u_av. If that
    does not lead to a proof, the other coordinate is tried.
    """
    if problem.form == "implicit":
        return proof_in_coordinate(problem, box, is_integrated=False)
    is_wide = False
    if (setting := setting_of(problem, box)) is not None:
        excursions = [excursion(setting.origin, setting.programs.starts, row) for row in (SIGMA, E)]
        is_finite = bool(np.all(np.isfinite(excursions)))
        is_wide = is_finite and len(region_of(problem, excursions[0], excursions[1]).pieces) > 1
    result = proof_in_coordinate(problem, box, is_integrated=is_wide)
    if isinstance(result, Failure) and result.reason != Obstacle.ORIGIN:
        alternative = proof_in_coordinate(problem, box, is_integrated=not is_wide)
        return result if isinstance(alternative, Failure) else alternative
    return result


def proof_in_coordinate(problem: ProofProblem, box: Box, *, is_integrated: bool) -> Proof | Failure:
    """Search invariant sets, each within the one before, until bounds imply themselves in the last one's region.

    ``is_integrated`` tells whether the coordinate is phi_1 in place of u_av.
    """
    if (setting := setting_of(problem, box, is_integrated=is_integrated)) is None:
        return Failure(box, Obstacle.ORIGIN)
    start_stage = first_set(setting)
    if isinstance(start_stage, Obstacle):
        return Failure(box, start_stage)
    stages = [start_stage]
    for _ in range(SHRINKING):
        p = np.array(stages[-1].p)
        sigma = INFLATION * largest_in_set(p, setting.origin.rows[SIGMA])
        e = INFLATION * largest_in_set(p, setting.origin.rows[E])
        change = INFLATION * largest_in_set(p, setting.origin.rows[CHANGE])
        if residual_stages := towards_residual(problem, box, StageRegion(sigma, e, change), e, problem):
            return Proof(box, [*stages, *residual_stages])
        shares = RATES if len(stages) == 1 else (stages[-1].rate / setting.speed,)
        if (next_stage := smaller_set(setting, sigma, e, shares)) is None:
            break
        stages.append(next_stage)
    return Proof(box, stages)


def halves(box: Box, problem: ProofProblem) -> list[Box]:
    """The two parts of a box, cut across the side along which the loop's eigenvalues at sigma = e = 0 change most.

    The cut is at the geometric mean of positive ends, else in the middle.
    """
    gains = gain_hull(problem, 1e-9, 1e-9)

    def eigenvalues(box: Box) -> np.ndarray:
        return np.sort_complex(np.linalg.eigvals(step_of(problem, box_middle(box, gains), box).a))

    def eigenvalue_change(name: str) -> float:
        low, high = (eigenvalues(box | {name: (end, end)}) for end in box[name])
        return float(np.abs(high - low).sum())

    name = max(box, key=eigenvalue_change)
    low, high = box[name]
    split = float(np.sqrt(low * high)) if low > 0.0 else 0.5 * (low + high)
    return [box | {name: (low, split)}, box | {name: (split, high)}]


def volume(box: Box, problem: ProofProblem) -> float:
    """Share of the problem's box, with 1/mu on a logarithmic scale."""
    share = 1.0
    for name, (low, high) in problem.box.items():
        if low < high:
            scale = np.log if name == "rate" else float
            share *= (scale(box[name][1]) - scale(box[name][0])) / (scale(high) - scale(low))
    return float(share)
