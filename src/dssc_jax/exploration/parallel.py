"""Parallel axes with a line for each draw, which the script of the page paints; a box over the axes brushes draws."""

import numpy as np
from bokeh.events import SelectionGeometry
from bokeh.models import BoxSelectTool, ColumnDataSource, CustomJS, FixedTicker, PlainText, Range1d
from bokeh.plotting import figure

from dssc_jax.exploration.draw_table import DrawTable
from dssc_jax.plotting.style import GREY

MOST_AXES = 8
LONGEST_LABEL = 18
"""Largest number of characters in a line below an axis."""
MOST_LINES = 2000
"""Largest number of lines of the brushed draws, and of all draws."""
LINE_OPACITY = 0.7
"""Opacity of a line among few lines; it is less among many."""
LINE_PICTURE = 240, 1000
"""Rows and columns of the painted lines [px]."""
WIDTH = 1240  # px
HEIGHT = 320
LEFT = 0.3  # space beside the axes, relative to their distance
RIGHT = 0.3
MARGIN = 0.14  # space above the axes, relative to their length
PAINT_LINES = "whenCalm(() => paintLines(source, picture, names, lows, highs, place, colours))"
SELECT_BETWEEN = "choose(source, show, betweenAxes(source, names, lows, highs, cb_obj.geometry), cb_obj.final)"


class ParallelAxes:
    """Uncertain numbers and metrics side by side, with a line through the values of each draw.

    Args:
        table: The draws.
        source: Data source of the page with the draws.
        script: The script with the functions that callbacks call.
        colours: Pixels of draws that pass and that fail, bright and dim.
    """

    def __init__(self, table: DrawTable, source: ColumnDataSource, script: str, colours: dict[str, list[int]]) -> None:
        self.names = parallel_columns(table)
        ends = [finite_ends(table.columns[name]) for name in self.names]
        span = len(self.names) - 1 + LEFT + RIGHT, 1.0 + 2.0 * MARGIN
        frame = {"x": [-LEFT], "y": [-MARGIN], "dw": [span[0]], "dh": [span[1]]}
        self.picture = ColumnDataSource({"image": [np.zeros(LINE_PICTURE, np.uint32)], **frame})
        self.figure = self._figure(table, ends, span)
        lows, highs = (list(side) for side in zip(*ends, strict=True))
        self.script = script
        self.script_arguments = {"source": source, "names": self.names, "lows": lows, "highs": highs}
        place = {"left": LEFT, "across": span[0], "margin": MARGIN, "most": MOST_LINES, "thinnest": LINE_OPACITY}
        paint = {**self.script_arguments, "picture": self.picture, "place": place, "colours": colours}
        self.paint = CustomJS(args=paint, code=script + PAINT_LINES)
        self.figure.js_on_change("inner_width", self.paint)  # when the page is laid out first

    def brush(self, show: CustomJS) -> None:
        """Let a box over the axes brush draws, which the callback ``show`` then shows on the page."""
        select = CustomJS(args={**self.script_arguments, "show": show}, code=self.script + SELECT_BETWEEN)
        self.figure.js_on_event(SelectionGeometry, select)

    def _figure(self, table: DrawTable, ends: list[tuple[float, float]], span: tuple[float, float]) -> figure:
        """The axes with their names and ends.

        Args:
            table: The draws.
            ends: Smallest and largest value of each axis.
            span: Width and height of the picture, in distances and lengths of the axes.
        """
        plot = figure(
            width=WIDTH,
            height=HEIGHT,
            tools="save",
            x_range=Range1d(start=-LEFT, end=span[0] - LEFT),
            y_range=Range1d(start=-MARGIN, end=span[1] - MARGIN),
        )
        box = BoxSelectTool(continuous=True, renderers=[])
        plot.add_tools(box)
        plot.toolbar.active_drag = box
        plot.toolbar.logo = None
        plot.image_rgba("image", "x", "y", "dw", "dh", source=self.picture, level="image")
        places = list(range(len(self.names)))
        plot.segment(places, 0.0, places, 1.0, color=GREY, line_width=1.5)
        for height, side, baseline, up in ((0.0, 0, "top", 3), (1.0, 1, "bottom", -3)):
            text = [f"{end[side]:.4g}" for end in ends]
            position = {"y_offset": up, "text_align": "center", "text_baseline": baseline}
            plot.text(places, height, text, text_font_size="12px", **position)
        plot.xaxis.ticker = FixedTicker(ticks=places)
        plot.xaxis.major_label_overrides = {
            place: PlainText(text=fitting_label(table.label(name))) for place, name in enumerate(self.names)
        }
        plot.xaxis.major_label_text_font_size = "13px"
        plot.yaxis.visible = plot.grid.visible = False
        return plot


def fitting_label(label: str) -> str:
    """Break a label into lines that fit below an axis, with the unit in the last line.

    A long dotted name loses its first parts, but an index keeps the part before it: ``inertia.0``.
    """
    name, _, unit = label.partition(" ")
    while len(name) > LONGEST_LABEL and "." in name and not name.partition(".")[2].isdecimal():
        name = name.partition(".")[2]
    lines = []
    while len(name) > LONGEST_LABEL and "_" in name[:LONGEST_LABEL]:
        end = name.rindex("_", 0, LONGEST_LABEL) + 1
        lines.append(name[:end])
        name = name[end:]
    return "\n".join([*lines, name, *([unit] if unit else [])])


def parallel_columns(table: DrawTable) -> list[str]:
    """Names of the columns with an axis: swept and drawn numbers, then metrics, with the headline metric last."""
    number, metric = table.first_axes
    middle = [name for name in table.columns if name not in (number, metric)]
    return [*dict.fromkeys((number, *middle[: MOST_AXES - 2], metric))]


def finite_ends(values: np.ndarray) -> tuple[float, float]:
    """The smallest and the largest finite value; an interval of length 1 around them if they are equal."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return -0.5, 0.5
    low = float(finite.min())
    high = float(finite.max())
    return (low, high) if low < high else (low - 0.5, low + 0.5)
