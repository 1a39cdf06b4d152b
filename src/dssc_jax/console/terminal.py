"""Print text, tables and progress to the terminal, and format numbers; used by all commands."""

import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
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


STAYS_FINITE = "that the draw stays finite"
"""What is required of each draw of a study without requirements."""
PIPE_WIDTH = 10_000
"""Width of the output if it goes to a pipe or a file [characters]."""
NARROWEST_PROSE = 24
"""Least width to which a column of prose is folded [characters]."""


def output() -> Console:
    """Return the console of standard output; in a pipe or a file, lines are not broken."""
    return Console(width=None if sys.stdout.isatty() else PIPE_WIDTH, highlight=False)


@cache
def errors() -> Console:
    """Return the console of standard error, for the progress bar and for notices during a run."""
    return Console(stderr=True, highlight=False)


def notify(text: str) -> None:
    """Print a line to standard error during a run."""
    errors().print(text, markup=False, soft_wrap=True)


def show_head(name: str, text: str) -> None:
    """Print the name of a study in bold, followed by a text."""
    output().print(f"[bold]{escape(name)}[/bold]  {escape(text)}")


def show_required(name: str, requirements: Sequence[str]) -> None:
    """Print the name of a study in bold, followed by its requirements.

    Args:
        name: Name of the study.
        requirements: The requirements in words; empty: the draws need only stay finite.
    """
    show_head(name, f"required: {'; '.join(requirements) or STAYS_FINITE}")


def show_line(text: str) -> None:
    """Print a text without line breaks, so that long names and paths can be copied from a terminal."""
    output().print(text, markup=False, soft_wrap=True)


def show_paragraph(text: str) -> None:
    """Print a text, broken between words where the terminal is narrower than the text."""
    output().print(text, markup=False)


def announce_compiling(study: "Study", quiet: bool) -> None:
    """Print to standard error that the loop will be compiled.

    Args:
        study: The study.
        quiet: Whether a program reads the output; then nothing is printed.
    """
    if not quiet:
        notify(f"{study.name}: compiling, which takes a few seconds if the cache does not have it")


@contextmanager
def progress_bar(
    study: "Study", quiet: bool, unit: str = "draws", early: str | Callable[[], str] = "", compiles: bool = True
) -> Iterator["ProgressCallback"]:
    """Show a progress bar with the remaining time on standard error.

    With ``quiet``, the bar is shown only if standard error is a terminal.

    Args:
        study: The study that is computed.
        quiet: Whether a program reads the command's output.
        unit: What is counted, for the message if the work ends early.
        early: Reason why the work may end early, or a function that returns the reason once the work has ended.
        compiles: Whether the loop is compiled first.

    Yields:
        The progress callback, to be called with the completed and the total count; a total of None is not known.
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
        """Move the bar to ``completed`` of ``total`` steps; the first call shows it.

        A total of None is unknown, and shows no share of the work.
        """
        nonlocal latest, limit, announced
        if compiles and not announced:
            announce_compiling(study, quiet)
        announced = True
        latest = completed
        limit = completed if total is None else total
        bar.start()  # not earlier, so that bad input shows no bar
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
        notify(f"{study.name} took {latest:,} of at most {limit:,} {unit}: {reason}")


def show_table(head: Sequence[str], rows: Sequence[Sequence[str]], title: str | None = None) -> None:
    """Print a plain table of text cells.

    If the table is wider than the terminal, its widest column is folded, provided that this column is prose. Otherwise
    each row is printed as a block of lines, so that no number is broken.

    Args:
        head: Names of the columns.
        rows: Cells, one sequence for each row.
        title: Title above the table; None: no title.
    """
    console = output()
    widths = []
    for column in zip(head, *rows, strict=True):
        widths.append(max(map(len, column)))
    widest = widths.index(max(widths))
    other_width = sum(widths) - widths[widest] + 2 * (len(widths) - 1)  # with the gaps between columns
    fits = other_width + widths[widest] <= console.width
    if not fits:
        has_room = console.width - other_width >= NARROWEST_PROSE
        if not has_room or not is_prose([row[widest] for row in rows]):
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
    """Whether a column may be folded: at least one of its cells has several parts, most of which are words."""
    for cell in cells:
        parts = cell.split()
        word_count = sum(part.isalpha() for part in parts)
        if " " in cell and word_count > len(parts) // 2:
            return True
    return False


def show_blocks(head: Sequence[str], rows: Sequence[Sequence[str]], title: str | None) -> None:
    """Print each row of a table as a block: the first cell in bold, and one line for each further cell.

    Args:
        head: Name of each column.
        rows: Cells of each row.
        title: Title above the blocks; None: no title.
    """
    if title is not None:
        show_paragraph(title)
    width = max(map(len, head[1:]), default=0)
    for first, *cells in rows:
        block_title = f"{head[0]} {first}" if head[0] else first
        output().print(f"[bold]{escape(block_title)}[/bold]")
        for name, cell in zip(head[1:], cells, strict=True):
            show_line(f"  {name:<{width}}  {cell}")


class PairedDifference(Protocol):
    """Paired difference of two controllers a and b on the same draws."""

    @property
    def a(self) -> str:
        """Name of the first controller."""
        ...

    @property
    def b(self) -> str:
        """Name of the second controller."""
        ...

    @property
    def difference(self) -> float:
        """Compared number of controller a minus that of controller b."""
        ...

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper bound of the difference."""
        ...

    @property
    def p_value(self) -> float:
        """p-value of the test that there is no difference."""
        ...


def show_pairs(pairs: Sequence[PairedDifference], title: str, test: str) -> None:
    """Print the difference of each pair of controllers with its 95 % interval and the p-value of a test.

    Args:
        pairs: The differences.
        title: Name of the compared number.
        test: Name of the test.
    """
    rows = []
    for pair in pairs:
        low, high = pair.interval
        difference = f"{pair.difference:+.4g} in [{low:+.3g}, {high:+.3g}]"
        rows.append((f"{pair.a} - {pair.b}", difference, f"{pair.p_value:.3g}"))
    show_table((title, "difference, 95 % interval", f"p-value ({test})"), rows)


def show_files(files: Sequence[Path]) -> None:
    """Print the path of each file that was written."""
    for path in files:
        show_line(f"wrote {path}")


def number_text(value: float | None, format_spec: str = ".3g", missing: str = "none") -> str:
    """Format a number; a number that is None, infinite or NaN becomes the text ``missing``."""
    if value is None or not math.isfinite(value):
        return missing
    return format(value, format_spec)


def values_text(values: Mapping[str, float], format_spec: str = ".6g") -> str:
    """Format numbers with their names in one line.

    Example:
        >>> values_text({"k_p": 1.25, "mu": 0.02})
        'k_p = 1.25, mu = 0.02'
    """
    return ", ".join(f"{name} = {value:{format_spec}}" for name, value in values.items())
