"""Print a proof of the sampled loop, and the verdict of the verifier."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dssc_jax.console.terminal import show_line, show_table

MOST_LISTED = 12
"""Largest number of unproved boxes, or of invalid certificates, that are printed."""


def show_proof(summary: dict[str, Any], path: Path | None, remarks: Sequence[str]) -> None:
    """Print the statement of a proof and the boxes that are not proved.

    Args:
        summary: Summary of the proof.
        path: File of the certificate; None: none was written.
        remarks: Further lines; empty ones are left out.
    """
    show_line(summary["statement"])
    has_boxes = any(failure["box"] for failure in summary["failures"])  # for a vehicle, the statement has the reason
    if has_boxes:
        rows = []
        for failure in summary["failures"][:MOST_LISTED]:
            ranges = [f"{low:.4g} .. {high:.4g}" for low, high in failure["box"].values()]
            rows.append((*ranges, failure["text"]))
        show_table((*summary["failures"][0]["box"], "not proved because"), rows)
    for remark in remarks:
        if remark:
            show_line(remark)
    if path is not None:
        show_line(f"wrote {path}")


def show_verdict(verdict: str, loop: dict[str, str]) -> None:
    """Print the verdict on a certificate, and the loop of the certificate.

    Args:
        verdict: The verdict in words.
        loop: Description of the loop, by label.
    """
    show_line(verdict)
    for label, words in loop.items():
        show_line(f"  {label:<13}{words}")


def show_sweep_verdicts(points: int, certificate_count: int, reasons: list[str]) -> None:
    """Print how many certificates of a sweep are valid.

    Args:
        points: Number of points of the sweep.
        certificate_count: Number of certificates.
        reasons: Why a certificate is not valid, one reason for each such certificate.
    """
    valid_count = certificate_count - len(reasons)
    text = f"{valid_count} of {certificate_count} certificates are valid; the sweep has {points} points"
    show_line("\n".join([text, *reasons[:MOST_LISTED]]))
