"""How far the random disturbances that a study declares move the estimates of a fit.

A residual hardly shows noise that is slower than the flight, such as the mean of a gust over the flight. The study
declares such noise, and simulations show how far it moves the estimates.
"""

import numpy as np

from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.prediction import REPLICATES, NoiseProgram, declares_noise
from dssc_jax.flight_logs.fit.refusals import NotIdentifiable
from dssc_jax.statistics.correlated_noise import weighted_products

ROUNDING = 1e-12  # least eigenvalue of a correlation matrix, as a share of the largest one


def declared_covariance(problem: FitProblem, minimum: Minimum) -> np.ndarray:
    """Second moments of how far the noise that the study declares moves the coordinates, shape (p, p).

    The moments are 0 if the study has no random disturbance. If the flight's residual is smaller than that of the
    simulations, the moments are reduced in proportion to the weighted sums of squares.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.

    Raises:
        NotIdentifiable: A simulation with the study's noise diverges, so that the moves are not known.
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
    """The first covariance, widened in the directions in which the second one is larger; all of shape (p, p).

    In the coordinates in which the first covariance is the identity and the second one is diagonal, the result is
    diagonal, and each entry is the larger of the two.
    """
    scale = np.sqrt(np.diag(first))
    values, vectors = np.linalg.eigh(first / np.outer(scale, scale))
    roots = np.sqrt(np.maximum(values, ROUNDING * values[-1]))
    root = scale[:, None] * vectors * roots
    inverse = (vectors / roots).T / scale
    values, vectors = np.linalg.eigh(inverse @ second @ inverse.T)
    axes = root @ vectors
    return (axes * np.maximum(values, 1.0)) @ axes.T
