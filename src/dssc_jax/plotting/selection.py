"""Figure of a race of candidates: where the chosen ones lie, and when the others left."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.plotting.style import BLUE, GREY, RED, SLIDE, set_log, styled, title
from dssc_jax.results.analysis import Analysis


@styled
def selection(analysis: Analysis) -> Figure:
    """Plot the candidates' values and shares of failed draws, and how many candidates got how many draws.

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
        draw_line(left, data, names[0])
    else:
        draw_plane(figure, left, data, names)
    looks = np.unique(draws)
    right.step([0, *looks], [len(draws), *(np.count_nonzero(draws >= look) for look in looks)], where="pre", color=BLUE)
    right.set(yscale="log", xlabel="draws", ylabel="candidates with as many draws")
    title(figure, f"{summary['study']}: {'; '.join(summary['requirements'])}\n{analysis.headline}")
    return figure


def labelled(data: xr.Dataset, name: str) -> str:
    """A number's name with its unit."""
    unit = data[name].attrs["units"]
    return name + (f" [{unit}]" if unit not in ("", "1") else "")


def draw_line(ax: Axes, data: xr.Dataset, name: str) -> None:
    """Draw the share of failed draws over one number."""
    is_chosen = data["place"].values >= 0
    values, share = data[name].values, (data["failures"] / data["draws"]).values
    ax.scatter(values[~is_chosen], share[~is_chosen], s=10, color=GREY, label="not chosen")
    ax.scatter(values[is_chosen], share[is_chosen], s=30, color=BLUE, label="chosen", zorder=3)
    ax.set(xlabel=labelled(data, name), ylabel="share of failed draws", ylim=(-0.02, 1.02))
    set_log(ax, values)
    ax.legend()


def draw_plane(figure: Figure, ax: Axes, data: xr.Dataset, names: list[str]) -> None:
    """Draw the share of failed draws over the first two numbers."""
    is_chosen = data["place"].values >= 0
    first, second = (data[name].values for name in names[:2])
    share = (data["failures"] / data["draws"]).values
    points = ax.scatter(first, second, s=12, c=share, cmap="viridis_r", vmin=0.0, vmax=1.0)
    ax.scatter(
        first[is_chosen], second[is_chosen], s=60, facecolors="none", edgecolors=RED, linewidths=1.8, label="chosen"
    )
    ax.set(xlabel=labelled(data, names[0]), ylabel=labelled(data, names[1]))
    set_log(ax, first, "x")
    set_log(ax, second, "y")
    figure.colorbar(points, ax=ax, label="share of failed draws")
    ax.legend()
