"""Summary of the points of a sweep: failures, violations of each requirement, quantiles of the metrics."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from itertools import combinations
from operator import itemgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import xarray as xr

from dssc_jax.closed_loop.metrics.requirements import ended_early, first_violation, violated
from dssc_jax.closed_loop.metrics.streaming import Metric
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.signals import Outcome
from dssc_jax.results.fields import MERGED
from dssc_jax.results.schema import outcome_codes
from dssc_jax.statistics import Method, Replicated
from dssc_jax.statistics.order import at_rank, quantile_ranks, sorted_draws, upper_quantile
from dssc_jax.study import Study

QUANTILES = (0.05, 0.5, 0.95)  # levels of a metric's quantiles
BATCH_LANES = 2**20
"""Largest number of lanes that are summarised at a time."""
BATCH_POINTS = 4096
"""Largest number of points that are summarised at a time."""
FEW_PAIRS = 3
"""Up to this number of pairs of requirements, a summary also has the pairs that no completed draw violates."""
SummaryRow: TypeAlias = JsonObject
"""Summary of a point, or of a requirement at a point, for JSON."""

Summary: TypeAlias = JsonObject
"""Summary of a result for JSON; its ``points`` are a list of :data:`SummaryRow`."""


class Statements(NamedTuple):
    """Makes the columns of statistical statements about many points, with one method and one confidence.

    A column has an entry for each point. The methods return columns by name.

    Args:
        method: Method of the intervals for this design of the draws.
        confidence: Confidence of each single interval.
    """

    method: Method
    confidence: float

    def failures(self, failed: np.ndarray) -> dict[str, list[object]]:
        """Columns with number, share and interval of failures.

        Args:
            failed: Whether each draw failed, shape (points, draws).
        """
        return frequency(failed, self.method.failure_interval(failed, self.confidence))

    def shares(self, happened: np.ndarray) -> dict[str, list[object]]:
        """Columns with number, share and interval of an event.

        Args:
            happened: Whether the event happened in each draw, shape (points, draws).
        """
        return frequency(happened, self.method.interval(happened, self.confidence))

    def quantiles(self, values: np.ndarray, missing: float) -> dict[str, list[object]]:
        """Columns with the quantiles of a metric, such as ``q95``, and their intervals, such as ``q95_interval``.

        An infinite entry becomes None. Draws that are not independent have no intervals.

        Args:
            values: Values of a metric, shape (points, draws).
            missing: Value in place of NaN, which stands for a draw without a value.
        """
        sorted_values = sorted_draws(values, missing)
        columns = {}
        for level in QUANTILES:
            name = quantile_name(level)
            columns[name] = upper_quantile(sorted_values, level)
            if not isinstance(self.method, Replicated):
                ranks = quantile_ranks(sorted_values.shape[-1], level, self.method.confidence_per_look(self.confidence))
                ends = [at_rank(sorted_values, rank) for rank in ranks]
                columns[f"{name}_interval"] = np.stack(ends, axis=-1)
        return {name: none_if_infinite(column) for name, column in columns.items()}


def quantile_name(level: float) -> str:
    """The name of a quantile in a summary, such as ``q95``."""
    return f"q{100 * level:g}"


def frequency(happened: np.ndarray, intervals: np.ndarray) -> dict[str, list[object]]:
    """Columns with number, share and interval of an event at each point.

    Args:
        happened: Whether the event happened in each draw, shape (points, draws).
        intervals: Intervals of the event's probability, shape (points, 2).
    """
    counts = np.count_nonzero(happened, axis=-1)
    draws = happened.shape[-1]
    return {
        "failures": counts.tolist(),
        "probability": (counts / draws).tolist(),
        "interval": intervals.tolist(),
    }


def point_rows(study: Study, dataset: xr.Dataset, method: Method, confidence: float) -> Iterator[SummaryRow]:
    """Yield a summary of each point of a sweep, the last axis varying fastest; without a sweep there is one point.

    Points are processed in batches, so that points with few draws cost little time, and few points are in memory at a
    time.

    Args:
        study: The study.
        dataset: Dataset of the result, see :class:`dssc_jax.results.result.Result`.
        method: Method of the intervals.
        confidence: Confidence of each single interval.
    """
    statements = Statements(method, confidence)
    draws = dataset.sizes["draw"]
    names = ["outcome", "failed_at", *(measure.name for measure in study.measures)]
    for requirement in study.requirements:
        names += [requirement.name, requirement.violation_name]
    lanes = {name: dataset[name].transpose(*study.axes, "draw").values.reshape(-1, draws) for name in names}
    count = len(lanes["outcome"])
    grid = np.meshgrid(*study.axes.values(), indexing="ij")
    swept = {name: values.ravel() for name, values in zip(study.axes, grid, strict=True)}
    certified = np.full(count, None)
    if "certified" in dataset:
        certified = dataset["certified"].transpose(*study.axes).values.ravel()
    batch_size = min(max(BATCH_LANES // draws, 1), BATCH_POINTS)
    for first in range(0, count, batch_size):
        batch = slice(first, first + batch_size)
        swept_in_batch = {name: values[batch].tolist() for name, values in swept.items()}
        lanes_in_batch = {name: values[batch] for name, values in lanes.items()}
        yield from summary_of_batch(study, lanes_in_batch, swept_in_batch, certified[batch].tolist(), statements)


def summary_of_batch(
    study: Study,
    lanes: Mapping[str, np.ndarray],
    swept: dict[str, list[float]],
    certified: list[bool | None],
    statements: Statements,
) -> list[SummaryRow]:
    """Summarise a batch of points: a row for each point.

    For a metric, ``ended_early`` counts the draws without a value that ended early, and ``undefined`` those that ran to
    the end. In the quantiles of the metric, these draws count as :attr:`Metric.worst`.

    Args:
        study: The study.
        lanes: Outcomes, slacks and metrics by name, each of shape (points, draws).
        swept: Value of each swept parameter at each point, by name.
        certified: Whether Theorem 1 certifies each point; None if the theorem does not apply.
        statements: Method and confidence of the statements.
    """
    outcome = lanes["outcome"]
    count, draws = outcome.shape
    early = ended_early(outcome)
    violations = {}
    for requirement in study.requirements:
        violations[requirement.label] = violated(lanes[requirement.name])
    overlaps = []
    for pairs in by_point(overlap_rows(violations, early, statements), count):
        is_short = len(pairs) <= FEW_PAIRS
        overlaps.append(pairs if is_short else [pair for pair in pairs if pair["draws"]])
    outcomes = {}
    for code, meaning in outcome_codes(study).items():
        outcomes[meaning] = np.count_nonzero(outcome == code, axis=-1).tolist()
    metrics = {}
    for measure in study.measures:
        values = lanes[measure.name]
        has_none = np.isnan(values)
        columns = statements.quantiles(values, measure.metric.worst) | {
            "ended_early": np.count_nonzero(has_none & early, axis=-1).tolist(),
            "undefined": np.count_nonzero(has_none & ~early, axis=-1).tolist(),
        }
        metrics[measure.name] = rows_of_columns(columns)
    return rows_of_columns(
        {
            **swept,
            "draws": [draws] * count,
            **statements.failures(outcome != Outcome.OK),
            "certified": certified,
            "ended_early": np.count_nonzero(early, axis=-1).tolist(),
            "requirements": by_point(requirement_rows(study, violations, lanes, statements), count),
            "overlaps": overlaps,
            "outcomes": rows_of_columns(outcomes),
            "metrics": rows_of_columns(metrics),
        }
    )


def json_lines(summary: Summary) -> Iterator[str]:
    """The text of a summary as JSON, in pieces, with a line for each entry and for each point.

    The points are read one by one from an iterator, so that few points of a large sweep are in memory at a time.
    """
    before_entry = "{"
    for name, value in summary.items():
        yield f"{before_entry}{json.dumps(name)}: "
        if name == "points":
            before_point = "["
            for point in value:
                yield f"{before_point}\n{json.dumps(point)}"
                before_point = ","
            yield "]"
        else:
            yield json.dumps(value)
        before_entry = ",\n"
    yield "}\n"


def requirement_rows(
    study: Study, violations: Mapping[str, np.ndarray], lanes: Mapping[str, np.ndarray], statements: Statements
) -> list[list[SummaryRow]]:
    """Summarise the violations of each requirement at each point.

    ``alone`` counts the completed draws that violate only this requirement, and ``first`` the draws that violate it
    before all other requirements. ``violated_at`` is the median of the times from which on the violation was certain.
    For a margin, ``unstable`` and ``no_operating_point`` count the completed draws that have no margin for this reason.
    For a metric that may have no value, ``undefined`` counts the completed draws without a value, and ``defined_if`` is
    the condition, in words, under which the metric has a value.

    Args:
        study: The study.
        violations: Whether each draw violates a requirement, by label, shape (points, draws).
        lanes: Outcomes, slacks and metrics by name, each of shape (points, draws).
        statements: Method and confidence of the statements.

    Returns:
        For each requirement, a row for each point.
    """
    early = ended_early(lanes["outcome"])
    first_index, _ = first_violation(study.requirements, lanes)
    violations_of_draw = np.sum(list(violations.values()), axis=0)
    table = []
    for index, requirement in enumerate(study.requirements):
        is_violated = violations[requirement.label]
        violates_alone = is_violated & (violations_of_draw == 1) & ~early
        violation_times = lanes[requirement.violation_name]
        metric = requirement.measure.metric
        head = {"name": requirement.label, "text": requirement.text}
        if metric.defined_if:
            head["defined_if"] = metric.defined_if
        columns = statements.shares(is_violated) | {
            "alone": np.count_nonzero(violates_alone, axis=-1).tolist(),
            "first": np.count_nonzero(first_index == index, axis=-1).tolist(),
            "violated_at": none_if_infinite(median_without_nan(violation_times)),
            **counts_without_value(metric, lanes[requirement.measure.name], early),
        }
        table.append([head | row for row in rows_of_columns(columns)])
    return table


def counts_without_value(metric: Metric, values: np.ndarray, early: np.ndarray) -> dict[str, list[int]]:
    """Columns with the numbers of completed draws without a value; empty for a metric that always has one.

    Args:
        metric: The metric.
        values: Values of the metric, shape (points, draws).
        early: Whether each draw ended early, shape (points, draws).
    """
    undefined_counts = np.count_nonzero(np.isnan(values) & ~early, axis=-1).tolist()
    columns = {}
    if metric.margin is not None and not np.isnan(metric.margin.kind.neutral):  # neutral: that of an unstable loop
        columns["unstable"] = np.count_nonzero(values == metric.margin.kind.neutral, axis=-1).tolist()
        columns["no_operating_point"] = undefined_counts
    if metric.defined_if:
        columns["undefined"] = undefined_counts
    return columns


def missing_value_texts(point: SummaryRow) -> list[str]:
    """Sentences on the draws of a point that have no value of a required margin or metric, with the reasons.

    Requirements of margins with the same counts share a sentence.
    """
    texts_by_counts: dict[tuple[int, int], list[str]] = {}  # by (unstable, no operating point)
    for row in point["requirements"]:
        counts = row.get("unstable", 0), row.get("no_operating_point", 0)
        if any(counts):
            texts_by_counts.setdefault(counts, []).append(row["text"])
    sentences = []
    for (unstable, no_operating_point), texts in texts_by_counts.items():
        reasons = []
        if unstable:
            reasons.append(f"in {unstable:,} the loop is unstable")
        if no_operating_point:
            reasons.append(f"in {no_operating_point:,} it has no operating point within the limits")
        sentences.append(f"draws without a margin violate {' and '.join(texts)}: {', '.join(reasons)}")
    for row in point["requirements"]:
        if row.get("undefined"):
            sentences.append(
                f"{row['undefined']:,} draws have no value, and violate {row['text']}: {row['defined_if']}"
            )
    return sentences


def median_without_nan(values: np.ndarray) -> np.ndarray:
    """The median of each row of values over the entries that are not NaN, without a warning; NaN if all are NaN."""
    counts = np.count_nonzero(~np.isnan(values), axis=-1)
    middle_places = np.stack([np.maximum(counts - 1, 0) // 2, counts // 2], axis=-1)  # the same if the count is odd
    middle_places = np.minimum(middle_places, values.shape[-1] - 1)
    sorted_values = np.sort(values, axis=-1)  # NaN last
    return np.take_along_axis(sorted_values, middle_places, -1).mean(-1)


def overlap_rows(
    violations: Mapping[str, np.ndarray], early: np.ndarray, statements: Statements
) -> list[list[SummaryRow]]:
    """Summarise the joint violations of each pair of requirements at each point.

    ``failures`` counts all draws that violate both requirements, ``draws`` the completed draws among these.

    Args:
        violations: Whether each draw violates a requirement, by label, shape (points, draws).
        early: Whether each draw ended early, shape (points, draws).
        statements: Method and confidence of the statements.

    Returns:
        For each pair, a row for each point.
    """
    table = []
    for first, second in combinations(violations, 2):
        violates_both = violations[first] & violations[second]
        completed_counts = np.count_nonzero(violates_both & ~early, axis=-1).tolist()
        columns = {"draws": completed_counts} | statements.shares(violates_both)
        table.append([{"names": [first, second]} | row for row in rows_of_columns(columns)])
    return table


def rows_of_columns(columns: Mapping[str, Sequence[object]]) -> list[SummaryRow]:
    """Convert columns by name into rows; each row is a dictionary with the names of the columns."""
    rows = zip(*columns.values(), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in rows]


def by_point(lists: Sequence[Sequence[Any]], count: int) -> list[list[Any]]:
    """Transpose lists with an entry for each of ``count`` points: for each point, the entries of all lists."""
    return [[entries[point] for entries in lists] for point in range(count)]


def none_if_infinite(values: np.ndarray) -> list[object]:
    """Convert an array into nested lists for JSON, with None in place of every value that is not finite."""
    objects = np.array(values, dtype=object)
    objects[~np.isfinite(values)] = None
    return objects.tolist()


def extreme_points(points: Sequence[SummaryRow]) -> tuple[SummaryRow, SummaryRow]:
    """The points with the lowest and with the highest failure probability."""
    probability = itemgetter("probability")
    return min(points, key=probability), max(points, key=probability)


def most_violated(point: SummaryRow) -> str:
    """The requirement that most draws of a point violate, with their number, such as ``error_max (12)``."""
    return largest_count({requirement["name"]: requirement["failures"] for requirement in point["requirements"]})


def largest_count(counts: Mapping[str, int]) -> str:
    """The name with the largest count, and the count, such as ``error_max (12)``; ``-`` if no count is above 0."""
    name = max(counts, key=lambda label: counts[label], default="")
    return f"{name} ({counts[name]})" if name and counts[name] else "-"


def jsonable(content: object) -> Any:
    """Convert data to the types of JSON: dataclasses become objects, arrays become lists, NaN and infinity None."""
    if is_dataclass(content) and not isinstance(content, type):
        table: JsonObject = {}
        for field in fields(content):
            value = jsonable(getattr(content, field.name))
            if field.metadata.get(MERGED):
                table |= value or {}
            else:
                table[field.name] = value
        return table
    if isinstance(content, Mapping):
        return {str(name): jsonable(value) for name, value in content.items()}
    if isinstance(content, np.ndarray):
        return jsonable(content.tolist())
    if isinstance(content, list | tuple):
        return [jsonable(value) for value in content]
    value = content.item() if isinstance(content, np.generic) else content
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
