"""Linked figures over the draws of a result in Bokeh; a script in the browser brushes draws in all of them."""

from pathlib import Path
from typing import Any

import numpy as np
from bokeh.events import Reset, SelectionGeometry, Tap
from bokeh.layouts import column, row
from bokeh.models import (
    BoxSelectTool,
    ColumnDataSource,
    CustomJS,
    Div,
    LassoSelectTool,
    LayoutDOM,
    Model,
    Range1d,
    Select,
)
from bokeh.plotting import figure

from dssc_jax.core import files
from dssc_jax.exploration.cell_map import CellMap
from dssc_jax.exploration.draw_table import DrawTable
from dssc_jax.exploration.parallel import ParallelAxes
from dssc_jax.plotting.style import BLUE, GREY, ORANGE
from dssc_jax.statistics import CONFIDENCE, FixedCount, rounded_probability

SCRIPT = files.read_text(Path(__file__).with_name("brush.js"))
"""JavaScript of all functions that callbacks in the browser call."""
BINS = 40
"""Number of bars of a histogram; the script uses the same number."""
TABLE_WIDTH = 1240  # px
PICTURE = 500, 640
"""Rows and columns of the scatter, which the script paints [px]."""
LARGE_MARK_DRAWS = 5000
"""Number of draws below which marks are large."""
OPACITIES = {"bright": 0.85, "dim": 0.12}
"""Opacity of the brushed draws, or of all draws if none is brushed, and of the others."""
AXIS_NAMES = ("x", "y")
"""Axes of the scatter; there is a histogram for each."""


def draw_source(table: DrawTable) -> ColumnDataSource:
    """Make the data source of the draws, with one row for each draw.

    Its columns are the numbers and metrics of the table, whether a draw failed, the draw's index, and the two axes of
    the scatter.
    """
    columns = {name: values.astype(np.float32) for name, values in table.columns.items()}
    data = {**columns, "failed": table.failed.astype(np.uint8), "draw": table.draw.astype(np.int32)}
    for axis, name in zip(AXIS_NAMES, table.first_axes, strict=True):
        data[axis] = columns[name]
    return ColumnDataSource(data, name="draws")


class Brushing:
    """Scatter, two histograms, parallel axes and the counts of the brushed draws.

    The data source ``clicked_row`` holds the row of the latest click, for a program behind the page.

    Args:
        table: The draws.
        folder: The results folder, for the command that replays a clicked draw.
    """

    def __init__(self, table: DrawTable, folder: str) -> None:
        """Fill the data sources, and make all figures and widgets; no draw is brushed yet."""
        self.table = table
        axis_columns: dict[str, str] = dict(zip(AXIS_NAMES, table.first_axes, strict=True))
        self.source = draw_source(table)
        self.clicked_row = ColumnDataSource({"row": []})
        self.summary = Div(text=self.statement(), disable_math=True, width=TABLE_WIDTH, styles={"font-size": "18px"})
        self.command = Div(text="a click on a draw gives its command", disable_math=True, width=TABLE_WIDTH)
        frame = {name: [0.0] for name in ("x", "y", "dw", "dh")}
        self.picture = ColumnDataSource({"image": [np.zeros(PICTURE, np.uint32)], **frame})
        self.bars = {axis: ColumnDataSource(self._histogram(name)) for axis, name in axis_columns.items()}
        self.selects: dict[str, Select] = {}
        for axis, name in axis_columns.items():
            self.selects[axis] = Select(title=f"{axis} axis", value=name, options=list(table.columns), width=300)
        self.colours: dict[str, list[int]] = {}
        for name, alpha in OPACITIES.items():
            self.colours[name] = [pixel(BLUE, alpha), pixel(ORANGE, alpha)]
        self.parallel = ParallelAxes(table, self.source, SCRIPT, self.colours)
        self.map = CellMap(table, self.source, SCRIPT) if table.result.study.axes else None
        labels = [table.label(name) for name in axis_columns.values()]
        self.scatter = self._scatter(*labels)
        self.histograms = [self._bar_figure(axis, label) for axis, label in zip(AXIS_NAMES, labels, strict=True)]
        self._connect(folder)

    @property
    def layout(self) -> LayoutDOM:
        """All figures and widgets, arranged for a page."""
        figures = row(self.scatter, column(*self.histograms))
        maps = [self.map.figure] if self.map is not None else []
        return column(self.summary, *maps, row(*self.selects.values()), figures, self.command, self.parallel.figure)

    @property
    def note(self) -> str:
        """A remark on the draws that the page leaves out; empty if it leaves out none."""
        table = self.table
        return "" if table.complete else f"; {len(table.rows):,} of {table.total:,} draws are shown"

    def statement(self) -> str:
        """Tell how many of all draws fail, with the interval of the probability; shown until draws are brushed."""
        failures = int(self.table.failed.sum())
        draws = len(self.table.failed)
        interval = FixedCount().interval(self.table.failed, CONFIDENCE)
        probability, low, high = map(rounded_probability, (failures / draws, *interval))
        counts = f"all {draws:,} draws, {failures:,} fail"
        return f"{counts}: probability {probability} in [{low}, {high}] (95 % Clopper-Pearson){self.note}"

    def _scatter(self, x_label: str, y_label: str) -> figure:
        """Make the figure of all draws over two columns, which the script paints as a picture.

        Args:
            x_label: Label of the horizontal axis.
            y_label: Label of the vertical axis.
        """
        plot = figure(
            width=720,
            height=560,
            tools="pan,wheel_zoom,reset,save",
            x_range=Range1d(),
            y_range=Range1d(),
            x_axis_label=x_label,
            y_axis_label=y_label,
        )
        box = BoxSelectTool(continuous=True, renderers=[])
        plot.add_tools(box, LassoSelectTool(continuous=False, renderers=[]))
        plot.toolbar.active_drag = box
        plot.toolbar.logo = None
        plot.image_rgba("image", "x", "y", "dw", "dh", source=self.picture, level="glyph")
        return plot

    def _bar_figure(self, axis: str, label: str) -> figure:
        """Make the histogram of an axis: all draws, brushed draws, and failures among the brushed draws.

        Args:
            axis: The axis, x or y.
            label: Name and unit of the values on the axis.
        """
        plot = figure(width=500, height=270, tools="", x_axis_label=label, y_axis_label="draws")
        bars = self.bars[axis]
        for name, colour, alpha in (("all", GREY, 0.3), ("brushed", BLUE, 0.6), ("failed", ORANGE, 0.9)):
            plot.quad("left", "right", name, 0, source=bars, fill_color=colour, fill_alpha=alpha, line_color=None)
        plot.toolbar_location = None
        return plot

    def _histogram(self, name: str) -> dict[str, Any]:
        """Count the values of a column of the table in bins.

        The histogram shows these counts as long as no draw is brushed.
        """
        values = self.table.columns[name]
        finite = np.isfinite(values)
        counts, edges = np.histogram(values[finite], BINS)
        failed, _ = np.histogram(values[finite & self.table.failed], edges)
        return {"left": edges[:-1], "right": edges[1:], "all": counts, "brushed": np.zeros(BINS), "failed": failed}

    def _callback(self, call: str, **models: object) -> CustomJS:
        """Return a callback that calls a function of the script.

        Args:
            call: The call in JavaScript, in which the draws are ``source``.
            models: Further objects by their names in the call.
        """
        return CustomJS(args={"source": self.source, **models}, code=SCRIPT + call)

    def _connect(self, folder: str) -> None:
        """Let brushes, clicks and selected axes call the functions of the script.

        Args:
            folder: The results folder, for the command that replays a clicked draw.
        """
        start, axes = self.table.replay_commands(folder)
        scatter: dict[str, object] = {
            "picture": self.picture,
            "ranges": {"x": self.scatter.x_range, "y": self.scatter.y_range},
        }
        paint = self._callback(
            "paintDraws(source, picture, ranges, reach, colours)",
            **scatter,
            reach=3 if len(self.table.failed) < LARGE_MARK_DRAWS else 1,
            colours=self.colours,
        )
        count = self._callback(
            "countBrushed(source, summary, bars, level, note)",
            summary=self.summary,
            bars=self.bars,
            level=CONFIDENCE,
            note=self.note,
        )
        show_all = self._callback("showAll(source, ranges, paint)", **scatter, paint=paint)
        callbacks = [paint, count, self.parallel.paint]
        show = CustomJS(
            args={"source": self.source, "callbacks": callbacks},
            code="for (const callback of callbacks) callback.execute(source)",
        )
        on_selection = self._callback("globalThis.brushing.drawn.delete(source); show.execute(source)", show=show)
        on_click = self._callback(
            "showClicked(source, command, picked, start, axes)",
            command=self.command,
            picked=self.clicked_row,
            start=start,
            axes=axes,
        )
        self.source.selected.js_on_change("indices", on_selection, on_click)
        self.parallel.brush(show)
        select_enclosed = "choose(source, show, enclosed(source, cb_obj.geometry), cb_obj.final)"
        self.scatter.js_on_event(SelectionGeometry, self._callback(select_enclosed, show=show))
        nearest = "nearestDraw(source, ranges, picture.data.image[0], cb_obj.x, cb_obj.y)"
        self.scatter.js_on_event(Tap, self._callback(f"source.selected.indices = {nearest}", **scatter))
        self.scatter.js_on_event(Reset, show_all)
        self.scatter.js_on_change("inner_width", show_all)  # once the page has its layout
        for axis_range in (self.scatter.x_range, self.scatter.y_range):
            axis_range.js_on_change("start", paint)
            axis_range.js_on_change("end", paint)
        self._connect_selects(show_all, count)

    def _connect_selects(self, show_all: CustomJS, count: CustomJS) -> None:
        """Let the selection of a column change an axis of the scatter and the histogram of this axis.

        Args:
            show_all: Callback that shows all draws in the scatter.
            count: Callback that counts the brushed draws.
        """
        labels = {name: self.table.label(name) for name in self.table.columns}
        labelled_axes: dict[str, list[Model]] = {
            "x": [self.scatter.xaxis[0], self.histograms[0].xaxis[0]],
            "y": [self.scatter.yaxis[0], self.histograms[1].xaxis[0]],
        }
        for axis in AXIS_NAMES:
            change = self._callback(
                "changeAxis(source, axis, cb_obj.value, labels[cb_obj.value], bars, labelled)\n"
                "show_all.execute(source)\ncount.execute(source)",
                axis=axis,
                labels=labels,
                bars=self.bars[axis],
                labelled=labelled_axes[axis],
                show_all=show_all,
                count=count,
            )
            self.selects[axis].js_on_change("value", change)


def pixel(colour: str, alpha: float) -> int:
    """Convert a colour and an opacity to a pixel: four bytes red, green, blue, opacity, the lowest first.

    Args:
        colour: The colour, such as ``#0072B2``.
        alpha: The opacity, from 0 to 1.
    """
    red, green, blue = bytes.fromhex(colour[1:])
    return int.from_bytes(bytes((red, green, blue, round(255 * alpha))), "little")
