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
    console.print(
        f"{100 * summary['confidence']:g} % confidence for all pairs together; nothing is claimed between them",
        markup=False,
    )
    console.print(f"{summary['certificate']}; it certifies {summary['certified']} pairs", markup=False, soft_wrap=True)
    show_files(files)
