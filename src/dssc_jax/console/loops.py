"""Print classical margins."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rich.markup import escape

from dssc_jax.analyses.loop_margins import LoopMargins
from dssc_jax.console.terminal import output, show_files, show_table
from dssc_jax.statistics import wilks_draws


def decibels(factor: float) -> str:
    """A gain margin as a factor and in decibels."""
    return f"{factor:.4g} ({20.0 * math.log10(factor):.3g} dB)" if factor > 0.0 else "none"


MARGIN_ROWS: dict[str, tuple[str, Callable[[float], str]]] = {
    "gain_upper": ("gain margin", decibels),
    "gain_lower": ("lower gain margin", decibels),
    "phase": ("phase margin", lambda value: f"{math.degrees(value):.3g} deg"),
    "delay": ("delay margin", lambda value: f"{value:.4g} s"),
    "disk": ("disk margin", lambda value: f"{value:.3g}"),
    "sensitivity_peak": ("peak sensitivity M_s", lambda value: f"{value:.3g}"),
    "complementary_peak": ("peak complementary M_t", lambda value: f"{value:.3g}"),
    "crossover": ("crossover", lambda value: f"{value:.4g} rad/s"),
    "bandwidth": ("bandwidth", lambda value: f"{value:.4g} rad/s"),
}
"""Row of each margin and its text."""


def show_loop(margins: LoopMargins, files: list[Path]) -> None:
    """Print the margins of every operating point and break point."""
    summary = margins.summary()
    console, draws = output(), summary["draws"]
    console.print(f"[bold]{escape(summary['study'])}[/bold]  {draws} draws, T_s = {summary['sample_time']:g} s")
    share, confidence = 100 * summary["share"], 100 * summary["confidence"]
    needed = wilks_draws(summary["share"], summary["confidence"])
    head = ("median", f"{share:g} % of all draws, confidence {confidence:g} %", "worst drawn")
    for point, loops in summary["operating_points"].items():
        for broken_at, own in loops.items():
            rows = [
                (text, *(margin_text(own[name][part], form) for part in ("median", "tolerance_limit", "worst")))
                for name, (text, form) in MARGIN_ROWS.items()
            ]
            where = "at the equilibrium" if point == "equilibrium" else f"at {point}"
            show_table((f"{broken_at}, {where}: {own['stable']} of {draws} stable", *head), rows)
            reason = without_margins(own, draws, needed, f"{share:g} % of all draws with {confidence:g} % confidence")
            if reason:
                console.print(reason, markup=False, soft_wrap=True)
    console.print(f"taken where there is no derivative: {summary['taken']}", markup=False, soft_wrap=True)
    if set(summary["operating_points"]) == {"equilibrium"}:
        console.print("margins hold at rest, where dry friction sticks; --at T1,T2 takes them in motion", markup=False)
    if draws < needed:
        console.print(f"a limit needs at least {needed} draws", markup=False)
    show_files(files)


def without_margins(own: Mapping[str, Any], draws: int, needed: int, level: str) -> str:
    """Why draws at one break point have no margin, and hence no limit may exist; empty if all have."""
    counts = {
        "the loop is unstable": draws - own["stable"] - own["no_operating_point"],
        "no operating point": own["no_operating_point"],
    }
    reasons = [f"{count} of {draws} draws without margins: {why}" for why, count in counts.items() if count]
    if reasons and draws >= needed and own["disk"]["tolerance_limit"] is None:
        reasons.append(f"hence no finite limit holds for {level}")
    return "; ".join(reasons)


def margin_text(value: float | None, form: Callable[[float], str]) -> str:
    """A margin as text; None stands for an infinite one, or for a loop without margins."""
    return "-" if value is None else form(value)
