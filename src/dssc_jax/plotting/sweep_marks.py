"""Marks on curves and maps of a sweep: the certified region, and the study's own value."""

import xarray as xr
from matplotlib.axes import Axes

from dssc_jax.plotting.cells import OUTLINE
from dssc_jax.plotting.style import GREY, Direction
from dssc_jax.results.result import Result

CERTIFIED_LEGEND = "Theorem 1: without lag and sampling"
STUDY_VALUE_LEGEND = "the study's own value"


def free_axes(result: Result) -> list[str]:
    """The swept parameters that are still dimensions of the dataset."""
    return [name for name in result.study.axes if name in result.dataset.dims]


def certified_region(result: Result) -> xr.DataArray | None:
    """Whether Theorem 1 certifies the loop at each point, over :func:`free_axes`; None if no point is certified."""
    dataset = result.with_theorem().dataset
    if "certified" not in dataset or not dataset["certified"].any():
        return None
    return dataset["certified"].astype(bool)


def study_value(result: Result, name: str) -> float | None:
    """The study's own value of a swept number; None if the number has a law instead of a value."""
    value = result.study.leaves().get(name)
    return value if isinstance(value, float) else None


def reaches_study_value(result: Result, name: str) -> bool:
    """Whether the values of an axis enclose the study's own value of the swept number."""
    value = study_value(result, name)
    axis = result.study.axes[name]
    return value is not None and min(axis) <= value <= max(axis)


def mark_study_value(ax: Axes, result: Result, name: str, direction: Direction, on_map: bool = False) -> None:
    """Draw a dotted line at the study's own value of a swept number, if the axis reaches this value.

    Args:
        ax: Axes to draw into.
        result: A sweep.
        name: The swept number.
        direction: The axis along which the number grows.
        on_map: Whether the line is drawn on a map, white with a dark rim and without a legend entry. Otherwise it is
            grey and has a legend entry.
    """
    value = study_value(result, name)
    if value is None or not reaches_study_value(result, name):
        return
    draw = ax.axvline if direction == "x" else ax.axhline
    if on_map:
        draw(value, color="white", linestyle=":", linewidth=2.0, path_effects=OUTLINE)
    else:
        draw(value, color=GREY, linestyle=":", linewidth=2.0, label=STUDY_VALUE_LEGEND)
