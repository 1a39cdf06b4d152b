"""Worst failure probability over all laws within a divergence of the assumed law, and the divergence a limit allows.

Let P be the assumed law of a draw, Q the true law, F the set of draws that fail, p = P(F) and q = Q(F). No divergence
grows when a draw is reduced to "fails or not": D(Ber(q), Ber(p)) <= D(Q, P). A law whose density relative to P is q/p
on F and (1-q)/(1-p) elsewhere attains the bound. So the worst case over all laws within D(Q, P) <= r, of any number of
uncertain numbers, is a problem in one dimension: the largest q with D(Ber(q), Ber(p)) <= r.

Both the worst probability and the radius that a limit allows are monotone in p. An end of an interval of p therefore
gives a bound with the confidence of that interval.

References:
    I. Csiszár, Studia Scientiarum Mathematicarum Hungarica 2 (1967) 299-318: a divergence does not grow when a draw is
    reduced to its outcome.
    A. Ben-Tal, D. den Hertog, A. De Waegenaere, B. Melenberg, G. Rennen, Management Science 59 (2013) 341-357: the
    worst case over such balls.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from scipy import special

from dssc_jax.core.bisection import bisect

HALVINGS = 80  # halvings of [p, 1]: the last digit of any probability above 1e-8


@dataclass(frozen=True)
class DivergenceBall(ABC):
    """A measure of how far a true law is from the assumed law, a divergence, and the bounds that follow from it.

    The ball of a radius contains all laws whose divergence from the assumed law is at most the radius. The methods give
    the extreme failure probabilities in such a ball.
    """

    title: ClassVar[str]
    """Name of the divergence in words."""

    @abstractmethod
    def divergence(self, q: float, p: float) -> float:
        """Least divergence D(Ber(q), Ber(p)) of a law with failure probability q from a law with failure probability p.

        Args:
            q: Failure probability of the true law, in [0, 1].
            p: Failure probability of the assumed law, in [0, 1].
        """

    @abstractmethod
    def worst(self, p: float, radius: float) -> float:
        """Largest failure probability of any law within the radius.

        Args:
            p: Failure probability of the assumed law, in [0, 1].
            radius: Largest divergence, >= 0.

        Raises:
            ValueError: An argument is out of range.
        """

    def best(self, p: float, radius: float) -> float:
        """Smallest failure probability of any law within the radius: 1 minus the largest probability of passing.

        Args:
            p: Failure probability of the assumed law, in [0, 1].
            radius: Largest divergence, >= 0.
        """
        return 1.0 - self.worst(1.0 - p, radius)

    def interval(self, interval: tuple[float, float], radius: float) -> tuple[float, float]:
        """Interval that contains the failure probability of every law within the radius.

        Args:
            interval: Confidence interval of the failure probability of the assumed law.
            radius: Largest divergence, >= 0.

        Returns:
            Lower and upper limit, with the confidence of ``interval``.
        """
        low, high = interval
        return self.best(low, radius), self.worst(high, radius)

    def largest_radius(self, p: float, limit: float) -> float:
        """Largest radius within which no law has a failure probability above the limit.

        Args:
            p: Failure probability of the assumed law, in [0, 1]. With the upper limit of its interval, the result is a
                lower limit of the radius.
            limit: Largest failure probability allowed, in (0, 1).

        Returns:
            The radius; 0 if p is at the limit or above. Infinity if p is 0 and remains 0 under every law within a
            finite radius.

        Raises:
            ValueError: An argument is out of range.

        Example:
            >>> round(KullbackLeibler().largest_radius(0.01, 0.05), 6)
            0.041291
        """
        require_probability(p=p)
        if not 0.0 < limit < 1.0:
            raise ValueError(f"limit must lie in (0, 1), got {limit!r}")
        return 0.0 if p >= limit else self.divergence(limit, p)


class TotalVariation(DivergenceBall):
    """Total variation: the largest difference between the probabilities of an event under the two laws."""

    title = "total variation"

    def divergence(self, q: float, p: float) -> float:
        """Total variation |q - p| between the outcomes, fails or not."""
        return abs(q - p)

    def worst(self, p: float, radius: float) -> float:
        """Largest failure probability min(1, p + r) within the radius r."""
        require_ball(p, radius)
        return min(1.0, p + radius)


class KullbackLeibler(DivergenceBall):
    """Kullback-Leibler divergence of the true law Q from the assumed law P: the mean of ln dQ/dP under Q [nat]."""

    title = "Kullback-Leibler divergence"

    def divergence(self, q: float, p: float) -> float:
        """Divergence q ln(q/p) + (1-q) ln((1-q)/(1-p)) between the outcomes, fails or not [nat]."""
        return float(special.rel_entr(q, p) + special.rel_entr(1.0 - q, 1.0 - p))

    def worst(self, p: float, radius: float) -> float:
        """Largest failure probability q within the radius, by bisection: the divergence of q equals the radius."""
        require_ball(p, radius)
        if p in (0.0, 1.0) or radius == 0.0:
            return p
        if radius >= -math.log(p):  # the divergence of q = 1
            return 1.0
        _, upper = bisect(lambda q: self.divergence(float(q), p) <= radius, inside=p, outside=1.0, halvings=HALVINGS)
        return float(upper)


class ChiSquare(DivergenceBall):
    """Chi-square divergence of the true law Q from the assumed law P: the variance of dQ/dP under P."""

    title = "chi-square divergence"

    def divergence(self, q: float, p: float) -> float:
        """Divergence (q - p)^2 / (p (1 - p)) between the outcomes, fails or not."""
        if q == p:
            return 0.0
        if p in (0.0, 1.0):
            return math.inf
        return (q - p) ** 2 / (p * (1.0 - p))

    def worst(self, p: float, radius: float) -> float:
        """Largest failure probability min(1, p + sqrt(r p (1 - p))) within the radius r."""
        require_ball(p, radius)
        return min(1.0, p + math.sqrt(radius * p * (1.0 - p)))


BALLS: dict[str, DivergenceBall] = {
    "total_variation": TotalVariation(),
    "kl": KullbackLeibler(),
    "chi_square": ChiSquare(),
}
"""Each divergence by its name in commands and results."""


def require_probability(**probabilities: float) -> None:
    """Refuse a probability outside [0, 1].

    Args:
        probabilities: Probabilities by name, for the message.

    Raises:
        ValueError: A probability lies outside.
    """
    for name, value in probabilities.items():
        if not 0.0 <= value <= 1.0:
            raise ValueError(f"{name} must lie in [0, 1], got {value!r}")


def require_ball(p: float, radius: float) -> None:
    """Refuse a probability outside [0, 1] and a negative radius.

    Raises:
        ValueError: An argument is out of range.
    """
    require_probability(p=p)
    if not radius >= 0.0:
        raise ValueError(f"radius must be 0 or more, got {radius!r}")
