"""Print the region of two numbers."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.markup import escape

from dssc_jax.console.terminal import output, show_files, show_table


def show_region(summary: Mapping[str, Any], files: list[Path]) -> None:
    """Print how many pairs meet the requirements, and what is claimed."""
    console = output()
    console.print(f"[bold]{escape(summary['study'])}[/bold]  required: {escape('; '.join(summary['requirements']))}")
    share, allowed = f"{100 * summary['passing']:g} %", summary["failures_allowed"]
    rows = [
        (f"at least {share} of all plants pass", str(summary["meets"]), f"at most {allowed} failures"),
        ("undecided", str(summary["undecided"]), ""),
        (f"fewer than {share} pass", str(summary["fails"]), f"at least {summary['failures_refuting']} failures"),
    ]
    lattice = " x ".join(map(str, summary["lattice"]))
    head = (" and ".join(summary["names"]), "pairs", f"of {summary['draws']} draws")
    show_table(head, rows, f"{summary['simulated_points']} of {lattice} pairs simulated")
    show_safe_ranges(summary)
    console.print(
        f"{100 * summary['confidence']:g} % confidence for all pairs together; nothing is claimed between them",
        markup=False,
    )
    console.print(f"{summary['certificate']}; it certifies {summary['certified']} pairs", markup=False, soft_wrap=True)
    show_files(files)


def show_safe_ranges(summary: Mapping[str, Any]) -> None:
    """Print the safe ranges of the second number for some values of the first."""
    first, second = (
        name if unit in ("", "1") else f"{name} [{unit}]"
        for name, unit in zip(summary["names"], summary["units"], strict=True)
    )
    rows = [
        (f"{row['first']:.4g}", "; ".join(f"{low:.4g} to {high:.4g}" for low, high in row["second"]))
        for row in summary["safe_ranges"]
    ]
    if rows:
        show_table((first, f"safe {second}"), rows, f"pairs at which at least {100 * summary['passing']:g} % pass")
