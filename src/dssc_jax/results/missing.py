"""Draws that have no value of a metric: what they count as in a summary, and what its None stands for."""

import math
from collections.abc import Callable

from dssc_jax.results.summary import QUANTILES, SummaryRow, quantile_name
from dssc_jax.study import Study

REASONS = {"ended_early": "ended early", "undefined": "ran to the end"}
"""Entries with counts of draws without a value in a metric's summary, and a text on what happened to these draws."""


def quantile_value(quantiles: SummaryRow, level: str, worst: float) -> float:
    """A quantile of a metric as a number, with the right infinite value in place of None.

    If a lower quantile is finite, the value is inf. If a higher one is finite, the value is -inf. Otherwise it is
    ``worst``, or inf if ``worst`` is finite.

    Args:
        quantiles: Entry of a metric in the summary of a point.
        level: Name of the quantile, such as ``q50``.
        worst: Value that a draw without a value counts as, :attr:`Metric.worst`.
    """
    value = quantiles[level]
    if value is not None:
        return value
    names = [quantile_name(share) for share in QUANTILES]
    place = names.index(level)
    if any(quantiles[name] is not None for name in names[:place]):
        return math.inf
    if any(quantiles[name] is not None for name in names[place + 1 :]):
        return -math.inf
    return worst if math.isinf(worst) else math.inf


def without_value_texts(study: Study, point: SummaryRow, number: Callable[[float], str]) -> list[str]:
    """Sentences on the draws of a point that have no value of a metric: how many, why, and what they count as.

    Args:
        study: The study.
        point: Summary of the point.
        number: (value that a draw counts as) -> text.

    Example of a sentence:
        75 draws that ended early have no value, and count as inf, but as -inf in lowest_y
    """
    sentences = []
    for reason, reason_text in REASONS.items():
        for count in sorted({row[reason] for row in point["metrics"].values()} - {0}, reverse=True):
            names = [name for name, row in point["metrics"].items() if row[reason] == count]
            names_by_worst: dict[float, list[str]] = {}
            for measure in study.measures:
                if measure.name in names:
                    names_by_worst.setdefault(measure.metric.worst, []).append(measure.name)
            of_which = "" if len(names) == len(study.measures) else f" of {', '.join(names)}"
            draws = f"{count:,} draw{'s' if count > 1 else ''} that {reason_text}"
            has = "have" if count > 1 else "has"
            verb = "count" if count > 1 else "counts"
            sentences.append(f"{draws} {has} no value{of_which}, and {verb} as {worsts_text(names_by_worst, number)}")
    return sentences


def worsts_text(names_by_worst: dict[float, list[str]], number: Callable[[float], str]) -> str:
    """Text on what draws count as: the value of most metrics, then other values with the names of their metrics."""
    ordered = sorted(names_by_worst, key=lambda worst: -len(names_by_worst[worst]))
    first, *others = ordered
    texts = [number(first)]
    texts += [f"as {number(worst)} in {' and '.join(names_by_worst[worst])}" for worst in others]
    return ", but ".join(texts)
