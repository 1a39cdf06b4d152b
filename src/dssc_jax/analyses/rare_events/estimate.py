"""The contract of estimates of a rare failure's probability, and plain draws, which may contradict an estimate."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.slacks import SlackCounter
from dssc_jax.statistics import CONFIDENCE, clopper_pearson


class PlainDraws(NamedTuple):
    """Plain independent draws, which check the estimate of a method for rare failures.

    Args:
        draws: Number of plain draws.
        points: The draws that failed, in standard normal space, shape (failures, d).
    """

    draws: int
    points: np.ndarray

    @property
    def failures(self) -> int:
        """Number of plain draws that failed."""
        return len(self.points)

    @property
    def share(self) -> float:
        """Share of the plain draws that failed, which estimates the failure probability."""
        return self.failures / self.draws

    def interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Lower and upper end of the exact interval of the failure probability from these draws (Clopper-Pearson)."""
        low, high = clopper_pearson(self.failures, self.draws, confidence)
        return float(low), float(high)


class PlainSimulations(NamedTuple):
    """All simulated plain draws, failed or not.

    Args:
        points: The draws in standard normal space, shape (n, d).
        slacks: Slack of each draw, shape (n,).
    """

    points: np.ndarray
    slacks: np.ndarray

    @property
    def draws(self) -> PlainDraws:
        """The number of plain draws, and the points of those that failed."""
        return PlainDraws(len(self.points), self.points[self.slacks < 0.0])


def simulate_plain_draws(
    counter: SlackCounter, rng: np.random.Generator, draws: int, dimension: int
) -> PlainSimulations:
    """Simulate plain draws, each with in-loop noise of its own.

    Args:
        counter: Computes slacks in standard normal space.
        rng: Random generator.
        draws: Number of draws.
        dimension: Number d of coordinates.
    """
    points = rng.standard_normal((draws, dimension))
    return PlainSimulations(points, counter(points, counter.unused_noise(draws)))


@dataclass(frozen=True)
class Estimate(ABC):
    """The probability of a rare failure, estimated by some method and checked by plain draws.

    The answer of the plain draws replaces the answer of the method if the two contradict each other.

    Args:
        simulations: Number of simulations of the method, without the plain draws.
        points: Failing points of the method in standard normal space, shape (n, d).
        noise_index: Index of the in-loop noise of each point, shape (n,).
        weights: Weight of each point, proportional to the probability that the point stands for, shape (n,).
        plain: The plain draws.
    """

    simulations: int
    points: np.ndarray = field(repr=False)
    noise_index: np.ndarray = field(repr=False)
    weights: np.ndarray = field(repr=False)
    plain: PlainDraws

    @property
    @abstractmethod
    def mean(self) -> float:
        """The failure probability by the method, whatever the plain draws say."""

    @abstractmethod
    def mean_interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Lower and upper end of the interval of :attr:`mean`."""

    @property
    @abstractmethod
    def variation(self) -> float:
        """Coefficient of variation of :attr:`mean`: its standard deviation divided by its value."""

    @property
    @abstractmethod
    def reached(self) -> bool:
        """Whether the method reached enough failures for an answer."""

    @property
    @abstractmethod
    def interval_name(self) -> str:
        """How :meth:`mean_interval` is computed, for reports."""

    @property
    def contradicted(self) -> bool:
        """Whether the interval by the plain draws and the interval by the method have no value in common."""
        low, high = self.mean_interval()
        plain_low, plain_high = self.plain.interval()
        return plain_high < low or high < plain_low

    @property
    def answered(self) -> bool:
        """Whether the method has a valid answer: it reached enough failures, and plain draws do not contradict it."""
        return self.reached and not self.contradicted

    @property
    def probability(self) -> float:
        """The failure probability by the method, or by the plain draws if the method has no valid answer."""
        return self.mean if self.answered else self.plain.share

    def interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Lower and upper end of the interval of :attr:`probability`."""
        return self.mean_interval(confidence) if self.answered else self.plain.interval(confidence)

    @property
    def method(self) -> str:
        """How the interval of :attr:`probability` is computed, for reports."""
        return self.interval_name if self.answered else f"Clopper-Pearson, {self.plain.draws:,} plain draws"

    @property
    def equivalent_draws(self) -> float:
        """Number of plain draws that would estimate the probability with the same coefficient of variation.

        Infinite without failures.

        The share of n draws has the coefficient of variation sqrt((1 - p)/(n p)) at the failure probability p.
        """
        p = self.mean
        if p == 0.0 or self.variation == 0.0:
            return np.inf
        return (1.0 - p) / (p * self.variation**2)
