"""Figures of results and trajectories. Each returns a matplotlib Figure; a failure probability shows its interval."""

import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, PercentFormatter

from dssc_jax.metrics import Measure
from dssc_jax.results import Result, headline, upper_quantiles
from dssc_jax.statistics import clopper_pearson

# Okabe and Ito's palette, told apart with any colour vision
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#6b6b6b"
STYLE: dict[Any, Any] = {
    "font.size": 13,
    "axes.titlesize": 14,
    "axes.labelsize": 13,
    "legend.fontsize": 12,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.8,
    "savefig.dpi": 140,
}
SLIDE = (11.5, 5.6)  # inches
DRAWABLE = 1e100  # larger numbers overflow in matplotlib's axes
LOG_SPAN = 8.0  # axes whose positive values span more than this ratio are logarithmic


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Draw in the project's style without touching the caller's."""

    def wrapper(*args: Any, **options: Any) -> Figure:
        with rc_context(STYLE):
            return draw(*args, **options)

    wrapper.__doc__, wrapper.__name__ = draw.__doc__, draw.__name__
    return wrapper


def label(about: dict[str, Any]) -> str:
    """Long name with unit."""
    unit = about.get("units", "")
    return f"{about.get('long_name', '')} [{unit}]" if unit not in ("", "1") else str(about.get("long_name", ""))


def is_log(values: np.ndarray) -> bool:
    """Whether an axis reads better logarithmically."""
    positive = values[np.isfinite(values)]
    return positive.size > 2 and positive.min() > 0 and positive.max() / positive.min() > LOG_SPAN


def set_scale(ax: Axes, values: np.ndarray, which: str = "x") -> None:
    """Logarithmic where it helps, with plain numbers at 1, 2 and 5 where the span is short."""
    if not is_log(values):
        return
    (ax.set_xscale if which == "x" else ax.set_yscale)("log")
    axis = ax.xaxis if which == "x" else ax.yaxis
    positive = values[np.isfinite(values)]
    decades = np.log10(positive.max() / positive.min())
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades < 2.0 else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


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


def limits(result: Result, measure: Measure) -> list[float]:
    """Required bounds of a measure."""
    bounds = [r for r in result.study.requirements if r.measure.name == measure.name]
    return [value for r in bounds for value in (r.maximum, r.minimum) if value is not None]


def quantiles(result: Result, measure: Measure) -> np.ndarray:
    """5 %, 50 % and 95 % quantiles over draws, shape (3, axes...); draws without a value count as infinite."""
    return upper_quantiles(result.dataset[measure.name].values, (0.05, 0.5, 0.95))


def title(figure: Figure, text: str) -> None:
    """A title in the user's own words: wrapped, and no mathematics read into it."""
    figure.suptitle(textwrap.fill(text, 95), parse_math=False)


def named(name: str, about: dict[str, Any]) -> str:
    """An axis label: the dotted name, and what it means."""
    return f"{name}\n{textwrap.fill(label(about), 42)}"


@styled
def trajectory(run: xr.Dataset) -> Figure:
    """One draw over time: output, error, command, and the state-dependent functions where there are any.

    A plant of several channels is shown by commands on the left and errors on the right, a row a channel.

    Args:
        run: What ``simulate`` or ``replay`` returned.
    """
    if "y" not in run:
        return flight(run)
    figure = Figure(figsize=(11.5, 8.0), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True)
    t = run["t"].values
    panels[0, 0].plot(t, run["y_ref"], color=GREY, linestyle="--", label="desired $y_m$")
    panels[0, 0].plot(t, run["y"], color=BLUE, label="output $y$")
    panels[0, 0].set_ylabel("output [m]")
    panels[0, 1].plot(t, run["e"], color=BLUE, label="error $e$ [m]")
    panels[0, 1].plot(t, run["sigma"], color=ORANGE, label=r"$\sigma = \dot e + l_0 e$ [m/s]")
    panels[0, 1].set_ylabel("error")
    panels[1, 0].plot(t, run["u_total"], color=GREY, linewidth=1.0, label="total $u + u_n$")
    panels[1, 0].plot(t, run["u"], color=RED, label="robust $u$")
    panels[1, 0].set_ylabel("command [m/s]")
    state_dependent(panels[1, 1], run)
    for ax in panels.flat:
        if ax.has_data():
            ax.legend(loc="best", frameon=False)
    for ax in panels[1]:
        ax.set_xlabel("time [s]")
    title(figure, how_it_ended(run))
    return figure


def how_it_ended(run: xr.Dataset) -> str:
    """A trajectory's title."""
    ended = str(run.attrs.get("outcome_meaning", "")).replace("_", " ")
    return f"{run.attrs.get('study', '')}, draw {run.attrs.get('draw', 0)}: {ended}"


def flight(run: xr.Dataset) -> Figure:
    """Commands and errors of every channel."""
    channels = [str(name).removesuffix("_y_ref") for name in run if str(name).endswith("_y_ref")]
    figure = Figure(figsize=(11.5, 2.3 * len(channels) + 1.0), layout="constrained")
    rows = figure.subplots(len(channels), 2, sharex=True, squeeze=False)
    for (left, right), channel in zip(rows, channels, strict=True):
        for name, colour, text in (("u_total", GREY, "total $u + u_n$"), ("u", RED, "robust $u$")):
            left.plot(run["t"], run[f"{channel}_{name}"], color=colour, linewidth=1.2, label=text)
        right.plot(run["t"], run[f"{channel}_e"], color=BLUE)
        left.set_ylabel(f"{channel}: command [{run[f'{channel}_u'].attrs['units']}]")
        right.set_ylabel(f"{channel}: error [{run[f'{channel}_e'].attrs['units']}]")
    rows[0, 0].legend(loc="best", frameon=False)
    for ax in rows[-1]:
        ax.set_xlabel("time [s]")
    title(figure, how_it_ended(run))
    return figure


def state_dependent(ax: Axes, run: xr.Dataset) -> None:
    """k_o and the time constants, on a logarithmic axis; the sliding margin is not theirs to show."""
    shown = {"k_o": ("$k_o$ [1/s]", BLUE), "tau_m": (r"$\tau_m$ [s]", GREEN), "tau_av": (r"$\tau_{av}$ [s]", ORANGE)}
    for name, (text, colour) in shown.items():
        if name in run:
            ax.semilogy(run["t"], run[name], color=colour, label=text)
    ax.set_ylabel("state-dependent functions")
    if not ax.has_data():
        ax.set_axis_off()


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
        factor_panel(ax, result.dataset[name].values, failed)
        ax.set(xlabel=f"{name} [{result.dataset[name].attrs['units']}]", ylabel="failure probability")
    low, high = clopper_pearson(int(failed.sum()), failed.size)
    title(
        figure,
        f"{result.study.name}: {failed.sum()} of {failed.size} draws fail; "
        f"probability in [{low:.3g}, {high:.3g}], 95 % Clopper-Pearson",
    )
    return figure


def factor_panel(ax: Axes, values: np.ndarray, failed: np.ndarray, bins: int = 8) -> None:
    """Failure probability with its interval in bins of equal count of one uncertain number."""
    groups = np.array_split(np.argsort(values), min(bins, len(values)))
    centres = [float(np.median(values[group])) for group in groups]
    counts = np.array([failed[group].sum() for group in groups])
    sizes = np.array([len(group) for group in groups])
    interval = clopper_pearson(counts, sizes)
    share = counts / sizes
    ax.errorbar(centres, share, np.abs(interval.T - share), fmt="o", color=RED, capsize=3)
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
        interval = clopper_pearson(failed.sum(-1), failed.shape[-1])
        panels[1].fill_between(x, *interval.T, color=RED, alpha=0.2, label="95 % Clopper-Pearson")
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


def fitted_slope(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Slope and intercept of log y against log x by least squares."""
    slope, intercept = np.polyfit(np.log(x), np.log(y), 1)
    return float(slope), float(intercept)


def add_slope(ax: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """The fitted power law."""
    slope, intercept = fitted_slope(x, y)
    ax.plot(x, np.exp(intercept) * x**slope, color=GREY, linestyle="--", label=f"fitted slope {slope:.2f}")


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
    upper = clopper_pearson(failed.sum(-1), draws)[..., 1]
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
        ("95 % upper bound of the probability at 5 %", "--"),
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


def save_all(result: Result, folder: Path) -> list[Path]:
    """Write the figures of a result as PNG and SVG.

    Returns:
        The files written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figure = sweep(result) if result.study.axes else failures(result)
    name = "sweep" if result.study.axes else "failures"
    return [write(figure, folder / f"{name}.{suffix}") for suffix in ("png", "svg")]


def write(figure: Figure, path: Path) -> Path:
    """Save a figure."""
    with rc_context(STYLE):
        figure.savefig(path)
    return path
