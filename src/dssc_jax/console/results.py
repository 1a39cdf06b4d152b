"""Print results: a run, a sweep."""

import math
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.markup import escape

from dssc_jax.closed_loop.requirements import ended_early
from dssc_jax.console.stated import show_stated
from dssc_jax.console.terminal import output, show_table
from dssc_jax.results.influence import idle_text
from dssc_jax.results.result import headline
from dssc_jax.results.schema import outcome_codes
from dssc_jax.results.summary import SummaryRow, most_violated, values_missing
from dssc_jax.statistics import compare_failures, describe_probability, rounded_probability

if TYPE_CHECKING:
    from dssc_jax.results.result import Result
    from dssc_jax.statistics import DesignEffect
    from dssc_jax.study import Study

WIDEST_ROWS = 40
WIDEST_COLUMNS = 24
MOST_PAIRED = 6  # points of a sweep whose failures are compared with those of the first, draw by draw
STAYS_FINITE = "that the draw stays finite"
SHARE = ("probability", "95 % interval")
VERDICT_MARKS = {True: "yes", False: "no", None: "-"}


def show_result(result: "Result") -> None:
    """Print failure probabilities with their intervals, and the files."""
    console = output()
    axes = result.study.axes
    required = "; ".join(rule.text for rule in result.study.requirements)
    console.print(f"[bold]{escape(result.study.name)}[/bold]  required: {escape(required or STAYS_FINITE)}")
    if result.has_equal_draws:
        console.print(equal_text(result), markup=False)
    if not axes:
        show_single_point(result)
    elif len(axes) == 2 and math.prod(map(len, axes.values())) > WIDEST_ROWS:
        show_grid(result, list(axes))
    else:
        show_points(result)
        if not result.has_equal_draws:
            show_paired(result)
    for text in filter(None, (result.design_reason, idle_text(result), result.certificate, result.integration)):
        console.print(text, markup=False)
    show_times(result)
    console.print(f"result  {result.path}", soft_wrap=True, markup=False)


def show_single_point(result: "Result") -> None:
    """Print the failure probability of a run, how its draws were chosen, and the table of its point."""
    console = output()
    if not result.has_equal_draws:
        console.print(describe_probability(result.failed.values, result.method), markup=False)
    effect = result.design_effect
    if effect is not None:
        console.print(effect_text(effect, result.study.config.draws), markup=False)
    stopping = result.manifest.get("stopping")
    if stopping:
        console.print(f"the draws decided their number, {stopping['rule']}: {stopping['verdict']}", markup=False)
    if result.stated:
        show_stated(result.stated_errors(result.stated))
    show_point(result.study, next(result.points()), result.has_equal_draws)


def show_times(result: "Result") -> None:
    """Print how long a run took, how fast it was, and its workers on a cluster."""
    console = output()
    times = result.manifest["times"]
    margins = times.get("margin_seconds", 0.0)
    margins_text = f" and {margins:.1f} s for margins" if margins else ""
    console.print(
        f"{times['seconds']:.1f} s, of which {times['compile_seconds']:.1f} s compiling{margins_text}; "
        f"{times['rate'] / 1e6:.0f} million draw samples a second"
    )
    if "cluster" in result.manifest:
        cluster = result.manifest["cluster"]
        console.print(f"{cluster['workers']} workers, {len(cluster['lost'])} lost on the way", highlight=False)


def equal_text(result: "Result") -> str:
    """A sentence that says that all draws are the same, and what they show."""
    draws = result.study.config.draws
    remedy = "set draws = 1, or give uncertain numbers, disturbances or sensors their laws"
    text = f"nothing in the study is random, so all {draws} draws are the same, and there is no interval: {remedy}"
    if result.study.axes:
        return text
    failed = bool(result.failed.values.flat[0])
    return f"{'each draw fails' if failed else 'no draw fails'}; {text}"


def effect_text(effect: "DesignEffect", draws: int) -> str:
    """The draws that a design saved, in words."""
    low, high = effect.ratio_interval
    ratio = f"variance {effect.variance_ratio:.2g} in [{low:.2g}, {high:.2g}] of that of independent draws"
    saved_draws = effect.plain_draws - draws
    cost = f"{saved_draws:,} saved" if saved_draws >= 0 else f"{-saved_draws:,} more than they would take"
    return f"{ratio}; an interval as narrow takes {effect.plain_draws:,} of these: {cost}"


def show_paired(result: "Result") -> None:
    """Print how the failure probability of a short sweep over one axis differs from that at its first value.

    The draws are common to all values, which two separate intervals would neglect.
    """
    axes = result.study.axes
    values = [value for axis in axes.values() for value in axis]
    if len(axes) != 1 or not 2 <= len(values) <= MOST_PAIRED or not result.study.config.independent:
        return
    (name,) = axes
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
    """Print the files of a result's figures."""
    output().print(f"figures {', '.join(str(path) for path in figures)}", soft_wrap=True, markup=False)


def show_point(study: "Study", point: SummaryRow, equal: bool = False) -> None:
    """Print each requirement, joint violations, early ends, and the metrics' quantiles.

    Args:
        study: The study.
        point: Its only point.
        equal: Whether all draws are the same, so that intervals are left out.
    """
    share = () if equal else SHARE
    if point["requirements"]:
        head = ("requirement", "violated by", *share, "by it alone", "first", "median time [s]")
        show_table(head, requirement_rows(study, point, equal))
    for text in values_missing(point):
        output().print(text, markup=False)
    if point["overlaps"]:
        head = ("both", "violated by", *share, "not by early ends")
        show_table(head, overlap_rows(point, equal))
    if point["ended_early"]:
        output().print(f"ended early, and so violated every requirement: {early_ends_text(study, point)}")
    levels = {"q50": "of every draw"} if equal else {"q5": "5 %", "q50": "median", "q95": "95 %"}
    show_table(("metric (ended early: inf)", *levels.values()), metric_rows(study, point, list(levels), equal))


def requirement_rows(study: "Study", point: SummaryRow, equal: bool) -> list[tuple[str, ...]]:
    """A row for each requirement: by how many draws it is violated, alone and first, and when."""
    rows = []
    for rule, requirement in zip(study.requirements, point["requirements"], strict=True):
        cells = failure_cells(requirement, point["draws"], equal)
        time = requirement["violated_at"]
        time_text = "-" if time is None else f"{time:.4g}"
        rows.append((rule.short, *cells, str(requirement["alone"]), str(requirement["first"]), time_text))
    return rows


def overlap_rows(point: SummaryRow, equal: bool) -> list[tuple[str, ...]]:
    """A row for each pair of requirements that some draws violate both."""
    rows = []
    for pair in point["overlaps"]:
        rows.append((" and ".join(pair["names"]), *failure_cells(pair, point["draws"], equal), str(pair["draws"])))
    return rows


def early_ends_text(study: "Study", point: SummaryRow) -> str:
    """How many draws ended early in each way."""
    texts = []
    for code, name in outcome_codes(study).items():
        count = point["outcomes"][name]
        if ended_early(code) and count:
            texts.append(f"{count} {name.replace('_', ' ')}")
    return ", ".join(texts)


def metric_rows(study: "Study", point: SummaryRow, levels: list[str], equal: bool) -> list[tuple[str, ...]]:
    """A row for each metric with its quantiles; of equal draws without intervals."""
    units = {measure.name: measure.unit for measure in study.measures}
    rows = []
    for name, quantiles in point["metrics"].items():
        shown = {level: quantiles[level] for level in levels} if equal else quantiles
        rows.append((name_with_unit(name, units[name]), *(quantile_text(shown, level) for level in levels)))
    return rows


def name_with_unit(name: str, unit: str) -> str:
    """A name followed by its unit in brackets, if it has one."""
    return name if unit == "1" else f"{name} [{unit}]"


def quantile_text(quantiles: SummaryRow, level: str) -> str:
    """A quantile with its interval, if there is one."""

    def number(value: float | None, infinite: str) -> str:
        return infinite if value is None else f"{value:.4g}"

    if quantiles[level] is None or f"{level}_interval" not in quantiles:
        return number(quantiles[level], "inf")
    low, high = quantiles[f"{level}_interval"]
    return f"{quantiles[level]:.4g} [{number(low, '-inf')}, {number(high, 'inf')}]"


def failure_cells(row: SummaryRow, draws: int, equal: bool = False) -> tuple[str, ...]:
    """Failures, their probability, and its interval; without failures the upper bound is given, never 0.

    Of draws that are all the same, the failures alone.
    """
    if equal:
        return (f"{row['failures']}/{draws}",)
    low, high = row["interval"]
    probability = f"{row['probability']:.4g}" if row["failures"] else f"<= {high:.3g}"
    return f"{row['failures']}/{draws}", probability, f"[{rounded_probability(low)}, {rounded_probability(high)}]"


def show_points(result: "Result") -> None:
    """Print one row for each sweep point, with the headline metric's median; only the first ones if there are many."""
    axes = result.study.axes
    metric = headline(result).name
    has_several_requirements = len(result.study.requirements) > 1
    result = result.with_theorem()
    equal = result.has_equal_draws
    share = () if equal else SHARE
    certifiable = "certified" in result.dataset
    rows = []
    for point in islice(result.points(), WIDEST_ROWS):
        values = [f"{point[name]:.5g}" for name in axes]
        middle = point["metrics"].get(metric, {}).get("q50")
        median_text = "inf" if middle is None else f"{middle:.4g}"
        worst = [most_violated(point)] if has_several_requirements else []
        marks = [VERDICT_MARKS[point["certified"]]] if certifiable else []
        rows.append((*values, *failure_cells(point, point["draws"], equal), *worst, median_text, *marks))
    worst = ["most violated"] if has_several_requirements else []
    show_table((*axes, "failures", *share, *worst, f"median {metric}", *(["certified"] if certifiable else [])), rows)
    hidden_count = math.prod(map(len, axes.values())) - len(rows)
    if hidden_count:
        output().print(f"... and {hidden_count} more points in summary.json")


def percent_text(percent: float, failures: int) -> str:
    """The share of failures in a cell of the grid; a dot if there are none."""
    if failures == 0:
        return "."
    return "<1" if percent < 0.5 else f"{percent:.0f}"


def show_grid(result: "Result", axes: list[str]) -> None:
    """Print the failure probability in per cent over two axes; values are skipped if there are very many."""
    down, across = axes
    down_values, across_values = (np.asarray(result.study.axes[name]) for name in axes)
    by_row = -(-len(down_values) // WIDEST_ROWS)
    by_column = -(-len(across_values) // WIDEST_COLUMNS)
    failed = result.failed.transpose(down, across, "draw").values[::by_row, ::by_column]
    share = 100.0 * failed.mean(-1)
    head = (f"{down} \\ {across}", *(f"{value:.3g}" for value in across_values[::by_column]))
    rows = []
    for value, row, counts in zip(down_values[::by_row], share, failed.sum(-1), strict=True):
        cells = [percent_text(percent, count) for percent, count in zip(row, counts, strict=True)]
        rows.append((f"{value:.3g}", *cells))
    draws = failed.shape[-1]
    legend = f"failures in % of {draws} draws"
    if not result.has_equal_draws:
        bound = describe_probability(np.zeros(draws, dtype=bool), result.method)
        legend += f"; '.': {bound}; all intervals in summary.json"
    show_table(head, rows, title=legend)
    if by_row * by_column > 1:
        output().print(
            f"... each step is {by_row} of {len(down_values)} values of {escape(down)}, "
            f"and {by_column} of {len(across_values)} of {escape(across)}; all points in summary.json"
        )
