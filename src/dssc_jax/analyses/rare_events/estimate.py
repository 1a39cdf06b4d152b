"""The contract of estimates of a rare failure's probability, and the plain draws that may contradict them."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from dssc_jax.statistics import CONFIDENCE, clopper_pearson

SlackFunction = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Slacks, shape (n,), of points (n, d) with noise indices (n,); negative: failure.

Points are in the method's coordinates: standard normal space, or the unit cube.
"""


class Counter:
    """Computes slacks, counts the evaluations, and provides fresh noise indices."""

    def __init__(self, slack: SlackFunction) -> None:
        self.slack = slack
        self.simulations = 0
        self.indices = 0

    def fresh(self, count: int) -> np.ndarray:
        """Noise indices that no point has used."""
        self.indices += count
        return np.arange(self.indices - count, self.indices)

    def __call__(self, points: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Compute slacks; a point without a slack fails."""
        self.simulations += len(points)
        slacks = self.slack(points, noise)
        return np.where(np.isnan(slacks), -np.inf, slacks)


class Plain(NamedTuple):
    """Plain independent draws in addition to those of the method.

    Args:
        draws: Number of plain draws.
        points: The draws that failed, in standard normal space, shape (failures, d).
    """

    draws: int
    points: np.ndarray

    @property
    def failures(self) -> int:
        """Number of draws that failed."""
        return len(self.points)

    @property
    def share(self) -> float:
        """Share of draws that failed."""
        return self.failures / self.draws

    def interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """The exact interval of the failure probability."""
        low, high = clopper_pearson(self.failures, self.draws, confidence)
        return float(low), float(high)


def plain_draws(
    counter: Counter, rng: np.random.Generator, draws: int, dimension: int
) -> tuple[Plain, np.ndarray, np.ndarray]:
    """Make plain draws.

    Returns:
        The plain draws; all their points, shape (draws, d), and slacks, shape (draws,).
    """
    points = rng.standard_normal((draws, dimension))
    slacks = counter(points, counter.fresh(draws))
    return Plain(draws, points[slacks < 0.0]), points, slacks


@dataclass(frozen=True)
class Estimate(ABC):
    """An estimate of a rare failure's probability.

    Args:
        simulations: Number of evaluations of the slack, without those of the plain draws.
        points: Failing points in standard normal space, shape (n, d).
        noise: Their noise indices, shape (n,).
        weights: Their weights, shape (n,), proportional to the probability that each stands for.
        plain: The plain draws.
    """

    simulations: int
    points: np.ndarray = field(repr=False)
    noise: np.ndarray = field(repr=False)
    weights: np.ndarray = field(repr=False)
    plain: Plain

    @property
    @abstractmethod
    def mean(self) -> float:
        """The failure probability without regard to the plain draws."""

    @abstractmethod
    def mean_interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """The interval of :attr:`mean` without regard to the plain draws."""

    @property
    @abstractmethod
    def variation(self) -> float:
        """Coefficient of variation of :attr:`mean`."""

    @property
    @abstractmethod
    def reached(self) -> bool:
        """Whether the method reached enough failures for an answer."""

    @property
    @abstractmethod
    def interval_name(self) -> str:
        """Name of the interval of :attr:`mean`."""

    @property
    def contradicted(self) -> bool:
        """Whether the plain draws' interval and that of :attr:`mean` are disjoint."""
        low, high = self.mean_interval()
        plain_low, plain_high = self.plain.interval()
        return plain_high < low or high < plain_low

    @property
    def answered(self) -> bool:
        """Whether :attr:`mean` is valid: the search reached failures, and plain draws do not contradict it."""
        return self.reached and not self.contradicted

    @property
    def probability(self) -> float:
        """:attr:`mean`, or the share of failed plain draws if it is not valid."""
        return self.mean if self.answered else self.plain.share

    def interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Interval of :attr:`mean`, or from the plain draws if it is not valid."""
        return self.mean_interval(confidence) if self.answered else self.plain.interval(confidence)

    @property
    def method(self) -> str:
        """Name of the interval's method."""
        return self.interval_name if self.answered else f"Clopper-Pearson, {self.plain.draws:,} plain draws"

    @property
    def plain_draws(self) -> float:
        """Number of plain draws that would give the same coefficient of variation."""
        p = self.mean
        return (1.0 - p) / (p * self.variation**2) if p > 0.0 and self.variation > 0.0 else np.inf
