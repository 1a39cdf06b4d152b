"""Results as a person sees them: a run, a sweep, one draw, a verification."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.markup import escape

from dssc_jax.console.terminal import output, show_files, show_table
from dssc_jax.results import headline
from dssc_jax.statistics import describe_probability

if TYPE_CHECKING:
    from dssc_jax.results import Result
    from dssc_jax.verification import Verification

WIDEST_ROWS = 40
STAYS_FINITE = "that the draw stays finite"
MARKS = {True: "yes", False: "no", None: "-"}


def show_result(result: "Result") -> None:
    """Failure probabilities with their intervals, and where everything is."""
    console = output()
    axes, required = result.study.axes, "; ".join(rule.text for rule in result.study.requirements)
    console.print(f"[bold]{escape(result.study.name)}[/bold]  required: {escape(required or STAYS_FINITE)}")
    if not axes:
        console.print(describe_probability(result.failed.values, result.method), markup=False)
        if stopping := result.manifest.get("stopping"):
            console.print(f"the draws decided their number, {stopping['rule']}: {stopping['verdict']}", markup=False)
        show_outcomes(result.summary()["points"][0])
    elif len(axes) == 2 and math.prod(map(len, axes.values())) > WIDEST_ROWS:
        show_grid(result, list(axes))
    else:
        show_points(list(axes), result.summary()["points"], headline(result).name)
    console.print(result.certificate, markup=False)
    times = result.manifest["times"]
    console.print(
        f"{times['seconds']:.1f} s, of which {times['compile_seconds']:.1f} s compiling; "
        f"{times['rate'] / 1e6:.0f} million draw samples a second"
    )
    if "cluster" in result.manifest:
        cluster = result.manifest["cluster"]
        console.print(f"{cluster['workers']} workers, {len(cluster['lost'])} lost on the way", highlight=False)
    console.print(f"result  {result.path}", soft_wrap=True, markup=False)


def show_figures(figures: list[Path]) -> None:
    """Where a result's figures are."""
    output().print(f"figures {', '.join(str(path) for path in figures)}", soft_wrap=True, markup=False)


def show_outcomes(point: dict[str, Any]) -> None:
    """How the draws ended, and the metrics' quantiles."""
    show_table(("outcome", "draws"), [(name.replace("_", " "), str(n)) for name, n in point["outcomes"].items()])
    rows = [
        (name, *(quantile_text(found, level) for level in ("q5", "q50", "q95")))
        for name, found in point["metrics"].items()
    ]
    show_table(("metric (ended early: inf)", "5 %", "median", "95 %"), rows)


def quantile_text(found: Mapping[str, Any], level: str) -> str:
    """A quantile with its interval, where there is one."""

    def number(value: float | None, infinite: str) -> str:
        return infinite if value is None else f"{value:.4g}"

    if found[level] is None or f"{level}_interval" not in found:
        return number(found[level], "inf")
    low, high = found[f"{level}_interval"]
    return f"{found[level]:.4g} [{number(low, '-inf')}, {number(high, 'inf')}]"


def show_points(axes: list[str], points: list[dict[str, Any]], metric: str) -> None:
    """One row a sweep point, with the headline metric's median; the first ones where there are very many."""
    rows = []
    for point in points[:WIDEST_ROWS]:
        low, high = point["interval"]
        share = f"{point['probability']:.4g}" if point["failures"] else f"<= {high:.3g}"
        values = [f"{point[name]:.5g}" for name in axes]
        middle = point["metrics"].get(metric, {}).get("q50")
        shown = "inf" if middle is None else f"{middle:.4g}"
        numbers = (f"{point['failures']}/{point['draws']}", share, f"[{low:.3g}, {high:.3g}]", shown)
        rows.append((*values, *numbers, MARKS[point["certified"]]))
    show_table((*axes, "failures", "probability", "95 % interval", f"median {metric}", "certified"), rows)
    if len(points) > WIDEST_ROWS:
        output().print(f"... and {len(points) - WIDEST_ROWS} more points in summary.json")


def show_grid(result: "Result", axes: list[str]) -> None:
    """Failure probability in per cent over two axes."""
    down, across = axes
    failed = result.failed.transpose(down, across, "draw").values
    share = 100.0 * failed.mean(-1)
    head = (f"{down} \\ {across}", *(f"{value:.3g}" for value in result.study.axes[across]))
    rows = []
    for value, row, counts in zip(result.study.axes[down], share, failed.sum(-1), strict=True):
        rows.append(
            (
                f"{value:.3g}",
                *("." if n == 0 else "<1" if p < 0.5 else f"{p:.0f}" for p, n in zip(row, counts, strict=True)),
            )
        )
    draws = failed.shape[-1]
    bound = describe_probability(np.zeros(draws, dtype=bool), result.method)
    show_table(head, rows, title=f"failures in % of {draws} draws; '.': {bound}; all intervals in summary.json")


def show_draw(attributes: Mapping[str, Any], files: list[Path]) -> None:
    """How one draw ended, its drawn numbers and its metrics."""
    ended = str(attributes["outcome_meaning"]).replace("_", " ")
    output().print(f"[bold]{escape(str(attributes['study']))}[/bold] draw {attributes['draw']}: {ended}")
    skipped = {"study", "draw", "outcome", "outcome_meaning"}
    if attributes["failed_at"] != attributes["failed_at"]:  # NaN: it did not
        skipped.add("failed_at")
    rows = [(name, f"{value:.6g}") for name, value in attributes.items() if name not in skipped]
    show_table(("number", "value"), rows)
    show_files(files)


def show_verification(found: "Verification") -> None:
    """How a result compares with its lanes computed again."""
    console = output()
    console.print(f"{found.identical} of {found.lanes} lanes bit-identical (--seed {found.seed} picks the same ones)")
    if found.worst is not None:
        rows = [
            (name, f"{value:.17g}" if isinstance(value, float) else str(value)) for name, value in found.worst.items()
        ]
        show_table(("largest deviation", f"{found.deviation:.3g}"), rows)
        verdict = "within rounding" if found.verified else "[red]more than rounding[/red]"
        console.print(f"the deviation is {verdict}; computed otherwise: {escape('; '.join(found.otherwise) or 'no')}")
