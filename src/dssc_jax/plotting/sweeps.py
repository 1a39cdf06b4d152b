"""Figures of a sweep: failure probability and the headline metric over one axis as curves, over two as maps."""

import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import PercentFormatter

from dssc_jax.closed_loop.metrics import Measure
from dssc_jax.plotting.cells import OUTLINE, cell_edges, cells, colour_limits, contour, map_top
from dssc_jax.plotting.draws import metric_bounds
from dssc_jax.plotting.standings import standing_colours, standing_keys, standing_of
from dssc_jax.plotting.style import (
    BLUE,
    GREEN,
    GREY,
    PANEL,
    RED,
    SLIDE,
    fit_probability,
    is_log,
    label,
    named,
    panel,
    set_log_ticks,
    set_scale,
    styled,
    title,
)
from dssc_jax.plotting.thinning import envelope, thinned
from dssc_jax.results.influence import idle_text
from dssc_jax.results.result import Result, measure_named
from dssc_jax.statistics.order import upper_quantiles

MARKED = 200  # a curve of more points shows none of them
CERTIFIED = "Theorem 1: without lag and sampling"
PROVED = "proved, with lag and sampling"
HALF, BOUND = ("half of the draws fail", "-"), ("95 % upper bound of the probability at 5 %", "--")
OWN_VALUE = "the study's own value"
AT_LIMIT = ("the median at its limit", "-")


@styled
def sweep(result: Result) -> Figure:
    """Plot a sweep over one axis as curves, over two as maps; further axes are held at their first value, and named.

    Raises:
        ValueError: the result has no sweep.
    """
    result = held_to_two(result)
    across = len(free_axes(result)) == 1
    both = bool(result.study.requirements) or not across
    figure = Figure(figsize=SLIDE if across else (SLIDE[0], SLIDE[1] + 0.6), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, 1 + both, sharey=not across))
    if across:
        typical(result, panels[0])
        if both:
            probability(result, panels[1])
    else:
        standing(result, panels[0]) if "proved" in result.dataset else probability(result, panels[0])
        typical(result, panels[1])
        panels[1].set_ylabel("")
        for ax in panels:
            if (legend := ax.get_legend()) is not None:
                legend.remove()
        known = "proved" in result.dataset
        keys: list[tuple[str, Any]] = [AT_LIMIT] if known else [(f"{HALF[0]}, or {AT_LIMIT[0]}", "-"), BOUND]
        handles = [*(standing_keys() if known else []), *map_keys(result, keys)]
        figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    title(figure, f"{result.study.config.description or result.study.name}{held(result)}\n{remarks(result)}")
    return figure


def remarks(result: Result) -> str:
    """What a sweep's title says besides its subject: idle axes, and what is certified."""
    return "\n".join(filter(None, (idle_text(result), result.certificate)))


@styled
def probability(result: Result, ax: Axes | None = None) -> Figure:
    """Plot the failure probability over the first one or two axes of a sweep, with its exact interval.

    Along one axis the interval is a band. On a map the solid contour is at a probability of one half, and beyond the
    dashed one the interval's upper end exceeds 5 %.

    Args:
        result: A sweep; axes beyond the second are held at their first value.
        ax: Axes to draw into; None: a new figure.

    Raises:
        ValueError: the result has no sweep.
    """
    result = held_to_two(result)
    figure, ax = panel(ax, PANEL if len(free_axes(result)) == 1 else (PANEL[0], PANEL[1] + 0.8))
    axes = free_axes(result)
    if len(axes) == 1:
        probability_curve(ax, result, axes[0])
    else:
        probability_map(ax, result, *axes)
    return figure


@styled
def standing(result: Result, ax: Axes | None = None) -> Figure:
    """Plot how each point of a sweep over two axes stands: proved, surviving every draw, failing in some, or in all.

    Args:
        result: A sweep with proofs; axes beyond the second are held at their first value.
        ax: Axes to draw into; None: a new figure.

    Raises:
        ValueError: the result has no sweep over two axes, or no proofs.
    """
    result = held_to_two(result)
    axes = free_axes(result)
    if len(axes) != 2 or "proved" not in result.dataset:
        raise ValueError("needs a sweep over two axes with proofs: dssc-jax sweep --prove")
    figure, ax = panel(ax, (PANEL[0], PANEL[1] + 0.8))
    down, across = axes
    share = result.failed.transpose(down, across, "draw").values.mean(-1)
    proved = result.dataset["proved"].transpose(down, across).values
    x, y = result.dataset[across].values, result.dataset[down].values
    kinds, colours = standing_of(proved, share), standing_colours()
    ax.pcolormesh(x, y, kinds, cmap=colours, vmin=-0.5, vmax=3.5, edgecolor="white", linewidth=0.4, **cells(share))
    failing = proved & (share > 0.0)  # of a requirement that the proof does not speak of
    for i, j in np.argwhere(failing):
        ax.text(float(x[j]), float(y[i]), f"{share[i, j]:.0%}", ha="center", va="center", fontsize="x-small")
    required = "; ".join(r.text for r in result.study.requirements) or "the draw stays finite"
    ax.set_title(textwrap.fill(f"{result.failed.sizes['draw']} draws: {required}", 44), parse_math=False)
    finish_map(ax, result, down, across, [])
    ax.legend(
        handles=[*standing_keys(), *map_keys(result, [])],
        loc="upper center",
        bbox_to_anchor=(0.5, -0.32),
        frameon=False,
    )
    return figure


@styled
def typical(result: Result, ax: Axes | None = None, metric: str | None = None) -> Figure:
    """Plot the median of a metric over the first one or two axes of a sweep; along one axis with 5 to 95 % of draws.

    Args:
        result: A sweep; axes beyond the second are held at their first value.
        ax: Axes to draw into; None: a new figure.
        metric: Name of the metric; None: the study's headline metric.

    Raises:
        ValueError: the result has no sweep.
        ConfigError: the result has no such metric.
    """
    result = held_to_two(result)
    figure, ax = panel(ax, PANEL if len(free_axes(result)) == 1 else (PANEL[0], PANEL[1] + 0.8))
    axes = free_axes(result)
    if len(axes) == 1:
        typical_curve(ax, result, measure_named(result, metric), axes[0])
    else:
        typical_map(ax, result, measure_named(result, metric), *axes)
    return figure


def free_axes(result: Result) -> list[str]:
    """The swept parameters that are still dimensions of the dataset."""
    return [name for name in result.study.axes if name in result.dataset.dims]


def held_to_two(result: Result) -> Result:
    """The result over its first two axes with several values; the others are held at their first value.

    Raises:
        ValueError: the result has no sweep.
    """
    axes = free_axes(result)
    if not axes:
        raise ValueError("the result has no sweep; plot.failures shows a run")
    shown = [name for name in axes if result.dataset.sizes[name] > 1][:2] or axes[:1]
    fixed = {name: 0 for name in axes if name not in shown}
    return result.at(fixed) if fixed else result


def held(result: Result) -> str:
    """The swept parameters that a figure holds at one value, for its title."""
    left = [name for name in result.study.axes if name not in result.dataset.dims]
    return "".join(f"; {name} = {result.dataset[name].item():g}" for name in left)


def typical_curve(ax: Axes, result: Result, measure: Measure, axis: str) -> None:
    """Draw a metric's quantiles along one axis."""
    x = result.dataset[axis].values
    low, middle, high = quantiles(result, measure)
    several = result.study.config.draws > 1
    if several:
        band = envelope(x, low, high)
        ax.fill_between(*band, color=BLUE, alpha=0.2, linewidth=0.0, label="5 to 95 % of draws")
    ax.plot(*thinned(x, middle), point_markers(x), color=BLUE, label="median" if several else "simulated")
    if len(x) > 1:
        ax.set_xlim(x.min(), x.max())
    if not np.isfinite(middle).any():
        ax.text(0.5, 0.5, "no finite median", transform=ax.transAxes, ha="center")
    for limit in metric_bounds(result, measure):
        ax.axhline(limit, color=RED, linestyle="--", label="required")
    set_scale(ax, middle[np.isfinite(middle)], "y")
    if result.study.config.plot.slope and len(x) > 1 and is_power(x) and is_power(middle):
        add_slope(ax, x, middle)
    ax.set_ylabel(label(result.dataset[measure.name].attrs))
    finish_curve(ax, result, axis)


def probability_curve(ax: Axes, result: Result, axis: str) -> None:
    """Draw the failure probability with its interval along one axis."""
    x, failed = result.dataset[axis].values, result.failed.values
    interval = result.method.interval(failed)
    band = envelope(x, *interval.T)
    ax.fill_between(*band, color=RED, alpha=0.2, linewidth=0.0, label=f"95 % {result.method.name}")
    ax.plot(*thinned(x, failed.mean(-1)), point_markers(x), color=RED, label="failed draws")
    ax.set_ylabel("failure probability")
    fit_probability(ax, float(interval.max()))
    finish_curve(ax, result, axis)


def point_markers(x: np.ndarray) -> str:
    """The marker of a curve: a mark at each point if they can be distinguished."""
    return "o-" if len(x) <= MARKED else "-"


def finish_curve(ax: Axes, result: Result, axis: str) -> None:
    """Add what all curves show: the certified stretch, the study's own value, scale and labels of the axis."""
    x = result.dataset[axis].values
    set_scale(ax, x)
    certified = certified_region(result)
    if certified is not None and certified.any():
        inside = certified.values
        edges = cell_edges(x, is_log(x))
        turns = np.flatnonzero(np.diff(inside, prepend=False, append=False))  # where stretches begin, and end
        for begin, end in turns.reshape(-1, 2):
            text = CERTIFIED if begin == turns[0] else None
            ax.axvspan(
                float(edges[begin]), float(edges[end]), fc="none", ec=GREEN, hatch="//", linewidth=0.0, label=text
            )
        ax.set_xlim(edges[0], edges[-1])
    if "proved" in result.dataset:
        mark_proved(ax, x, result.dataset["proved"].values)
    mark_own_value(ax, result, axis, GREY)
    ax.set_xlabel(named(axis, result.dataset[axis].attrs))
    ax.legend(frameon=False)


def mark_proved(ax: Axes, x: np.ndarray, proved: np.ndarray) -> None:
    """Mark the proved stretches by a bar along the axis."""
    edges, low = cell_edges(x, is_log(x)), ax.get_xaxis_transform()
    turns = np.flatnonzero(np.diff(proved, prepend=False, append=False))
    for begin, end in turns.reshape(-1, 2):
        text = PROVED if begin == turns[0] else None
        ax.plot(edges[[begin, end]], [0.0, 0.0], transform=low, color=GREEN, linewidth=7.0, label=text, zorder=0)


def probability_map(ax: Axes, result: Result, down: str, across: str) -> None:
    """Draw the failure probability over two axes."""
    failed = result.failed.transpose(down, across, "draw").values
    draws, share = failed.shape[-1], failed.mean(-1)
    x, y = result.dataset[across].values, result.dataset[down].values
    image = ax.pcolormesh(x, y, share, cmap="cividis", vmin=0.0, vmax=map_top(share), **cells(share))
    contour(ax, x, y, share, 0.5, "-")
    contour(ax, x, y, result.method.interval(failed)[..., 1], 0.05, "--")
    text = f"failure probability ({draws} draws)"
    ax.figure.colorbar(image, ax=ax, format=PercentFormatter(1.0), label=text)
    required = "; ".join(r.text for r in result.study.requirements) or "the draw stays finite"
    ax.set_title(textwrap.fill(required, 44), parse_math=False)
    finish_map(ax, result, down, across, [HALF, BOUND])


def typical_map(ax: Axes, result: Result, measure: Measure, down: str, across: str) -> None:
    """Draw the median of a metric over two axes."""
    x, y = result.dataset[across].values, result.dataset[down].values
    middle = upper_quantiles(result.dataset[measure.name].transpose(down, across, "draw").values, (0.5,))[0]
    finite = middle[np.isfinite(middle)]
    norm = "log" if is_log(finite) else "linear"
    upper_limits = [r.maximum for r in result.study.requirements if r.measure.name == measure.name and r.maximum]
    cap = 30.0 * min(upper_limits) if upper_limits and norm == "log" else None
    if not finite.size:
        ax.text(0.5, 0.5, "no finite median", transform=ax.transAxes, ha="center")
    image = ax.pcolormesh(x, y, middle, cmap="viridis", norm=norm, **cells(middle), **colour_limits(finite, cap))
    bar = ax.figure.colorbar(
        image,
        ax=ax,
        label=textwrap.fill(f"median {label(result.dataset[measure.name].attrs)}", 40),
        extend="max" if colour_limits(finite, cap) else "neither",
    )
    if norm == "log":
        set_log_ticks(bar.ax.yaxis, *image.get_clim())
    for limit in metric_bounds(result, measure):
        contour(ax, x, y, middle, limit, "-")
    ax.set_title("median over draws")
    finish_map(ax, result, down, across, [AT_LIMIT] if metric_bounds(result, measure) else [])


def finish_map(ax: Axes, result: Result, down: str, across: str, keys: list[tuple[str, Any]]) -> None:
    """Add what all maps show: the certified region, the study's own values, scales, labels and a key below."""
    x, y = result.dataset[across].values, result.dataset[down].values
    certified = certified_region(result)
    if certified is not None and certified.any():
        inside = certified.transpose(down, across).values
        hatched = np.ma.masked_array(np.ones(inside.shape), mask=~inside)
        ax.pcolor(x, y, hatched, shading="nearest", facecolor="none", edgecolor="white", hatch="//", linewidth=0.0)
    ax.grid(False)
    set_scale(ax, x)
    set_scale(ax, y, "y")
    mark_own_value(ax, result, across, "white")
    mark_own_value(ax, result, down, "white", "y")
    ax.set_xlabel(named(across, result.dataset[across].attrs))
    ax.set_ylabel(named(down, result.dataset[down].attrs))
    if handles := map_keys(result, keys):
        ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.24), frameon=False)


def map_keys(result: Result, keys: list[tuple[str, Any]]) -> list[Any]:
    """Legend of a map's white elements, drawn as in the map: its contours, and what every map shows."""
    if any(reaches_own_value(result, name) for name in free_axes(result)):
        keys = [*keys, (OWN_VALUE, ":")]
    handles: list[Any] = [
        Line2D([], [], color="white", linestyle=line, linewidth=1.8, label=text, path_effects=OUTLINE)
        for text, line in keys
    ]
    if (certified := certified_region(result)) is not None and certified.any():
        handles.append(Patch(facecolor=GREY, edgecolor="white", hatch="//", linewidth=0.0, label=CERTIFIED))
    return handles


def certified_region(result: Result) -> Any:
    """The region in which Theorem 1 certifies the loop, over the remaining axes; None if it does not apply."""
    dataset = result.with_theorem().dataset
    return dataset["certified"].astype(bool) if "certified" in dataset else None


def quantiles(result: Result, measure: Measure) -> np.ndarray:
    """5 %, 50 % and 95 % quantiles over draws, shape (3, axes...); draws without a value count as infinite."""
    return upper_quantiles(result.dataset[measure.name].values, (0.05, 0.5, 0.95))


def own_value(result: Result, name: str) -> float | None:
    """The study's own value of a swept number; None if it is a law."""
    value = result.study.leaves().get(name)
    return float(value) if isinstance(value, float) else None


def reaches_own_value(result: Result, name: str) -> bool:
    """Whether an axis includes the study's own value of its number."""
    value, axis = own_value(result, name), result.study.axes[name]
    return value is not None and min(axis) <= value <= max(axis)


def mark_own_value(ax: Axes, result: Result, name: str, colour: str, which: str = "x") -> None:
    """Draw a dotted line at the study's own value of a swept number, if the axis reaches it."""
    if reaches_own_value(result, name):
        line = ax.axvline if which == "x" else ax.axhline
        look: dict[str, Any] = {"path_effects": OUTLINE} if colour == "white" else {"label": OWN_VALUE}
        line(own_value(result, name) or 0.0, color=colour, linestyle=":", linewidth=2.0, **look)


def is_power(values: np.ndarray) -> bool:
    """Whether the values have logarithms."""
    return bool(np.isfinite(values).all() and (values > 0).all())


def fitted_slope(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Fit slope and intercept of log y against log x by least squares."""
    slope, intercept = np.polyfit(np.log(x), np.log(y), 1)
    return float(slope), float(intercept)


def add_slope(ax: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Draw the fitted power law."""
    slope, intercept = fitted_slope(x, y)
    ax.plot(x, np.exp(intercept) * x**slope, color=GREY, linestyle="--", label=f"fitted slope {slope:.2f}")
