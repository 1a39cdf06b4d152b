"""What a person sees in the terminal: progress, tables, one draw's end."""

import os
import platform
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import cache
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
    from dssc_jax.design import Certificate, Parameters
    from dssc_jax.results import Result
    from dssc_jax.study import Study
    from dssc_jax.verification import Verification

WIDEST_ROWS = 40


def output() -> Console:
    """Standard output, never wrapped into unreadable columns where it is a pipe."""
    return Console(width=None if sys.stdout.isatty() else 140, highlight=False)


@cache
def errors() -> Console:
    """Standard error, shared by the bar and by what is told meanwhile."""
    return Console(stderr=True, highlight=False)


def tell(text: str) -> None:
    """Something a person should know while a run goes on."""
    errors().print(text, markup=False)


@contextmanager
def progress_bar(study: "Study", quiet: bool) -> Iterator[Callable[[int, int], None]]:
    """A bar with the time left, on stderr; ``quiet`` shows it only where stderr is a terminal."""
    console = errors()
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
    times = result.manifest["times"]
    console.print(
        f"{times['seconds']:.1f} s, of which {times['compile_seconds']:.1f} s compiling; "
        f"{times['rate'] / 1e6:.0f} million draw samples a second"
    )
    if "cluster" in result.manifest:
        cluster = result.manifest["cluster"]
        console.print(f"{cluster['workers']} workers, {len(cluster['lost'])} lost on the way", highlight=False)
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
        rows.append((*values, f"{point['failures']}/{point['draws']}", share, f"[{low:.3g}, {high:.3g}]", shown))
    show_table((*axes, "failures", "probability", "95 % interval", f"median {metric}"), rows)
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
    show_files(files)


def show_verification(found: "Verification") -> None:
    """How a result compares with its lanes computed again."""
    console = output()
    console.print(f"{found.identical} of {found.lanes} lanes bit-identical (--seed {found.seed} picks the same ones)")
    if found.worst is not None:
        rows = [
            (name, f"{value:.17g}" if isinstance(value, float) else str(value)) for name, value in found.worst.items()
        ]
        show_table(("largest deviation", f"{found.deviation:.3g}"), rows)
        verdict = "within rounding" if found.verified else "[red]more than rounding[/red]"
        console.print(f"the deviation is {verdict}; computed otherwise: {escape('; '.join(found.otherwise) or 'no')}")


def show_files(files: Sequence[Path]) -> None:
    """The files that were written."""
    for path in files:
        output().print(f"wrote {path}", soft_wrap=True, markup=False)


def show_certificate(name: str, parameters: "Parameters", certificate: "Certificate") -> None:
    """Every inequality with its slack."""
    console = output()
    verdict = "[green]certified[/green]" if certificate.certified else "[red]not certified[/red]"
    console.print(f"[bold]{escape(name)}[/bold]: {verdict}")
    console.print("  ".join(f"{key}={value:.6g}" for key, value in parameters._asdict().items()))
    rows = []
    for i in certificate.inequalities:
        numbers = ["-" if x is None else f"{x:.6g}" for x in (i.value, i.bound, i.slack, i.printed_slack)]
        rows.append((i.name, *numbers, i.state.value.replace("_", " "), i.equation))
    show_table(("inequality", "value", "must exceed", "slack", "printed slack", "state", "equation"), rows)


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
