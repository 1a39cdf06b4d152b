"""Sequential stopping rules that preserve the stated confidence.

Checking a fixed-n interval repeatedly until it is narrow reduces its coverage far below the nominal value. Here
failures are counted only at looks, whose numbers of draws grow geometrically, and the boundaries at which the rule
stops are fixed in advance. The printed interval accounts for all looks (:mod:`dssc_jax.statistics.multistage`).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

from dssc_jax.statistics.multistage import Look, multistage_interval
from dssc_jax.statistics.order import first
from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson, require_share

FIRST = 100  # draws of the first look
RATIO = 1.1  # ratio of a look's draws to those of the look before it
SPARSE_RATIO = 1.5  # the same for a test whose verdict does not depend on the looks


def looks(limit: int, ratio: float) -> list[int]:
    """Numbers of draws at the looks: a geometric sequence that ends with ``limit``."""
    numbers = []
    draws = FIRST
    while draws < limit:
        numbers.append(draws)
        draws = math.ceil(ratio * draws)
    return [*numbers, limit]


@dataclass(frozen=True)
class UntilWidth:
    """Stop when the interval of the failure probability is narrow enough.

    It takes about as many draws as a fixed number chosen with knowledge of the failure probability.

    Args:
        width: Upper minus lower bound, in (0, 1).
        confidence: Coverage of the interval.

    Raises:
        ValueError: an argument is out of range.

    Reference:
        J. Frey, "Fixed-width sequential confidence intervals for a proportion", The American Statistician 64 (2010)
        242-249, on rules of this kind; the interval is that of Jennison and Turnbull.
    """

    width: float
    confidence: float = CONFIDENCE

    def __post_init__(self) -> None:
        require_share(width=self.width, confidence=self.confidence)

    @property
    def text(self) -> str:
        """Text of the rule."""
        return f"until the {100 * self.confidence:g} % interval is no wider than {self.width:g}"

    @property
    def slug(self) -> str:
        """The rule as part of a folder name."""
        return f"width-{self.width:g}"

    def looks(self, most: int) -> Iterator[Look]:
        """The looks from the first that can stop the run to the one that must, or to ``most`` draws."""
        earlier: list[Look] = []
        for draws in looks(most, RATIO):
            lower = self.lower(earlier, draws)
            if lower >= 0 or draws == most:
                look = Look(draws, lower, draws - lower)
                yield look
                earlier.append(look)
            if 2 * lower >= draws - 1:
                break

    def stops(self, most: int) -> int:
        """An upper limit of the number of looks."""
        return len(looks(most, RATIO))

    def lower(self, earlier: list[Look], draws: int) -> int:
        """The lower boundary: the most failures, up to half the draws, with a narrow interval; -1: none."""

        def wide(failures: int) -> bool:
            low, high = clopper_pearson(min(failures, draws // 2), draws, self.confidence)
            return failures > draws // 2 or bool(high - low > self.width)

        lower = first(wide, 0) - 1
        while lower >= 0 and self.length([*earlier, Look(draws, lower, draws - lower)], lower) > self.width:
            lower -= 1
        return lower

    def length(self, looks: list[Look], failures: int) -> float:
        """Length of the interval after a stop."""
        low, high = multistage_interval(looks, failures, self.confidence)
        return high - low

    def verdict(self, look: Look, failures: int) -> str | None:
        """``narrow`` if the interval is narrow enough; None: continue."""
        return "narrow" if failures <= look.lower or failures >= look.upper else None


@dataclass(frozen=True)
class AcceptReject:
    """Wald's sequential test of p <= ``accept`` against p >= ``reject``.

    The likelihood ratio of the two is compared with 1/a and a: the probability of accepting a loop that is to be
    rejected, or of rejecting one that is to be accepted, is at most a = 1 - confidence, for any times of the looks
    (Ville).

    Args:
        accept: Acceptable failure probability, in (0, reject).
        reject: Unacceptable failure probability, in (accept, 1).
        confidence: 1 - a.

    Raises:
        ValueError: an argument is out of range.

    Reference:
        A. Wald, Annals of Mathematical Statistics 16 (1945) 117-186.
    """

    accept: float
    reject: float
    confidence: float = CONFIDENCE

    def __post_init__(self) -> None:
        require_share(accept=self.accept, reject=self.reject, confidence=self.confidence)
        if not self.accept < self.reject:
            raise ValueError(f"accept must be below reject, got {self.accept:g} and {self.reject:g}")

    @property
    def text(self) -> str:
        """Text of the rule."""
        return (
            f"until a failure probability <= {self.accept:g} is accepted, or one >= {self.reject:g} rejected, "
            f"with confidence {self.confidence:g}"
        )

    @property
    def slug(self) -> str:
        """The rule as part of a folder name."""
        return f"accept-{self.accept:g}-reject-{self.reject:g}"

    def looks(self, most: int) -> Iterator[Look]:
        """The looks up to ``most`` draws, with the numbers of failures at which the likelihood ratio decides."""
        log_ratio_of_failure = math.log(self.reject / self.accept)
        log_ratio_of_pass = math.log1p(-self.reject) - math.log1p(-self.accept)
        bound = -math.log(1.0 - self.confidence)
        for draws in looks(most, SPARSE_RATIO):
            lower = math.floor((-bound - draws * log_ratio_of_pass) / (log_ratio_of_failure - log_ratio_of_pass))
            upper = math.ceil((bound - draws * log_ratio_of_pass) / (log_ratio_of_failure - log_ratio_of_pass))
            yield Look(draws, max(lower, -1), min(upper, draws + 1))

    def stops(self, most: int) -> int:
        """The number of looks."""
        return len(looks(most, SPARSE_RATIO))

    def verdict(self, look: Look, failures: int) -> str | None:
        """``accepted``, ``rejected``, or None: continue."""
        if failures <= look.lower:
            return "accepted"
        return "rejected" if failures >= look.upper else None


StoppingRule: TypeAlias = UntilWidth | AcceptReject
