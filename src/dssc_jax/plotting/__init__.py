"""Figures of results and trajectories. Each returns a matplotlib Figure; a failure probability shows its interval.

``failures``, ``sweep`` and ``trajectory`` compose a slide; ``distribution``, ``factor``, ``probability``, ``typical``
and ``signals`` are single panels that also draw into axes of yours.
"""

from pathlib import Path

from dssc_jax.plotting.comparisons import comparison
from dssc_jax.plotting.draws import distribution, factor, failures
from dssc_jax.plotting.margins import margin
from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, SLIDE, STYLE, write
from dssc_jax.plotting.sweeps import fitted_slope, probability, sweep, typical
from dssc_jax.plotting.trajectories import signals, trajectory
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
    "distribution",
    "factor",
    "failures",
    "fitted_slope",
    "margin",
    "probability",
    "save_all",
    "signals",
    "sweep",
    "trajectory",
    "typical",
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
