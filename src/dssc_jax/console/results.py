"""Print the result of a run or a sweep."""

import math
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dssc_jax.closed_loop.metrics.requirements import ended_early
from dssc_jax.console.stated import show_stated
from dssc_jax.console.terminal import number_text, show_line, show_paragraph, show_required, show_table
from dssc_jax.results.influence import idle_text
from dssc_jax.results.missing import quantile_value, without_value_texts
from dssc_jax.results.result import headline_measure
from dssc_jax.results.schema import name_with_unit, outcome_codes
from dssc_jax.results.summary import SummaryRow, missing_value_texts, most_violated
from dssc_jax.statistics import compare_failures, describe_probability, rounded_probability

if TYPE_CHECKING:
    from dssc_jax.results.result import Result
    from dssc_jax.statistics import DesignEffect
    from dssc_jax.study import Study

MOST_ROWS = 40
"""Largest number of points of a sweep that are printed, one in each row."""
MOST_COLUMNS = 24
"""Largest number of columns of a table over two axes."""
MOST_PAIRED = 6
"""Largest number of points of a sweep whose failures are compared with those of the first, draw by draw."""
PROBABILITY_HEAD = ("probability", "95 % interval")
"""Heads of the cells of :func:`failure_cells` after the first."""
VERDICT_MARKS = {True: "yes", False: "no", None: "-"}
"""Texts of the verdict of Theorem 1; None: the theorem does not apply."""


def show_result(result: "Result") -> None:
    """Print the failure probabilities of a run or a sweep with their intervals, the computing time, and the folder."""
    axes = result.study.axes
    show_required(result.study.name, [rule.text for rule in result.study.requirements])
    if result.has_equal_draws:
        show_paragraph(equal_draws_text(result))
    if not axes:
        show_single_point(result)
    elif len(axes) == 2 and math.prod(map(len, axes.values())) > MOST_ROWS:
        show_grid(result, list(axes))
    else:
        show_points(result)
        if not result.has_equal_draws:
            show_paired_differences(result)
    for text in (result.design_reason, idle_text(result), result.certificate, result.integration):
        if text:
            show_paragraph(text)
    show_times(result)
    show_line(f"result  {result.path}")


def show_single_point(result: "Result") -> None:
    """Print the failure probability of a run, the effects of its design and stopping rule, and tables of metrics."""
    if not result.has_equal_draws:
        show_paragraph(describe_probability(result.failed.values, result.method))
    effect = result.design_effect
    if effect is not None:
        show_paragraph(design_effect_text(effect, result.study.config.draws))
    stopping = result.manifest.get("stopping")
    if stopping:
        show_paragraph(f"the draws decided their number, {stopping['rule']}: {stopping['verdict']}")
    if result.stated:
        show_stated(result.stated_errors(result.stated))
    show_point(result.study, next(result.points()), result.has_equal_draws)


def show_times(result: "Result") -> None:
    """Print how long a run took, its speed, and the workers if a cluster computed it."""
    times = result.manifest["times"]
    margins = times.get("margin_seconds", 0.0)
    margins_text = f" and {margins:.1f} s for margins" if margins else ""
    show_paragraph(
        f"{times['seconds']:.1f} s, of which {times['compile_seconds']:.1f} s compiling{margins_text}; "
        f"{times['rate'] / 1e6:.0f} million draw samples a second"
    )
    if "cluster" in result.manifest:
        cluster = result.manifest["cluster"]
        show_paragraph(f"{cluster['workers']} workers, {len(cluster['lost'])} lost on the way")


def equal_draws_text(result: "Result") -> str:
    """Tell that all draws are the same, so that an interval would mean nothing, and how to make the draws differ."""
    draws = result.study.config.draws
    remedy = "set draws = 1, or give uncertain numbers, disturbances or sensors their laws"
    text = f"nothing in the study is random, so all {draws} draws are the same, and there is no interval: {remedy}"
    if result.study.axes:
        return text
    failed = bool(result.failed.values.flat[0])
    return f"{'each draw fails' if failed else 'no draw fails'}; {text}"


def design_effect_text(effect: "DesignEffect", draws: int) -> str:
    """Tell how many independent draws would give an interval as narrow as that of a design.

    Args:
        effect: Variance under the design, relative to independent draws.
        draws: Number of draws of the design.
    """
    low, high = effect.ratio_interval
    ratio = f"variance {effect.variance_ratio:.2g} in [{low:.2g}, {high:.2g}] of that of independent draws"
    saved_draws = effect.plain_draws - draws
    cost = f"{saved_draws:,} saved" if saved_draws >= 0 else f"{-saved_draws:,} more than they would take"
    return f"{ratio}; an interval as narrow takes {effect.plain_draws:,} of these: {cost}"


def show_paired_differences(result: "Result") -> None:
    """Print how the failure probability at each value of a sweep differs from that at the first value.

    All values share the draws, so the paired difference is sharper than the intervals at both values suggest. Only a
    sweep over one axis with few values and independent draws has such a table; for others nothing is printed.
    """
    axes = result.study.axes
    if len(axes) != 1 or not result.study.config.independent:
        return
    ((name, values),) = axes.items()
    if not 2 <= len(values) <= MOST_PAIRED:
        return
    failures = result.failed.transpose(name, "draw").values
    rows = []
    for value, failed in zip(values[1:], failures[1:], strict=True):
        pair = compare_failures(failed, failures[0])
        low, high = pair.interval
        difference = f"{pair.difference:+.3g} in [{low:+.3g}, {high:+.3g}]"
        rows.append((f"{value:.5g}", str(pair.only_a), str(pair.only_b), difference, f"{pair.p_value:.3g}"))
    head = (f"against {values[0]:.5g}, same draws", "fail here only", "there only", "difference, 95 % interval")
    show_table((*head, "p-value (McNemar)"), rows)


def show_figures(figures: list[Path]) -> None:
    """Print the paths of a result's figures."""
    show_line(f"figures {', '.join(map(str, figures))}")


def show_point(study: "Study", point: SummaryRow, draws_equal: bool) -> None:
    """Print violations of each requirement and of pairs of requirements, early ends, and quantiles of the metrics.

    Args:
        study: The study.
        point: Summary of the point.
        draws_equal: Whether all draws are the same, so that intervals are left out.
    """
    probability_head = () if draws_equal else PROBABILITY_HEAD
    if point["requirements"]:
        head = ("requirement", "violated by", *probability_head, "by it alone", "first", "median time [s]")
        show_table(head, requirement_rows(study, point, draws_equal))
    for text in missing_value_texts(point):
        show_paragraph(text)
    if point["overlaps"]:
        head = ("both", "violated by", *probability_head, "not by early ends")
        show_table(head, overlap_rows(point, draws_equal))
    if point["ended_early"]:
        show_paragraph(f"ended early, and so violated every requirement: {early_ends_text(study, point)}")
    titles = {"q50": "of every draw"} if draws_equal else {"q5": "5 %", "q50": "median", "q95": "95 %"}
    rows = metric_rows(study, point, list(titles), draws_equal)
    show_table(("metric", *titles.values()), rows)
    for text in without_value_texts(study, point, "{:.4g}".format):
        show_paragraph(text)


def requirement_rows(study: "Study", point: SummaryRow, draws_equal: bool) -> list[tuple[str, ...]]:
    """One row for each requirement: how many draws violate it, violate it alone, and violate it first.

    The last cell is the median time of violation [s].

    Args:
        study: The study.
        point: Summary of one point.
        draws_equal: Whether all draws are the same.
    """
    rows = []
    for rule, requirement in zip(study.requirements, point["requirements"], strict=True):
        cells = failure_cells(requirement, point["draws"], draws_equal)
        time = requirement["violated_at"]
        time_text = "-" if time is None else f"{time:.4g}"
        rows.append((rule.short_text, *cells, str(requirement["alone"]), str(requirement["first"]), time_text))
    return rows


def overlap_rows(point: SummaryRow, draws_equal: bool) -> list[tuple[str, ...]]:
    """One row for each pair of requirements: how many draws violate both, and how many of these ran to their end.

    Args:
        point: Summary of one point.
        draws_equal: Whether all draws are the same.
    """
    rows = []
    for pair in point["overlaps"]:
        cells = failure_cells(pair, point["draws"], draws_equal)
        rows.append((" and ".join(pair["names"]), *cells, str(pair["draws"])))
    return rows


def early_ends_text(study: "Study", point: SummaryRow) -> str:
    """List the numbers of draws that ended early, by cause."""
    texts = []
    for code, name in outcome_codes(study).items():
        count = point["outcomes"][name]
        if ended_early(code) and count:
            texts.append(f"{count} {name.replace('_', ' ')}")
    return ", ".join(texts)


def metric_rows(study: "Study", point: SummaryRow, levels: list[str], draws_equal: bool) -> list[tuple[str, ...]]:
    """One row for each metric: its quantiles at the levels, with intervals unless all draws are the same.

    Args:
        study: The study, for the metrics and their units.
        point: Summary of a point.
        levels: Names of the quantiles in the summary, such as ``q50``.
        draws_equal: Whether all draws are the same.
    """
    rows = []
    for measure in study.measures:
        quantiles = point["metrics"][measure.name]
        cells = [quantile_text(quantiles, level, measure.metric.worst, not draws_equal) for level in levels]
        rows.append((name_with_unit(measure.name, measure.unit), *cells))
    return rows


def quantile_text(quantiles: SummaryRow, level: str, worst: float, with_interval: bool) -> str:
    """Format a quantile of a metric, with its interval if requested.

    Args:
        quantiles: Quantiles and their intervals, by name; None stands for an infinite value.
        level: Name of the quantile, such as ``q50``.
        worst: Value that a draw without a value counts as.
        with_interval: Whether to add the interval; an infinite quantile never has one.
    """
    value = f"{quantile_value(quantiles, level, worst):.4g}"
    interval = quantiles.get(f"{level}_interval")
    if quantiles[level] is None or interval is None or not with_interval:
        return value
    low, high = interval
    return f"{value} [{number_text(low, '.4g', '-inf')}, {number_text(high, '.4g', 'inf')}]"


def failure_cells(row: SummaryRow, draws: int, draws_equal: bool) -> tuple[str, ...]:
    """Cells with the number of failures, their probability and its interval.

    Without failures, the upper bound stands in place of the probability 0, as "<= BOUND".

    Args:
        row: Entry of a summary with the failures, their probability and its interval.
        draws: Number of draws.
        draws_equal: Whether all draws are the same; then only the number of failures is given.
    """
    if draws_equal:
        return (f"{row['failures']}/{draws}",)
    low, high = row["interval"]
    probability = f"{row['probability']:.4g}" if row["failures"] else f"<= {high:.3g}"
    return f"{row['failures']}/{draws}", probability, f"[{rounded_probability(low)}, {rounded_probability(high)}]"


def show_points(result: "Result") -> None:
    """Print a row for each point of a sweep: failures, the median of the headline metric, and Theorem 1's verdict.

    Points after the first :data:`MOST_ROWS` are left out.
    """
    axes = result.study.axes
    measure = headline_measure(result.study)
    metric = measure.name
    has_several_requirements = len(result.study.requirements) > 1
    result = result.with_theorem()
    draws_equal = result.has_equal_draws
    has_certificates = "certified" in result.dataset
    head = [*axes, "failures"]
    if not draws_equal:
        head.extend(PROBABILITY_HEAD)
    if has_several_requirements:
        head.append("most violated")
    head.append(f"median {metric}")
    if has_certificates:
        head.append("certified")
    rows = []
    for point in islice(result.points(), MOST_ROWS):
        row = [f"{point[name]:.5g}" for name in axes]
        row.extend(failure_cells(point, point["draws"], draws_equal))
        if has_several_requirements:
            row.append(most_violated(point))
        row.append(quantile_text(point["metrics"][metric], "q50", measure.metric.worst, with_interval=False))
        if has_certificates:
            row.append(VERDICT_MARKS[point["certified"]])
        rows.append(row)
    show_table(head, rows)
    hidden_count = math.prod(map(len, axes.values())) - len(rows)
    if hidden_count:
        show_paragraph(f"... and {hidden_count} more points in summary.json")


def percent_text(percent: float, failures: int) -> str:
    """Format the share of failures at a point of the grid: "." without failures, and "<1" below 0.5 %.

    Args:
        percent: Share of the draws that fail [%].
        failures: Number of draws that fail.
    """
    if failures == 0:
        return "."
    return "<1" if percent < 0.5 else f"{percent:.0f}"


def show_grid(result: "Result", axes: list[str]) -> None:
    """Print the failure probability in per cent over the two axes of a sweep.

    If an axis has more values than the table may have rows or columns, only every n-th value is printed.

    Args:
        result: A sweep over two axes.
        axes: Name of the axis along the rows, and name of the axis along the columns.
    """
    down, across = axes
    down_values = np.asarray(result.study.axes[down])
    across_values = np.asarray(result.study.axes[across])
    row_step = math.ceil(len(down_values) / MOST_ROWS)
    column_step = math.ceil(len(across_values) / MOST_COLUMNS)
    failed = result.failed.transpose(down, across, "draw").values[::row_step, ::column_step]
    head = (f"{down} \\ {across}", *(f"{value:.3g}" for value in across_values[::column_step]))
    rows = []
    for value, failed_row in zip(down_values[::row_step], failed, strict=True):
        percents = 100.0 * failed_row.mean(-1)
        failure_counts = failed_row.sum(-1)
        rows.append((f"{value:.3g}", *map(percent_text, percents, failure_counts)))
    draws = failed.shape[-1]
    legend = f"failures in % of {draws} draws"
    if not result.has_equal_draws:
        bound = describe_probability(np.zeros(draws, dtype=bool), result.method)
        legend += f"; '.': {bound}; all intervals in summary.json"
    show_table(head, rows, title=legend)
    if row_step * column_step > 1:
        show_paragraph(
            f"... each step is {row_step} of {len(down_values)} values of {down}, "
            f"and {column_step} of {len(across_values)} of {across}; all points in summary.json"
        )
