"""Figures of the page on noise."""

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from benchmarks.noise.contests import CONTROLLERS, NAMES
from benchmarks.noise.contests import PERIODS as CONTEST_PERIODS
from benchmarks.noise.costs import Costs
from benchmarks.noise.maps import PERIODS, Map
from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, SKY, VIOLET, styled

COLOURS = (RED, BLUE, SKY, GREEN, GREY, ORANGE, VIOLET, "#F0E442", "black")
MARKERS = "osv^Dx*P+"


@styled
def maps(found: Mapping[str, Map]) -> Figure:
    """Failure probability over T_s and noise, a panel each."""
    figure = Figure(figsize=(11.5, 8.6), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True).ravel()
    mesh = None
    for ax, (name, one) in zip(panels, found.items(), strict=True):
        mesh = ax.pcolormesh(1e3 * np.array(PERIODS), one.noise, one.failures.T, vmin=0.0, vmax=1.0, cmap="viridis_r")
        ax.set(xscale="log", yscale="log", title=name, ylabel=f"standard deviation of the noise [{one.unit}]")
        ax.grid(visible=False)
    for ax in panels[2:]:
        ax.set_xlabel("T_s [ms]")
    assert mesh is not None
    figure.colorbar(mesh, ax=list(panels), label="share of draws that fail", format=PercentFormatter(1.0))
    return figure


@styled
def costs(controllers: Mapping[tuple[str, float], Costs], differentiators: Mapping[tuple[str, float], Costs]) -> Figure:
    """rms of the error, and variation of the output, over T_s: controllers above, differentiators below."""
    figure = Figure(figsize=(11.5, 9.0), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True)
    rows = (
        (controllers, CONTROLLERS, "e, rms [m]", "total variation of u per second [m/s^2]"),
        (differentiators, NAMES, "error of y', rms [m/s]", "total variation of y' per second [m/s^2]"),
    )
    for (found, names, error, moved), (left, right) in zip(rows, panels, strict=True):
        for i, (name, text) in enumerate(names.items()):
            style = {
                "color": COLOURS[i],
                "marker": MARKERS[i],
                "label": text.partition(",")[0] if found is differentiators else text,
            }
            for ax, cost in ((left, "l2"), (right, "variation")):
                ax.plot(
                    1e3 * np.array(CONTEST_PERIODS), [getattr(found[name, h], cost) for h in CONTEST_PERIODS], **style
                )
        left.set(xscale="log", yscale="log", ylabel=error)
        right.set(xscale="log", yscale="log", ylabel=moved)
        right.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    for ax in panels[1]:
        ax.set_xlabel("T_s [ms]")
    return figure


@styled
def spectra(found: Mapping[str, xr.Dataset]) -> Figure:
    """Gain from the error of the measured sigma to the command over frequency."""
    figure = Figure(figsize=(11.5, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True)
    for colour, (name, one) in zip((BLUE, ORANGE), found.items(), strict=True):
        left.plot(one["frequency"], one["gain"], color=colour, label=name)
        right.plot(one["frequency"], one["coherence"], color=colour)
    left.set(xscale="log", yscale="log", xlabel="frequency [Hz]", ylabel="gain from noise of sigma to u")
    right.set(xscale="log", xlabel="frequency [Hz]", ylabel="coherence", ylim=(0.0, 1.05))
    left.legend()
    return figure
