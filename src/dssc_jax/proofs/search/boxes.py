"""Boxes of uncertain numbers: their halves, and their share of the problem's."""

import numpy as np

from dssc_jax.proofs.problem import Interval, ProofProblem
from dssc_jax.proofs.search.gains import gain_hull
from dssc_jax.proofs.search.sampled_loop import box_middle, step_of

Box = dict[str, Interval]


def halves(box: Box, problem: ProofProblem) -> list[Box]:
    """Both halves of a box along the side whose ends differ most in the loop's eigenvalues at sigma = e = 0."""
    gains = gain_hull(problem, 1e-9, 1e-9)

    def eigenvalues(box: Box) -> np.ndarray:
        return np.sort_complex(np.linalg.eigvals(step_of(problem, box_middle(box, gains), box).a))

    def effect(name: str) -> float:
        low, high = (eigenvalues(box | {name: (end, end)}) for end in box[name])
        return float(np.abs(high - low).sum())

    name = max(box, key=effect)
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
