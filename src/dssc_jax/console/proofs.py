"""Show a proof of the sampled loop, and a verifier's verdict."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dssc_jax.console.terminal import output, show_table

MOST_SHOWN = 12
"""Boxes without a proof that are listed."""


def show_proof(summary: dict[str, Any], path: Path | None, remarks: Sequence[str] = ()) -> None:
    """Print the statement, the boxes that are not proved, and remarks, of which empty ones are left out."""
    console = output()
    console.print(summary["statement"], soft_wrap=True, markup=False)
    if any(failure["box"] for failure in summary["failures"]):  # a vehicle is no box: the statement has the reason
        rows = []
        for failure in summary["failures"][:MOST_SHOWN]:
            ranges = [f"{low:.4g} .. {high:.4g}" for low, high in failure["box"].values()]
            rows.append((*ranges, failure["text"]))
        show_table((*summary["failures"][0]["box"], "not proved because"), rows)
    for remark in filter(None, remarks):
        console.print(remark, soft_wrap=True, markup=False)
    if path is not None:
        console.print(f"wrote {path}", soft_wrap=True, markup=False)


def show_verdict(verdict: str, loop: dict[str, str]) -> None:
    """Print what a certificate's verdict says, and of which loop it is one."""
    console = output()
    console.print(verdict, soft_wrap=True, markup=False)
    for label, words in loop.items():
        console.print(f"  {label:<13}{words}", soft_wrap=True, markup=False)


def show_sweep_verdicts(points: int, certificate_count: int, reasons: list[str]) -> None:
    """Print whether the certificates of a sweep's points are valid."""
    valid = certificate_count - len(reasons)
    text = f"{valid} of {certificate_count} certificates are valid; the sweep has {points} points"
    output().print("\n".join([text, *reasons[:MOST_SHOWN]]), soft_wrap=True, markup=False)
