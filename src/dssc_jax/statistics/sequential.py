"""Sequential stopping rules that preserve the stated confidence.

Checking a fixed-n interval repeatedly until it is narrow reduces its coverage far below the nominal value. Here the
looks form a geometric sequence n_1 < n_2 < ..., the error probability is divided among them, and the printed interval
is that of the last look.
"""

import math
from dataclasses import dataclass

from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson, look_error, require_share

FIRST = 100  # draws of the first look
RATIO = 1.5  # of a look's draws to those of the look before it


def looks(limit: int) -> list[int]:
    """Numbers of draws at the looks: a geometric sequence that ends with ``limit``."""
    numbers = []
    draws = FIRST
    while draws < limit:
        numbers.append(draws)
        draws = math.ceil(RATIO * draws)
    return [*numbers, limit]


@dataclass(frozen=True)
class UntilWidth:
    """Stop when the interval of the failure probability is narrow enough.

    Args:
        width: Upper minus lower bound, in (0, 1).
        confidence: Coverage of the interval.

    Raises:
        ValueError: an argument is out of range.

    Reference:
        H. Robbins, Annals of Mathematical Statistics 41 (1970) 1397-1409, on dividing the error among looks.
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

    def verdict(self, failures: int, draws: int, look: int) -> str | None:
        """``narrow`` if it is; None: continue."""
        low, high = clopper_pearson(failures, draws, 1.0 - look_error(look, 1.0 - self.confidence))
        return "narrow" if high - low <= self.width else None


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

    def verdict(self, failures: int, draws: int, look: int) -> str | None:
        """``accepted``, ``rejected``, or None: continue. The test needs no division of the error among looks."""
        ratio = failures * math.log(self.reject / self.accept)
        ratio += (draws - failures) * (math.log1p(-self.reject) - math.log1p(-self.accept))
        bound = -math.log(1.0 - self.confidence)
        if abs(ratio) < bound:
            return None
        return "rejected" if ratio > 0.0 else "accepted"
