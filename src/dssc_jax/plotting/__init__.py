"""Figures of results and trajectories, as matplotlib Figures. Failure probabilities are shown with their intervals.

``failures``, ``sweep`` and ``trajectory`` make whole figures for a slide. ``distribution``, ``factor``,
``probability``, ``standing``, ``typical`` and ``signals`` make single panels, which can also be drawn into given axes.
"""

from pathlib import Path

from matplotlib.figure import Figure

from dssc_jax.core import files
from dssc_jax.plotting.comparisons import comparison
from dssc_jax.plotting.curves import fitted_slope
from dssc_jax.plotting.draws import distribution, factor, failures
from dssc_jax.plotting.indices import sensitivity
from dssc_jax.plotting.law_errors import law_errors
from dssc_jax.plotting.law_ranges import law_ranges
from dssc_jax.plotting.loops import loop_margins
from dssc_jax.plotting.margins import margin
from dssc_jax.plotting.rare import rare
from dssc_jax.plotting.regions import region
from dssc_jax.plotting.searches import falsification, tuning
from dssc_jax.plotting.selection import selection
from dssc_jax.plotting.strata import strata
from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, SLIDE, STYLE, write, write_png_and_svg
from dssc_jax.plotting.sweeps import probability, standing, sweep, typical
from dssc_jax.plotting.theory import theory
from dssc_jax.plotting.trajectories import signals, trajectory
from dssc_jax.plotting.winds import worst_wind
from dssc_jax.plotting.worst_loops import worst_loop
from dssc_jax.results.result import Result

__all__ = [
    "BLUE",
    "GREEN",
    "GREY",
    "ORANGE",
    "RED",
    "SLIDE",
    "STYLE",
    "comparison",
    "distribution",
    "factor",
    "failures",
    "falsification",
    "fitted_slope",
    "law_errors",
    "law_ranges",
    "loop_margins",
    "margin",
    "probability",
    "rare",
    "region",
    "save_all",
    "save_figure",
    "selection",
    "sensitivity",
    "signals",
    "standing",
    "strata",
    "sweep",
    "theory",
    "trajectory",
    "tuning",
    "typical",
    "worst_loop",
    "worst_wind",
    "write",
]


def save_all(result: Result, folder: Path) -> list[Path]:
    """Write the figure of a run or a sweep as PNG and SVG, and return the paths of the files."""
    if result.study.axes:
        return save_figure(sweep(result), folder, "sweep")
    return save_figure(failures(result), folder, "failures")


def save_figure(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG, and return the paths of the files.

    Args:
        figure: The figure.
        folder: Folder in an existing results folder; created if absent.
        name: Name of both files.
    """
    files.make_folder(folder, folder.parent)
    png = folder / f"{name}.png"
    svg = folder / f"{name}.svg"
    write_png_and_svg(figure, png, svg, folder.parent)
    return [png, svg]
