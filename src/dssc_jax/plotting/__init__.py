"""Figures of results and trajectories. Each returns a matplotlib Figure; a failure probability shows its interval."""

from pathlib import Path

from dssc_jax.plotting.comparisons import comparison
from dssc_jax.plotting.margins import margin
from dssc_jax.plotting.populations import failures, fitted_slope, sweep
from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, SLIDE, STYLE, write
from dssc_jax.plotting.trajectories import trajectory
from dssc_jax.plotting.tuning import tuning
from dssc_jax.results import Result

__all__ = [
    "BLUE",
    "GREEN",
    "GREY",
    "ORANGE",
    "RED",
    "SLIDE",
    "STYLE",
    "comparison",
    "failures",
    "fitted_slope",
    "margin",
    "save_all",
    "sweep",
    "trajectory",
    "tuning",
    "write",
]


def save_all(result: Result, folder: Path) -> list[Path]:
    """Write the figures of a result as PNG and SVG.

    Returns:
        The files written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figure = sweep(result) if result.study.axes else failures(result)
    name = "sweep" if result.study.axes else "failures"
    return [write(figure, folder / f"{name}.{suffix}") for suffix in ("png", "svg")]
