"""Searches as a person sees them: tuned gains, and the worst draw."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape

from dssc_jax.console.terminal import output, show_files, show_table


def show_tuning(summary: Mapping[str, Any], files: list[Path]) -> None:
    """The tuned numbers, and what fresh draws say of them."""
    console = output()
    console.print(f"[bold]{escape(summary['study'])}[/bold]")
    rows = [(name, f"{summary['start'][name]:.6g}", f"{value:.6g}") for name, value in summary["tuned"].items()]
    show_table(("tuned", "start", "result"), rows)
    verdict = summary["verdict"]
    (before, after), (low, high) = verdict["objective"], verdict["reduction_interval"]
    aggregate, level = summary["objective"]["aggregate"], summary["objective"]["level"]
    name = f"{aggregate} {level:g}" if aggregate == "cvar" else aggregate
    rows = [(f"objective ({name})", f"{before:.5g}", f"{after:.5g}", "")]
    for metric, (bound, first, second) in verdict["limits"].items():
        rows.append((f"mean {metric}", f"{first:.5g}", f"{second:.5g}", f"<= {bound:.5g}"))
    first, second = verdict["failures"]
    rows.append(("failed draws", str(first), str(second), ""))
    show_table((f"on {verdict['draws']} fresh draws", "start", "result", "limit"), rows)
    console.print(f"reduction {verdict['reduction']:.1%} in [{low:.1%}, {high:.1%}] (95 %, bootstrap over draws)")
    middle, low, high = verdict["difference"]
    console.print(
        f"cost draw by draw, result less start: median {middle:+.4g} in [{low:+.4g}, {high:+.4g}] (95 %, exact)"
    )
    if summary["gradients"]:
        console.print(f"gradients: {summary['gradients']['text']}")
    if summary["certified_points"] is not None:
        console.print(f"certified: all {summary['certified_points']} points that were visited, by Theorem 1")
    for number, hunt in enumerate(summary["counterexamples"], start=1):
        console.print(f"hunt {number}: worst slack {hunt['slack']:.4g} in {hunt['simulations']} simulations")
    if not summary["feasible"]:
        console.print(
            f"no point met every limit on the validation draws; the nearest misses by {summary['violation']:.2%}"
        )
    console.print(f"{summary['method']}, {summary['stopped']}; {summary['seconds']:.1f} s")
    show_files(files)


def show_falsification(summary: Mapping[str, Any], files: list[Path]) -> None:
    """The worst draw that was found."""
    console = output()
    required = escape("; ".join(summary["requirements"]))
    console.print(f"[bold]{escape(summary['study'])}[/bold]  required: {required}")
    show_table(("worst draw", ""), [(name, f"{value:.6g}") for name, value in summary["witness"].items()])
    slack = "ended early" if summary["slack"] == -np.inf else f"slack {summary['slack']:.4g} of the bound"
    spent = f"{summary['simulations']} simulations, {summary['seconds']:.1f} s"
    ending = (
        f"fails; the first failure came after {summary['first_failure']}" if summary["failed"] else "passes; the worst"
    )
    console.print(f"it {ending} of {spent}: {slack}")
    show_files(files)
