"""Figure of theory and simulation: local and performance margins, and chattering predicted and simulated."""

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dssc_jax.plotting.margins import MarginSummary, in_order_of_walk, mark_certificate, set_walk_axis, summary_of
from dssc_jax.plotting.style import BLUE, GREY, ORANGE, PANEL, RED, SKY, SLIDE, VIOLET, styled
from dssc_jax.results.analysis import Analysis

THEORY_COLOURS = (BLUE, RED, ORANGE, VIOLET, SKY, "black")
DECAYED = 1e-2  # 1/s
"""Final amplitudes up to this many times the initial push count as decayed, and are not drawn."""


@styled
def theory(
    margins: Mapping[str, Analysis],
    oscillations: Mapping[str, xr.Dataset] | None = None,
    local: float | None = None,
) -> Figure:
    """Plot local and simulated margins on the left, and oscillations beyond the local margin on the right.

    The result of Theorem 1 for the walk of the first margins is written below. If it is on the axis, a line marks it.

    Args:
        margins: Margins over the same number, by criterion. Those of the sampled linearisation are drawn dashed, those
            in continuous time dotted.
        oscillations: The return value of :func:`dssc_jax.analyses.theory.chattering`, by controller. If there are none,
            only the left panel is drawn.
        local: Local critical value of the loop on the right whose gains are finite at the origin.
    """
    oscillations = oscillations or {}
    width = SLIDE[0] if oscillations else PANEL[0] + 1.4
    figure = Figure(figsize=(width, SLIDE[1] + 0.9), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, 2 if oscillations else 1))
    margins_panel(panels[0], margins)
    if oscillations:
        oscillations_panel(panels[1], oscillations, local)
    return figure


def margins_panel(ax: Axes, margins: Mapping[str, Analysis]) -> None:
    """Draw the distribution functions of the critical values, one for each criterion, and the result of Theorem 1."""
    summaries = {name: summary_of(analysis) for name, analysis in margins.items()}
    for colour, (name, analysis) in zip(cycle(THEORY_COLOURS), margins.items(), strict=False):
        draw_distribution(ax, analysis.dataset, summaries[name], name, colour)
    first = next(iter(summaries.values()))
    start, end = first["bounds"]
    ax.set_ylim(-0.03, 1.03)
    set_walk_axis(ax, first)
    mark_certificate(ax, first)
    ax.set_xlabel(f"critical {first['parameter']} [{first['unit']}]")
    side = "below" if end > start else "above"
    ax.set_ylabel(f"share of draws at or {side}")
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))
    ax.legend(frameon=False, fontsize=11)
    ax.set_title("margins of random draws")


def oscillations_panel(ax: Axes, oscillations: Mapping[str, xr.Dataset], local: float | None) -> None:
    """Draw simulated and predicted amplitudes of sigma over the time constant of the lag.

    Args:
        ax: Axes to draw into.
        oscillations: Amplitudes by controller.
        local: Local margin [s]; None: no line is drawn for it.
    """
    for colour, (name, oscillation) in zip(cycle(THEORY_COLOURS), oscillations.items(), strict=False):
        swept_number = next(iter(oscillation.dims))  # the only dimension, named by the study's number
        mu = oscillation[swept_number].values
        final = oscillation["amplitude"]
        amplitude = np.where(final > DECAYED * oscillation.attrs["push"], final, np.nan)
        ax.loglog(mu, amplitude, "o", color=colour, label=f"{name}, simulated")
        predicted = oscillation["predicted"]
        if not np.isnan(predicted).all():
            ax.loglog(mu, predicted, color=colour, label=f"{name}, describing function")
    if local is not None:
        ax.axvline(local, color=GREY, linestyle="--", label=f"local margin {local:.3g} s")
    first = next(iter(oscillations.values()))
    unit = first["amplitude"].attrs["units"]
    ax.set(xlabel="time constant $\\mu$ of the lag [s]", ylabel=rf"amplitude of $\sigma$ that is left [{unit}]")
    ax.legend(frameon=False, fontsize=11)
    ax.set_title("beyond the local margin")


def draw_distribution(ax: Axes, margins: xr.Dataset, summary: MarginSummary, name: str, colour: str) -> None:
    """Draw the distribution function of critical values along the walk.

    The curve begins above 0 if draws fail at the start of the walk, and ends below 1 if draws pass to its end.

    Args:
        ax: Axes to draw into.
        margins: Dataset of the margins.
        summary: Summary of the margins.
        name: Legend of the curve.
        colour: Colour of the curve.
    """
    critical = margins["critical"].values
    censoring = margins["censoring"].values  # -1: fails at the start, 1: passes to the end, 0: fails between
    start, end = summary["bounds"]
    steps = in_order_of_walk(critical[censoring == 0], summary)
    failed_at_start = np.count_nonzero(censoring < 0)
    share = (failed_at_start + np.arange(len(steps) + 1)) / critical.size
    x = np.concatenate([[start], steps, [end]])
    y = np.concatenate([share, share[-1:]])
    ax.step(x, y, where="post", color=colour, linestyle=line_style(summary["criterion"]), label=name)


def line_style(criterion: Sequence[str]) -> str:
    """Line style of a criterion: solid if simulated, dashed if linearised and sampled, dotted in continuous time.

    Args:
        criterion: The criterion in words.
    """
    text = " ".join(criterion)
    if "linearised" not in text:
        return "-"
    return "--" if "sampled" in text else ":"
