"""Print margins: of one loop, of several controllers, and with theory."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.markup import escape

from dssc_jax.console.terminal import number_text, output, show_files, show_pairs, show_table
from dssc_jax.statistics import wilks_draws

BEFORE = "before the start"
SHARES = {
    "fail_at_start": "fail at the start already",
    "pass_to_end": "pass the whole way",
    "non_monotone": "pass again beyond a failure",
}
TURNED = 0.5  # share of draws that fail at the start and pass further on: the walk may be the wrong way round


def value_text(value: float | None, end: float, unit: str = "") -> str:
    """A critical value of some rank as text; marked if it lies outside the walk."""
    if value is None:
        return BEFORE
    return f"{value:.4g}{'' if unit in ('', '1') else f' {unit}'}{' or beyond' if value == end else ''}"


def tolerance_text(summary: Mapping[str, Any], draws: int, end: float, unit: str = "") -> str:
    """The lower tolerance limit, or the reason why there is none."""
    needed = wilks_draws(summary["content"], summary["confidence"])
    if draws < needed:
        return f"none of {draws} draws, {needed} are needed"
    return value_text(summary["lower_tolerance"], end, unit)


def show_margins(summary: Mapping[str, Any], files: list[Path]) -> None:
    """Print a summary of a distribution of margins."""
    console = output()
    (start, end), unit, draws = summary["bounds"], summary["unit"], summary["draws"]
    required = escape("; ".join(summary["criterion"]))
    console.print(f"[bold]{escape(summary['study'])}[/bold]  required: {required}")
    rows = [
        ("draws", str(draws)),
        ("walk", f"{start:g} to {end:g}{'' if unit == '1' else f' {unit}'}"),
        ("median critical value", value_text(summary["median"], end, unit)),
        ("95 % of all draws pass up to (confidence 95 %, Wilks)", tolerance_text(summary, draws, end, unit)),
        *((text, f"{100 * summary[share]:.3g} %") for share, text in SHARES.items()),
        *((f"first violated: {text}", f"{n} of {draws} draws") for text, n in summary["first_violated"].items()),
        ("seconds", f"{summary['seconds']:.1f}, of which {summary['compile_seconds']:.1f} compiling"),
    ]
    show_table((summary["parameter"], ""), rows)
    console.print(summary["certificate"], markup=False, soft_wrap=True)
    show_reach(summary["proof"])
    if min(summary["fail_at_start"], summary["non_monotone"]) > TURNED:
        console.print(f"most draws fail at {start:g} and pass further on: is {start:g} the safe end of the walk?")
    show_files(files)


def show_reach(proof: Mapping[str, Any] | None) -> None:
    """Print how far the sampled loop is proved, if that was asked."""
    if proof is not None:
        output().print(proof["statement"], markup=False, soft_wrap=True)


def show_margin_contest(summary: Mapping[str, Any], files: list[Path]) -> None:
    """Print the margins of several controllers, and for each pair which one goes further."""
    console = output()
    (start, end), draws, unit = summary["bounds"], summary["draws"], summary["unit"]
    required = escape("; ".join(summary["criterion"]))
    console.print(f"[bold]{escape(summary['study'])}[/bold]  {draws} draws; required: {required}")
    controllers = summary["controllers"]
    rows = [
        (
            name,
            value_text(own["median"], end),
            tolerance_text(own, draws, end),
            *(f"{100 * own[share]:.3g} %" for share in SHARES),
            f"{own['seconds']:.1f}",
        )
        for name, own in controllers.items()
    ]
    head = ("controller", "median", "95 % of draws pass up to", *SHARES.values(), "seconds")
    show_table(head, rows, f"{summary['parameter']} [{unit}] from {start:g} to {end:g}")
    show_pairs(summary["pairs"], "share of draws that go further", "exact, paired")
    for text in sorted({own["certificate"] for own in controllers.values()}):
        names = [name for name, own in controllers.items() if own["certificate"] == text]
        console.print(f"{', '.join(names)}: {text}", markup=False, soft_wrap=True)
    console.print(f"{summary['seconds']:.1f} s in all")
    show_files(files)


def show_theory(summary: Mapping[str, Any], files: list[Path]) -> None:
    """Print the answers of theory and simulation, one row each, with the question that each one answers."""
    console = output()
    (start, end), draws = summary["bounds"], summary["draws"]
    console.print(f"[bold]{escape(summary['study'])}[/bold]  {draws} draws, {escape(summary['parameter'])}")
    rows = [
        (name, value_text(own["median"], end), tolerance_text(own, draws, end), "; ".join(own["criterion"]))
        for name, own in {**summary["local"], "simulated": summary["performance"]}.items()
    ]
    head = ("margin", f"median [{summary['unit']}]", "95 % of draws pass up to", "criterion")
    show_table(head, rows, f"walk from {start:g} to {end:g}")
    rows = [
        (name, f"{of['mu'][k]:.3g}", f"{of['amplitude'][k]:.3g}", number_text(of["predicted"][k]))
        for name, of in summary["oscillations"].items()
        for k in (0, len(of["mu"]) // 2, -1)
    ]
    if rows:
        show_table(("oscillation", "mu [s]", "amplitude of sigma [output/s]", "by describing function"), rows)
    console.print(summary["certificate"]["text"], markup=False, soft_wrap=True)
    show_reach(summary["proof"])
    for name, reason in summary["not_covered"].items():
        console.print(f"{name}: {reason}", markup=False, soft_wrap=True)
    show_files(files)
