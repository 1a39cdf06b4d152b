"""Linked brushing over the draws of a result, in Bokeh: what a brush does happens in the browser, without a program."""

from pathlib import Path

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
BINS = 40
TABLE_WIDTH = 1240  # px
PICTURE = 500, 640  # rows and columns of the painted scatter
FEW = 5000  # draws whose marks may be large
LOOKS = {"bright": 0.85, "dim": 0.12}
"""Opacity of the brushed draws, or of all where none is brushed, and of the others."""
AXIS_NAMES = ("x", "y")
CHANGE_AXIS = """
const values = source.data[select.value]
source.data[axis] = values
const edges = edgesOf(values, 40)
bars.data = {left: edges.slice(0, -1), right: edges.slice(1), all: histogram(values, edges, values.keys()),
  brushed: new Array(40).fill(0), failed: new Array(40).fill(0)}
for (const shown of shown_axes) shown.axis_label = names[select.value]
everything.execute(source)
brush.execute(source)
"""
PAINT = "paintDraws(source, picture, ranges, reach, colours)"
SELECT = "choose(source, show, enclosed(source, cb_obj.geometry), cb_obj.final)"
CHOOSE = "source.selected.indices = nearestDraw(source, ranges, picture.data.image[0], cb_obj.x, cb_obj.y)"
SHOW_ALL = """
for (const axis of ["x", "y"]) {
  const [start, end] = extentOf(source.data[axis])
  ranges[axis].setv({start: start, end: end})
}
paint.execute(source)
"""
BRUSH = """
const indices = chosenDraws(source), failed = source.data.failed
const whole = indices.length == 0, chosen = whole ? failed.keys() : indices
const draws = whole ? failed.length : indices.length
const failures = counted(failed, whole ? [...chosen] : chosen)
say(describe(failures, draws, exactInterval(failures, draws, level), whole) + note, source, said)
for (const [axis, bars] of [["x", x_bars], ["y", y_bars]]) {
  const values = source.data[axis]
  const edges = [...bars.data.left, bars.data.right[bars.data.right.length - 1]]
  bars.data.brushed = histogram(values, edges, indices)
  bars.data.failed = histogram(values, edges, (whole ? [...failed.keys()] : indices).filter(i => failed[i]))
  bars.change.emit()
}
"""
SHOW = "for (const part of parts) part.execute(source)"
SELECTED = "globalThis.brushing.drawn.delete(source); show.execute(source)"
CLICK = """
const indices = source.selected.indices
if (indices.length == 1) {
  const i = indices[0]
  const at = axes.map(name => ` --at ${name}=${source.data[name][i]}`).join("")
  const outcome = source.data.failed[i] ? "fails" : "passes"
  command.text = `draw ${source.data.draw[i]} ${outcome}: ${start}${source.data.draw[i]}${at}`
  picked.data = {row: [i]}
}
"""


class Brushing:
    """Scatter, two histograms, parallel axes, and the counts of the brushed draws.

    Args:
        table: The draws.
        folder: The results folder, for the command that replays a clicked draw.

    The source ``picked`` holds the row that was clicked last, for a program behind the page.
    """

    def __init__(self, table: DrawTable, folder: str) -> None:
        self.table = table
        self.names = list(table.columns)
        shown = dict(zip(AXIS_NAMES, table.first_axes, strict=True))
        columns = {name: values.astype(np.float32) for name, values in table.columns.items()}
        self.source = ColumnDataSource(
            {
                **columns,
                **{axis: columns[name] for axis, name in shown.items()},
                "failed": table.failed.astype(np.uint8),
                "draw": table.draw.astype(np.int32),
            },
            name="draws",
        )
        self.picked = ColumnDataSource({"row": []})
        self.said = Div(text="", disable_math=True, width=TABLE_WIDTH, styles={"font-size": "18px"})
        self.command = Div(text="a click on a draw gives its command", disable_math=True, width=TABLE_WIDTH)
        self.picture = ColumnDataSource(
            {"image": [np.zeros(PICTURE, np.uint32)], **{name: [0.0] for name in ("x", "y", "dw", "dh")}}
        )
        self.bars = {axis: ColumnDataSource({**self._histogram(shown[axis])}) for axis in AXIS_NAMES}
        self.labels = {axis: table.label(name) for axis, name in shown.items()}
        self.selects = {
            axis: Select(title=f"{axis} axis", value=name, options=[*self.names], width=300)
            for axis, name in shown.items()
        }
        colours = {name: [pixel(colour, alpha) for colour in (BLUE, ORANGE)] for name, alpha in LOOKS.items()}
        self.parallel = ParallelAxes(table, self.source, SCRIPT, colours)
        self.map = CellMap(table, self.source, SCRIPT) if table.result.study.axes else None
        self.scatter = self._scatter()
        self.histograms = {axis: self._bar_figure(axis) for axis in AXIS_NAMES}
        self._connect(folder, colours)
        self.said.text = self.statement()

    @property
    def layout(self) -> LayoutDOM:
        """The page's content."""
        figures = row(self.scatter, column(*self.histograms.values()))
        maps = [self.map.figure] if self.map is not None else []
        return column(self.said, *maps, row(*self.selects.values()), figures, self.command, self.parallel.figure)

    @property
    def note(self) -> str:
        """What the page leaves out."""
        table = self.table
        return "" if table.complete else f"; {len(table.rows):,} of {table.total:,} draws are shown"

    def statement(self) -> str:
        """Failures of all draws with their interval, as the page says it before anything is brushed."""
        failures, draws = int(self.table.failed.sum()), len(self.table.failed)
        interval = FixedCount().interval(self.table.failed, CONFIDENCE)
        probability, low, high = map(rounded_probability, (failures / draws, *interval))
        interval = f"in [{low}, {high}] (95 % Clopper-Pearson)"
        return f"all {draws:,} draws, {failures:,} fail: probability {probability} {interval}{self.note}"

    def _scatter(self) -> figure:
        """All draws over two columns, painted by the page's script."""
        plot = figure(
            width=720,
            height=560,
            tools="pan,wheel_zoom,reset,save",
            x_range=Range1d(),
            y_range=Range1d(),
            x_axis_label=self.labels["x"],
            y_axis_label=self.labels["y"],
        )
        box = BoxSelectTool(continuous=True, renderers=[])
        plot.add_tools(box, LassoSelectTool(continuous=False, renderers=[]))
        plot.toolbar.active_drag = box
        plot.toolbar.logo = None
        plot.image_rgba("image", "x", "y", "dw", "dh", source=self.picture, level="glyph")
        return plot

    def _bar_figure(self, axis: str) -> figure:
        """The histogram of an axis: all, brushed, and failures among the brushed."""
        plot = figure(width=500, height=270, tools="", x_axis_label=self.labels[axis], y_axis_label="draws")
        looks = (("all", GREY, 0.3), ("brushed", BLUE, 0.6), ("failed", ORANGE, 0.9))
        for name, colour, alpha in looks:
            plot.quad(
                "left", "right", name, 0, source=self.bars[axis], fill_color=colour, fill_alpha=alpha, line_color=None
            )
        plot.toolbar_location = None
        return plot

    def _histogram(self, name: str) -> dict[str, np.ndarray]:
        """The histogram of a column before anything is brushed."""
        values = self.table.columns[name]
        finite = np.isfinite(values)
        counts, edges = np.histogram(values[finite], BINS)
        failed = np.histogram(values[finite & self.table.failed], edges)[0]
        return {"left": edges[:-1], "right": edges[1:], "all": counts, "brushed": np.zeros(BINS), "failed": failed}

    def _connect(self, folder: str, colours: dict[str, list[int]]) -> None:
        """Let brushes, clicks and choices of axes act."""
        start, axes = self.table.replay_commands(folder)
        brush = CustomJS(
            args={
                "source": self.source,
                "said": self.said,
                "x_bars": self.bars["x"],
                "y_bars": self.bars["y"],
                "level": CONFIDENCE,
                "note": self.note,
            },
            code=SCRIPT + BRUSH,
        )
        click = CustomJS(
            args={
                "source": self.source,
                "command": self.command,
                "picked": self.picked,
                "start": start,
                "axes": axes,
            },
            code=CLICK,
        )
        ranges = {"x": self.scatter.x_range, "y": self.scatter.y_range}
        drawn = {"source": self.source, "picture": self.picture, "ranges": ranges}
        reach = 3 if len(self.table.failed) < FEW else 1
        paint = CustomJS(args={**drawn, "reach": reach, "colours": colours}, code=SCRIPT + PAINT)
        everything = CustomJS(args={**drawn, "paint": paint}, code=SCRIPT + SHOW_ALL)
        parts = [paint, brush, self.parallel.paint]
        show = CustomJS(args={"source": self.source, "parts": parts}, code=SHOW)
        selected = CustomJS(args={"source": self.source, "show": show}, code=SCRIPT + SELECTED)
        self.source.selected.js_on_change("indices", selected, click)
        self.scatter.js_on_event(SelectionGeometry, CustomJS(args={**drawn, "show": show}, code=SCRIPT + SELECT))
        self.parallel.brush(show)
        self.scatter.js_on_event(Tap, CustomJS(args=drawn, code=SCRIPT + CHOOSE))
        self.scatter.js_on_event(Reset, everything)
        for shown in ranges.values():
            shown.js_on_change("start", paint)
            shown.js_on_change("end", paint)
        self.scatter.js_on_change("inner_width", everything)  # when the page is laid out first
        names = {name: self.table.label(name) for name in self.names}
        for axis in AXIS_NAMES:
            args = {
                "source": self.source,
                "select": self.selects[axis],
                "axis": axis,
                "bars": self.bars[axis],
                "shown_axes": [getattr(self.scatter, f"{axis}axis")[0], self.histograms[axis].xaxis[0]],
                "names": names,
                "brush": brush,
                "everything": everything,
            }
            self.selects[axis].js_on_change("value", CustomJS(args=args, code=SCRIPT + CHANGE_AXIS))


def pixel(colour: str, alpha: float) -> int:
    """A colour such as ``#0072B2`` with an opacity, as a pixel of a picture (the bytes red, green, blue, opacity)."""
    red, green, blue = bytes.fromhex(colour[1:])
    return int.from_bytes(bytes((red, green, blue, round(255 * alpha))), "little")
