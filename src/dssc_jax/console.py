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

from dssc_jax.global_sensitivity import FAILURE
from dssc_jax.results import headline, headline_measure
from dssc_jax.statistics import describe_probability

if TYPE_CHECKING:
    from dssc_jax.global_sensitivity import Sensitivity
    from dssc_jax.results import Result
    from dssc_jax.study import Study

WIDEST_ROWS = 40
MARKS = {True: "yes", False: "no", None: "-"}


def output() -> Console:
    """Standard output, never wrapped into unreadable columns where it is a pipe."""
    return Console(width=None if sys.stdout.isatty() else 140, highlight=False)


@contextmanager
def progress_bar(study: "Study", quiet: bool) -> Iterator[Callable[[int, int], None]]:
    """A bar with the time left, on stderr; ``quiet`` shows it only where stderr is a terminal."""
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

    def advance(done: int, total: int) -> None:
        bar.start()  # not before the first call: bad input is told without a bar
        text = study.name if done else f"{study.name} (compiling)"
        bar.update(task, completed=done, total=total, description=text)

    try:
        yield advance
    finally:
        if bar.live.is_started:
            bar.stop()


@contextmanager
def counter(study: "Study", quiet: bool) -> Iterator[Callable[[int], None]]:
    """The simulations done so far, on stderr, for work whose end nobody knows."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), TextColumn("{task.completed:,.0f} simulations"), TimeElapsedColumn())
    bar = Progress(*columns, console=console, disable=quiet and not console.is_terminal)
    task = bar.add_task(study.name, total=None)

    def advance(done: int) -> None:
        bar.start()
        bar.update(task, completed=done)

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
        console.print(describe_probability(result.failed.values, result.method), markup=False)
        if summary["stopping"]:
            stopping = summary["stopping"]
            console.print(f"the draws decided their number, {stopping['rule']}: {stopping['verdict']}", markup=False)
        show_outcomes(points[0])
    elif len(axes) == 2 and len(points) > WIDEST_ROWS:
        show_grid(result, axes)
    else:
        show_points(axes, points, headline(result).name)
    console.print(result.certificate, markup=False)
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
        (name, *(quantile_text(found, level) for level in ("q5", "q50", "q95")))
        for name, found in point["metrics"].items()
    ]
    show_table(("metric (ended early: inf)", "5 %", "median", "95 %"), rows)


def quantile_text(found: Mapping[str, Any], level: str) -> str:
    """A quantile with its interval, where there is one."""

    def number(value: float | None, infinite: str) -> str:
        return infinite if value is None else f"{value:.4g}"

    if found[level] is None or f"{level}_interval" not in found:
        return number(found[level], "inf")
    low, high = found[f"{level}_interval"]
    return f"{found[level]:.4g} [{number(low, '-inf')}, {number(high, 'inf')}]"


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
    bound = describe_probability(np.zeros(draws, dtype=bool), result.method)
    show_table(head, rows, title=f"failures in % of {draws} draws; '.': {bound}; all intervals in summary.json")


def show_sensitivity(result: "Sensitivity", files: list[Path]) -> None:
    """Indices of failure and of the study's headline metric; the file has those of all."""
    console = output()
    console.print(
        f"[bold]{escape(result.study.name)}[/bold]  Sobol indices, {result.simulations} simulations on {result.rows} "
        f"rows; {100 * result.confidence:g} % bootstrap intervals"
    )
    for name in dict.fromkeys((FAILURE, headline_measure(result.study).name)):
        found = result.outputs[name]
        if found is None:
            why = f"has no value on {result.missing[name]} draws" if result.missing[name] else "does not vary"
            console.print(f"{name}: {why}, hence no indices", markup=False)
            continue
        rows = [
            (factor, interval_text(*first), interval_text(*total))
            for factor, first, total in zip(result.factors, found.first, found.total, strict=True)
        ]
        show_table((name, "first order: alone", "total: with all interactions"), rows)
    for path in files:
        console.print(f"wrote {path}", soft_wrap=True, markup=False)


def interval_text(value: float, low: float, high: float) -> str:
    """An index with its interval; one that could be 0 says so."""
    return f"{value:.3f} [{low:.3f}, {high:.3f}]{'  consistent with 0' if low <= 0.0 else ''}"


def show_rare(found: Mapping[str, Any], files: list[Path]) -> None:
    """The probability of a rare failure, what it cost, and where failures are."""
    console = output()
    low, high = found["interval"]
    level = f"{100 * found['confidence']:g} % {found['interval_method']}"
    console.print(f"[bold]{escape(found['study'])}[/bold]  required: {escape('; '.join(found['requirements']))}")
    if found["probability"] == 0.0:
        console.print("no repeat reached a failure; this method then says nothing of its probability", markup=False)
    else:
        console.print(
            f"failure probability {found['probability']:.3g} in [{low:.3g}, {high:.3g}] ({level})", markup=False
        )
        console.print(
            f"coefficient of variation {found['variation']:.2g} by {found['simulations']:,} simulations; plain draws "
            f"would take {found['plain_draws'] or np.inf:,.0f}",
            markup=False,
        )
        rows = [
            (name, f"{about['median']:.4g}", *(f"{value:.4g}" for value in about["failing"]))
            for name, about in found["where"].items()
        ]
        show_table(("number", "median", "failing: 5 %", "median", "95 %"), rows)
    if found["in_loop_noise"]:
        console.print("in-loop noise: half of the moves redraw it; a failure that only rare noise causes costs more")
    for path in files:
        console.print(f"wrote {path}", soft_wrap=True, markup=False)


def show_draw(attributes: Mapping[str, Any], files: list[Path]) -> None:
    """How one draw ended, its drawn numbers and its metrics."""
    ended = str(attributes["outcome_meaning"]).replace("_", " ")
    output().print(f"[bold]{escape(str(attributes['study']))}[/bold] draw {attributes['draw']}: {ended}")
    skipped = {"study", "draw", "outcome", "outcome_meaning"}
    rows = [(name, f"{value:.6g}") for name, value in attributes.items() if name not in skipped]
    show_table(("number", "value"), rows)
    for path in files:
        output().print(f"wrote {path}", soft_wrap=True, markup=False)


def show_page(page: Path, note: str) -> None:
    """A page that was written."""
    output().print(f"wrote {page} ({note})", soft_wrap=True, markup=False)


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
