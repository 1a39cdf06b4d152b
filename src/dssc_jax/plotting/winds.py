"""Figure of the worst winds found: one panel for each signal, with the three components over time."""

from typing import Protocol

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.core.json_types import JsonObject
from dssc_jax.plotting.style import BLUE, GREEN, ORANGE, styled, title
from dssc_jax.study import Study

COLOURS_OF_COMPONENTS = {"x": BLUE, "y": ORANGE, "z": GREEN}
MOST_PANELS = 12
COLUMNS = 3


class PlottedWorstWind(Protocol):
    """What the figure takes from :class:`dssc_jax.WorstWind`."""

    study: Study
    dataset: xr.Dataset

    def summary(self) -> JsonObject:
        """The answer in plain numbers."""
        ...


@styled
def worst_wind(found: PlottedWorstWind) -> Figure:
    """Plot the wind that drives each signal to its worst value, of at most 12 signals.

    Args:
        found: The return value of :func:`dssc_jax.worst_wind`.
    """
    summary = found.summary()
    answers = summary["signals"][:MOST_PANELS]
    columns = min(COLUMNS, len(answers))
    rows = -(-len(answers) // columns)
    figure = Figure(figsize=(4.0 * columns + 1.5, 2.3 * rows + 1.6), layout="constrained")
    panels = np.ravel(figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False))
    for ax, answer in zip(panels, answers, strict=False):
        wind = found.dataset.sel(signal=answer["signal"])
        draw_wind(ax, wind, smooth=summary["rate"] is not None)
        worst_text = "ends early" if answer["worst"] is None else f"{answer['worst']:.4g} {answer['unit']}"
        ax.set_title(f"{answer['signal']}: {worst_text.removesuffix(' 1')}", fontsize="medium")
    for ax in panels[len(answers) :]:
        ax.remove()
    for ax in panels[max(0, len(answers) - columns) : len(answers)]:
        ax.set_xlabel("time [s]")
        ax.tick_params(labelbottom=True)
    figure.supylabel("wind [m/s]", fontsize="medium")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    config = found.study.config
    rate = "" if summary["rate"] is None else f", |w'| at most {summary['rate']:g} m/s²"
    bounds = f"at most {summary['speed']:g} m/s horizontally and {summary['vertical']:g} m/s vertically{rate}"
    title(figure, f"{config.description or config.name}\nthe worst wind found, {bounds}")
    return figure


def draw_wind(ax: Axes, wind: xr.Dataset, smooth: bool) -> None:
    """Draw the components of one wind; vectors that hold are steps."""
    for axis, colour in COLOURS_OF_COMPONENTS.items():
        style = "default" if smooth else "steps-post"
        ax.plot(wind["time"], wind[f"wind_{axis}"], drawstyle=style, color=colour, label=f"along {axis}", linewidth=1.2)
