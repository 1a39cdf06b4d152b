"""A logged flight over the range of a study's draws."""

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.plotting.style import BLUE, DARK, ORANGE, RED, styled, title
from dssc_jax.plotting.thinning import envelope, thinned

if TYPE_CHECKING:
    from dssc_jax.flight_logs.comparison import LogComparison, SignalAnswer
    from dssc_jax.flight_logs.next_flight import NextFlight

MOST_SIGNALS = 5  # of one figure
BANDS = (("lowest", "highest", 0.18, "all draws"), ("low", "high", 0.3, "90 % of the draws"))


@styled
def log_comparison(comparison: "LogComparison") -> Figure:
    """Plot the logged signals over the draws, those with the largest departures first, and the test's statistic.

    Bands are the range of all draws and the middle 90 % of them at each time.

    Args:
        comparison: The return value of :func:`dssc_jax.compare_log`.
    """
    data = comparison.dataset
    facts = {str(name): comparison.signal_answer(str(name)) for name in data["signal"].values}
    names = sorted(facts, key=lambda name: -(facts[name].largest_departure or np.inf))
    plotted_names = names[:MOST_SIGNALS]
    figure = Figure(figsize=(11.5, 2.5 * len(plotted_names) + 2.6), layout="constrained")
    axes = figure.subplots(len(plotted_names) + 1, 1)
    handles = {}
    for ax, name in zip(axes, plotted_names, strict=False):
        draw_signal(ax, data.sel(signal=name), facts[name])
        ax.set_ylabel(f"{name} [{facts[name].unit}]")
        lines, texts = ax.get_legend_handles_labels()
        handles |= dict(zip(texts, lines, strict=True))
    for ax in axes[1 : len(plotted_names)]:
        ax.sharex(axes[0])
    axes[len(plotted_names) - 1].set_xlabel("time [s]")
    position = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": 5, "fontsize": 10}
    axes[0].legend(list(handles.values()), list(handles), frameon=False, **position)
    draw_statistics(axes[-1], comparison)
    hidden = len(facts) - len(plotted_names)
    note = f"; {hidden} signals with smaller departures are not shown" if hidden else ""
    config = comparison.study.config
    name = config.description or config.name
    title(figure, f"{name}: {comparison.log} over {data.sizes['curve'] - 1} draws{note}")
    return figure


@styled
def next_flight_figure(analysis: "NextFlight") -> Figure:
    """Plot the band of the next flight over the flights and the draws, and the departures of both.

    Args:
        analysis: The return value of :func:`dssc_jax.next_flight`.
    """
    data = analysis.dataset
    names = [str(name) for name in data["signal"].values if data["spread"].sel(signal=name).notnull().any()]
    plotted_names = names[:MOST_SIGNALS]
    figure = Figure(figsize=(11.5, 2.5 * len(plotted_names) + 2.6), layout="constrained")
    axes = figure.subplots(len(plotted_names) + 1, 1)
    time = data["t"].values
    for ax, name in zip(axes, plotted_names, strict=False):
        signal = data.sel(signal=name)
        for low, high, colour, alpha, text in (
            ("lower", "upper", BLUE, 0.2, f"the next flight, {100 * analysis.probability:g} %"),
            ("lowest", "highest", DARK, 0.5, "all flights"),
        ):
            is_finite = np.isfinite(signal[low].values)
            if is_finite.any():
                x, lower, upper = envelope(
                    time[is_finite], signal[low].values[is_finite], signal[high].values[is_finite]
                )
                ax.fill_between(x, lower, upper, color=colour, alpha=alpha, linewidth=0.0, label=text)
        ax.plot(*thinned(time, signal["middle"].values), color=ORANGE, linewidth=1.2, label="median of the draws")
        ax.set_ylabel(name)
    axes[len(plotted_names) - 1].set_xlabel("time [s]")
    axes[0].legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=10)
    draw_departures(axes[-1], data["departure_of_draw"].values, data["departure"].values)
    config = analysis.study.config
    title(figure, f"{config.description or config.name}: {len(analysis.logs)} flights")
    return figure


def draw_departures(ax: Axes, draws: np.ndarray, flights: np.ndarray) -> None:
    """Draw the share of draws above each departure, and the flights' departures.

    Args:
        ax: The axes to draw on.
        draws: Largest departures of the draws, shape (draws,).
        flights: Largest departures of the flights, shape (flights,).
    """
    ordered = np.sort(draws[np.isfinite(draws)])
    share = 1.0 - np.arange(len(ordered)) / len(draws)
    ax.step(ordered, share, where="pre", color=BLUE, label="share of draws at or above")
    finite = flights[np.isfinite(flights)]
    ax.plot(finite, np.full(len(finite), 0.02), "|", color=RED, markersize=14, label="flights")
    ax.set(xlabel="largest departure from the draws' median, in their spreads", ylabel="share", ylim=(0.0, 1.02))
    ax.set_xscale("log")
    ax.legend(frameon=False, loc="best")


def draw_signal(ax: Axes, signal: xr.Dataset, answer: "SignalAnswer") -> None:
    """Draw one signal over the bands of the draws.

    Args:
        ax: The axes to draw on.
        signal: The dataset of the comparison for one signal.
        answer: The position of that signal in the draws.
    """
    time = signal["t"].values
    for low, high, alpha, text in BANDS:
        x, lower, upper = envelope(time, signal[low].values, signal[high].values)
        ax.fill_between(x, lower, upper, color=BLUE, alpha=alpha, linewidth=0.0, label=text)
    commanded = signal["commanded"].values
    if np.isfinite(commanded).any():
        ax.plot(*thinned(time, commanded), color=ORANGE, linewidth=1.2, label="analysed controller")
    logged = signal["logged"].values
    is_finite = np.isfinite(logged)
    ax.plot(*thinned(time[is_finite], logged[is_finite]), color=DARK, linewidth=1.2, label="logged")
    first_outside = answer.first_outside
    if first_outside is not None:
        ax.axvline(first_outside, color=RED, linestyle="--", linewidth=1.2, label="first outside")


def draw_statistics(ax: Axes, comparison: "LogComparison") -> None:
    """Draw the share of draws above each departure in the decisive signal, and the log's departure."""
    decisive = comparison.decisive()
    departures = comparison.decisive_departures()
    if decisive is None or departures is None:
        ax.set_axis_off()
        ax.text(0.5, 0.5, "every draw is the same; ranks say nothing", ha="center", va="center")
        return
    ordered = np.sort(departures[:-1])
    ordered = ordered[np.isfinite(ordered)]
    share = 1.0 - np.arange(len(ordered)) / (len(departures) - 1)
    ax.step(ordered, share, where="pre", color=BLUE, label="share of draws at or above")
    if np.isfinite(departures[-1]):
        ax.axvline(departures[-1], color=RED, label=f"the log: p = {comparison.p_value:.3g}")
    else:
        ax.plot([], [], color=RED, label=f"the log: beyond all, p = {comparison.p_value:.3g}")
    ax.set(xlabel=f"largest standardised departure of a curve in {decisive[0]}", ylabel="share")
    ax.set(xscale="log", ylim=(0.0, 1.02))
    ax.legend(frameon=False, loc="best")
