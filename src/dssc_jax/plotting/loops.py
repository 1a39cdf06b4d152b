"""Figure of the linearised loop over all draws: Bode and Nyquist diagrams, sensitivities, margins."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, study_title, styled, title
from dssc_jax.results.analysis import Analysis

NYQUIST_SPAN = (-3.2, 1.2)
"""Ends of the real axis of the Nyquist diagram."""
LOWEST_GAIN = -60.0
"""Lowest gain [dB] that is drawn."""


@styled
def loop_margins(margins: Analysis, point: str | None = None, broken_at: str | None = None) -> Figure:
    """Plot Bode and Nyquist diagrams of the open loop L, S and T, and the distributions of phase and delay margin.

    Bands contain 90 % of the draws at each frequency. Curves in the Nyquist diagram are single draws.

    Args:
        margins: The return value of :func:`dssc_jax.loop_margins`.
        point: Name of the operating point; None: the first.
        broken_at: Name of the break point; None: the first.
    """
    data = margins.dataset
    summary = margins.summary()
    point = point or str(data["operating_point"].values[0])
    broken_at = broken_at or str(data["loop"].values[0])
    loop_data = data.sel(operating_point=point, loop=broken_at)
    figure = Figure(figsize=(12.5, 8.2), layout="constrained")
    (gain, nyquist, phase_margin), (phase, sensitivities, delay_margin) = figure.subplots(2, 3)
    gain_panel(gain, loop_data)
    phase_panel(phase, loop_data)
    nyquist_panel(nyquist, loop_data["loop_real"].values, loop_data["loop_imaginary"].values)
    sensitivity_panel(sensitivities, loop_data)
    statistics = summary["operating_points"][point][broken_at]
    stable = statistics["stable"]
    margin_panel(phase_margin, loop_data["phase"], stable, statistics["phase"]["tolerance_limit"], "deg", 180.0 / np.pi)
    margin_panel(delay_margin, loop_data["delay"], stable, statistics["delay"]["tolerance_limit"], "s", 1.0)
    place = point if point == "equilibrium" else f"linearised at {point}"
    loop_text = f"loop broken at {broken_at}, {place}, {summary['draws']} draws"
    title(figure, f"{study_title(margins.study)}: {loop_text}")
    return figure


def gain_panel(ax: Axes, loop_data: xr.Dataset) -> None:
    """Draw the loop gain over frequency."""
    fan(ax, loop_data["frequency"].values, decibels(loop_data["loop_gain"]), BLUE, "|L|")
    ax.axhline(0.0, color="black", linewidth=0.8)
    lowest, _ = ax.get_ylim()
    ax.set(ylabel="loop gain [dB]", ylim=(max(LOWEST_GAIN, lowest), None))


def phase_panel(ax: Axes, loop_data: xr.Dataset) -> None:
    """Draw the loop's phase over frequency."""
    fan(ax, loop_data["frequency"].values, np.degrees(loop_data["loop_phase"].values), BLUE, "arg L")
    ax.axhline(-180.0, color="black", linewidth=0.8)
    ax.set(ylabel="phase of L [deg]", xlabel="frequency [rad/s]")


def sensitivity_panel(ax: Axes, loop_data: xr.Dataset) -> None:
    """Draw sensitivity and complementary sensitivity over frequency."""
    frequency = loop_data["frequency"].values
    fan(ax, frequency, decibels(loop_data["sensitivity"]), ORANGE, "|S|")
    fan(ax, frequency, decibels(loop_data["complementary"]), GREEN, "|T|")
    ax.axhline(0.0, color="black", linewidth=0.8)
    ax.set(ylabel="sensitivities [dB]", xlabel="frequency [rad/s]")
    lowest, _ = ax.get_ylim()
    ax.set_ylim(max(LOWEST_GAIN, lowest), None)
    legend_above(ax)


def decibels(gain: xr.DataArray) -> np.ndarray:
    """Convert gains to dB."""
    return 20.0 * np.log10(gain.values)


def legend_above(ax: Axes) -> None:
    """Put a small legend above the axes, where it does not cover a line."""
    ax.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=10)


def fan(ax: Axes, frequency: np.ndarray, quantiles: np.ndarray, colour: str, text: str) -> None:
    """Draw the median and a band over frequency.

    Args:
        ax: Axes to draw into.
        frequency: Frequencies [rad/s], shape (n,).
        quantiles: 5, 50 and 95 % quantiles over the draws, shape (3, n).
        colour: Colour of line and band.
        text: Symbol of the quantity, for the legend.
    """
    low, median, high = quantiles
    ax.fill_between(frequency, low, high, color=colour, alpha=0.25, linewidth=0.0)
    ax.plot(frequency, median, color=colour, label=f"{text}: median and 90 % of draws")
    ax.set_xscale("log")


def nyquist_panel(ax: Axes, real: np.ndarray, imaginary: np.ndarray) -> None:
    """Draw the Nyquist curves of single draws, the point -1, and the circle of M_s = 2.

    Args:
        ax: Axes to draw into.
        real: Real part of L, shape (draws, frequencies).
        imaginary: Imaginary part of L, of the same shape.
    """
    ax.plot(real.T, imaginary.T, color=BLUE, linewidth=0.7, alpha=0.5)
    ax.add_patch(Circle((-1.0, 0.0), 0.5, fill=False, color=GREY, linestyle=":"))  # radius 1/M_s
    ax.plot([-1.0], [0.0], "+", color=RED, markersize=12, markeredgewidth=2.0)
    left, right = NYQUIST_SPAN
    half = 0.5 * (right - left)
    ax.set(xlim=NYQUIST_SPAN, ylim=(-half, half), xlabel="Re L", ylabel="Im L (dotted: M_s = 2)")
    ax.set_aspect("equal")


def margin_panel(ax: Axes, margin: xr.DataArray, stable: int, limit: float | None, unit: str, scale: float) -> None:
    """Draw the distribution function of a margin over all draws, and its tolerance limit.

    A draw without a stable loop counts as a margin of 0, so the curve begins at the share of these draws. The curve
    does not reach 1 if some stable loops have an infinite margin.

    Args:
        ax: Axes to draw into.
        margin: The margin of each draw, shape (draws,); not finite where the draw has no margin, or an infinite one.
        stable: Number of draws with a stable loop.
        limit: Tolerance limit of the margin; None: no limit is drawn.
        unit: Unit of the axis.
        scale: Factor that converts the margin to that unit.
    """
    values = scale * margin.values
    sorted_values = np.sort(values[np.isfinite(values)])
    unstable = values.size - stable
    ranks = unstable + np.arange(1, len(sorted_values) + 1)
    text = "draws"
    if unstable:
        sorted_values = np.concatenate([[0.0], sorted_values])
        ranks = np.concatenate([[unstable], ranks])
        text = f"draws; {unstable:,} without a stable loop"
    ax.step(sorted_values, ranks / values.size, where="post", color=BLUE, label=text)
    ax.set(xlabel=f"{margin.name} margin [{unit}]", ylabel="share of draws at or below", ylim=(-0.03, 1.03))
    if limit is not None:
        text = f"95 % of draws, confidence 95 %: {scale * limit:.3g} {unit}"
        ax.axvline(scale * limit, color=ORANGE, linestyle="--", label=text)
    legend_above(ax)
