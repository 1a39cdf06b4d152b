"""Random designs with a lag: the proved residual against the exact worst case, the proved lag against the local one."""

import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from benchmarks.conservatism import random_cases
from dssc_jax.design import Bounds, Guarantee, guarantee
from dssc_jax.design.practice import practice
from dssc_jax.proofs.problem import ProofProblem
from dssc_jax.proofs.prove import prove_problem
from dssc_jax.proofs.search.box_search import Proof
from dssc_jax.proofs.search.gains import gain_hull, region_of
from dssc_jax.proofs.search.programs import BoundedRow
from dssc_jax.proofs.search.sampled_loop import Step, box_middle, step_of
from dssc_jax.proofs.search.set_stages import RATES, set_stage, setting_of
from dssc_jax.proofs.verifier.verdict import verify_proof

FUNCTIONS = ("phi_a", "phi_b", "kappa_a", "kappa_b", "kappa_c", "kappa_d", "gamma", "delta")
LONGEST, ENDED = 4_000_000, 1e-9
SHARES = (0.99, 0.98, 0.97, 0.96, 0.95, 0.9, 0.8, 0.6, 0.4, 0.2)


class DesignProof(NamedTuple):
    """A design's proved bound of |e|, the exact worst case of its loop at sigma = e = 0, and Theorem 1's bound [m]."""

    proved: float
    exact: float
    theorem: float
    reason: str


def random_designs(count: int, seed: int) -> Iterator[tuple[ProofProblem, Guarantee, Bounds]]:
    """Designs from rest, with the plant at k_max and a_max, T_s a third of the proposed one and a lag of order 2."""
    cases = random_cases(np.random.default_rng(seed), count)
    for i in range(count):
        p, b = (single(each, i) for each in (cases.parameters, cases.bounds))
        functions = {"kind": "vgsta", "k_o": 1.0, "epsilon": float(p.eps)}
        functions |= {name: float(getattr(p, name)) for name in FUNCTIONS}
        period, k_p, a_p = float(practice(p, b).sample_time) / 3.0, float(b.k_max), float(b.a_max)
        problem = ProofProblem(
            sample_time=period, l0=float(p.l0), form="implicit", functions=functions, rho=1e6, nominal=None,
            k_p=(k_p, k_p), a_p=(a_p, a_p), zero_a=(), zero_c=(), numerator=(1.0,), denominator=(1.0, 2.0, 1.0),
            mu=(1.0, 1.0), delay=0.0, sensor_lag=0.0, level=0.0, slope=float(b.alpha_d2), reference=(0.0, 0.0, 0.0),
            initial=((0.0, 0.0), (0.0, 0.0)), start="matched",
        )  # fmt: skip
        yield problem, guarantee(p, b), b


def design_proofs(count: int, seed: int = 5) -> list[DesignProof]:
    """Prove designs with a lag of half of their local margin."""
    result = []
    for problem, theorem, _ in random_designs(count, seed):
        problem = with_lag(problem, 0.5 * local_margin(problem))
        outcome = prove_problem(problem, 1)
        reason = outcome.failures[0].reason if outcome.failures else ""
        result.append(DesignProof(outcome.error, exact_worst(at_origin(problem)), float(theorem.e), reason))
    return result


def proved_shares(count: int, seed: int = 7) -> list[float]:
    """The largest lag at which a V falls for all gains of Theorem 1's residual set, over the local margin.

    At every corner of the design's k_p and a_p; of the least local margin of them. The verifier accepts each set.
    """
    result = []
    for problem, theorem, bounds in random_designs(count, seed):
        plants = itertools.product((bounds.k_max, bounds.k_min), (-bounds.a_max, bounds.a_max))
        pairs = [((float(k_p), float(k_p)), (float(a_p), float(a_p))) for k_p, a_p in plants]
        corners = [dataclasses.replace(problem, k_p=k_p, a_p=a_p, slope=0.0) for k_p, a_p in pairs]
        local, region = min(map(local_margin, corners)), (float(theorem.sigma), float(theorem.e))
        shares = (
            share for share in SHARES if all(holds_in(with_lag(each, share * local), *region) for each in corners)
        )
        result.append(next(shares, 0.0))
    return result


def holds_in(problem: ProofProblem, sigma: float, e: float) -> bool:
    """Whether a set in this region is invariant and attracts without disturbance, as the verifier says."""
    if (setting := setting_of(problem, problem.box)) is None:
        return False
    region = region_of(problem, sigma, e)
    steps = setting.steps(region)
    rows = [BoundedRow(setting.origin.rows.sigma, sigma, 1.0), BoundedRow(setting.origin.rows.e, e, 1.0)]
    for share in (min(RATES), 0.01):
        if (found := setting.solve(steps, rows, share, holds_start=False)) is not None:
            proof = Proof(problem.box, [set_stage(found, region, setting)])
            if verify_proof(problem.to_dict(), proof.to_dict()).proved:
                return True
    return False


def single(arrays: Any, i: int) -> Any:
    """One of the records whose fields are arrays."""
    return type(arrays)(*(part[i] if np.ndim(part) else part for part in arrays))


def at_origin(problem: ProofProblem) -> Step:
    """The loop linearised at sigma = e = 0."""
    return step_of(problem, box_middle(problem.box, gain_hull(problem, 1e-12, 1e-12)), problem.box)


def with_lag(problem: ProofProblem, mu: float) -> ProofProblem:
    """The problem with another lag."""
    return dataclasses.replace(problem, mu=(mu, mu))


def local_margin(problem: ProofProblem) -> float:
    """The lag at which the loop linearised at the origin becomes unstable [s]."""
    low, high = problem.sample_time * 1e-3, problem.sample_time * 1e5
    for _ in range(50):
        middle = float(np.sqrt(low * high))
        stable = np.max(np.abs(np.linalg.eigvals(at_origin(with_lag(problem, middle)).a))) < 1.0
        low, high = (middle, high) if stable else (low, middle)
    return low


def exact_worst(step: Step) -> float:
    """The l1 norm from the increments of d to e, summed one sample after the other."""
    total, z = 0.0, step.b[:, 0]
    for k in range(LONGEST):
        part = abs(step.rows.e @ z)
        total += part
        z = step.a @ z
        if k % 1000 == 999 and np.abs(z).max() <= ENDED * np.abs(step.b[:, 0]).max():
            break
    return total
