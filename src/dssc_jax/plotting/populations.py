"""Figures of a result: the draws of a run, and the points of a sweep."""

import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from dssc_jax.metrics import Measure
from dssc_jax.plotting.style import BLUE, DRAWABLE, GREY, RED, SLIDE, is_log, label, named, set_scale, styled, title
from dssc_jax.results import Result, headline, upper_quantiles
from dssc_jax.statistics import Method


@styled
def failures(result: Result) -> Figure:
    """A run without sweep: the distribution of the headline metric, and failures against each uncertain number."""
    measure = headline(result)
    laws = [name for name in result.study.laws if np.abs(result.dataset[name].values).max() < DRAWABLE][:5]
    columns = min(3, 1 + len(laws))
    rows = -(-(1 + len(laws)) // columns)
    figure = Figure(figsize=(SLIDE[0], 4.4 * rows if rows > 1 else SLIDE[1]), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for empty in axes[1 + len(laws) :]:
        empty.set_axis_off()
    values = result.dataset[measure.name].values
    shown = np.sort(values[np.abs(values) < DRAWABLE])
    few = "o" if len(shown) < 20 else None
    axes[0].plot(shown, np.arange(1, len(shown) + 1) / values.size, color=BLUE, marker=few)
    for limit in limits(result, measure):
        axes[0].axvline(limit, color=RED, linestyle="--", label="required")
    if shown.size:
        set_scale(axes[0], shown)
    axes[0].set(xlabel=label(result.dataset[measure.name].attrs), ylabel="share of draws at or below", ylim=(0, 1.02))
    if limits(result, measure):
        axes[0].legend(frameon=False)
    failed = result.failed.values
    for ax, name in zip(axes[1:], laws, strict=False):
        factor_panel(ax, result.dataset[name].values, failed, result.method)
        ax.set_xlabel(f"{name} [{result.dataset[name].attrs['units']}]")
    low, high = result.method.interval(failed)
    title(
        figure,
        f"{result.study.name}: {failed.sum()} of {failed.size} draws fail; "
        f"probability in [{low:.3g}, {high:.3g}], 95 % {result.method.name}",
    )
    return figure


def factor_panel(ax: Axes, values: np.ndarray, failed: np.ndarray, method: Method, bins: int = 8) -> None:
    """Failure probability in bins of equal count of one uncertain number; its interval where draws are independent."""
    groups = np.array_split(np.argsort(values), min(bins, len(values)))
    centres = [float(np.median(values[group])) for group in groups]
    share = np.array([failed[group].mean() for group in groups])
    reach = None
    if method.independent:
        reach = np.abs(np.stack([method.interval(failed[group]) for group in groups]).T - share)
    ax.errorbar(centres, share, reach, fmt="o", color=RED, capsize=3)
    ax.set_ylabel("failure probability" if method.independent else "share of failed draws (no interval)")
    set_scale(ax, np.asarray(centres))
    ax.set_ylim(-0.03, 1.03)
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))


@styled
def sweep(result: Result) -> Figure:
    """A sweep over one axis as curves, over two as maps; further axes are held at their first value, and named.

    Raises:
        ValueError: the result has no sweep.
    """
    axes = list(result.study.axes)
    if not axes:
        raise ValueError("the result has no sweep; plot.failures shows a run")
    shown = [name for name in axes if len(result.study.axes[name]) > 1][:2] or axes[:1]
    fixed = {name: 0 for name in axes if name not in shown}
    if fixed:
        result = Result(result.study, result.dataset.isel(fixed), result.manifest)
    return curves(result, shown[0]) if len(shown) == 1 else maps(result, shown[0], shown[1])


def held(result: Result) -> str:
    """The swept parameters that a figure holds at one value, for its title."""
    left = [name for name in result.study.axes if name not in result.dataset.dims]
    return "".join(f"; {name} = {result.dataset[name].item():g}" for name in left)


def curves(result: Result, axis: str) -> Figure:
    """The headline metric's quantiles and the failure probability with its interval along one axis."""
    measure = headline(result)
    figure = Figure(figsize=SLIDE, layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, 2 if result.study.requirements else 1))
    x = result.dataset[axis].values
    low, middle, high = quantiles(result, measure)
    several = result.study.config.draws > 1
    if several:
        panels[0].fill_between(x, low, high, color=BLUE, alpha=0.2, label="5 to 95 % of draws")
    panels[0].plot(x, middle, "o-", color=BLUE, label="median" if several else "simulated")
    if len(x) > 1:
        panels[0].set_xlim(x.min(), x.max())
    if not np.isfinite(middle).any():
        panels[0].text(0.5, 0.5, "no finite median", transform=panels[0].transAxes, ha="center")
    for limit in limits(result, measure):
        panels[0].axhline(limit, color=RED, linestyle="--", label="required")
    set_scale(panels[0], middle[np.isfinite(middle)], "y")
    if (
        result.study.config.plot.slope
        and len(x) > 1
        and (x > 0).all()
        and (middle > 0).all()
        and np.isfinite(middle).all()
    ):
        add_slope(panels[0], x, middle)
    panels[0].set_ylabel(label(result.dataset[measure.name].attrs))
    panels[0].legend(frameon=False)
    if result.study.requirements:
        failed = result.failed.values
        interval = result.method.interval(failed)
        panels[1].fill_between(x, *interval.T, color=RED, alpha=0.2, label=f"95 % {result.method.name}")
        panels[1].plot(x, failed.mean(-1), "o-", color=RED, label="failed draws")
        panels[1].set(ylabel="failure probability", ylim=(-0.03, 1.03))
        panels[1].yaxis.set_major_formatter(PercentFormatter(1.0))
        panels[1].legend(frameon=False)
    for ax in panels:
        set_scale(ax, x)
        mark_own_value(ax, result, axis, GREY)
        ax.set_xlabel(named(axis, result.dataset[axis].attrs))
    title(figure, f"{result.study.config.description or result.study.name}{held(result)}")
    return figure


def maps(result: Result, down: str, across: str) -> Figure:
    """Failure probability, and the median of the headline metric, over two axes."""
    measure = headline(result)
    figure = Figure(figsize=(SLIDE[0], SLIDE[1] + 0.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    x, y = result.dataset[across].values, result.dataset[down].values
    failed = result.failed.transpose(down, across, "draw").values
    share = failed.mean(-1)
    image = left.pcolormesh(x, y, share, cmap="cividis", vmin=0.0, vmax=1.0, shading="nearest")
    draws = failed.shape[-1]
    upper = result.method.interval(failed)[..., 1]
    contour(left, x, y, share, 0.5, "-")
    contour(left, x, y, upper, 0.05, "--")
    figure.colorbar(image, ax=left, format=PercentFormatter(1.0), label=f"failure probability ({draws} draws)")
    required = "; ".join(r.text for r in result.study.requirements) or "the draw stays finite"
    left.set_title(textwrap.fill(required, 44), parse_math=False)
    middle = quantiles(result, measure)[1]
    finite = middle[np.isfinite(middle)]
    norm = "log" if is_log(finite) else "linear"
    upper_limits = [r.maximum for r in result.study.requirements if r.measure.name == measure.name and r.maximum]
    cap = 30.0 * min(upper_limits) if upper_limits and norm == "log" else None
    if not finite.size:
        right.text(0.5, 0.5, "no finite median", transform=right.transAxes, ha="center")
    image = right.pcolormesh(x, y, middle, cmap="viridis", norm=norm, shading="nearest", **clip(finite, cap))
    figure.colorbar(
        image,
        ax=right,
        label=textwrap.fill(f"median {label(result.dataset[measure.name].attrs)}", 40),
        extend="max" if clip(finite, cap) else "neither",
    )
    for limit in limits(result, measure):
        contour(right, x, y, middle, limit, "-")
    right.set_title("median over draws")
    keys: list[tuple[str, Any]] = [
        ("50 % fail, or the median at its limit", "-"),
        (f"95 % upper bound at 5 % ({result.method.name})", "--"),
    ]
    for ax in (left, right):
        ax.grid(False)
        set_scale(ax, x)
        set_scale(ax, y, "y")
        marked = [mark_own_value(ax, result, across, "white"), mark_own_value(ax, result, down, "white", "y")]
        if any(marked) and ax is left:
            keys.append(("the study's own value", ":"))
        ax.set_xlabel(named(across, result.dataset[across].attrs))
    left.set_ylabel(named(down, result.dataset[down].attrs))
    handles = [Line2D([], [], color="black", linestyle=style, linewidth=1.8, label=text) for text, style in keys]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(keys), frameon=False)
    title(figure, f"{result.study.config.description or result.study.name}{held(result)}")
    return figure


def quantiles(result: Result, measure: Measure) -> np.ndarray:
    """5 %, 50 % and 95 % quantiles over draws, shape (3, axes...); draws without a value count as infinite."""
    return upper_quantiles(result.dataset[measure.name].values, (0.05, 0.5, 0.95))


def limits(result: Result, measure: Measure) -> list[float]:
    """Required bounds of a measure."""
    bounds = [r for r in result.study.requirements if r.measure.name == measure.name]
    return [value for r in bounds for value in (r.maximum, r.minimum) if value is not None]


def own_value(result: Result, name: str) -> float | None:
    """The value that the study itself gives a swept number; None where it is a law."""
    value = result.study.leaves().get(name)
    return float(value) if isinstance(value, float) else None


def mark_own_value(ax: Axes, result: Result, name: str, colour: str, which: str = "x") -> bool:
    """A dotted line at the study's own value of a swept number, if the axis reaches it."""
    value = own_value(result, name)
    axis = np.asarray(result.study.axes[name])
    if value is None or not axis.min() <= value <= axis.max():
        return False
    (ax.axvline if which == "x" else ax.axhline)(value, color=colour, linestyle=":", linewidth=2.0)
    return True


def fitted_slope(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Slope and intercept of log y against log x by least squares."""
    slope, intercept = np.polyfit(np.log(x), np.log(y), 1)
    return float(slope), float(intercept)


def add_slope(ax: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """The fitted power law."""
    slope, intercept = fitted_slope(x, y)
    ax.plot(x, np.exp(intercept) * x**slope, color=GREY, linestyle="--", label=f"fitted slope {slope:.2f}")


def clip(finite: np.ndarray, cap: float | None) -> dict[str, float]:
    """Colour limits: a diverging corner shall not flatten the rest."""
    if cap is None or not finite.size or not finite.min() < cap < finite.max():
        return {}
    return {"vmin": float(finite.min()), "vmax": cap}


def contour(ax: Axes, x: np.ndarray, y: np.ndarray, z: np.ndarray, level: float, style: str) -> None:
    """A white contour where the level is crossed."""
    if min(z.shape) >= 2 and np.nanmin(z) < level < np.nanmax(z):
        shown = np.where(np.isfinite(z), z, 1e3 * abs(level))
        ax.contour(x, y, shown, levels=(level,), colors="white", linewidths=1.8, linestyles=style)
