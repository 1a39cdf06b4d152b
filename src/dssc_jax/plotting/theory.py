"""Theory beside simulation: local and performance margins, and chattering predicted and simulated."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, SLIDE, styled

if TYPE_CHECKING:
    from dssc_jax.margins import Margins

COLOURS = (BLUE, RED, GREEN, ORANGE)
NOTHING = 1e-9  # m/s: a deviation that has died away is not drawn


@styled
def theory(
    margins: Mapping[str, "Margins"],
    oscillations: Mapping[str, xr.Dataset],
    local: float | None = None,
    certified: float | None = None,
) -> Figure:
    """Two kinds of margin on the left, never one curve; on the right what happens beyond the local one.

    Args:
        margins: Margins over one and the same number, by what they are of. Those of a linearisation are dashed.
        oscillations: What :func:`dssc_jax.theory.chattering` returned, by controller.
        local: Local critical value of the loop on the right whose gains are finite at the origin.
        certified: Value up to which a certificate speaks.
    """
    figure = Figure(figsize=(SLIDE[0], SLIDE[1] + 0.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for colour, (name, found) in zip(COLOURS, margins.items(), strict=False):
        cumulative(left, found, name, colour)
    if certified is not None:
        left.axvline(certified, color=GREY, linestyle="-.", label=f"certified up to {certified:.2g}")
    first = next(iter(margins.values()))
    left.set(xscale="log" if first.walk.log else "linear", ylim=(-0.03, 1.03))
    left.set(xlabel=f"critical {first.parameter} [{first.dataset['critical'].attrs['units']}]")
    left.set_ylabel("share of draws at or below")
    left.yaxis.set_major_formatter(PercentFormatter(1.0))
    for colour, (name, found) in zip(COLOURS, oscillations.items(), strict=False):
        mu = found["unmodelled.mu"].values
        amplitude = np.where(found["amplitude"] > NOTHING, found["amplitude"], np.nan)
        right.loglog(mu, amplitude, "o", color=colour, label=f"{name}, simulated")
        if not np.isnan(found["predicted"]).all():
            right.loglog(mu, found["predicted"], color=colour, label=f"{name}, describing function")
    if local is not None:
        right.axvline(local, color=GREY, linestyle="--", label=f"local margin {local:.3g} s")
    right.set(xlabel="time constant $\\mu$ of the lag [s]", ylabel=r"amplitude of $\sigma$ that is left [m/s]")
    for ax in (left, right):
        ax.legend(frameon=False, fontsize=11)
    left.set_title("margins of random draws")
    right.set_title("beyond the local margin")
    return figure


def cumulative(ax: Axes, found: "Margins", name: str, colour: str) -> None:
    """Distribution function of critical values; censored draws keep it from reaching 0 or 1."""
    critical, censoring = found.dataset["critical"].values, found.dataset["censoring"].values
    steps = np.sort(critical[censoring == 0])
    start = np.count_nonzero(censoring < 0)
    share = (start + np.arange(len(steps) + 1)) / critical.size
    x = np.concatenate([[found.walk.start], steps, [found.walk.end]])
    style = "--" if "linearised" in " ".join(found.criterion) else "-"
    ax.step(x, np.concatenate([share, share[-1:]]), where="post", color=colour, linestyle=style, label=name)
