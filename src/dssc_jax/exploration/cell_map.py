"""The failure probability over the axes of a sweep as a curve or a map; a click on a point brushes its draws."""

import math
from typing import Any

import numpy as np
from bokeh.models import BasicTicker, ColorBar, ColumnDataSource, CustomJS, FixedTicker, LinearColorMapper
from bokeh.plotting import figure
from bokeh.transform import transform

from dssc_jax.exploration.draw_table import DrawTable
from dssc_jax.plotting.style import BLUE, GREY
from dssc_jax.statistics import CONFIDENCE, clopper_pearson, rounded_probability

WIDTH = 1240  # px
HEIGHT = 300
MOST_LABELS = 12
"""Largest number of labels on an axis."""
SELECT_CELL = """
const cell = cells.selected.indices[0]
if (cell != undefined) choose(source, null, drawsAt(source, names, names.map(name => cells.data[name][cell])), true)
"""
"""JavaScript that brushes the draws of a point that was clicked."""


def point_columns(failed: np.ndarray) -> dict[str, Any]:
    """Columns with the failure probability of each point, its interval, and both in words.

    Args:
        failed: Whether each draw failed, shape (points, draws).
    """
    draws = failed.shape[-1]
    failures = failed.sum(-1)
    low, high = clopper_pearson(failures, draws, CONFIDENCE).T
    statements = []
    for count, lower, upper in zip(failures, low, high, strict=True):
        interval = f"[{rounded_probability(lower)}, {rounded_probability(upper)}]"
        statements.append(f"{count:,} of {draws:,} draws fail: in {interval}")
    return {"probability": failures / draws, "low": low, "high": high, "statement": statements}


class CellMap:
    """The failures at the points of a sweep: over one axis as a curve with intervals, over two axes as a map.

    The values of an axis ascend, in whichever order the study lists them. If the sweep has further axes, the draws at
    all of their values are counted together, and the title says so.

    Args:
        table: The draws of a sweep.
        source: Data source of the page with the draws.
        script: The script with the functions that callbacks call.
    """

    def __init__(self, table: DrawTable, source: ColumnDataSource, script: str) -> None:
        """Count the failures at each point, and make the figure; the arguments are those of the class."""
        axes = table.result.study.axes
        self.names = list(axes)[:2]
        pooled_axes = list(axes)[2:]
        values = [sorted(axes[name]) for name in self.names]
        grid = [len(axis_values) for axis_values in values]
        failed = table.result.failed.sortby(self.names).transpose(*self.names, *pooled_axes, "draw").values
        data = point_columns(failed.reshape(math.prod(grid), -1))
        places = np.indices(grid).reshape(len(values), -1)  # index of each point along each axis
        for index, name in enumerate(self.names):
            data[name] = np.asarray(values[index], np.float32)[places[index]]
            data["xy"[index]] = places[index]
        self.cells = ColumnDataSource(data)
        self.figure = self._figure(values, pooled_axes)
        select = CustomJS(args={"source": source, "cells": self.cells, "names": self.names}, code=script + SELECT_CELL)
        self.cells.selected.js_on_change("indices", select)

    def _figure(self, values: list[list[float]], pooled_axes: list[str]) -> figure:
        """Make the curve or the map.

        Args:
            values: Values of each of the one or two axes, ascending.
            pooled_axes: Names of the axes whose draws are counted together.
        """
        note = f", draws of all values of {', '.join(pooled_axes)} together" if pooled_axes else ""
        plot = figure(
            width=WIDTH,
            height=HEIGHT,
            tools="tap,hover,save",
            tooltips=[*((name, f"@{{{name}}}") for name in self.names), ("", "@statement")],
            title=f"failure probability{note}; a click brushes the draws of a point",
            x_axis_label=self.names[0],
            y_axis_label=self.names[1] if len(values) > 1 else "failure probability",
        )
        plot.toolbar.logo = None
        for axis, axis_values in zip((plot.xaxis, plot.yaxis), values, strict=False):  # a curve has values of x only
            step = math.ceil(len(axis_values) / MOST_LABELS)
            axis.ticker = FixedTicker(ticks=list(range(0, len(axis_values), step)))
            axis.major_label_overrides = {place: f"{value:.3g}" for place, value in enumerate(axis_values)}
        if len(values) == 1:
            plot.segment("x", "low", "x", "high", source=self.cells, color=GREY, line_width=2)
            plot.scatter("x", "probability", source=self.cells, color=BLUE, size=9)
            return plot
        mapper = LinearColorMapper(palette="Cividis256", low=0.0, high=1.0)
        colours = {"fill_color": transform("probability", mapper), "line_color": "white"}
        plot.rect("x", "y", 1.0, 1.0, source=self.cells, nonselection_fill_alpha=0.4, **colours)
        plot.add_layout(ColorBar(color_mapper=mapper, ticker=BasicTicker(desired_num_ticks=5)), "right")
        plot.grid.visible = False
        return plot
