"""Figure of theory and simulation: local and performance margins, and chattering predicted and simulated."""

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dssc_jax.plotting.margins import MarginSummary, certificate, in_order_of_walk, set_walk, summary_of
from dssc_jax.plotting.style import BLUE, GREY, ORANGE, PANEL, RED, SKY, SLIDE, VIOLET, styled
from dssc_jax.results.analysis import Analysis

THEORY_COLOURS = (BLUE, RED, ORANGE, VIOLET, SKY, "black")
SETTLED = 1e-2  # 1/s
"""A final amplitude up to this many times the initial push has died away, and is not drawn."""


@styled
def theory(
    margins: Mapping[str, Analysis],
    oscillations: Mapping[str, xr.Dataset] | None = None,
    local: float | None = None,
) -> Figure:
    """Plot both kinds of margin on the left, and oscillations beyond the local margin on the right.

    The result of Theorem 1 for the walk of the first margins is given below, and marked by a line if it is on the axis.

    Args:
        margins: Margins over the same number, by their criterion. Those of a linearisation are
            dashed, in continuous time dotted.
        oscillations: The return value of :func:`dssc_jax.analyses.theory.chattering`, by controller; if empty, only the
            left panel is drawn.
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
    """Draw the distribution functions of all margins, and the first one's result of Theorem 1."""
    summaries = {name: summary_of(analysis) for name, analysis in margins.items()}
    for colour, (name, analysis) in zip(cycle(THEORY_COLOURS), margins.items(), strict=False):
        cumulative(ax, analysis.dataset, summaries[name], name, colour)
    first = next(iter(summaries.values()))
    start, end = first["bounds"]
    ax.set_ylim(-0.03, 1.03)
    set_walk(ax, first)
    certificate(ax, first)
    ax.set_xlabel(f"critical {first['parameter']} [{first['unit']}]")
    side = "below" if end > start else "above"
    ax.set_ylabel(f"share of draws at or {side}")
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))
    ax.legend(frameon=False, fontsize=11)
    ax.set_title("margins of random draws")


def oscillations_panel(ax: Axes, oscillations: Mapping[str, xr.Dataset], local: float | None) -> None:
    """Draw amplitudes over the lag's time constant, simulated and predicted."""
    for colour, (name, oscillation) in zip(cycle(THEORY_COLOURS), oscillations.items(), strict=False):
        mu = oscillation[next(iter(oscillation.dims))].values
        final = oscillation["amplitude"]
        amplitude = np.where(final > SETTLED * oscillation.attrs["push"], final, np.nan)
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


def cumulative(ax: Axes, margins: xr.Dataset, summary: MarginSummary, name: str, colour: str) -> None:
    """Draw the distribution function of critical values; with censored draws it does not reach 0 or 1."""
    critical = margins["critical"].values
    censoring = margins["censoring"].values
    start, end = summary["bounds"]
    steps = in_order_of_walk(critical[censoring == 0], summary)
    failed_at_start = np.count_nonzero(censoring < 0)
    share = (failed_at_start + np.arange(len(steps) + 1)) / critical.size
    x = np.concatenate([[start], steps, [end]])
    y = np.concatenate([share, share[-1:]])
    ax.step(x, y, where="post", color=colour, linestyle=line_style(summary["criterion"]), label=name)


def line_style(criterion: Sequence[str]) -> str:
    """Solid for a simulated criterion, dashed for one of the sampled linearisation, dotted in continuous time."""
    text = " ".join(criterion)
    if "linearised" not in text:
        return "-"
    return "--" if "sampled" in text else ":"
