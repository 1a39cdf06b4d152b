"""Parallel axes with a line for each draw, painted by a script in the browser; a box over the axes brushes draws."""

from typing import Any

import numpy as np
from bokeh.events import SelectionGeometry
from bokeh.models import BoxSelectTool, ColumnDataSource, CustomJS, FixedTicker, PlainText, Range1d
from bokeh.plotting import figure

from dssc_jax.exploration.draw_table import DrawTable
from dssc_jax.plotting.style import GREY

MOST_AXES = 8
"""Largest number of axes."""
LONGEST_LABEL = 18
"""Largest number of characters in a line of the label below an axis."""
MOST_LINES = 2000
"""Largest number of lines that are painted of the brushed draws, and of all draws."""
LINE_OPACITY = 0.7
"""Opacity of a line among few lines; it is less among many."""
LINE_PICTURE = 240, 1000
"""Rows and columns of the painted lines [px]."""
WIDTH = 1240  # px
HEIGHT = 320  # px
LEFT = 0.3  # space before the first axis, relative to the distance between axes
RIGHT = 0.3  # space after the last axis, likewise
MARGIN = 0.14  # space above and below the axes, relative to their length
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
        """Choose the columns that get an axis, and make the figure.

        The page paints the lines as soon as it has its layout.
        """
        self.names = parallel_columns(table)
        ends = [finite_ends(table.columns[name]) for name in self.names]
        width = len(self.names) - 1 + LEFT + RIGHT
        height = 1.0 + 2.0 * MARGIN
        frame = {"x": [-LEFT], "y": [-MARGIN], "dw": [width], "dh": [height]}
        self.picture = ColumnDataSource({"image": [np.zeros(LINE_PICTURE, np.uint32)], **frame})
        self.figure = self._figure(table, ends, width, height)
        lows = [low for low, _ in ends]
        highs = [high for _, high in ends]
        self.script = script
        self.script_arguments = {"source": source, "names": self.names, "lows": lows, "highs": highs}
        place = {"left": LEFT, "across": width, "margin": MARGIN, "most": MOST_LINES, "thinnest": LINE_OPACITY}
        paint = {**self.script_arguments, "picture": self.picture, "place": place, "colours": colours}
        self.paint = CustomJS(args=paint, code=script + PAINT_LINES)
        self.figure.js_on_change("inner_width", self.paint)  # once the page has its layout

    def brush(self, show: CustomJS) -> None:
        """Let a box over the axes brush draws; the callback ``show`` then shows them on the whole page."""
        select = CustomJS(args={**self.script_arguments, "show": show}, code=self.script + SELECT_BETWEEN)
        self.figure.js_on_event(SelectionGeometry, select)

    def _figure(self, table: DrawTable, ends: list[tuple[float, float]], width: float, height: float) -> figure:
        """Make the axes, with their names and the values at their ends.

        Args:
            table: The draws.
            ends: Smallest and largest value of each axis.
            width: Width of the picture, in distances between axes.
            height: Height of the picture, in lengths of an axis.
        """
        plot = figure(
            width=WIDTH,
            height=HEIGHT,
            tools="save",
            x_range=Range1d(start=-LEFT, end=width - LEFT),
            y_range=Range1d(start=-MARGIN, end=height - MARGIN),
        )
        box = BoxSelectTool(continuous=True, renderers=[])
        plot.add_tools(box)
        plot.toolbar.active_drag = box
        plot.toolbar.logo = None
        plot.image_rgba("image", "x", "y", "dw", "dh", source=self.picture, level="image")
        places = list(range(len(self.names)))
        plot.segment(places, 0.0, places, 1.0, color=GREY, line_width=1.5)
        style: dict[str, Any] = {"text_font_size": "12px", "text_align": "center"}
        lows = [f"{low:.4g}" for low, _ in ends]
        highs = [f"{high:.4g}" for _, high in ends]
        plot.text(places, 0.0, lows, y_offset=3, text_baseline="top", **style)
        plot.text(places, 1.0, highs, y_offset=-3, text_baseline="bottom", **style)
        labels = {}
        for place, name in enumerate(self.names):
            labels[place] = PlainText(text=fitting_label(table.label(name)))
        plot.xaxis.ticker = FixedTicker(ticks=places)
        plot.xaxis.major_label_overrides = labels
        plot.xaxis.major_label_text_font_size = "13px"
        plot.yaxis.visible = False
        plot.grid.visible = False
        return plot


def fitting_label(label: str) -> str:
    """Break a label into lines that fit below an axis, with the unit in the last line.

    A dotted name that is too long loses its first parts. An index keeps the part before it: ``inertia.0``.

    Args:
        label: Name of a column, and its unit after a space.
    """
    name, _, unit = label.partition(" ")
    while len(name) > LONGEST_LABEL and "." in name:
        shorter_name = name.partition(".")[2]
        if shorter_name.isdecimal():
            break
        name = shorter_name
    lines = []
    while len(name) > LONGEST_LABEL and "_" in name[:LONGEST_LABEL]:
        end = name.rindex("_", 0, LONGEST_LABEL) + 1
        lines.append(name[:end])
        name = name[end:]
    lines.append(name)
    if unit:
        lines.append(unit)
    return "\n".join(lines)


def parallel_columns(table: DrawTable) -> list[str]:
    """Return the columns with an axis: swept and drawn numbers, then metrics, with the headline metric last.

    If there are more than :data:`MOST_AXES` columns, the last ones before the headline metric are left out.
    """
    number, metric = table.first_axes
    middle = [name for name in table.columns if name not in (number, metric)]
    return [*dict.fromkeys((number, *middle[: MOST_AXES - 2], metric))]


def finite_ends(values: np.ndarray) -> tuple[float, float]:
    """Return the smallest and the largest finite value, as the ends of an axis.

    If both are equal, the ends lie 0.5 below and above them. Without finite values the ends are -0.5 and 0.5.
    """
    finite = values[np.isfinite(values)]
    if not finite.size:
        return -0.5, 0.5
    low = float(finite.min())
    high = float(finite.max())
    return (low, high) if low < high else (low - 0.5, low + 0.5)
