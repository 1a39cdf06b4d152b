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
    """A normal law of the mixture.

    Args:
        mean: Mean, shape (d,).
        root: Lower triangular root of the covariance, shape (d, d).
        share: Share of the law in the mixture.
    """

    mean: np.ndarray
    root: np.ndarray
    share: float

    def log_density(self, points: np.ndarray) -> np.ndarray:
        """Logarithm of the density at points of shape (n, d), up to a constant that all normal laws share; (n,)."""
        scores = linalg.solve_triangular(self.root, (points - self.mean).T, lower=True)
        log_determinant = float(np.log(np.diag(self.root)).sum())  # of the root
        return -0.5 * np.sum(scores**2, axis=0) - log_determinant


def weighted_mixture(means: np.ndarray, roots: list[np.ndarray], weights: np.ndarray) -> list[Component]:
    """The mixture of some normal laws and the wide law, with shares that are proportional to weights.

    No share is below :data:`LEAST_SHARE`, before they are made to add up to 1.

    Args:
        means: Means of the laws, shape (laws, d).
        roots: Roots of their covariances, each of shape (d, d).
        weights: Weights of the laws, shape (laws,). All of them are 0 where the design points are so far away that
            probabilities underflow; the laws then have equal shares.
    """
    dimension = means.shape[1]
    total = float(weights.sum())
    shares = np.maximum(weights / total, LEAST_SHARE) if total > 0.0 else np.ones(len(weights))
    shares *= (1.0 - WIDE_SHARE) / shares.sum()
    components = [Component(mean, root, float(share)) for mean, root, share in zip(means, roots, shares, strict=True)]
    return [*components, Component(np.zeros(dimension), WIDE * np.eye(dimension), WIDE_SHARE)]


def mixture_sample(components: list[Component], count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw about ``count`` points of a mixture: a fixed number from each law, at least 2.

    Returns:
        The points, shape (n, d), and at each the ratio of the standard normal density to that of the mixture,
        shape (n,).
    """
    numbers = [max(2, round(component.share * count)) for component in components]
    parts = []
    for component, number in zip(components, numbers, strict=True):
        parts.append(component.mean + rng.standard_normal((number, len(component.mean))) @ component.root.T)
    points = np.concatenate(parts)
    shares = np.array(numbers) / len(points)
    densities = np.stack([component.log_density(points) for component in components])
    mixture = special.logsumexp(densities, axis=0, b=shares[:, None])
    return points, np.exp(-0.5 * np.sum(points**2, axis=1) - mixture)


def fit_mixture(components: list[Component], points: np.ndarray, weights: np.ndarray) -> list[Component]:
    """Fit a mixture to weighted failures, by one step of expectation and maximisation.

    Each law gets the mean of the failures near it, and their covariance where that is wider than the unit matrix. A
    law with few failures stays as it is.

    Args:
        components: The mixture to start from; its last law is the wide one, which stays.
        points: Points in standard normal space, shape (n, d).
        weights: Probability of the failures that each point stands for, shape (n,).
    """
    narrow = components[:-1]
    densities = np.stack([component.log_density(points) for component in narrow])
    responsibilities = np.exp(densities - special.logsumexp(densities, axis=0))
    means = []
    roots = []
    totals = []
    for component, responsibility in zip(narrow, responsibilities, strict=True):
        shares = weights * responsibility
        total = float(shares.sum())
        size = effective_size(shares)
        totals.append(total)
        if size < FEWEST:
            means.append(component.mean)
            roots.append(component.root)
            continue
        mean = shares @ points / total
        means.append(mean)
        roots.append(root_of_failures(points - mean, shares / total, size))
    if not sum(totals):
        return components
    return weighted_mixture(np.array(means), roots, np.array(totals))


def root_of_failures(deviations: np.ndarray, weights: np.ndarray, size: float) -> np.ndarray:
    """Root of the covariance of weighted points, shape (d, d).

    The covariance is shrunk towards the unit matrix, the more so the fewer points there are. In no direction is it
    narrower than the unit matrix.

    Args:
        deviations: Points less their mean, shape (n, d).
        weights: Weight of each point, which add up to 1, shape (n,).
        size: Effective number of points.
    """
    dimension = deviations.shape[1]
    covariance = (weights[:, None] * deviations).T @ deviations
    doubt = (dimension + 1.0) / (dimension + 1.0 + size)
    values, vectors = np.linalg.eigh((1.0 - doubt) * covariance + doubt * np.eye(dimension))
    return np.linalg.cholesky((vectors * np.maximum(values, 1.0)) @ vectors.T)
