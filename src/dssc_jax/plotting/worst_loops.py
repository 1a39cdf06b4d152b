"""Figure of the worst margins of the linearised loop: drawn, found and bounded."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.plotting.style import BLUE, GREEN, ORANGE, study_title, styled, title
from dssc_jax.results.analysis import Analysis

PANELS = {
    "gain_upper": ("gain margin [1]", 1.0),
    "phase": ("phase margin [deg]", 180.0 / np.pi),
    "delay": ("delay margin [s]", 1.0),
    "disk": ("disk margin [1]", 1.0),
    "sensitivity_peak": ("M_s [1]", 1.0),
    "complementary_peak": ("M_t [1]", 1.0),
}
"""Axis label of each margin, and the factor that converts it to the label's unit."""
MARKS = {
    "drawn": ("o", BLUE, "worst drawn"),
    "found": ("D", ORANGE, "worst found in the box"),
    "bounded": ("|", GREEN, "bounded on all of the box"),
}
"""Marker, colour and legend of each kind of value, by its variable in the dataset."""


@styled
def worst_loop(worst: Analysis) -> Figure:
    """Plot the worst drawn, the worst found and the bounded value of each margin, at every break point.

    Args:
        worst: The return value of :func:`dssc_jax.worst_loop`.
    """
    loops = list(map(str, worst.dataset["loop"].values))
    figure = Figure(figsize=(11.0, 3.6 + 0.8 * len(loops)), layout="constrained")
    panels = figure.subplots(2, 3, sharey=True)
    for ax, margin in zip(np.ravel(panels), PANELS, strict=True):
        margin_panel(ax, worst, margin, loops)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    title(figure, f"{study_title(worst.study)}: worst margins over the box of the laws")
    return figure


def margin_panel(ax: Axes, worst: Analysis, margin: str, loops: list[str]) -> None:
    """Draw the worst drawn, found and bounded value of one margin, one row for each break point.

    Values that are not finite are left out. If all values of a kind are, a text in the panel says so.

    Args:
        ax: Axes to draw into.
        worst: The analysis.
        margin: Name of the margin.
        loops: Names of the break points, from the bottom row up.
    """
    label, scale = PANELS[margin]
    data = worst.dataset.sel(margin=margin)
    rows = np.arange(len(loops))
    text_height = 0.1  # as a share of the panel
    for name, (marker, colour, text) in MARKS.items():
        values = scale * data[name].values
        values = np.where(np.isfinite(values), values, np.nan)
        ax.plot(values, rows, marker, color=colour, label=text, markersize=12, fillstyle="none", markeredgewidth=2.0)
        if np.isnan(values).all():
            ax.text(0.5, text_height, f"{text}: none", transform=ax.transAxes, ha="center")
        text_height += 0.1
    ax.set(xlabel=label, yticks=rows, yticklabels=loops, ylim=(-0.7, len(loops) - 0.3))
