"""Bode, Nyquist and sensitivity fans of the linearised loop over all draws."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, styled, title
from dssc_jax.results.analysis import Analysis

SPAN_OF_NYQUIST = (-3.2, 1.2)  # of the real axis
FLOOR_OF_BODE = -60.0  # [dB]


@styled
def loop_margins(margins: Analysis, point: str | None = None, broken_at: str | None = None) -> Figure:
    """Plot Bode and Nyquist diagrams of L, both sensitivities, and the distributions of phase and delay margin.

    Bands hold 90 % of the draws at each frequency; lines in the Nyquist diagram are single draws.

    Args:
        margins: The return value of :func:`dssc_jax.loop_margins`.
        point: Name of the operating point; None: the first.
        broken_at: Name of the break point; None: the first.
    """
    data, summary = margins.dataset, margins.summary()
    point = point or str(data["operating_point"].values[0])
    broken_at = broken_at or str(data["loop"].values[0])
    own = data.sel(operating_point=point, loop=broken_at)
    figure = Figure(figsize=(12.5, 8.2), layout="constrained")
    axes = figure.subplots(2, 3)
    frequency = data["frequency"].values
    fan(axes[0, 0], frequency, 20.0 * np.log10(own["loop_gain"].values), BLUE, "|L|")
    axes[0, 0].axhline(0.0, color="black", linewidth=0.8)
    axes[0, 0].set(ylabel="loop gain [dB]", ylim=(max(FLOOR_OF_BODE, axes[0, 0].get_ylim()[0]), None))
    fan(axes[1, 0], frequency, np.degrees(own["loop_phase"].values), BLUE, "arg L")
    axes[1, 0].axhline(-180.0, color="black", linewidth=0.8)
    axes[1, 0].set(ylabel="phase of L [deg]", xlabel="frequency [rad/s]")
    nyquist(axes[0, 1], own["loop_real"].values, own["loop_imaginary"].values)
    for name, colour, text in (("sensitivity", ORANGE, "|S|"), ("complementary", GREEN, "|T|")):
        fan(axes[1, 1], frequency, 20.0 * np.log10(own[name].values), colour, text)
    axes[1, 1].axhline(0.0, color="black", linewidth=0.8)
    axes[1, 1].set(ylabel="sensitivities [dB]", xlabel="frequency [rad/s]")
    axes[1, 1].set_ylim(max(FLOOR_OF_BODE, axes[1, 1].get_ylim()[0]), None)
    axes[1, 1].legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=10)
    statistics = summary["operating_points"][point][broken_at]
    for ax, name, factor, unit in ((axes[0, 2], "phase", 180.0 / np.pi, "deg"), (axes[1, 2], "delay", 1.0, "s")):
        distribution_of_margin(ax, factor * own[name].values, f"{name} margin [{unit}]")
        limit = statistics[name]["tolerance_limit"]
        if limit is not None:
            text = f"95 % of draws, confidence 95 %: {factor * limit:.3g} {unit}"
            ax.axvline(factor * limit, color=ORANGE, linestyle="--", label=text)
        ax.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=10)
    config = margins.study.config
    where = point if point == "equilibrium" else f"linearised at {point}"
    title(figure, f"{config.description or config.name}: loop broken at {broken_at}, {where}, {summary['draws']} draws")
    return figure


def fan(ax: Axes, frequency: np.ndarray, quantiles: np.ndarray, colour: str, text: str) -> None:
    """Draw the median and the band of 90 % over frequency; quantiles of shape (levels, frequencies)."""
    ax.fill_between(frequency, quantiles[0], quantiles[-1], color=colour, alpha=0.25, linewidth=0.0)
    ax.plot(frequency, quantiles[len(quantiles) // 2], color=colour, label=f"{text}: median and 90 % of draws")
    ax.set_xscale("log")


def nyquist(ax: Axes, real: np.ndarray, imaginary: np.ndarray) -> None:
    """Draw single draws, each of shape (lines, frequencies), the point -1, and the circle of M_s = 2."""
    ax.plot(real.T, imaginary.T, color=BLUE, linewidth=0.7, alpha=0.5)
    ax.add_patch(Circle((-1.0, 0.0), 0.5, fill=False, color=GREY, linestyle=":"))
    ax.plot([-1.0], [0.0], "+", color=RED, markersize=12, markeredgewidth=2.0)
    half = 0.5 * (SPAN_OF_NYQUIST[1] - SPAN_OF_NYQUIST[0])
    ax.set(xlim=SPAN_OF_NYQUIST, ylim=(-half, half), xlabel="Re L", ylabel="Im L (dotted: M_s = 2)")
    ax.set_aspect("equal")


def distribution_of_margin(ax: Axes, values: np.ndarray, text: str) -> None:
    """Draw the distribution function of a margin over the draws that have one."""
    ordered = np.sort(values[np.isfinite(values)])
    ax.step(ordered, np.arange(1, len(ordered) + 1) / values.size, where="post", color=BLUE, label="draws")
    ax.set(xlabel=text, ylabel="share of draws at or below", ylim=(-0.03, 1.03))
