"""Theory and simulation: local and performance margins, and chattering predicted and simulated."""

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
    """Two kinds of margin on the left, never one curve; on the right what happens beyond the local one.

    What Theorem 1 says of the walk of the first margins stands below; a line where it speaks within the axis.

    Args:
        margins: Margins over one and the same number, by what they are of. Those of a linearisation are
            dashed, in continuous time dotted.
        oscillations: What :func:`dssc_jax.analyses.theory.chattering` returned, by controller; none: the left panel
            alone.
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
    """Amplitudes over the lag's time constant, simulated and predicted."""
    for colour, (name, one) in zip(cycle(THEORY_COLOURS), oscillations.items(), strict=False):
        mu = one["unmodelled.mu"].values
        amplitude = np.where(one["amplitude"] > NO_ANSWER * one.attrs["push"], one["amplitude"], np.nan)
        ax.loglog(mu, amplitude, "o", color=colour, label=f"{name}, simulated")
        if not np.isnan(one["predicted"]).all():
            ax.loglog(mu, one["predicted"], color=colour, label=f"{name}, describing function")
    if local is not None:
        ax.axvline(local, color=GREY, linestyle="--", label=f"local margin {local:.3g} s")
    ax.set(xlabel="time constant $\\mu$ of the lag [s]", ylabel=r"amplitude of $\sigma$ that is left [m/s]")
    ax.legend(frameon=False, fontsize=11)
    ax.set_title("beyond the local margin")


def cumulative(ax: Axes, margins: Analysis, summary: Mapping[str, Any], name: str, colour: str) -> None:
    """Distribution function of critical values; censored draws keep it from reaching 0 or 1."""
    critical, censoring = margins.dataset["critical"].values, margins.dataset["censoring"].values
    start, end = summary["bounds"]
    steps = np.sort(critical[censoring == 0])
    steps = steps if end > start else steps[::-1]
    share = (np.count_nonzero(censoring < 0) + np.arange(len(steps) + 1)) / critical.size
    x, criterion = np.concatenate([[start], steps, [end]]), " ".join(summary["criterion"])
    style = "-" if "linearised" not in criterion else "--" if "sampled" in criterion else ":"
    ax.step(x, np.concatenate([share, share[-1:]]), where="post", color=colour, linestyle=style, label=name)
