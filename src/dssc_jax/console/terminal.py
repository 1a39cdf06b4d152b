"""Output shared by all commands: tables, progress, plain data for JSON."""

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

if TYPE_CHECKING:
    from dssc_jax.core.signals import ProgressCallback
    from dssc_jax.study import Study


PIPE_WIDTH = 10_000
FOLDED = 24  # characters that a column of prose keeps at least where it is folded


def output() -> Console:
    """Standard output; a pipe or a file has no width, so that each row of a table is one line there."""
    return Console(width=None if sys.stdout.isatty() else PIPE_WIDTH, highlight=False)


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
    notify(f"{study.name}: compiling, which takes a few seconds if the cache does not have it")


@contextmanager
def progress_bar(
    study: "Study", quiet: bool, of: str = "draws", early: str | Callable[[], str] = "", compiles: bool = True
) -> Iterator["ProgressCallback"]:
    """Show a progress bar with the time left on stderr; with ``quiet`` only if stderr is a terminal.

    Args:
        study: The study that is computed.
        quiet: Whether a program reads the command's output.
        of: The unit that is counted.
        early: The reason why the work may end early, if it may, or a function that gives it once the work has ended.
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
    latest = 0
    limit = 0
    announced = False

    def advance(completed: int, total: int | None) -> None:
        nonlocal latest, limit, announced
        if compiles and not announced:
            announce_compiling(study, quiet)
        announced = True
        latest = completed
        limit = completed if total is None else total
        bar.start()  # not before the first call: bad input shows no bar
        description = study.name if completed else f"{study.name} (compiling)"
        bar.update(task, completed=completed, total=total, description=description)

    try:
        yield advance
        if latest < limit:
            bar.update(task, total=latest)
    finally:
        if bar.live.is_started:
            bar.stop()
    if latest < limit and not bar.disable:
        reason = early() if callable(early) else early
        notify(f"{study.name} took {latest:,} of at most {limit:,} {of}: {reason}")


def show_table(head: Sequence[str], rows: Sequence[Sequence[str]], title: str | None = None) -> None:
    """Print a plain table.

    Where it is wider than the terminal, its widest column is folded if it is prose; otherwise each row is printed as a
    block of lines, so that no number is broken.
    """
    console = output()
    widths = [max(len(line) for line in column) for column in zip(head, *rows, strict=True)]
    widest = widths.index(max(widths))
    fixed = sum(widths) - widths[widest] + 2 * (len(widths) - 1)
    fits = fixed + widths[widest] <= console.width
    if not fits and (console.width - fixed < FOLDED or not is_prose([row[widest] for row in rows])):
        show_blocks(head, rows, title)
        return
    table = Table(title_justify="left", box=None, header_style="bold", pad_edge=False, padding=(0, 2, 0, 0))
    for index, name in enumerate(head):
        table.add_column(escape(name), no_wrap=index != widest or fits)
    table.title = None if title is None else escape(title)
    for row in rows:
        table.add_row(*map(escape, row))
    console.print(table)


def is_prose(cells: Sequence[str]) -> bool:
    """Whether a column may be folded: words, not numbers or intervals."""
    for cell in cells:
        words = cell.split()
        if " " in cell and sum(word.isalpha() for word in words) > len(words) // 2:
            return True
    return False


def show_blocks(head: Sequence[str], rows: Sequence[Sequence[str]], title: str | None) -> None:
    """Print each row of a table as its first cell and a line for each other one."""
    console = output()
    if title is not None:
        console.print(title, markup=False)
    width = max(map(len, head[1:]), default=0)
    for first, *cells in rows:
        console.print(f"[bold]{escape(f'{head[0]} ' if head[0] else '')}{escape(first)}[/bold]")
        for name, cell in zip(head[1:], cells, strict=True):
            console.print(f"  {name:<{width}}  {cell}", markup=False, soft_wrap=True)


class PairedDifference(Protocol):
    """The difference of a pair of controllers a, b, with its interval and the test's p-value."""

    @property
    def a(self) -> str:
        """One controller."""
        ...

    @property
    def b(self) -> str:
        """The other controller."""
        ...

    @property
    def difference(self) -> float:
        """The compared number of a, minus that of b."""
        ...

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of the difference."""
        ...

    @property
    def p_value(self) -> float:
        """p-value of the test that there is no difference."""
        ...


def show_pairs(pairs: Sequence[PairedDifference], title: str, test: str) -> None:
    """Print the differences of all pairs of controllers, with their intervals and the test's p-values."""
    rows = []
    for pair in pairs:
        low, high = pair.interval
        difference = f"{pair.difference:+.4g} in [{low:+.3g}, {high:+.3g}]"
        rows.append((f"{pair.a} - {pair.b}", difference, f"{pair.p_value:.3g}"))
    show_table((title, "difference, 95 % interval", f"p-value ({test})"), rows)


def show_files(files: Sequence[Path]) -> None:
    """Print the files that were written."""
    for path in files:
        output().print(f"wrote {path}", soft_wrap=True, markup=False)


def show_page(page: Path, note: str) -> None:
    """Print the page that was written."""
    output().print(f"wrote {page} ({note})", soft_wrap=True, markup=False)


def number_text(value: float | None, form: str = ".3g", missing: str = "none") -> str:
    """A number as text, or ``missing`` if there is none or it is not finite."""
    return missing if value is None or not math.isfinite(value) else format(value, form)
