"""Mixtures of normal laws around the failures, from which the points of importance sampling are chosen."""

from typing import NamedTuple

import numpy as np
from scipy import linalg, special

from dssc_jax.statistics.weighted import effective_size

WIDE = 2.5  # standard deviations of the wide normal law
WIDE_SHARE = 0.1  # share of the points from the wide law
LEAST_SHARE = 0.05  # least share of a narrow law
FEWEST = 5.0  # effective number of failures to which a law is fitted


class Component(NamedTuple):
    """A normal law of the mixture, in standard normal space.

    Args:
        mean: Mean, shape (d,).
        root: Lower triangular root L of the covariance L L^T, shape (d, d).
        share: Share of the law in the mixture.
    """

    mean: np.ndarray
    root: np.ndarray
    share: float

    def log_density(self, points: np.ndarray) -> np.ndarray:
        """Logarithm of the density at points of shape (n, d), without the common term -d/2 ln(2 pi), shape (n,)."""
        scores = linalg.solve_triangular(self.root, (points - self.mean).T, lower=True)
        log_determinant_of_root = float(np.log(np.diag(self.root)).sum())
        return -0.5 * np.sum(scores**2, axis=0) - log_determinant_of_root


def weighted_mixture(means: np.ndarray, roots: list[np.ndarray], weights: np.ndarray) -> list[Component]:
    """A mixture of narrow normal laws and, as its last component, the wide law around the median draw.

    The shares of the narrow laws are proportional to their weights. Small shares are first raised to
    :data:`LEAST_SHARE`, so that no kind of failure is neglected; then the narrow laws together get the share that the
    wide law leaves.

    Args:
        means: Means of the narrow laws, shape (laws, d).
        roots: Lower triangular roots of their covariances, each of shape (d, d).
        weights: Weights of the narrow laws, shape (laws,). All of them are 0 where the design points are so far away
            that probabilities underflow; the laws then have equal shares.
    """
    dimension = means.shape[1]
    total = float(weights.sum())
    shares = np.maximum(weights / total, LEAST_SHARE) if total > 0.0 else np.ones(len(weights))
    shares *= (1.0 - WIDE_SHARE) / shares.sum()
    components = [Component(mean, root, float(share)) for mean, root, share in zip(means, roots, shares, strict=True)]
    return [*components, Component(np.zeros(dimension), WIDE * np.eye(dimension), WIDE_SHARE)]


def draw_from_mixture(
    components: list[Component], count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draw about ``count`` points of a mixture: from each law in proportion to its share, at least 2 points.

    Args:
        components: The laws of the mixture.
        count: Number of points, up to rounding.
        rng: Random generator.

    Returns:
        The points, shape (n, d), and at each the standard normal density divided by the density of the mixture,
        shape (n,). Averages over the points with these ratios as weights estimate averages over plain draws.
    """
    counts = [max(2, round(component.share * count)) for component in components]
    parts = []
    for component, part_count in zip(components, counts, strict=True):
        scores = rng.standard_normal((part_count, len(component.mean)))
        parts.append(component.mean + scores @ component.root.T)
    points = np.concatenate(parts)
    shares = np.array(counts) / len(points)
    log_densities = np.stack([component.log_density(points) for component in components])
    log_mixture_density = special.logsumexp(log_densities, axis=0, b=shares[:, None])
    log_normal_density = -0.5 * np.sum(points**2, axis=1)
    return points, np.exp(log_normal_density - log_mixture_density)


def fit_mixture(components: list[Component], points: np.ndarray, weights: np.ndarray) -> list[Component]:
    """Fit a mixture to weighted failures, by a step of expectation and maximisation.

    Each narrow law gets the mean and the covariance of the failures near it; in directions in which these scatter less
    than a unit normal law, the unit variance stays (:func:`covariance_root`). A law with few failures near it stays as
    it is.

    Args:
        components: The mixture to start from; its last law, the wide law, stays.
        points: Points in standard normal space, shape (n, d).
        weights: Probability of the failures that each point stands for, shape (n,).
    """
    narrow = components[:-1]
    log_densities = np.stack([component.log_density(points) for component in narrow])
    memberships = np.exp(log_densities - special.logsumexp(log_densities, axis=0))  # of each point in each law
    means = []
    roots = []
    totals = []
    for component, membership in zip(narrow, memberships, strict=True):
        law_weights = weights * membership
        total = float(law_weights.sum())
        size = effective_size(law_weights)
        totals.append(total)
        if size < FEWEST:
            means.append(component.mean)
            roots.append(component.root)
            continue
        mean = law_weights @ points / total
        means.append(mean)
        roots.append(covariance_root(points - mean, law_weights / total, size))
    if not sum(totals):
        return components
    return weighted_mixture(np.array(means), roots, np.array(totals))


def covariance_root(deviations: np.ndarray, weights: np.ndarray, size: float) -> np.ndarray:
    """Lower triangular root of the covariance of weighted points, shape (d, d), with no variance below 1.

    The covariance is first shrunk towards the unit matrix, more strongly for fewer points. Then its principal variances
    below 1 are raised to 1, since a law that is too narrow would miss failures.

    Args:
        deviations: Points minus their weighted mean, shape (n, d).
        weights: Weights of the points, shape (n,); they add up to 1.
        size: Effective number of points.
    """
    dimension = deviations.shape[1]
    covariance = (weights[:, None] * deviations).T @ deviations
    doubt = (dimension + 1.0) / (dimension + 1.0 + size)  # share of the unit matrix
    variances, axes = np.linalg.eigh((1.0 - doubt) * covariance + doubt * np.eye(dimension))
    return np.linalg.cholesky((axes * np.maximum(variances, 1.0)) @ axes.T)
