"""The answer of `laws`: how wrong the laws of a study may be before too many draws fail."""

from dataclasses import dataclass
from typing import Annotated, Self

from dssc_jax.analyses.laws.fresh_changes import FreshLimits
from dssc_jax.core.quantities import Quantity
from dssc_jax.results.stated_errors import StatedError
from dssc_jax.statistics.law_changes import Change
from dssc_jax.statistics.worst_changes import LargestChange

DEVIATIONS = "standard deviations"


@dataclass(frozen=True)
class FailureShare:
    """The failure probability under the study's own laws, from the draws of the result."""

    failures: Annotated[int, Quantity("1", "failed draws")]
    probability: Annotated[float, Quantity("1", "failure probability")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval of the failure probability")]
    interval_method: Annotated[str, Quantity("", "method of the interval")]


@dataclass(frozen=True)
class Guaranteed:
    """The largest changes of all laws that keep the limit, however the failing draws lie among all draws."""

    mean_shift: Annotated[float, Quantity(DEVIATIONS, "shift of all means, with confidence")]
    widening: Annotated[
        float | None, Quantity("1", "relative width of all laws, with confidence; None: laws are correlated")
    ]


@dataclass(frozen=True)
class Estimates:
    """How wrong the laws may be by the best estimate, which ignores that the number of draws is finite."""

    total_variation: Annotated[float, Quantity("1", "total variation")]
    kl: Annotated[float, Quantity("nat", "Kullback-Leibler divergence; None: no draw fails")]
    chi_square: Annotated[float, Quantity("1", "chi-square divergence; None: no draw fails")]
    mean_shift: Annotated[float | None, Quantity(DEVIATIONS, "shift of all means; None: not reached by the weights")]
    widening: Annotated[float | None, Quantity("1", "relative width of all laws; None: not reached by the weights")]


@dataclass(frozen=True)
class WeightedAnswer:
    """The largest change of one kind, of all laws at once, that keeps the limit according to the weighted draws."""

    bound: Annotated[float, Quantity("that of the change", "largest change, with confidence")]
    estimate: Annotated[float | None, Quantity("that of the change", "largest change; None: not reached")]
    explored: Annotated[float, Quantity("that of the change", "largest change for which the weights are trusted")]
    probability: Annotated[float, Quantity("1", "weighted failure probability at the estimate, or where they end")]
    effective: Annotated[float, Quantity("1", "effective number of draws there")]
    effective_failures: Annotated[float, Quantity("1", "effective number of failed draws there")]
    reason: Annotated[str, Quantity("", "why the weights say no more; empty: they reach the limit")]

    @classmethod
    def of(cls, largest: LargestChange, change: Change) -> Self:
        """Convert the largest change to the unit of answers: a shift in standard deviations, or a relative width.

        Args:
            largest: The largest change, as a size.
            change: The kind of change, which converts sizes.
        """
        return cls(
            bound=change.amount(largest.bound),
            estimate=None if largest.estimate is None else change.amount(largest.estimate),
            explored=change.amount(largest.explored),
            probability=largest.worst.probability,
            effective=largest.worst.effective,
            effective_failures=largest.worst.failing,
            reason=largest.reason,
        )


@dataclass(frozen=True)
class Knowledge:
    """What it is worth to know in which part of its law a number lies; all parts are equally probable."""

    parts: Annotated[int, Quantity("1", "number of parts")]
    removed: Annotated[float, Quantity("1", "share of the variance of failure that the knowledge removes")]
    removed_interval: Annotated[tuple[float, float], Quantity("1", "interval of that share")]
    changes: Annotated[float, Quantity("1", "probability that the decision about the limit changes")]
    changes_interval: Annotated[tuple[float, float], Quantity("1", "interval of that probability")]


@dataclass(frozen=True)
class LawError:
    """How wrong the law of one number may be while the laws of all other numbers are right."""

    mean_shift: Annotated[float, Quantity(DEVIATIONS, "shift of its mean, with confidence")]
    mean_shift_estimate: Annotated[
        float | None, Quantity(DEVIATIONS, "shift of its mean, without the draws' uncertainty")
    ]
    towards: Annotated[str, Quantity("", "which values fail more often: larger, smaller, or not clear")]
    widening: Annotated[float, Quantity("1", "relative width, with confidence")]
    widening_estimate: Annotated[float | None, Quantity("1", "relative width, without the draws' uncertainty")]
    median: Annotated[float, Quantity("that of the number", "median of its law")]
    shifted_median: Annotated[
        float | None, Quantity("that of the number", "median after the shift, with confidence; None: not clear")
    ]
    in_worst_shift: Annotated[float, Quantity(DEVIATIONS, "its part in the worst shift of all means")]
    failing: Annotated[
        tuple[float, float, float] | None,
        Quantity("that of the number", "5 %, 50 % and 95 % quantile among failed draws; None: no draw fails"),
    ]
    failing_median_interval: Annotated[
        tuple[float, float] | None,
        Quantity("that of the number", "interval of its median among failed draws; None: too few failures"),
    ]
    knowledge: Annotated[Knowledge | None, Quantity("", "what knowing the number is worth; None: too few failures")]


@dataclass(frozen=True)
class LawErrorsAnswer:
    """How wrong the laws may be before the failure probability can exceed the limit: all laws together, and each alone.

    Amounts "with confidence" are safe bounds; those in ``estimates`` ignore that the number of draws is finite.
    """

    requirements: Annotated[tuple[str, ...], Quantity("", "what a draw has to meet")]
    limit: Annotated[float, Quantity("1", "largest failure probability allowed")]
    draws: Annotated[int, Quantity("1", "number of draws")]
    confidence: Annotated[float, Quantity("1", "confidence of each single statement")]
    failure: FailureShare
    total_variation: Annotated[float, Quantity("1", "total variation of the laws, with confidence")]
    kl: Annotated[float, Quantity("nat", "Kullback-Leibler divergence of the true law, with confidence")]
    chi_square: Annotated[float, Quantity("1", "chi-square divergence of the true law, with confidence")]
    mean_shift: Annotated[float, Quantity(DEVIATIONS, "shift of all means, in the worst direction, with confidence")]
    widening: Annotated[float, Quantity("1", "relative width of all laws, with confidence")]
    guaranteed: Guaranteed
    estimates: Estimates
    weights: dict[str, WeightedAnswer]
    most_important: Annotated[str | None, Quantity("", "the number whose mean may be least wrong; None: not reached")]
    measure_next: Annotated[
        str | None, Quantity("", "the number whose knowledge removes most variance; None: none is known to do so")
    ]
    by_law: dict[str, LawError]
    stated: list[StatedError]
    fresh: FreshLimits | None
    seconds: Annotated[float, Quantity("s", "computing time")]
