"""Print single draws: one trajectory, or lanes of a result that were computed again."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from dssc_jax.console.terminal import output, show_files, show_table
from dssc_jax.engine.reference import VERDICTS

if TYPE_CHECKING:
    from dssc_jax.runs.verify import Verification


def show_draw(attributes: Mapping[str, Any], units: Mapping[str, str], files: list[Path]) -> None:
    """Print how one draw ended, its drawn numbers, its metrics and its events, each with its unit."""
    study = escape(str(attributes["study"]))
    verdict = escape(str(attributes["verdict"]))
    output().print(f"[bold]{study}[/bold] draw {attributes['draw']}: {verdict}")
    hidden_names = {"study", "draw", "outcome", "outcome_meaning", "verdict", "agreement", "deviation"}
    if attributes["failed_at"] != attributes["failed_at"]:  # NaN: it did not
        hidden_names.add("failed_at")
    hidden_names |= {"event_kinds", "event_times"}
    rows = [
        (name, f"{value:.6g}", units.get(name, "")) for name, value in attributes.items() if name not in hidden_names
    ]
    events = zip(attributes.get("event_kinds", ()), attributes.get("event_times", ()), strict=True)
    rows += [(f"event: {kind}", f"at {time:.6g}", "s") for kind, time in events]
    show_table(("number", "value", "unit"), rows)
    if "agreement" in attributes:
        agreement = VERDICTS[str(attributes["agreement"])].format(attributes["deviation"])
        output().print(f"computed again by the plain program, the draw {agreement}")
    show_files(files)


def show_verification(verification: "Verification") -> None:
    """Print how a result compares with its recomputed lanes."""
    console = output()
    verdict = VERDICTS[verification.verdict].format(verification.deviation)
    lanes = f"{verification.lanes} lane{'s' * (verification.lanes > 1)} (--seed {verification.seed} picks the same)"
    console.print(f"computed again by the plain program, {lanes}: the result {verdict}")
    if verification.undecided:
        console.print(f"{verification.undecided} of them amplify rounding so much that they are no evidence")
    if verification.worst is not None:
        rows = [
            (name, f"{value:.17g}" if isinstance(value, float) else str(value))
            for name, value in verification.worst.items()
        ]
        show_table(("largest deviation", f"{verification.deviation:.3g}"), rows)
    if verification.otherwise:
        console.print(f"the result was computed otherwise: {escape('; '.join(verification.otherwise))}")
    if verification.single_precision:
        single = verification.single_precision
        console.print(
            f"float32 itself, against float64 with the same noise: {single.outcomes} outcomes differ; relative "
            f"deviation of a lane {single.median:.1g} (median), {single.largest:.1g} (largest)"
        )
