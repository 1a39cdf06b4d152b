"""Print searches: tuned gains, and the worst draw."""

from collections.abc import Mapping
from pathlib import Path

from rich.markup import escape

from dssc_jax.analyses.falsification.falsify import Falsified
from dssc_jax.analyses.tuning import Tuned
from dssc_jax.console.terminal import number_text, output, show_files, show_table

ENDED = "ended early"


def show_tuning(tuned: Tuned, files: list[Path]) -> None:
    """Print the tuned numbers and their evaluation on fresh draws."""
    summary = tuned.summary()
    console = output()
    console.print(f"[bold]{escape(summary['study'])}[/bold]")
    rows = [(name, f"{summary['start'][name]:.6g}", f"{value:.6g}") for name, value in summary["tuned"].items()]
    show_table(("tuned", "start", "result"), rows)
    verdict = summary["verdict"]
    (before, after), (low, high) = verdict["objective"], verdict["reduction_interval"]
    aggregate, level = summary["objective"]["aggregate"], summary["objective"]["level"]
    name = f"{aggregate} {level:g}" if aggregate == "cvar" else aggregate
    rows = [(f"objective ({name})", number_text(before, ".5g", ENDED), number_text(after, ".5g", ENDED), "")]
    for metric, (bound, first, second) in verdict["limits"].items():
        before, after = (number_text(mean, ".5g", ENDED) for mean in (first, second))
        rows.append((f"mean {metric}", before, after, f"<= {bound:.5g}"))
    first, second = verdict["failures"]
    rows.append(("failed draws", str(first), str(second), ""))
    show_table((f"on {verdict['draws']} fresh draws", "start", "result", "limit"), rows)
    reduction, low, high = (number_text(value, ".1%") for value in (verdict["reduction"], low, high))
    console.print(f"reduction {reduction} in [{low}, {high}] (95 %, bootstrap over draws)")
    middle, low, high = (number_text(value, "+.4g") for value in verdict["difference"])
    console.print(f"cost draw by draw, result less start: median {middle} in [{low}, {high}] (95 %, exact)")
    if summary["gradients"]:
        console.print(f"gradients: {summary['gradients']['text']}")
    if summary["certified_points"] is not None:
        console.print(f"certified: all {summary['certified_points']} points that were visited, by Theorem 1")
    if (aimed := summary.get("aimed")) is not None:
        name = "proved bound of |e|" if aimed["over"] is None else f"last proved {aimed['over']}"
        console.print(f"{name}: {aimed['start']:.4g} at the start, {aimed['result']:.4g} at the result", markup=False)
    if summary["proved_points"] is not None:
        console.print(f"proved: all {summary['proved_points']} points that were accepted, with lag and sampling")
    if summary.get("proof") is not None:
        console.print(summary["proof"], markup=False, soft_wrap=True)
    for number, hunt in enumerate(summary["counterexamples"], start=1):
        slack = number_text(hunt["slack"], ".4g", ENDED)
        console.print(f"hunt {number}: worst slack {slack} in {hunt['simulations']} simulations")
    if not summary["feasible"]:
        missed = number_text(summary["violation"], ".2%", "draws that end early")
        console.print(f"no point met every limit on the validation draws; the nearest misses by {missed}")
    console.print(f"{summary['method']}, {summary['stopped']}; {summary['seconds']:.1f} s")
    show_files(files)


def likelihood_text(likelihood: Mapping[str, float]) -> str:
    """How likely a draw is, in words."""
    return (
        f"at {likelihood['distance']:.3g} sigma: log density {likelihood['log_density']:.4g} relative to the mode; "
        f"{likelihood['mass']:.5g} of all draws lie nearer"
    )


def show_falsification(falsified: Falsified, files: list[Path]) -> None:
    """Print the worst draw found and the likeliest failure, with their likelihoods."""
    summary = falsified.summary()
    console = output()
    required = escape("; ".join(summary["requirements"]))
    console.print(f"[bold]{escape(summary['study'])}[/bold]  required: {required}")
    if within := summary["within"]:
        console.print(f"searched: within {within['distance']:.4g} sigma, which holds {within['mass']:.5g} of all draws")
    nearest = summary["nearest_failure"]
    columns = [summary["witness"], nearest["witness"]] if nearest else [summary["witness"]]
    rows = [
        (name, *(f"{column[name]:.6g}" for column in columns), "" if unit == "1" else unit)
        for name, unit in summary["units"].items()
    ]
    show_table((*("number", "worst draw", "likeliest failure")[: 1 + len(columns)], ""), rows)
    value, rule = summary["worst_value"], summary["worst_requirement"]
    result = ENDED if value is None else f"{value} where {rule} is required"
    spent = f"{summary['simulations']} simulations, {summary['seconds']:.1f} s"
    if summary["failed"]:
        console.print(f"it fails: {result}; the first failure came after {summary['first_failure']} of {spent}")
    else:
        console.print(f"no failure was found, which proves nothing; the worst of {spent}: {result}")
    console.print(f"worst draw {likelihood_text(summary['likelihood'])}", soft_wrap=True)
    if nearest:
        console.print(f"likeliest failure found {likelihood_text(nearest['likelihood'])}", soft_wrap=True)
    show_files(files)
