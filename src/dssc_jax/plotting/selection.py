"""Figure of a selection among candidates: where the selected ones lie, and how many draws the others got."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.plotting.style import BLUE, GREY, RED, SLIDE, set_log, styled, title
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.schema import name_with_unit


@styled
def selection(analysis: Analysis) -> Figure:
    """Plot the candidates with their shares of failed draws, and the number of candidates over the number of draws.

    Args:
        analysis: The return value of :func:`dssc_jax.select`.
    """
    data = analysis.dataset
    summary = analysis.summary()
    names = list(summary["ranges"])
    draws = data["draws"].values
    figure = Figure(figsize=SLIDE, layout="constrained")
    left, right = figure.subplots(1, 2)
    if len(names) == 1:
        share_panel(left, data, names[0])
    else:
        plane_panel(figure, left, data, names)
    looks = np.unique(draws)
    remaining = [np.count_nonzero(draws >= look) for look in looks]
    right.step([0, *looks], [len(draws), *remaining], where="pre", color=BLUE)
    right.set(yscale="log", xlabel="draws", ylabel="candidates with as many draws")
    title(figure, f"{summary['study']}: {'; '.join(summary['requirements'])}\n{analysis.headline}")
    return figure


def label_of(data: xr.Dataset, name: str) -> str:
    """Axis label of a number: its name and unit."""
    return name_with_unit(name, data[name].attrs["units"])


def share_panel(ax: Axes, data: xr.Dataset, name: str) -> None:
    """Draw the share of failed draws of each candidate over one number, and mark the selected candidates.

    Args:
        ax: Axes to draw into.
        data: Dataset of the selection; a ``place`` of 0 or more marks a selected candidate.
        name: Name of the number.
    """
    selected = data["place"].values >= 0
    values = data[name].values
    share = (data["failures"] / data["draws"]).values
    ax.scatter(values[~selected], share[~selected], s=10, color=GREY, label="not chosen")
    ax.scatter(values[selected], share[selected], s=30, color=BLUE, label="chosen", zorder=3)
    ax.set(xlabel=label_of(data, name), ylabel="share of failed draws", ylim=(-0.02, 1.02))
    set_log(ax, values)
    ax.legend()


def plane_panel(figure: Figure, ax: Axes, data: xr.Dataset, names: list[str]) -> None:
    """Draw the candidates over the first two numbers, coloured by share of failed draws; mark the selected ones.

    Args:
        figure: The figure, for the colour bar.
        ax: Axes to draw into.
        data: Dataset of the selection; a ``place`` of 0 or more marks a selected candidate.
        names: Names of the numbers.
    """
    selected = data["place"].values >= 0
    first = data[names[0]].values
    second = data[names[1]].values
    share = (data["failures"] / data["draws"]).values
    points = ax.scatter(first, second, s=12, c=share, cmap="viridis_r", vmin=0.0, vmax=1.0)
    ring = {"s": 60, "facecolors": "none", "edgecolors": RED, "linewidths": 1.8}
    ax.scatter(first[selected], second[selected], label="chosen", **ring)
    ax.set(xlabel=label_of(data, names[0]), ylabel=label_of(data, names[1]))
    set_log(ax, first, "x")
    set_log(ax, second, "y")
    figure.colorbar(points, ax=ax, label="share of failed draws")
    ax.legend()
