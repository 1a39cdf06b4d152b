"""Figure of theory and simulation: local and performance margins, and chattering predicted and simulated."""

from collections.abc import Mapping
from itertools import cycle
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dssc_jax.plotting.margins import certificate, set_walk
from dssc_jax.plotting.style import BLUE, GREY, ORANGE, PANEL, RED, SKY, SLIDE, VIOLET, styled
from dssc_jax.results.analysis import Analysis

THEORY_COLOURS = (BLUE, RED, ORANGE, VIOLET, SKY, "black")
NO_ANSWER = 1e-2  # of the push [1/s]: a deviation that dies away is not drawn


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
    size = (SLIDE[0] if oscillations else PANEL[0] + 1.4, SLIDE[1] + 0.9)
    figure = Figure(figsize=size, layout="constrained")
    left, *others = np.atleast_1d(figure.subplots(1, 2 if oscillations else 1))
    summaries = {name: one.summary() for name, one in margins.items()}
    for colour, (name, one) in zip(cycle(THEORY_COLOURS), margins.items(), strict=False):
        cumulative(left, one, summaries[name], name, colour)
    first = next(iter(summaries.values()))
    left.set_ylim(-0.03, 1.03)
    set_walk(left, first)
    certificate(left, first)
    left.set(xlabel=f"critical {first['parameter']} [{first['unit']}]")
    side = "below" if first["bounds"][1] > first["bounds"][0] else "above"
    left.set_ylabel(f"share of draws at or {side}")
    left.yaxis.set_major_formatter(PercentFormatter(1.0))
    left.legend(frameon=False, fontsize=11)
    left.set_title("margins of random draws")
    for right in others:
        draw_beyond(right, oscillations or {}, local)
    return figure


def draw_beyond(ax: Axes, oscillations: Mapping[str, xr.Dataset], local: float | None) -> None:
    """Draw amplitudes over the lag's time constant, simulated and predicted."""
    unit = next((f" [{one['amplitude'].attrs['units']}]" for one in oscillations.values()), "")
    for colour, (name, one) in zip(cycle(THEORY_COLOURS), oscillations.items(), strict=False):
        mu = one[next(iter(one.dims))].values
        amplitude = np.where(one["amplitude"] > NO_ANSWER * one.attrs["push"], one["amplitude"], np.nan)
        ax.loglog(mu, amplitude, "o", color=colour, label=f"{name}, simulated")
        if not np.isnan(one["predicted"]).all():
            ax.loglog(mu, one["predicted"], color=colour, label=f"{name}, describing function")
    if local is not None:
        ax.axvline(local, color=GREY, linestyle="--", label=f"local margin {local:.3g} s")
    ax.set(xlabel="time constant $\\mu$ of the lag [s]", ylabel=rf"amplitude of $\sigma$ that is left{unit}")
    ax.legend(frameon=False, fontsize=11)
    ax.set_title("beyond the local margin")


def cumulative(ax: Axes, margins: Analysis, summary: Mapping[str, Any], name: str, colour: str) -> None:
    """Draw the distribution function of critical values; with censored draws it does not reach 0 or 1."""
    critical, censoring = margins.dataset["critical"].values, margins.dataset["censoring"].values
    start, end = summary["bounds"]
    steps = np.sort(critical[censoring == 0])
    steps = steps if end > start else steps[::-1]
    share = (np.count_nonzero(censoring < 0) + np.arange(len(steps) + 1)) / critical.size
    x, criterion = np.concatenate([[start], steps, [end]]), " ".join(summary["criterion"])
    style = "-" if "linearised" not in criterion else "--" if "sampled" in criterion else ":"
    ax.step(x, np.concatenate([share, share[-1:]]), where="post", color=colour, linestyle=style, label=name)
