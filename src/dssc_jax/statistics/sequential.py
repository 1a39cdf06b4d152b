"""Sequential stopping rules that preserve the stated confidence.

If the interval for a fixed number of draws is computed again and again until it is narrow, its coverage falls far below
the nominal value. Here failures are counted only at looks, whose numbers of draws grow geometrically, and the
boundaries at which a rule stops are fixed in advance. The interval accounts for all looks
(:mod:`dssc_jax.statistics.multistage`).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

from dssc_jax.statistics.multistage import Look, multistage_interval
from dssc_jax.statistics.order import first_integer
from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson, require_share

FIRST = 100  # draws of the first look
RATIO = 1.1  # draws of a look, relative to the look before it
SPARSE_RATIO = 1.5  # the same for Wald's test, which is valid for any times of the looks


def look_draws(limit: int, ratio: float) -> list[int]:
    """Numbers of draws at the looks: a geometric sequence from :data:`FIRST` that ends with ``limit``.

    Args:
        limit: Largest number of draws.
        ratio: Ratio of two successive numbers, above 1.
    """
    numbers = []
    draws = FIRST
    while draws < limit:
        numbers.append(draws)
        draws = math.ceil(ratio * draws)
    return [*numbers, limit]


@dataclass(frozen=True)
class UntilWidth:
    """Stopping rule: stop when the interval of the failure probability is narrow enough.

    A run under this rule needs about as many draws as a fixed number that is planned with knowledge of the failure
    probability.

    Args:
        width: Upper minus lower bound, in (0, 1).
        confidence: Coverage of the interval.

    Raises:
        ValueError: An argument is out of range.

    Reference:
        J. Frey, "Fixed-width sequential confidence intervals for a proportion", The American Statistician 64 (2010)
        242-249, on rules of this kind; the interval is due to Jennison and Turnbull.
    """

    width: float
    confidence: float = CONFIDENCE

    def __post_init__(self) -> None:
        """Refuse arguments outside (0, 1)."""
        require_share(width=self.width, confidence=self.confidence)

    @property
    def text(self) -> str:
        """The rule in words."""
        return f"until the {100 * self.confidence:g} % interval is no wider than {self.width:g}"

    @property
    def slug(self) -> str:
        """The rule as part of a folder name."""
        return f"width-{self.width:g}"

    def looks(self, limit: int) -> Iterator[Look]:
        """The looks that can stop the run, up to a look that surely stops it, or to ``limit`` draws.

        The boundaries are symmetric in failures and passes.
        """
        earlier: list[Look] = []
        for draws in look_draws(limit, RATIO):
            lower = self.lower_boundary(earlier, draws)
            can_stop = lower >= 0
            if can_stop or draws == limit:
                look = Look(draws, lower, draws - lower)
                yield look
                earlier.append(look)
            surely_stops = 2 * lower >= draws - 1  # the boundaries meet
            if surely_stops:
                break

    def stops(self, limit: int) -> int:
        """Upper limit of the number of looks in a run of at most ``limit`` draws."""
        return len(look_draws(limit, RATIO))

    def lower_boundary(self, earlier: list[Look], draws: int) -> int:
        """Largest number of failures, up to half the draws, after which the interval is narrow; -1 if there is none.

        The search starts from the boundary for a fixed number of draws, and lowers it until the exact interval after
        all looks is narrow, too.

        Args:
            earlier: Looks before this look.
            draws: Number of draws at this look.
        """
        half = draws // 2

        def is_wide(failures: int) -> bool:
            """Whether the interval is wide after this number of failures, for a fixed number of draws.

            More than half of the draws failing counts as wide, because the boundary lies at or below half.
            """
            low, high = clopper_pearson(min(failures, half), draws, self.confidence)
            return failures > half or bool(high - low > self.width)

        lower = first_integer(is_wide, 0) - 1
        while lower >= 0:
            looks = [*earlier, Look(draws, lower, draws - lower)]
            if self.width_after(looks, lower) <= self.width:
                break
            lower -= 1
        return lower

    def width_after(self, looks: list[Look], failures: int) -> float:
        """Width of the exact interval after a stop at the last look."""
        low, high = multistage_interval(looks, failures, self.confidence)
        return high - low

    def verdict(self, look: Look, failures: int) -> str | None:
        """The verdict ``narrow`` if the rule stops at a look with this number of failures; None: the run goes on."""
        stops = failures <= look.lower or failures >= look.upper
        return "narrow" if stops else None


@dataclass(frozen=True)
class AcceptReject:
    """Stopping rule: Wald's sequential test of a failure probability p <= ``accept`` against p >= ``reject``.

    The test stops when the likelihood ratio of the two hypotheses reaches 1/a or a, where a = 1 - confidence. So the
    probability of a wrong acceptance is at most a, and so is the probability of a wrong rejection, for any times of the
    looks (Ville).

    Args:
        accept: Acceptable failure probability, in (0, reject).
        reject: Unacceptable failure probability, in (accept, 1).
        confidence: Confidence 1 - a of the verdict.

    Raises:
        ValueError: An argument is out of range.

    Reference:
        A. Wald, Annals of Mathematical Statistics 16 (1945) 117-186.
    """

    accept: float
    reject: float
    confidence: float = CONFIDENCE

    def __post_init__(self) -> None:
        """Refuse probabilities that are out of range or in the wrong order."""
        require_share(accept=self.accept, reject=self.reject, confidence=self.confidence)
        if not self.accept < self.reject:
            raise ValueError(f"accept must be below reject, got {self.accept:g} and {self.reject:g}")

    @property
    def text(self) -> str:
        """The rule in words."""
        return (
            f"until a failure probability <= {self.accept:g} is accepted, or one >= {self.reject:g} rejected, "
            f"with confidence {self.confidence:g}"
        )

    @property
    def slug(self) -> str:
        """The rule as part of a folder name."""
        return f"accept-{self.accept:g}-reject-{self.reject:g}"

    def looks(self, limit: int) -> Iterator[Look]:
        """The looks up to ``limit`` draws, with the boundaries at which the likelihood ratio decides.

        Each failed draw adds the log likelihood ratio of ``reject`` to ``accept`` for a failure, and each pass adds
        that for a pass. The test decides where the sum reaches -ln(1/a) or ln(1/a).
        """
        log_ratio_of_failure = math.log(self.reject / self.accept)
        log_ratio_of_pass = math.log1p(-self.reject) - math.log1p(-self.accept)
        bound = -math.log(1.0 - self.confidence)
        slope = log_ratio_of_failure - log_ratio_of_pass  # of the sum over the failures
        for draws in look_draws(limit, SPARSE_RATIO):
            lower = math.floor((-bound - draws * log_ratio_of_pass) / slope)
            upper = math.ceil((bound - draws * log_ratio_of_pass) / slope)
            yield Look(draws, max(lower, -1), min(upper, draws + 1))  # -1 and draws + 1: no stop

    def stops(self, limit: int) -> int:
        """Number of looks in a run of ``limit`` draws."""
        return len(look_draws(limit, SPARSE_RATIO))

    def verdict(self, look: Look, failures: int) -> str | None:
        """The verdict ``accepted`` or ``rejected`` at a look with this number of failures; None: the run goes on."""
        if failures <= look.lower:
            return "accepted"
        return "rejected" if failures >= look.upper else None


StoppingRule: TypeAlias = UntilWidth | AcceptReject
