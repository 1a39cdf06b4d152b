"""Theory beside simulation: local and performance margins, and chattering predicted and simulated."""

from collections.abc import Mapping
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dssc_jax.plotting.margins import certificate
from dssc_jax.plotting.style import BLUE, GREY, ORANGE, PANEL, RED, SKY, SLIDE, VIOLET, styled

if TYPE_CHECKING:
    from dssc_jax.analyses.margins import Margins

COLOURS = (BLUE, RED, ORANGE, VIOLET, SKY, "black")
NOTHING = 1e-2  # of the push [1/s]: a deviation that dies away is not drawn


@styled
def theory(
    margins: Mapping[str, "Margins"],
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
    for colour, (name, found) in zip(cycle(COLOURS), margins.items(), strict=False):
        cumulative(left, found, name, colour)
    first = next(iter(margins.values()))
    left.set(xscale="log" if first.walk.log else "linear", ylim=(-0.03, 1.03))
    left.set_xlim(first.walk.start, first.walk.end)
    certificate(left, first.certificate, first.walk)
    left.set(xlabel=f"critical {first.parameter} [{first.dataset['critical'].attrs['units']}]")
    side = "below" if first.walk.end > first.walk.start else "above"
    left.set_ylabel(f"share of draws at or {side}")
    left.yaxis.set_major_formatter(PercentFormatter(1.0))
    left.legend(frameon=False, fontsize=11)
    left.set_title("margins of random draws")
    for right in others:
        beyond(right, oscillations or {}, local)
    return figure


def beyond(ax: Axes, oscillations: Mapping[str, xr.Dataset], local: float | None) -> None:
    """Amplitudes over the lag's time constant, simulated and predicted."""
    for colour, (name, found) in zip(cycle(COLOURS), oscillations.items(), strict=False):
        mu = found["unmodelled.mu"].values
        amplitude = np.where(found["amplitude"] > NOTHING * found.attrs["push"], found["amplitude"], np.nan)
        ax.loglog(mu, amplitude, "o", color=colour, label=f"{name}, simulated")
        if not np.isnan(found["predicted"]).all():
            ax.loglog(mu, found["predicted"], color=colour, label=f"{name}, describing function")
    if local is not None:
        ax.axvline(local, color=GREY, linestyle="--", label=f"local margin {local:.3g} s")
    ax.set(xlabel="time constant $\\mu$ of the lag [s]", ylabel=r"amplitude of $\sigma$ that is left [m/s]")
    ax.legend(frameon=False, fontsize=11)
    ax.set_title("beyond the local margin")


def cumulative(ax: Axes, found: "Margins", name: str, colour: str) -> None:
    """Distribution function of critical values; censored draws keep it from reaching 0 or 1."""
    critical, censoring = found.dataset["critical"].values, found.dataset["censoring"].values
    steps = np.sort(critical[censoring == 0])
    steps = steps if found.walk.end > found.walk.start else steps[::-1]
    start = np.count_nonzero(censoring < 0)
    share = (start + np.arange(len(steps) + 1)) / critical.size
    x = np.concatenate([[found.walk.start], steps, [found.walk.end]])
    linearised = "linearised" in " ".join(found.criterion)
    style = "-" if not linearised else "--" if "sampled" in " ".join(found.criterion) else ":"
    ax.step(x, np.concatenate([share, share[-1:]]), where="post", color=colour, linestyle=style, label=name)
