"""Print an analysis whose kind has no output of its own: its headline, and its single numbers with their meanings."""

from pathlib import Path

from rich.markup import escape

from dssc_jax.console.terminal import output, show_files, show_table
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.fields import field_meanings


def show_analysis(analysis: Analysis, files: list[Path]) -> None:
    """Print the headline, a row for each single number or text of the answer, and the files."""
    output().print(f"[bold]{escape(analysis.study.name)}[/bold]  {escape(analysis.headline)}", soft_wrap=True)
    summary = analysis.summary()
    rows = []
    for key, unit, meaning in field_meanings(type(analysis).answer_type()):
        value = summary.get(key)
        if isinstance(value, bool | int | float | str):
            text = f"{value:.6g}" if isinstance(value, float) else str(value)
            rows.append((meaning, text, "" if unit == "1" else unit))
    show_table((analysis.title, "", ""), rows)
    show_files(files)
