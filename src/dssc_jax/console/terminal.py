"""Output shared by all commands: tables, progress, plain data for JSON."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from dssc_jax.core.signals import ProgressCallback

if TYPE_CHECKING:
    from dssc_jax.study import Study


def output() -> Console:
    """Standard output, with a fixed width if it is not a terminal."""
    return Console(width=None if sys.stdout.isatty() else 140, highlight=False)


@cache
def errors() -> Console:
    """Standard error, used by the progress bar and by notices during a run."""
    return Console(stderr=True, highlight=False)


def notify(text: str) -> None:
    """Show a line on standard error during a run."""
    errors().print(text, markup=False, soft_wrap=True)


def announce_compiling(study: "Study", quiet: bool = False) -> None:
    """Say on standard error that the loop is about to be compiled, which takes longer the more channels it has."""
    if quiet:
        return
    usual = "about half a minute for a vehicle" if len(study.loop.channels) > 1 else "a few seconds"
    notify(f"{study.name}: compiling, which usually takes {usual} the first time and is kept for the next")


@contextmanager
def progress_bar(
    study: "Study", quiet: bool, of: str = "draws", early: str = "", compiles: bool = True
) -> Iterator[ProgressCallback]:
    """Show a progress bar with the time left on stderr; with ``quiet`` only if stderr is a terminal.

    Args:
        study: The study that is computed.
        quiet: Whether a program reads the command's output.
        of: The unit that is counted.
        early: The reason why the work may end early, if it may.
        compiles: Whether the loop is compiled first.

    Yields:
        The progress callback; if the total is not known, the bar only counts.
    """
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
    counted = most = 0
    announced = False

    def advance(done: int, total: int | None) -> None:
        nonlocal counted, most, announced
        if compiles and not announced:
            announce_compiling(study, quiet)
        announced = True
        counted, most = done, done if total is None else total
        bar.start()  # not before the first call: bad input shows no bar
        bar.update(task, completed=done, total=total, description=study.name if done else f"{study.name} (compiling)")

    try:
        yield advance
        if counted < most:
            bar.update(task, total=counted)
    finally:
        if bar.live.is_started:
            bar.stop()
    if counted < most and not bar.disable:
        notify(f"{study.name} stopped early after {counted:,} of at most {most:,} {of}: {early}")


def show_table(head: Sequence[str], rows: Sequence[Sequence[str]], title: str | None = None) -> None:
    """Print a plain table."""
    table = Table(*map(escape, head), title_justify="left", box=None, header_style="bold", pad_edge=False)
    table.title = None if title is None else escape(title)
    for row in rows:
        table.add_row(*map(escape, row))
    output().print(table)


def show_pairs(pairs: Sequence[Mapping[str, Any]], title: str, test: str) -> None:
    """Print the differences of all pairs of controllers, with their intervals and the test's p-values."""
    rows = []
    for pair in pairs:
        low, high = pair["interval"]
        difference = f"{pair['difference']:+.4g} in [{low:+.3g}, {high:+.3g}]"
        rows.append((f"{pair['a']} - {pair['b']}", difference, f"{pair['p_value']:.3g}"))
    show_table((title, "difference, 95 % interval", f"p-value ({test})"), rows)


def show_files(files: Sequence[Path]) -> None:
    """Print the files that were written."""
    for path in files:
        output().print(f"wrote {path}", soft_wrap=True, markup=False)


def show_page(page: Path, note: str) -> None:
    """Print the page that was written."""
    output().print(f"wrote {page} ({note})", soft_wrap=True, markup=False)


def number_text(value: float | None, form: str = ".3g", missing: str = "none") -> str:
    """A number as text, or ``missing`` if there is none."""
    return missing if value is None else format(value, form)
