"""Figures of a sweep: failure probability and the headline metric over one axis as curves, over two as maps."""

import textwrap
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import PercentFormatter
from matplotlib.typing import LineStyleType

from dssc_jax.closed_loop.metrics.streaming import Measure
from dssc_jax.plotting.cells import OUTLINE, capped_limits, cell_edges, contour, largest_colour, needs_bitmap
from dssc_jax.plotting.curves import probability_curve, typical_curve
from dssc_jax.plotting.draws import metric_bounds
from dssc_jax.plotting.standings import standing_colours, standing_handles, standing_of
from dssc_jax.plotting.style import (
    GREY,
    PANEL,
    SLIDE,
    axis_label,
    is_log,
    label,
    panel,
    set_log_ticks,
    set_scale,
    study_title,
    styled,
    title,
)
from dssc_jax.plotting.sweep_marks import (
    CERTIFIED_LEGEND,
    STUDY_VALUE_LEGEND,
    certified_region,
    free_axes,
    mark_study_value,
    reaches_study_value,
)
from dssc_jax.results.influence import idle_text
from dssc_jax.results.result import Result, measure_named
from dssc_jax.statistics.order import upper_quantiles

LineKey: TypeAlias = tuple[str, LineStyleType]
"""Legend text and style of a white line on a map."""

MAP_PANEL = (PANEL[0], PANEL[1] + 0.8)
"""Width and height of a single map [inch]."""
HALF: LineKey = ("half of the draws fail", "-")
UPPER_BOUND: LineKey = ("95 % upper bound of the probability at 5 %", "--")
MEDIAN_LIMIT: LineKey = ("the median at its limit", "-")


@styled
def sweep(result: Result) -> Figure:
    """Plot a sweep over one axis as curves, or over two axes as maps.

    Further axes are held at their first value, which the title names.

    Raises:
        ValueError: The result has no sweep.
    """
    result = over_two_axes(result)
    figure = sweep_curves(result) if len(free_axes(result)) == 1 else sweep_maps(result)
    remarks = [text for text in (idle_text(result), result.certificate) if text]
    first_line = f"{study_title(result.study)}{fixed_parameters_text(result)}"
    title(figure, "\n".join([first_line, *remarks]))
    return figure


def sweep_curves(result: Result) -> Figure:
    """Plot the headline metric over one axis; with requirements, plot the failure probability beside it."""
    figure = Figure(figsize=SLIDE, layout="constrained")
    if result.study.requirements:
        left, right = figure.subplots(1, 2)
        typical(result, left)
        probability(result, right)
    else:
        typical(result, figure.subplots())
    return figure


def sweep_maps(result: Result) -> Figure:
    """Plot two maps over two axes with a common legend.

    The left map shows the standings if the points were proved, and otherwise the failure probability. The right map
    shows the headline metric.
    """
    figure = Figure(figsize=(SLIDE[0], SLIDE[1] + 0.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    if "proved" in result.dataset:
        standing(result, left)
        handles = [*standing_handles(result.dataset["proved"].attrs["covered"]), *map_handles(result, [MEDIAN_LIMIT])]
    else:
        probability(result, left)
        handles = map_handles(result, [(f"{HALF[0]}, or {MEDIAN_LIMIT[0]}", "-"), UPPER_BOUND])
    typical(result, right)
    right.set_ylabel("")
    for ax in (left, right):
        legend = ax.get_legend()
        if legend is not None:  # the common legend replaces it
            legend.remove()
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    return figure


@styled
def probability(result: Result, ax: Axes | None = None) -> Figure:
    """Plot the failure probability over the first one or two axes of a sweep, with its exact interval.

    Along one axis the interval is a band. On a map, the probability is one half on the solid contour, and the upper
    bound of the interval exceeds 5 % beyond the dashed contour.

    Args:
        result: A sweep; axes beyond the second are held at their first value.
        ax: Axes to draw into; None: a new figure.

    Raises:
        ValueError: The result has no sweep.
    """
    result = over_two_axes(result)
    axes = free_axes(result)
    if len(axes) == 1:
        figure, ax = panel(ax)
        probability_curve(ax, result, axes[0])
    else:
        figure, ax = panel(ax, MAP_PANEL)
        probability_map(ax, result, axes[0], axes[1])
    return figure


@styled
def standing(result: Result, ax: Axes | None = None) -> Figure:
    """Plot the standing of each point of a sweep over two axes: proved, no draw fails, some draws fail, or all do.

    Args:
        result: A sweep with proofs; axes beyond the second are held at their first value.
        ax: Axes to draw into; None: a new figure.

    Raises:
        ValueError: The result has no sweep over two axes, or no proofs.
    """
    result = over_two_axes(result)
    axes = free_axes(result)
    if len(axes) != 2 or "proved" not in result.dataset:
        raise ValueError("needs a sweep over two axes with proofs: prove it first")
    figure, ax = panel(ax, MAP_PANEL)
    down, across = axes  # the vertical and the horizontal axis
    share = result.failed.transpose(down, across, "draw").values.mean(-1)
    proved = result.dataset["proved"].transpose(down, across).values
    standings = standing_of(proved, share)
    x = result.dataset[across].values
    y = result.dataset[down].values
    mesh = ax.pcolormesh(*map_edges(x, y), standings, cmap=standing_colours(), vmin=-0.5, vmax=3.5)
    mesh.set(edgecolor="white", linewidth=0.4, rasterized=needs_bitmap(share))
    proved_with_failures = proved & (share > 0.0)  # of a requirement that the proof does not cover
    for i, j in np.argwhere(proved_with_failures):
        ax.text(float(x[j]), float(y[i]), f"{share[i, j]:.0%}", ha="center", va="center", fontsize="x-small")
    draws = result.failed.sizes["draw"]
    ax.set_title(textwrap.fill(f"{draws} draws: {required_text(result)}", 44), parse_math=False)
    finish_map(ax, result, down, across, [])
    handles = [*standing_handles(result.dataset["proved"].attrs["covered"]), *map_handles(result, [])]
    ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.32), frameon=False)
    return figure


def required_text(result: Result) -> str:
    """Write the study's requirements in one line; formulas are given by their names."""
    texts = [requirement.short_text for requirement in result.study.requirements]
    return "; ".join(texts) or "the draw stays finite"


@styled
def typical(result: Result, ax: Axes | None = None, metric: str | None = None) -> Figure:
    """Plot the median of a metric over the first one or two axes of a sweep.

    Along one axis, a band extends from the 5 % to the 95 % quantile.

    Args:
        result: A sweep; axes beyond the second are held at their first value.
        ax: Axes to draw into; None: a new figure.
        metric: Name of the metric; None: the study's headline metric.

    Raises:
        ValueError: The result has no sweep.
        ConfigError: The result has no such metric.
    """
    result = over_two_axes(result)
    axes = free_axes(result)
    measure = measure_named(result, metric)
    if len(axes) == 1:
        figure, ax = panel(ax)
        typical_curve(ax, result, measure, axes[0])
    else:
        figure, ax = panel(ax, MAP_PANEL)
        median_map(ax, result, measure, axes[0], axes[1])
    return figure


def over_two_axes(result: Result) -> Result:
    """Reduce a result to its first two axes with several values, in ascending order, as a figure needs them.

    All other axes are fixed at the first value that the study lists.

    Raises:
        ValueError: The result has no sweep.
    """
    axes = free_axes(result)
    if not axes:
        raise ValueError("the result has no sweep; plot.failures shows a run")
    axes_with_values = [name for name in axes if result.dataset.sizes[name] > 1]
    plotted_axes = axes_with_values[:2] or axes[:1]
    first_values = {name: 0 for name in axes if name not in plotted_axes}  # index by axis
    return ascending(result.at(first_values), plotted_axes)


def ascending(result: Result, axes: Sequence[str]) -> Result:
    """The result with the points sorted by value along some axes of its sweep.

    A study may list the values of an axis in any order.
    """
    return replace(result, dataset=result.dataset.sortby(list(axes)))


def fixed_parameters_text(result: Result) -> str:
    """The swept parameters that a figure shows at one value only, each as "; NAME = VALUE", to continue the title."""
    names = [name for name in result.study.axes if name not in result.dataset.dims]
    return "".join(f"; {name} = {result.dataset[name].item():g}" for name in names)


def probability_map(ax: Axes, result: Result, down: str, across: str) -> None:
    """Draw the failure probability as a map, with two contours.

    One contour is where the probability is one half. The other is where the upper bound of the interval is 5 %.

    Args:
        ax: Axes to draw into.
        result: A result over two axes.
        down: Name of the vertical axis.
        across: Name of the horizontal axis.
    """
    failed = result.failed.transpose(down, across, "draw").values
    share = failed.mean(-1)
    upper = result.method.failure_interval(failed)[..., 1]
    x = result.dataset[across].values
    y = result.dataset[down].values
    bitmap = needs_bitmap(share)
    top = largest_colour(share)
    image = ax.pcolormesh(*map_edges(x, y), share, cmap="cividis", vmin=0.0, vmax=top, rasterized=bitmap)
    contour(ax, x, y, share, 0.5, "-")
    contour(ax, x, y, upper, 0.05, "--")
    text = f"failure probability ({failed.shape[-1]} draws)"
    ax.figure.colorbar(image, ax=ax, format=PercentFormatter(1.0), label=text)
    ax.set_title(textwrap.fill(required_text(result), 44), parse_math=False)
    finish_map(ax, result, down, across, [HALF, UPPER_BOUND])


def median_map(ax: Axes, result: Result, measure: Measure, down: str, across: str) -> None:
    """Draw the median of a metric over the draws as a map, with contours at its limits.

    Args:
        ax: Axes to draw into.
        result: A result over two axes.
        measure: The metric.
        down: Name of the vertical axis.
        across: Name of the horizontal axis.
    """
    x = result.dataset[across].values
    y = result.dataset[down].values
    metric = result.dataset[measure.name]
    median = upper_quantiles(metric.transpose(down, across, "draw").values, (0.5,), measure.metric.worst)[0]
    finite = median[np.isfinite(median)]
    if not finite.size:
        ax.text(0.5, 0.5, "no finite median", transform=ax.transAxes, ha="center")
    norm = "log" if is_log(finite) else "linear"
    cap = colour_cap(result, measure) if norm == "log" else None
    limits = capped_limits(finite, cap)
    image = ax.pcolormesh(*map_edges(x, y), median, cmap="viridis", norm=norm, rasterized=needs_bitmap(median))
    if limits is not None:
        image.set_clim(*limits)
    text = textwrap.fill(f"median {label(metric.attrs)}", 40)
    bar = ax.figure.colorbar(image, ax=ax, label=text, extend="neither" if limits is None else "max")
    if norm == "log":
        set_log_ticks(bar.ax.yaxis, *image.get_clim())
    bounds = metric_bounds(result, measure)
    for bound in bounds:
        contour(ax, x, y, median, bound, "-")
    ax.set_title("median over draws")
    finish_map(ax, result, down, across, [MEDIAN_LIMIT] if bounds else [])


def colour_cap(result: Result, measure: Measure) -> float | None:
    """Upper end of a logarithmic map's colours: 30 times the lowest upper limit that the study sets for the metric.

    An upper limit of 0 is ignored. Without another upper limit, the result is None.
    """
    upper_limits: list[float] = []
    for requirement in result.study.requirements:
        if requirement.measure.name == measure.name and requirement.maximum:
            upper_limits.append(requirement.maximum)
    return 30.0 * min(upper_limits) if upper_limits else None


def map_edges(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges of a map's cells, half way between the values on the scale of each axis.

    Args:
        x: Values along the horizontal axis, ascending, shape (n,).
        y: Values along the vertical axis, ascending, shape (m,).

    Returns:
        Edges along both axes, shape (n + 1,) and (m + 1,).
    """
    return cell_edges(x, is_log(x)), cell_edges(y, is_log(y))


def finish_map(ax: Axes, result: Result, down: str, across: str, keys: Sequence[LineKey]) -> None:
    """Add what all maps show: the certified region, the study's own values, scales, labels and a legend below.

    Args:
        ax: Axes of the map.
        result: A result over two axes.
        down: Name of the vertical axis.
        across: Name of the horizontal axis.
        keys: The contours of the map.
    """
    x = result.dataset[across].values
    y = result.dataset[down].values
    certified = certified_region(result)
    if certified is not None:
        inside = certified.transpose(down, across).values
        hatched = np.ma.masked_array(np.ones(inside.shape), mask=~inside)
        ax.pcolor(*map_edges(x, y), hatched, facecolor="none", edgecolor="white", hatch="//", linewidth=0.0)
    ax.grid(False)
    set_scale(ax, x)
    set_scale(ax, y, "y")
    mark_study_value(ax, result, across, "x", on_map=True)
    mark_study_value(ax, result, down, "y", on_map=True)
    ax.set_xlabel(axis_label(across, result.dataset[across].attrs))
    ax.set_ylabel(axis_label(down, result.dataset[down].attrs))
    handles = map_handles(result, keys)
    if handles:
        ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.24), frameon=False)


def map_handles(result: Result, keys: Sequence[LineKey]) -> list[Line2D | Patch]:
    """Legend entries of a map: its contours, the study's own values, and the certified region.

    Args:
        result: A result over two axes.
        keys: Text and line style of each contour.
    """
    all_keys = list(keys)
    if any(reaches_study_value(result, name) for name in free_axes(result)):
        all_keys.append((STUDY_VALUE_LEGEND, ":"))
    handles: list[Line2D | Patch] = []
    for text, style in all_keys:
        line = Line2D([], [], color="white", linestyle=style, linewidth=1.8, label=text)
        line.set_path_effects(OUTLINE)
        handles.append(line)
    if certified_region(result) is not None:
        handles.append(Patch(facecolor=GREY, edgecolor="white", hatch="//", linewidth=0.0, label=CERTIFIED_LEGEND))
    return handles
