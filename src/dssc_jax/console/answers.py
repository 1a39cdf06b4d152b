"""Print an analysis of any kind from its answer, such as a new analysis that has no printer yet."""

from pathlib import Path

from dssc_jax.console.terminal import show_files, show_head, show_table
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.fields import field_meanings


def show_analysis(analysis: Analysis, files: list[Path]) -> None:
    """Print the headline of an analysis, each number and text of its answer with its meaning, and the files.

    Entries of the answer that are lists or tables are left out.

    Args:
        analysis: The analysis.
        files: Files that were written, whose paths are printed.
    """
    show_head(analysis.study.name, analysis.headline)
    summary = analysis.summary()
    rows = []
    for key, unit, meaning in field_meanings(type(analysis).answer_type()):
        value = summary.get(key)
        if isinstance(value, bool | int | float | str):
            text = f"{value:.6g}" if isinstance(value, float) else str(value)
            rows.append((meaning, text, "" if unit == "1" else unit))
    show_table((analysis.title, "", ""), rows)
    show_files(files)
