"""What a person sees in the terminal: progress, tables, one draw's end."""

import os
import platform
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from dssc_jax.results import headline
from dssc_jax.statistics import describe_probability

if TYPE_CHECKING:
    from dssc_jax.results import Result
    from dssc_jax.study import Study

WIDEST_ROWS = 40
MARKS = {True: "yes", False: "no", None: "-"}


def output() -> Console:
    """Standard output, never wrapped into unreadable columns where it is a pipe."""
    return Console(width=None if sys.stdout.isatty() else 140, highlight=False)


@contextmanager
def progress_bar(study: "Study", quiet: bool) -> Iterator[Callable[..., None]]:
    """A bar with the time left, on stderr; ``quiet`` shows it only where stderr is a terminal.

    Yields:
        Takes what is done, what is to do, and a line on what was found so far, if any.
    """
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    bar = Progress(*columns, console=console, disable=quiet and not console.is_terminal)
    task = bar.add_task(f"{study.name} (compiling)", total=None)

    def advance(done: int, total: int, found: str = "") -> None:
        bar.start()  # not before the first call: bad input is told without a bar
        text = f"{study.name} {found}".strip() if done else f"{study.name} (compiling)"
        bar.update(task, completed=done, total=total, description=text)

    try:
        yield advance
    finally:
        if bar.live.is_started:
            bar.stop()


def show_table(head: Sequence[str], rows: Sequence[Sequence[str]], title: str | None = None) -> None:
    """A plain table."""
    table = Table(*map(escape, head), title=title, title_justify="left", box=None, header_style="bold", pad_edge=False)
    for row in rows:
        table.add_row(*map(escape, row))
    output().print(table)


def show_result(result: "Result", figures: list[Path]) -> None:
    """Failure probabilities with their intervals, and where everything is."""
    summary = result.summary()
    console = output()
    required = "; ".join(summary["requirements"]) or "that the draw stays finite"
    console.print(f"[bold]{escape(result.study.name)}[/bold]  required: {escape(required)}")
    axes = list(result.study.axes)
    points = summary["points"]
    if not axes:
        console.print(describe_probability(points[0]["failures"], points[0]["draws"]))
        show_outcomes(points[0])
    elif len(axes) == 2 and len(points) > WIDEST_ROWS:
        show_grid(result, axes)
    else:
        show_points(axes, points, headline(result).name)
    marks = [point["certified"] for point in points]
    told = f"{sum(marks)} of {len(marks)} points: " if None not in marks else "no point: "
    console.print(f"certified: {told}{result.certificate}", markup=False)
    times = result.manifest["times"]
    console.print(
        f"{times['seconds']:.1f} s, of which {times['compile_seconds']:.1f} s compiling; "
        f"{times['rate'] / 1e6:.0f} million draw samples a second"
    )
    places = f"result  {result.path}\nfigures {', '.join(str(path) for path in figures)}"
    console.print(places, soft_wrap=True, markup=False)


def show_outcomes(point: dict[str, Any]) -> None:
    """How the draws ended, and the metrics' quantiles."""
    show_table(("outcome", "draws"), [(name.replace("_", " "), str(n)) for name, n in point["outcomes"].items()])
    rows = [
        (name, *(f"{value:.4g}" if value is not None else "inf" for value in found.values()))
        for name, found in point["metrics"].items()
    ]
    show_table(("metric (ended early: inf)", "5 %", "median", "95 %"), rows)


def show_points(axes: list[str], points: list[dict[str, Any]], metric: str) -> None:
    """One row a sweep point, with the headline metric's median; the first ones where there are very many."""
    rows = []
    for point in points[:WIDEST_ROWS]:
        low, high = point["interval"]
        share = f"{point['probability']:.4g}" if point["failures"] else f"<= {high:.3g}"
        values = [f"{point[name]:.5g}" for name in axes]
        middle = point["metrics"].get(metric, {}).get("q50")
        shown = "inf" if middle is None else f"{middle:.4g}"
        numbers = (f"{point['failures']}/{point['draws']}", share, f"[{low:.3g}, {high:.3g}]", shown)
        rows.append((*values, *numbers, MARKS[point["certified"]]))
    show_table((*axes, "failures", "probability", "95 % interval", f"median {metric}", "certified"), rows)
    if len(points) > WIDEST_ROWS:
        output().print(f"... and {len(points) - WIDEST_ROWS} more points in summary.json")


def show_grid(result: "Result", axes: list[str]) -> None:
    """Failure probability in per cent over two axes."""
    down, across = axes
    failed = result.failed.transpose(down, across, "draw").values
    share = 100.0 * failed.mean(-1)
    head = (f"{down} \\ {across}", *(f"{value:.3g}" for value in result.study.axes[across]))
    rows = []
    for value, row, counts in zip(result.study.axes[down], share, failed.sum(-1), strict=True):
        rows.append(
            (
                f"{value:.3g}",
                *("." if n == 0 else "<1" if p < 0.5 else f"{p:.0f}" for p, n in zip(row, counts, strict=True)),
            )
        )
    draws = failed.shape[-1]
    bound = describe_probability(0, draws)
    show_table(head, rows, title=f"failures in % of {draws} draws; '.': {bound}; all intervals in summary.json")


def show_draw(attributes: Mapping[str, Any], files: list[Path]) -> None:
    """How one draw ended, its drawn numbers and its metrics."""
    ended = str(attributes["outcome_meaning"]).replace("_", " ")
    output().print(f"[bold]{escape(str(attributes['study']))}[/bold] draw {attributes['draw']}: {ended}")
    skipped = {"study", "draw", "outcome", "outcome_meaning"}
    rows = [(name, f"{value:.6g}") for name, value in attributes.items() if name not in skipped]
    show_table(("number", "value"), rows)
    for path in files:
        output().print(f"wrote {path}", soft_wrap=True, markup=False)


def show_margins(summary: Mapping[str, Any], files: list[Path]) -> None:
    """A distribution of margins by the numbers one can defend."""
    console = output()
    start, end = summary["bounds"]
    required = escape("; ".join(summary["criterion"]))
    console.print(f"[bold]{escape(summary['study'])}[/bold]  required: {required}")

    def told(value: float | None, before: str) -> str:
        if value is None:
            return before
        return f"{value:.6g} {summary['unit']}" + (" or beyond" if value == end else "")

    few = "none: it lies before the start, or 59 draws are needed"
    rows = [
        ("draws", str(summary["draws"])),
        ("walk", f"{start:g} to {end:g} {summary['unit']}"),
        ("median critical value", told(summary["median"], "before the start")),
        ("95 % of all draws pass up to (confidence 95 %, Wilks)", told(summary["lower_tolerance"], few)),
        ("fail at the start already", f"{100 * summary['fail_at_start']:.3g} %"),
        ("pass the whole way", f"{100 * summary['pass_to_end']:.3g} %"),
        ("pass again beyond a failure", f"{100 * summary['non_monotone']:.3g} %"),
        ("seconds", f"{summary['seconds']:.1f}, of which {summary['compile_seconds']:.1f} compiling"),
    ]
    show_table((summary["parameter"], ""), rows)
    for path in files:
        console.print(f"wrote {path}", soft_wrap=True, markup=False)


def show_comparison(summary: Mapping[str, Any], files: list[Path]) -> None:
    """Controllers one by one and in pairs, with the gains that correspond and with tuned ones."""
    console = output()
    required = "; ".join(summary["requirements"]) or "that the draw stays finite"
    console.print(f"[bold]{escape(summary['study'])}[/bold]  required: {escape(required)}")
    for contest, gains in ((summary, "given or corresponding gains"), (summary["tuned"], "tuned gains")):
        if contest is None:
            continue
        metric = headline_metric(contest)
        rows = []
        for name, own in contest["controllers"].items():
            low, high = own["interval"]
            share = f"{own['probability']:.4g}" if own["failures"] else f"<= {high:.3g}"
            middle = f"{own['median'][metric]:.4g}" if metric else ""
            rows.append((name, f"{own['failures']}/{summary['draws']}", share, f"[{low:.3g}, {high:.3g}]", middle))
        show_table((gains, "failures", "probability", "95 % interval", f"median {metric or ''}"), rows)
        rows = []
        for pair in contest["pairs"]:
            low, high = pair["interval"]
            difference = f"{pair['difference']:+.4g} in [{low:+.3g}, {high:+.3g}]"
            rows.append((f"{pair['a']} - {pair['b']}", difference, f"{pair['p_value']:.3g}"))
        show_table(("failure probability, paired", "difference, 95 % interval", "p-value (exact McNemar)"), rows)
    if summary["tuned"]:
        console.print(f"tuning: {escape(summary['tuned']['budget'])}", soft_wrap=True)
    for path in files:
        console.print(f"wrote {path}", soft_wrap=True, markup=False)


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
        console.print(f"hunt {number}: worst margin {hunt['margin']:.4g} in {hunt['simulations']} simulations")
    if not summary["feasible"]:
        console.print(
            f"no point met every limit on the validation draws; the nearest misses by {summary['violation']:.2%}"
        )
    console.print(f"{summary['method']}, {summary['stopped']}; {summary['seconds']:.1f} s")
    for path in files:
        console.print(f"wrote {path}", soft_wrap=True, markup=False)


def show_falsification(summary: Mapping[str, Any], files: list[Path]) -> None:
    """The worst draw that was found."""
    console = output()
    required = escape("; ".join(summary["requirements"]))
    console.print(f"[bold]{escape(summary['study'])}[/bold]  required: {required}")
    show_table(("worst draw", ""), [(name, f"{value:.6g}") for name, value in summary["witness"].items()])
    margin = "ended early" if summary["margin"] == -np.inf else f"margin {summary['margin']:.4g} of the bound"
    spent = f"{summary['simulations']} simulations, {summary['seconds']:.1f} s"
    found = (
        f"fails; the first failure came after {summary['first_failure']}" if summary["failed"] else "passes; the worst"
    )
    console.print(f"it {found} of {spent}: {margin}")
    for path in files:
        console.print(f"wrote {path}", soft_wrap=True, markup=False)


def headline_metric(contest: Mapping[str, Any]) -> str | None:
    """The last metric of a contest, which a requirement added, if there is any."""
    metrics = list(next(iter(contest["controllers"].values()))["median"])
    return metrics[-1] if metrics else None


def jsonable(content: Any) -> Any:
    """Plain data as JSON has it: NaN and infinity become null."""
    if isinstance(content, Mapping):
        return {name: jsonable(value) for name, value in content.items()}
    if isinstance(content, list | tuple):
        return [jsonable(value) for value in content]
    value = content.item() if isinstance(content, np.generic) else content
    return None if isinstance(value, float) and not np.isfinite(value) else value


def machine() -> str:
    """Processor, versions and date, to stand beside a measured number."""
    import jax

    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [line.partition(":")[2].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        model = f"{len(names)} cores of {names[0]}" if names else model
    return f"{model}, Python {platform.python_version()}, JAX {jax.__version__}, {datetime.now(UTC):%Y-%m-%d}"


def environment() -> dict[str, Any]:
    """Versions, devices, flags and registries."""
    import jax

    from dssc_jax import xla
    from dssc_jax.study.build import REGISTRIES
    from dssc_jax.study.components import field_specs

    kinds = {}
    for slot, registry in REGISTRIES.items():
        kinds[slot] = {}
        for kind, entry in registry.items():
            member = next(iter(entry.members.values()))
            options = {entry.option: [key.value for key in entry.members]} if entry.option else {}
            kinds[slot][kind] = {
                "summary": entry.summary,
                "fields": list(field_specs(getattr(member, "params", member))),
                "options": options,
            }
    packages = ("dssc_jax", "jax", "jaxlib", "numpy", "scipy", "xarray", "zarr", "optax")
    return {
        "versions": {"python": platform.python_version(), **{name: version(name) for name in packages}},
        "devices": [str(device) for device in jax.devices()],
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
        "xla_settings": "off" if os.environ.get(xla.SWITCH, "").lower() in xla.OFF else "on",
        "kinds": kinds,
    }


def show_environment(found: dict[str, Any]) -> None:
    """The environment, for people."""
    console = output()
    console.print("  ".join(f"{name} {number}" for name, number in found["versions"].items()))
    console.print(
        f"devices    {', '.join(found['devices'])}\nXLA flags  {found['xla_flags'] or 'none'}", soft_wrap=True
    )
    for slot, kinds in found["kinds"].items():
        rows = []
        for kind, about in kinds.items():
            options = "; ".join(f"{name}: {' | '.join(map(str, values))}" for name, values in about["options"].items())
            rows.append((kind, about["summary"], ", ".join(about["fields"]), options))
        show_table((f"[{slot}]", "what", "fields", "options"), rows)
