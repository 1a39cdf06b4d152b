"""How far the random disturbances that a study declares move the estimates of a fit.

A residual hardly shows noise that is slower than the flight, such as the mean of a gust over it. The study declares it,
and simulations show what it does to the estimates.
"""

import numpy as np

from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.prediction import REPLICATES, NoiseProgram, declares_noise
from dssc_jax.flight_logs.fit.refusals import NotIdentifiable
from dssc_jax.statistics.correlated_noise import weighted_products

ROUNDING = 1e-12  # least eigenvalue of a correlation matrix, as a share of the largest one


def declared_covariance(problem: FitProblem, minimum: Minimum) -> np.ndarray:
    """Second moments of the moves of the coordinates by the study's noise, shape (p, p); 0 without random disturbances.

    Where the residual is smaller than that of the study's noise, the noise of the flight counts as that much weaker.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.

    Raises:
        NotIdentifiable: A simulation with the study's noise diverges, so that nothing tells how far it moves them.
    """
    count = len(problem.names)
    if not declares_noise(problem.study):
        return np.zeros((count, count))
    program = NoiseProgram(problem.study, problem.names, problem.log.commands, sensors=True)
    replicates = program.simulate(problem.values(minimum.x), REPLICATES)
    products = np.zeros((REPLICATES + count,) * 2)
    rows = zip(problem.readings, problem.noises, problem.variances, problem.columns(minimum.x), strict=True)
    for readings, noise, variance, columns in rows:
        simulated = readings.interpolate(replicates[:, readings.channel])
        extended = np.column_stack([simulated.T, columns[:, 1:]])
        products += weighted_products(noise, readings.times, extended)[0] / variance
    if not np.isfinite(products).all():
        raise NotIdentifiable(
            "with the study's random disturbances the simulated output is not finite for these commands, so that no "
            "interval can be told"
        )
    gradients = products[REPLICATES:, :REPLICATES]
    moves = np.linalg.solve(minimum.equations.information, gradients)
    costs = np.diag(products)[:REPLICATES] - np.sum(gradients * moves, axis=0)
    strength = min(1.0, minimum.cost / max(float(np.mean(costs)), TINY))
    return strength * moves @ moves.T / REPLICATES


def larger_covariance(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The first covariance, widened where the second one is larger; both of shape (p, p).

    In the coordinates in which the first is the identity and the second is diagonal, the larger of the two counts.
    """
    scale = np.sqrt(np.diag(first))
    values, vectors = np.linalg.eigh(first / np.outer(scale, scale))
    roots = np.sqrt(np.maximum(values, ROUNDING * values[-1]))
    root = scale[:, None] * vectors * roots
    inverse = (vectors / roots).T / scale
    values, vectors = np.linalg.eigh(inverse @ second @ inverse.T)
    axes = root @ vectors
    return (axes * np.maximum(values, 1.0)) @ axes.T
