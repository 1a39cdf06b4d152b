"""Figures of results and trajectories. Each returns a matplotlib Figure; a failure probability shows its interval."""

from pathlib import Path

from matplotlib.figure import Figure

from dssc_jax.plotting.indices import sensitivity
from dssc_jax.plotting.populations import failures, fitted_slope, sweep
from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, SLIDE, STYLE, write
from dssc_jax.plotting.trajectories import trajectory
from dssc_jax.results import Result

__all__ = [
    "BLUE",
    "GREEN",
    "GREY",
    "ORANGE",
    "RED",
    "SLIDE",
    "STYLE",
    "failures",
    "fitted_slope",
    "save_all",
    "save_figure",
    "sensitivity",
    "sweep",
    "trajectory",
    "write",
]


def save_all(result: Result, folder: Path) -> list[Path]:
    """Write the figures of a result as PNG and SVG.

    Returns:
        The files written.
    """
    figure = sweep(result) if result.study.axes else failures(result)
    return save_figure(figure, folder, "sweep" if result.study.axes else "failures")


def save_figure(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG.

    Returns:
        The files written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    return [write(figure, folder / f"{name}.{suffix}") for suffix in ("png", "svg")]
