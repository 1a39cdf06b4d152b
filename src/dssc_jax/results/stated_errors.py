"""Intervals of the failure probability if the laws are wrong by stated amounts."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.quantities import Quantity
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.results.scored_draws import ScoredDraws
from dssc_jax.statistics import CONFIDENCE, Method, Replicated
from dssc_jax.statistics.divergence_balls import BALLS
from dssc_jax.statistics.law_changes import Shift, Widening
from dssc_jax.study import Study

NO_LAW = "no law can be changed; give at least one number a law that is not a choice"
STATED = "stated"
"""The manifest's entry with the amounts by which the laws may be wrong."""


@dataclass(frozen=True)
class StatedError:
    """An amount by which the laws may be wrong, and the intervals of the failure probability that follow."""

    kind: Annotated[str, Quantity("", "total_variation, kl, chi_square, mean_shift or widening")]
    amount: Annotated[float, Quantity("that of the kind", "how wrong the laws may be")]
    interval: Annotated[
        tuple[float, float] | None,
        Quantity("1", "interval of the failure probability, whatever draws fail; None: laws are correlated"),
    ]
    weighted_interval: Annotated[
        tuple[float, float] | None,
        Quantity("1", "interval by the draws' weights; None: they say nothing, or are not needed"),
    ]

    @property
    def text(self) -> str:
        """Kind and amount, in words."""
        return f"{self.kind.replace('_', ' ')} up to {self.amount:g}"

    @property
    def weights_refused(self) -> str:
        """Reason why the draws' weights give no interval; empty if they give one, or are not needed."""
        if self.weighted_interval is not None or self.kind in BALLS:
            return ""
        return "the weights are too uneven, or too few draws fail"


@dataclass(frozen=True)
class StatedAmounts:
    """Amounts by which the laws of a study may be wrong, as the user states them; false if no amount is stated.

    Args:
        within: Largest divergence of the true law, by name of the divergence in
            :data:`dssc_jax.statistics.divergence_balls.BALLS`.
        shift: Largest shift of the means [standard deviations]; None: not stated.
        widening: Largest relative width of the laws, at least 1; None: not stated.

    Raises:
        ConfigError: An amount is out of range.
    """

    within: Mapping[str, float]
    shift: float | None
    widening: float | None

    def __post_init__(self) -> None:
        """Refuse unknown divergences and amounts that are out of range."""
        for name, radius in self.within.items():
            if name not in BALLS:
                raise ConfigError("within", f"'{name}' is no divergence; {nearest(name, BALLS)}")
            if not 0.0 <= radius < math.inf:
                raise ConfigError("within", f"the radius of {name} must be finite and 0 or more, got {radius:g}")
        if self.shift is not None and not 0.0 <= self.shift < math.inf:
            raise ConfigError("shift", f"must be finite and 0 or more, got {self.shift:g}")
        if self.widening is not None and not 1.0 <= self.widening < math.inf:
            raise ConfigError("widening", f"must be finite and 1 or more, got {self.widening:g}")

    def __bool__(self) -> bool:
        """Whether any amount is stated."""
        return bool(self.within) or self.shift is not None or self.widening is not None

    @property
    def entry(self) -> dict[str, object]:
        """The amounts as an entry of the manifest, from which :meth:`of` reads them."""
        return {"within": dict(self.within), "shift": self.shift, "widening": self.widening}

    @classmethod
    def of(cls, entry: JsonObject) -> "StatedAmounts":
        """Read the amounts from an entry of the manifest.

        Raises:
            ConfigError: The entry is damaged.
        """
        try:
            within = {str(name): float(radius) for name, radius in entry["within"].items()}
            shift = None if entry["shift"] is None else float(entry["shift"])
            widening = None if entry["widening"] is None else float(entry["widening"])
        except (AttributeError, KeyError, TypeError, ValueError):
            raise ConfigError("stated", f"must be the amounts by which laws may be wrong, got {entry!r}") from None
        return cls(within, shift, widening)

    def require(self, study: Study) -> None:
        """Refuse a study for which these amounts give no intervals.

        Raises:
            ConfigError: The study has a sweep, its draws are not independent, or no law can be shifted or widened.
        """
        if study.axes:
            rule = f"has a sweep over {', '.join(study.axes)}; how wrong its laws may be is a question about one point"
            raise ConfigError(study.source, rule)
        require_independent(study, "an interval for wrong laws")
        changes_all_laws = self.shift is not None or self.widening is not None
        if changes_all_laws and not any(law.movable for law in study.laws.values()):
            raise ConfigError(study.source, NO_LAW)

    def errors(self, draws: ScoredDraws, interval: tuple[float, float], confidence: float) -> list[StatedError]:
        """The intervals of the failure probability for each amount.

        Args:
            draws: The draws as scores, with the information which of them failed.
            interval: Interval of the failure probability under the present laws.
            confidence: Confidence of the intervals by the draws' weights.
        """
        bounds = draws.bounds(interval)
        movable_laws = draws.free(draws.names)
        errors = []
        for name, radius in self.within.items():
            interval_in_ball = BALLS[name].interval(interval, radius)
            errors.append(StatedError(name, radius, interval_in_ball, weighted_interval=None))  # needs no weights
        if self.shift is not None:
            interval_of_any = bounds.interval_after_shift(movable_laws, self.shift)
            weighted_interval = draws.weighted(Shift, confidence).interval_within(self.shift)
            errors.append(StatedError("mean_shift", self.shift, interval_of_any, weighted_interval))
        if self.widening is not None:
            interval_of_any = bounds.interval_after_widening(movable_laws, self.widening)
            weighted_interval = draws.weighted(Widening, confidence).interval_within(math.log(self.widening))
            errors.append(StatedError("widening", self.widening, interval_of_any, weighted_interval))
        return errors


def confidence_of(method: Method, confidence: float = CONFIDENCE) -> float:
    """Confidence with which a statement must be computed so that it holds with the nominal confidence.

    The function is for statements other than the failure interval. A stopping rule with several looks requires a higher
    confidence, since each look could have been the last one.

    Args:
        method: The method of the intervals.
        confidence: The nominal confidence.
    """
    if isinstance(method, Replicated):
        return confidence
    return method.confidence_per_look(confidence)
