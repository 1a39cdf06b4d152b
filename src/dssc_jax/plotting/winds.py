"""Figure of the worst winds: one panel for each signal, with the three components over time."""

import math

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.core.json_types import JsonObject
from dssc_jax.plotting.style import BLUE, GREEN, ORANGE, study_title, styled, title
from dssc_jax.results.analysis import Analysis

COLOURS_OF_COMPONENTS = {"x": BLUE, "y": ORANGE, "z": GREEN}
MOST_PANELS = 12
COLUMNS = 3  # of panels


@styled
def worst_wind(search: Analysis) -> Figure:
    """Plot the wind that drives each signal to its worst value, for the first 12 signals.

    Args:
        search: The return value of :func:`dssc_jax.worst_wind`.
    """
    summary = search.summary()
    answers = summary["signals"][:MOST_PANELS]
    columns = min(COLUMNS, len(answers))
    rows = math.ceil(len(answers) / columns)
    figure = Figure(figsize=(4.0 * columns + 1.5, 2.3 * rows + 1.6), layout="constrained")
    panels = np.ravel(figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False))
    for ax, answer in zip(panels, answers, strict=False):
        wind = search.dataset.sel(signal=answer["signal"])
        draw_wind(ax, wind, smooth=summary["rate"] is not None)
        ax.set_title(f"{answer['signal']}: {worst_text(answer)}", fontsize="medium")
    for empty in panels[len(answers) :]:
        empty.remove()
    lowest_of_columns = panels[max(0, len(answers) - columns) : len(answers)]
    for ax in lowest_of_columns:
        ax.set_xlabel("time [s]")
        ax.tick_params(labelbottom=True)
    figure.supylabel("wind [m/s]", fontsize="medium")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    rate = "" if summary["rate"] is None else f", |w'| at most {summary['rate']:g} m/s²"
    bounds = f"at most {summary['speed']:g} m/s horizontally and {summary['vertical']:g} m/s vertically{rate}"
    title(figure, f"{study_title(search.study)}\nthe worst wind found, {bounds}")
    return figure


def worst_text(answer: JsonObject) -> str:
    """The worst value of a signal with its unit, in words; "ends early" if the flight has no such value."""
    if answer["worst"] is None:
        return "ends early"
    value = f"{answer['worst']:.4g}"
    return value if answer["unit"] == "1" else f"{value} {answer['unit']}"


def draw_wind(ax: Axes, wind: xr.Dataset, smooth: bool) -> None:
    """Draw the three components of a wind over time, as lines if the wind is smooth, else as steps.

    Args:
        ax: Axes to draw into.
        wind: The components ``wind_x``, ``wind_y`` and ``wind_z`` [m/s] over ``time`` [s].
        smooth: Whether the wind varies continuously; otherwise each value holds until the next time.
    """
    for axis, colour in COLOURS_OF_COMPONENTS.items():
        style = "default" if smooth else "steps-post"
        ax.plot(wind["time"], wind[f"wind_{axis}"], drawstyle=style, color=colour, label=f"along {axis}", linewidth=1.2)
