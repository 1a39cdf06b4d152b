"""Stopping when the draws have said enough, without losing the confidence that is printed.

Looking at a fixed-n interval again and again until it is narrow covers far less than it says. Here the looks are at
a geometric sequence n_1 < n_2 < ..., the error is shared out over them, and the interval printed is that of the look.
"""

import math
from dataclasses import dataclass

from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson, look_error, require_share

FIRST, RATIO = 100, 1.5  # draws of the first look, and each look's multiple of the one before


def looks(most: int) -> list[int]:
    """Numbers of draws at which one looks: a geometric sequence that ends with ``most``."""
    numbers, draws = [], FIRST
    while draws < most:
        numbers.append(draws)
        draws = math.ceil(RATIO * draws)
    return [*numbers, most]


@dataclass(frozen=True)
class UntilWidth:
    """Stop when the interval of the failure probability is narrow enough.

    Args:
        width: Upper less lower bound, in (0, 1).
        confidence: Coverage of the interval.

    Raises:
        ValueError: an argument is out of range.

    Reference:
        H. Robbins, Annals of Mathematical Statistics 41 (1970) 1397-1409, on sharing out the error over looks.
    """

    width: float
    confidence: float = CONFIDENCE

    def __post_init__(self) -> None:
        require_share(width=self.width, confidence=self.confidence)

    @property
    def text(self) -> str:
        """The rule, for people."""
        return f"until the {100 * self.confidence:g} % interval is no wider than {self.width:g}"

    @property
    def slug(self) -> str:
        """The rule, for the name of a folder."""
        return f"width-{self.width:g}"

    def verdict(self, failures: int, draws: int, look: int) -> str | None:
        """``narrow`` when it is; None: go on."""
        low, high = clopper_pearson(failures, draws, 1.0 - look_error(look, 1.0 - self.confidence))
        return "narrow" if high - low <= self.width else None


@dataclass(frozen=True)
class AcceptReject:
    """Wald's sequential test of p <= ``accept`` against p >= ``reject``.

    The likelihood ratio of the two is compared with 1/a and a: the probability of accepting a loop that is to be
    rejected, or of rejecting one that is to be accepted, is at most a = 1 - confidence, whenever one looks (Ville).

    Args:
        accept: Failure probability that is good enough, in (0, reject).
        reject: Failure probability that is too high, in (accept, 1).
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
        """The rule, for people."""
        return (
            f"until a failure probability <= {self.accept:g} is accepted, or one >= {self.reject:g} rejected, "
            f"with confidence {self.confidence:g}"
        )

    @property
    def slug(self) -> str:
        """The rule, for the name of a folder."""
        return f"accept-{self.accept:g}-reject-{self.reject:g}"

    def verdict(self, failures: int, draws: int, look: int) -> str | None:
        """``accepted``, ``rejected``, or None: go on. The test needs no sharing out over looks."""
        ratio = failures * math.log(self.reject / self.accept)
        ratio += (draws - failures) * (math.log1p(-self.reject) - math.log1p(-self.accept))
        bound = -math.log(1.0 - self.confidence)
        if abs(ratio) < bound:
            return None
        return "rejected" if ratio > 0.0 else "accepted"
