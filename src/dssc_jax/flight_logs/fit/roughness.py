"""Roughness of a fit: how far its sum of squares is from the parabola that the intervals assume.

Limits and samples within a plant, as in the cascade of an autopilot, make the output jump by a little where a number
moves an event across a sample. The sum of squares then has steps, and any point whose parabola is lower than a step
may be the best one.
"""

import math

import numpy as np

from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum, random_rays
from dssc_jax.flight_logs.signal_warnings import SignalWarning

SEED = 1  # the seeds of the search are even
POINTS = 32
NEAREST, FARTHEST = 0.5, 3.0  # distances of the points, in standard deviations of the estimate
LAW_SHARE = 0.5  # longest distance along an axis, in standard deviations of the law: farther, no parabola is smooth
SMOOTH = 1.0  # roughness that is as large as the noise of a weighted sum of squares


def roughness(problem: FitProblem, minimum: Minimum) -> float:
    """Root mean square of the deviations from the parabola around a minimum, in units of the sum of squares.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.
    """
    values, directions = np.linalg.eigh(minimum.equations.information)
    lengths = np.minimum(1.0 / np.sqrt(np.maximum(values, TINY)), LAW_SHARE / FARTHEST)
    deviations = []
    for ray in random_rays(SEED, (POINTS, len(problem.names)), NEAREST, FARTHEST):
        move = ray * lengths
        x = minimum.x + directions @ move
        if problem.is_admissible(problem.values(x)):
            cost = problem.normal_equations(x).cost
            # On the parabola, the cost would rise by the last term.
            deviations.append(cost - minimum.cost - values @ move**2)
    finite_deviations = np.array([deviation for deviation in deviations if math.isfinite(deviation)])
    return float(np.sqrt(np.mean(finite_deviations**2))) if finite_deviations.size else 0.0


def widening(rough: float) -> float:
    """The factor by which a roughness widens the covariance; 1 if the roughness is no larger than the noise."""
    return max(1.0, rough / SMOOTH)


def roughness_doubts(rough: float) -> tuple[SignalWarning, ...]:
    """The doubt about a sum of squares that is no parabola; none if its roughness is no larger than its noise."""
    if widening(rough) == 1.0:
        return ()
    text = (
        f"the sum of squares deviates from a parabola by {rough:.3g} times its noise, as where limits or samples of an "
        f"inner loop make the output jump: all intervals are widened by {math.sqrt(widening(rough)):.3g}"
    )
    return (SignalWarning("", "rough-squares", text),)
