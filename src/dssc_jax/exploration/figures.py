"""Figures of the pages in Bokeh: fans of signals with one draw, a vehicle's path, draws, and failure probability."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from bokeh.models import (
    ColumnDataSource,
    CustomJSTickFormatter,
    DataRange1d,
    FactorRange,
    LinearAxis,
    Model,
    PlainText,
    Range,
    Range1d,
    Title,
)
from bokeh.plotting import figure

from dssc_jax.exploration.live import LiveRun
from dssc_jax.plotting.style import BLUE, GREY, ORANGE, RED, drawable
from dssc_jax.results.schema import name_with_unit
from dssc_jax.runs.trajectory import column_attributes
from dssc_jax.study import Study

WIDTH = 440  # px
HEIGHT = 250  # px
LEVEL_NAMES = ("q5", "q25", "q50", "q75", "q95")
"""Columns of a fan's data source: the quantiles of :data:`dssc_jax.exploration.live.FAN_LEVELS`."""
TICK_TEXT = r"""
const largest = Math.max(...ticks.map(Math.abs))
const minus = text => text.replace("-", "\u2212")
if (largest === 0 || (largest >= 2e-3 && largest < 1e6)) return minus(String(Number(tick.toPrecision(10))))
if (tick === 0) return "0"
const power = Math.floor(Math.log10(largest) + 1e-9)
const raised = {"-": "\u207b", 1: "\u00b9", 2: "\u00b2", 3: "\u00b3"}
const digits = [...String(power)].map(c => raised[c] ?? String.fromCharCode(0x2070 + Number(c)))
return minus(String(Number((tick / 10 ** power).toPrecision(6)))) + "\u00b710" + digits.join("")
"""
"""JavaScript that formats a tick as a decimal number, or as 5·10⁻⁶ if the axis has small or large numbers."""
BANDS = (("q5", "q95", 0.18), ("q25", "q75", 0.35))
"""Lower and upper quantile of each band of a fan, and its opacity."""


def page_figure(tools: str, height: int = HEIGHT, **options: Any) -> figure:
    """Make an empty figure that fills its column and hides its tools until the pointer is over it.

    Args:
        tools: Names of Bokeh's tools, separated by commas.
        height: Height [px].
        options: Further options of the figure.
    """
    plot = figure(width=WIDTH, height=height, tools=tools, sizing_mode="stretch_width", **options)
    plot.toolbar.logo = None
    plot.toolbar.autohide = True
    for axis in plot.axis:
        if isinstance(axis, LinearAxis):
            axis.update(formatter=CustomJSTickFormatter(code=TICK_TEXT))
    return plot


def signal_figure(name: str, study: Study, **options: Any) -> figure:
    """Make an empty figure of a signal over time, whose title is the signal's meaning and unit.

    Args:
        name: Name of the signal.
        study: The study.
        options: Further options of the figure.
    """
    attributes = column_attributes(name, study)
    text = name_with_unit(attributes["long_name"], attributes["units"])
    title = Title(text=PlainText(text=text), text_font_style="normal")
    x_label = PlainText(text="time [s]")
    return page_figure("xpan,xwheel_zoom,box_zoom,reset,save", x_axis_label=x_label, title=title, **options)


def path_figure(across: str, upward: str) -> figure:
    """Make an empty figure of a path over two channels, with equal scales.

    Args:
        across: Channel of the horizontal axis.
        upward: Channel of the vertical axis.
    """
    return page_figure(
        "pan,wheel_zoom,reset,save",
        match_aspect=True,
        x_axis_label=PlainText(text=f"{across} [m]"),
        y_axis_label=PlainText(text=f"{upward} [m]"),
    )


class FanFigure:
    """A signal over time: the fan of all draws, the outline of the previous run's fan, and one draw.

    Args:
        study: The study, for the unit and the meaning of the signal.
        name: Name of the signal.
        x_range: Time axis of another figure that moves together with this one; None: a new time axis.
    """

    def __init__(self, study: Study, name: str, x_range: Range | None = None) -> None:
        """Make the figure, without a run.

        Args:
            study: The study, for the meaning and unit of the signal.
            name: Name of the signal.
            x_range: Range of the time axis that several figures share; None: a new one.
        """
        self.name = name
        self._outlined: LiveRun | None = None  # the run whose outline is shown
        self.current = ColumnDataSource()
        self.previous = ColumnDataSource()
        self.draw = ColumnDataSource()
        scale = DataRange1d()
        self.figure = signal_figure(
            name,
            study,
            active_drag="box_zoom",
            x_range=x_range or DataRange1d(range_padding=0.0),
            y_range=scale,
            output_backend="canvas",
        )
        fill_fan(self.previous, np.empty(0), np.empty((5, 0)))
        plot = self.figure
        fan: list[Model] = [
            plot.varea("t", low, high, source=self.current, fill_color=BLUE, fill_alpha=alpha)
            for low, high, alpha in BANDS
        ]
        fan.append(plot.line("t", "q50", source=self.current, color=BLUE, line_width=2))
        for level in ("q5", "q50", "q95"):
            dash = "solid" if level == "q50" else "dashed"
            plot.line("t", level, source=self.previous, color=GREY, line_width=1.5, line_dash=dash)
        plot.line("t", "value", source=self.draw, color=RED, line_width=1.5)
        scale.renderers = fan  # so that a draw that diverges does not set the scale

    def show(self, run: LiveRun, previous: LiveRun | None, draw: int) -> None:
        """Show a run.

        Args:
            run: The run.
            previous: A run to compare with; None: the outline stays as it is.
            draw: Index of the draw that is shown in red.
        """
        fill_fan(self.current, run.times, run.fan(self.name).values)
        if previous is not None and previous is not self._outlined:
            self._outlined = previous
            fill_fan(self.previous, previous.times, previous.fan(self.name).values)
        self.draw.data = {"t": run.times, "value": drawable(run.signal(self.name)[draw])}


def fill_fan(source: ColumnDataSource, times: np.ndarray, values: np.ndarray) -> None:
    """Fill a data source with the quantiles at the times at which a draw is still running.

    Args:
        source: The data source.
        times: Times [s], shape (samples,).
        values: Quantiles, shape (5, samples); NaN once no draw is running.
    """
    is_running = ~np.isnan(values[0])
    rows = drawable(values[:, is_running])
    source.data = {"t": times[is_running], **dict(zip(LEVEL_NAMES, rows, strict=True))}


class PathFigure:
    """The path of a vehicle in one draw over two channels, with the desired path."""

    def __init__(self, across: str, upward: str) -> None:
        """Make the figure over two channels, without a path."""
        self.channels = (across, upward)
        self.path = ColumnDataSource({"across": [], "upward": []})
        self.desired = ColumnDataSource({"across": [], "upward": []})
        self.figure = path_figure(across, upward)
        self.figure.line("across", "upward", source=self.desired, color=GREY, line_width=1.5, line_dash="dashed")
        self.figure.line("across", "upward", source=self.path, color=RED, line_width=2)

    def show_draw(self, run: LiveRun, draw: int) -> None:
        """Show the desired and the flown path of one draw of a run."""
        for source, signal in ((self.path, "y"), (self.desired, "y_ref")):
            across, upward = self.channels
            source.data = {
                "across": drawable(run.signal(f"{across}_{signal}")[draw]),
                "upward": drawable(run.signal(f"{upward}_{signal}")[draw]),
            }


class DrawsFigure:
    """The smallest slack of all draws over one uncertain number; a click selects a draw.

    Draws that pass are blue circles. Draws that fail are orange crosses.

    Args:
        choose: Called with the index of a draw that was clicked.
    """

    def __init__(self, choose: Callable[[int], None]) -> None:
        """Make the figure, without draws."""
        self.passed = ColumnDataSource()
        self.failed = ColumnDataSource()
        self.selected_draw = ColumnDataSource()
        self.number = PlainText(text="")
        self.figure = page_figure(
            "tap,pan,wheel_zoom,box_zoom,reset,save",
            active_drag="box_zoom",
            x_axis_label=self.number,
            y_axis_label=PlainText(text="smallest relative slack"),
            y_range=DataRange1d(),
        )
        for source, marker, colour, size in ((self.passed, "circle", BLUE, 5), (self.failed, "x", ORANGE, 7)):
            self.figure.scatter("x", "slack", source=source, marker=marker, color=colour, size=size, alpha=0.7)
            source.selected.on_change("indices", partial(self._clicked, source, choose))
        ring = {"size": 15, "line_color": RED, "line_width": 3, "fill_alpha": 0.0}
        self.figure.scatter("x", "slack", source=self.selected_draw, marker="circle", **ring)

    def show(self, run: LiveRun, name: str, draw: int) -> None:
        """Show the draws of a run, and mark one of them.

        Args:
            run: The run.
            name: Uncertain number of the horizontal axis; empty: the index of the draw.
            draw: Index of the marked draw.
        """
        values = run.values[name] if name else np.arange(run.failed.size)
        self.number.text = name or "draw"
        is_finite = np.isfinite(run.slack)  # that of a draw that ended early is -inf
        lowest = run.slack[is_finite].min() if is_finite.any() else -1.0
        slack = np.where(is_finite, run.slack, lowest)
        for source, is_shown in ((self.passed, ~run.failed), (self.failed, run.failed)):
            source.selected.indices = []
            draws = np.flatnonzero(is_shown)
            source.data = {"x": values[draws], "slack": slack[draws], "draw": draws}
        self.selected_draw.data = {"x": values[[draw]], "slack": slack[[draw]]}

    @staticmethod
    def _clicked(
        source: ColumnDataSource, choose: Callable[[int], None], attr: str, old: list[int], new: list[int]
    ) -> None:
        """Select the draw of a mark that was clicked.

        Args:
            source: Data source of the mark.
            choose: Called with the index of the draw.
            attr: Name of the changed property; this argument and the next two are those of Bokeh's callbacks.
            old: Indices of the marks that were selected before.
            new: Indices of the marks that are selected now; empty if none is.
        """
        if new:
            choose(int(np.asarray(source.data["draw"])[new[0]]))


class ProbabilityFigure:
    """The failure probability with its interval, of the present run and of the previous one."""

    def __init__(self) -> None:
        """Make the figure, without a run."""
        self.source = ColumnDataSource({"name": [], "p": [], "low": [], "high": [], "colour": []})
        self.figure = page_figure(
            "",
            height=110,
            x_range=Range1d(start=0.0, end=1.0),
            y_range=FactorRange(factors=["now", "before"]),
            x_axis_label=PlainText(text="failure probability, 95 % interval"),
        )
        self.figure.hbar(
            "name", left="low", right="high", height=0.5, source=self.source, color="colour", fill_alpha=0.35
        )
        self.figure.scatter("p", "name", source=self.source, size=11, color="colour", marker="diamond")
        self.figure.toolbar_location = None

    def show(self, run: LiveRun, previous: LiveRun | None) -> None:
        """Show a run beside the previous run.

        Args:
            run: The run.
            previous: The previous run; None: there is none.
        """
        runs = {"now": run}
        colours = [BLUE]
        if previous is not None:
            runs["before"] = previous
            colours.append(GREY)
        self.source.data = {
            "name": list(runs),
            "p": [live_run.probability for live_run in runs.values()],
            "low": [live_run.interval[0] for live_run in runs.values()],
            "high": [live_run.interval[1] for live_run in runs.values()],
            "colour": colours,
        }


def path_views(study: Study) -> Sequence[tuple[str, str]]:
    """Return the two channels of each view of a vehicle's path, from above and from the side.

    A study without the channels x, y and z has no view.
    """
    has_path = {"x", "y", "z"} <= set(study.loop.channels)
    return (("x", "y"), ("x", "z")) if has_path else ()


def displayed_signals(study: Study) -> Sequence[str]:
    """Return the signals that a page shows: output, error and command of a single channel, or all errors of several."""
    if len(study.loop.channels) == 1:
        return ("y", "e", "u_total")
    return tuple(f"{channel}_e" for channel in study.loop.channels)
