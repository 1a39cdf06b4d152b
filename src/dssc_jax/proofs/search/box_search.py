"""The search for a proof in one box of uncertain numbers: bounds that imply themselves, or invariant sets.

Nothing that is found here counts as proved before :mod:`dssc_jax.proofs.verifier.verdict` has accepted it.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np

from dssc_jax.proofs.problem import Box, ProofProblem
from dssc_jax.proofs.search.bounds_map import CHANGE, ERROR, SIGMA
from dssc_jax.proofs.search.fixed_point import BoundsStage, from_start, towards_residual
from dssc_jax.proofs.search.gains import NEAR_ORIGIN, gain_hull, region_of
from dssc_jax.proofs.search.law_spread import StageRegion
from dssc_jax.proofs.search.obstacles import Obstacle
from dssc_jax.proofs.search.programs import largest_in_set
from dssc_jax.proofs.search.sampled_loop import box_middle, signal_sizes, step_of
from dssc_jax.proofs.search.set_stages import (
    ENOUGH,
    INFLATION,
    RATES,
    SetStage,
    Setting,
    excursion,
    first_set,
    setting_of,
    smaller_set,
)

SHRINKING = 8
"""Largest number of invariant sets after the first one, each within the one before."""
LOOSE = 1.3
"""Ratio of the bound of |e| from the start on to the largest |e| of the loop linearised at sigma = e = 0.

Above it the bound counts as loose, and an invariant set is tried, too."""


@dataclass(frozen=True)
class Proof:
    """A proof in one box: stages whose regions shrink, from a region that holds every start down to the residual.

    Args:
        box: Intervals of k_p, a_p and 1/mu.
        stages: Invariant sets, or bounds that imply themselves, from the first region to the residual.
    """

    box: Box
    stages: Sequence[SetStage | BoundsStage]

    def to_dict(self) -> dict[str, object]:
        """The proof as a table of JSON's types, as a certificate holds it."""
        return asdict(self)


class Failure(NamedTuple):
    """A box without a proof, and the condition that the search could not meet in this box."""

    box: Box
    reason: Obstacle


def prove_box(problem: ProofProblem, box: Box) -> Proof | Failure:
    """Search for one proof that holds for every plant of a box.

    Bounds that imply themselves are tried first, since they are cheap and tight. If no such bounds hold from the start
    on, or if their bound of |e| is loose, the search looks for a proof that begins with invariant sets.

    Returns:
        The proof, or the reason why there is none.
    """
    if problem.rho is not None and problem.rho <= signal_sizes(problem, box).offset:
        return Failure(box, Obstacle.SLIDING)  # rho does not exceed |d_r + f|: nothing is left for sliding
    start_result = from_start(problem, box)
    if not isinstance(start_result, Obstacle):
        stage = start_result.stage
        limits = StageRegion(
            sigma=stage.bounds[SIGMA],
            e=stage.bounds[ERROR],
            change=stage.bounds[CHANGE],
        )
        proof = Proof(box, [stage, *towards_residual(problem, box, limits, start_result.allowed_problem)])
        return tighter_start(problem, proof)
    needs_more_command = start_result == Obstacle.SLIDING  # bounds imply themselves, but u_eq may exceed rho
    if any(problem.by_state):  # invariant sets cannot bound a disturbance that depends on the state
        return Failure(box, Obstacle.SLIDING if needs_more_command else Obstacle.GAIN)
    result = proof_by_sets(problem, box)
    if isinstance(result, Failure) and needs_more_command:
        return Failure(box, Obstacle.SLIDING)
    return result


def tighter_start(problem: ProofProblem, proof: Proof) -> Proof:
    """Replace a proof whose bound of |e| from the start on is loose by one that begins with an invariant set.

    A set costs more time. So it is tried only if the bound of |e| is more than ``LOOSE`` times the largest |e| of the
    loop linearised at sigma = e = 0. The new proof is taken if its bound from the start on is smaller, and its last
    bound is at most 1/``ENOUGH`` times the old one.

    Args:
        problem: The loop and its uncertain numbers.
        proof: A proof that begins with bounds that imply themselves.

    Returns:
        The new proof, or the given one.
    """
    if any(problem.by_state) or (setting := setting_of(problem, proof.box)) is None:
        return proof
    start_error = reached_error(proof.stages[0], setting)
    if start_error <= LOOSE * excursion(setting.origin, setting.programs.starts, setting.origin.rows.e):
        return proof
    set_proof = proof_by_sets(problem, proof.box)
    if isinstance(set_proof, Failure) or reached_error(set_proof.stages[0], setting) >= start_error:
        return proof
    ends_as_near = smallest_error(set_proof, setting) <= smallest_error(proof, setting) / ENOUGH
    return set_proof if ends_as_near else proof


def reached_error(stage: SetStage | BoundsStage, setting: Setting) -> float:
    """The bound of |e| [m] at the samples that a stage shows: from the start on, or once the loop has settled.

    Args:
        stage: The stage.
        setting: The setting of the box, which has e as a row over z.
    """
    if isinstance(stage, BoundsStage):
        return stage.bounds[ERROR]
    return largest_in_set(np.array(stage.p), setting.origin.rows.e)


def smallest_error(proof: Proof, setting: Setting) -> float:
    """The smallest bound of |e| [m] at the samples over all stages of a proof; it holds once the loop has settled."""
    return min(reached_error(stage, setting) for stage in proof.stages)


def proof_by_sets(problem: ProofProblem, box: Box) -> Proof | Failure:
    """Search for a proof that begins with an invariant set which holds every start.

    In the conservative form the integrator's state may be written as v or as q = v - phi_1. If K_P varies much over
    the region, q is better and is tried first, otherwise v. If the first choice leads to no proof, the other is tried,
    except if the loop is not stable at sigma = e = 0, where both fail.
    """
    if problem.form == "implicit":
        return proof_in_coordinate(problem, box, is_integrated=False)
    gains_vary = gains_vary_on_the_way(problem, box)
    result = proof_in_coordinate(problem, box, is_integrated=gains_vary)
    if isinstance(result, Failure) and result.reason != Obstacle.ORIGIN:
        alternative = proof_in_coordinate(problem, box, is_integrated=not gains_vary)
        return result if isinstance(alternative, Failure) else alternative
    return result


def gains_vary_on_the_way(problem: ProofProblem, box: Box) -> bool:
    """Whether the region that the loop reaches from its starts needs several pieces, since K_P varies much over it.

    The region is estimated by the loop linearised at sigma = e = 0; False if this loop is not stable.
    """
    setting = setting_of(problem, box)
    if setting is None:
        return False
    rows = setting.origin.rows
    sigma = excursion(setting.origin, setting.programs.starts, rows.sigma)
    e = excursion(setting.origin, setting.programs.starts, rows.e)
    return bool(np.isfinite(sigma) and np.isfinite(e)) and len(region_of(problem, sigma, e).pieces) > 1


def proof_in_coordinate(problem: ProofProblem, box: Box, *, is_integrated: bool) -> Proof | Failure:
    """Search for invariant sets, each within the one before, until bounds imply themselves in the last set.

    Bounds that imply themselves are tighter than any set, so the proof ends with them where they exist.

    Args:
        problem: The loop and its uncertain numbers.
        box: Intervals of k_p, a_p and 1/mu.
        is_integrated: Whether the state z contains q = v - phi_1 in place of v.
    """
    setting = setting_of(problem, box, is_integrated=is_integrated)
    if setting is None:
        return Failure(box, Obstacle.ORIGIN)
    start_stage = first_set(setting)
    if isinstance(start_stage, Obstacle):
        return Failure(box, start_stage)
    stages = [start_stage]
    for _ in range(SHRINKING):
        region = region_of_set(setting, stages[-1])
        residual_stages = towards_residual(problem, box, region, problem)
        if residual_stages:
            return Proof(box, [*stages, *residual_stages])
        # the first set after the start's tries several rates lambda; the sets after it keep the best of them
        shares = RATES if len(stages) == 1 else (stages[-1].rate / setting.speed,)
        next_stage = smaller_set(setting, region.sigma, region.e, shares)
        if next_stage is None:
            break
        stages.append(next_stage)
    return Proof(box, stages)


def region_of_set(setting: Setting, stage: SetStage) -> StageRegion:
    """A region that every trajectory enters in finite time: the set of a stage, which attracts, with some room."""
    p = np.array(stage.p)
    rows = setting.origin.rows
    return StageRegion(
        sigma=INFLATION * largest_in_set(p, rows.sigma),
        e=INFLATION * largest_in_set(p, rows.e),
        change=INFLATION * largest_in_set(p, rows.change),
    )


def halves(box: Box, problem: ProofProblem) -> list[Box]:
    """Cut a box in two, across the interval along which the loop's eigenvalues change most.

    The eigenvalues are those of the loop linearised at sigma = e = 0. The interval is cut at the geometric mean of its
    ends if both are positive, otherwise in its middle.

    Args:
        box: Intervals of k_p, a_p and 1/mu, at least one of them with a width.
        problem: The loop and its uncertain numbers.
    """
    gains = gain_hull(problem, NEAR_ORIGIN, NEAR_ORIGIN)

    def eigenvalues(box: Box) -> np.ndarray:
        """Eigenvalues of A in z+ = A z for the loop in the middle of a box, sorted for comparison, shape (n,)."""
        return np.sort_complex(np.linalg.eigvals(step_of(problem, box_middle(box, gains), box).a))

    def eigenvalue_change(name: str) -> float:
        """The sum of the distances by which the eigenvalues move from one end of an uncertain number to the other."""
        low, high = box[name]
        at_low = eigenvalues(box | {name: (low, low)})
        at_high = eigenvalues(box | {name: (high, high)})
        return float(np.abs(at_high - at_low).sum())

    name = max(box, key=eigenvalue_change)
    low, high = box[name]
    split = float(np.sqrt(low * high)) if low > 0.0 else 0.5 * (low + high)
    return [box | {name: (low, split)}, box | {name: (split, high)}]


def volume(box: Box, problem: ProofProblem) -> float:
    """Share of the problem's box that a smaller box takes by volume, 0 to 1; 1/mu counts on a logarithmic scale.

    Args:
        box: The smaller box, within the problem's box.
        problem: The loop, whose intervals without width are ignored.
    """
    share = 1.0
    for name, (lowest, highest) in problem.box.items():
        if lowest < highest:
            low, high = box[name]
            scale = np.log if name == "rate" else float
            share *= (scale(high) - scale(low)) / (scale(highest) - scale(lowest))
    return float(share)
