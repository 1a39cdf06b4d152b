"""Print how a single draw ended, and whether recomputed draws agree with their result."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from dssc_jax.console.terminal import output, show_files, show_paragraph, show_table
from dssc_jax.engine.reference import VERDICTS

if TYPE_CHECKING:
    from dssc_jax.runs.verify import Verification


NOT_IN_TABLE = frozenset(
    ("study", "draw", "outcome", "outcome_meaning", "verdict", "agreement", "deviation", "event_kinds", "event_times")
)
"""Attributes of a trajectory that are not printed as a row of its table."""


def show_draw(attributes: Mapping[str, Any], units: Mapping[str, str], files: list[Path]) -> None:
    """Print how one draw ended, its drawn numbers, its metrics and its events.

    The attribute ``failed_at`` is NaN if the draw ran to its end, and is then left out.

    Args:
        attributes: Attributes of the trajectory.
        units: Unit of each number, by name.
        files: Files of the trajectory that were written.
    """
    study = escape(str(attributes["study"]))
    verdict = escape(str(attributes["verdict"]))
    output().print(f"[bold]{study}[/bold] draw {attributes['draw']}: {verdict}")
    rows = []
    for name, value in attributes.items():
        ran_to_its_end = name == "failed_at" and math.isnan(value)
        if name not in NOT_IN_TABLE and not ran_to_its_end:
            rows.append((name, f"{value:.6g}", units.get(name, "")))
    for kind, time in zip(attributes.get("event_kinds", ()), attributes.get("event_times", ()), strict=True):
        rows.append((f"event: {kind}", f"at {time:.6g}", "s"))
    show_table(("number", "value", "unit"), rows)
    if "agreement" in attributes:
        agreement = VERDICTS[str(attributes["agreement"])].format(attributes["deviation"])
        show_paragraph(f"computed again by the plain program, the draw {agreement}")
    show_files(files)


def show_verification(verification: "Verification") -> None:
    """Print whether a result agrees with its recomputed lanes, and the lane that deviates most."""
    verdict = VERDICTS[verification.verdict].format(verification.deviation)
    lanes = "1 lane" if verification.lanes == 1 else f"{verification.lanes} lanes"
    choice = f"(--seed {verification.seed} picks the same)"
    show_paragraph(f"computed again by the plain program, {lanes} {choice}: the result {verdict}")
    if verification.undecided:
        show_paragraph(f"{verification.undecided} of them amplify rounding so much that they are no evidence")
    if verification.worst is not None:
        rows = []
        for name, value in verification.worst.items():
            rows.append((name, f"{value:.17g}" if isinstance(value, float) else str(value)))
        show_table(("largest deviation", f"{verification.deviation:.3g}"), rows)
    if verification.otherwise:
        show_paragraph(f"the result was computed otherwise: {'; '.join(verification.otherwise)}")
    if verification.single_precision:
        single = verification.single_precision
        show_paragraph(
            f"float32 itself, against float64 with the same noise: {single.outcomes} outcomes differ; relative "
            f"deviation of a lane {single.median:.1g} (median), {single.largest:.1g} (largest)"
        )
