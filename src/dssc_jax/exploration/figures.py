"""Figures of a live run in Bokeh: fans of signals, one draw in them, and a vehicle's path."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from bokeh.models import ColumnDataSource, DataRange1d, FactorRange, Model, PlainText, Range, Range1d, Title
from bokeh.plotting import figure

from dssc_jax.exploration.live import LiveRun
from dssc_jax.plotting.style import BLUE, DRAWABLE, GREY, ORANGE, RED
from dssc_jax.runs.trajectory import column_attributes
from dssc_jax.study import Study

WIDTH, HEIGHT = 440, 250  # px
BANDS = (("q5", "q95", 0.18), ("q25", "q75", 0.35))
NOW, BEFORE, DRAW = "now", "before", "draw"


class FanFigure:
    """One signal over time: the fan of all draws now, the outline of the fan before, and one draw.

    Args:
        study: The study, for unit and meaning.
        name: The signal.
        x_range: The time axis of another figure, to move together with it.
    """

    def __init__(self, study: Study, name: str, x_range: Range | None = None) -> None:
        self.name = name
        self._outlined: LiveRun | None = None
        about = column_attributes(name, study)
        self.now, self.before, self.draw = ColumnDataSource(), ColumnDataSource(), ColumnDataSource()
        scale = DataRange1d()
        self.figure = figure(
            width=WIDTH,
            height=HEIGHT,
            tools="xpan,xwheel_zoom,box_zoom,reset,save",
            active_drag="box_zoom",
            x_range=x_range or DataRange1d(range_padding=0.0),
            y_range=scale,
            x_axis_label=PlainText(text="time [s]"),
            title=signal_title(about),
            sizing_mode="stretch_width",
            output_backend="canvas",
        )
        self._fill(self.before, np.empty(0), np.empty((5, 0)))
        plot = self.figure
        shown: list[Model] = [
            plot.varea("t", low, high, source=self.now, fill_color=BLUE, fill_alpha=alpha) for low, high, alpha in BANDS
        ]
        shown.append(plot.line("t", "q50", source=self.now, color=BLUE, line_width=2))
        for level in ("q5", "q50", "q95"):
            dash = "solid" if level == "q50" else "dashed"
            plot.line("t", level, source=self.before, color=GREY, line_width=1.5, line_dash=dash)
        plot.line("t", "value", source=self.draw, color=RED, line_width=1.5)
        scale.renderers = shown  # a draw that diverges does not set the scale
        quiet_toolbar(plot)

    def show(self, run: LiveRun, before: LiveRun | None, draw: int) -> None:
        """Show a run, the one before it, and one of its draws."""
        fan = run.fan(self.name)
        self._fill(self.now, run.times, fan.values)
        if before is not None and before is not self._outlined:
            self._outlined = before
            self._fill(self.before, before.times, before.fan(self.name).values)
        self.show_draw(run, draw)

    def show_draw(self, run: LiveRun, draw: int) -> None:
        """Show one draw of a run."""
        self.draw.data = {"t": run.times, "value": drawable(run.signal(self.name)[draw])}

    @staticmethod
    def _fill(source: ColumnDataSource, times: np.ndarray, values: np.ndarray) -> None:
        seen = ~np.isnan(values[0])
        rows = zip(("q5", "q25", "q50", "q75", "q95"), drawable(values[:, seen]), strict=True)
        source.data = {"t": times[seen], **dict(rows)}


class PathFigure:
    """A vehicle's path of one draw, seen along one axis, with the desired path.

    Args:
        across: The channel on the horizontal axis.
        upward: The channel on the vertical axis.
    """

    def __init__(self, across: str, upward: str) -> None:
        self.channels = across, upward
        self.path, self.desired = (ColumnDataSource({"across": [], "upward": []}) for _ in range(2))
        self.figure = path_frame(across, upward)
        self.figure.line("across", "upward", source=self.desired, color=GREY, line_width=1.5, line_dash="dashed")
        self.figure.line("across", "upward", source=self.path, color=RED, line_width=2)

    def show_draw(self, run: LiveRun, draw: int) -> None:
        """Show one draw of a run."""
        for source, signal in ((self.path, "y"), (self.desired, "y_ref")):
            across, upward = (drawable(run.signal(f"{channel}_{signal}")[draw]) for channel in self.channels)
            source.data = {"across": across, "upward": upward}


class DrawsFigure:
    """Every draw by one of its uncertain numbers and its smallest slack; a click chooses a draw.

    Passing draws are blue circles, failing ones orange crosses.

    Args:
        choose: Called with the draw that was clicked.
    """

    def __init__(self, choose: Callable[[int], None]) -> None:
        self.passed, self.failed, self.chosen = (ColumnDataSource() for _ in range(3))
        self.number = PlainText(text="")
        self.figure = figure(
            width=WIDTH,
            height=HEIGHT,
            tools="tap,pan,wheel_zoom,box_zoom,reset,save",
            active_drag="box_zoom",
            x_axis_label=self.number,
            y_axis_label=PlainText(text="smallest relative slack"),
            y_range=DataRange1d(),
            sizing_mode="stretch_width",
        )
        looks = ((self.passed, "circle", BLUE, 5), (self.failed, "x", ORANGE, 7))
        for source, marker, colour, size in looks:
            self.figure.scatter("x", "slack", source=source, marker=marker, color=colour, size=size, alpha=0.7)
            source.selected.on_change("indices", partial(self._clicked, source, choose))
        self.figure.scatter(
            "x", "slack", source=self.chosen, marker="circle", size=15, line_color=RED, line_width=3, fill_alpha=0.0
        )
        quiet_toolbar(self.figure)

    def show(self, run: LiveRun, name: str, draw: int) -> None:
        """Show the draws of a run over an uncertain number, or over the draw's index if ``name`` is empty."""
        values = run.values[name] if name else np.arange(run.failed.size)
        self.number.text = name or "draw"
        finite = np.isfinite(run.slack)
        lowest = run.slack[finite].min() if finite.any() else -1.0
        slack = np.where(finite, run.slack, lowest)
        for source, chosen in ((self.passed, ~run.failed), (self.failed, run.failed)):
            source.selected.indices = []
            source.data = {"x": values[chosen], "slack": slack[chosen], "draw": np.flatnonzero(chosen)}
        self.chosen.data = {"x": values[[draw]], "slack": slack[[draw]]}

    @staticmethod
    def _clicked(
        source: ColumnDataSource, choose: Callable[[int], None], attr: str, old: list[int], new: list[int]
    ) -> None:
        if new:
            choose(int(np.asarray(source.data["draw"])[new[0]]))


class ProbabilityFigure:
    """The failure probability with its interval, before and now."""

    def __init__(self) -> None:
        self.source = ColumnDataSource({"name": [], "p": [], "low": [], "high": [], "colour": []})
        self.figure = figure(
            width=WIDTH,
            height=110,
            tools="",
            x_range=Range1d(start=0.0, end=1.0),
            y_range=FactorRange(factors=[NOW, BEFORE]),
            x_axis_label=PlainText(text="failure probability, 95 % interval"),
            sizing_mode="stretch_width",
        )
        self.figure.hbar(
            "name", left="low", right="high", height=0.5, source=self.source, color="colour", fill_alpha=0.35
        )
        self.figure.scatter("p", "name", source=self.source, size=11, color="colour", marker="diamond")
        self.figure.toolbar_location = None

    def show(self, run: LiveRun, before: LiveRun | None) -> None:
        """Show a run and the one before it."""
        rows = [(NOW, run, BLUE)] + ([(BEFORE, before, GREY)] if before is not None else [])
        self.source.data = {
            "name": [name for name, _, _ in rows],
            "p": [run.probability for _, run, _ in rows],
            "low": [run.interval[0] for _, run, _ in rows],
            "high": [run.interval[1] for _, run, _ in rows],
            "colour": [colour for _, _, colour in rows],
        }


def path_frame(across: str, upward: str) -> figure:
    """An empty figure for a path, with equal scales."""
    plot = figure(
        width=WIDTH,
        height=HEIGHT,
        tools="pan,wheel_zoom,reset,save",
        match_aspect=True,
        x_axis_label=PlainText(text=f"{across} [m]"),
        y_axis_label=PlainText(text=f"{upward} [m]"),
        sizing_mode="stretch_width",
    )
    quiet_toolbar(plot)
    return plot


def seen_paths(study: Study) -> Sequence[tuple[str, str]]:
    """The channels of each view of a vehicle's path: from above and from the side; none without x, y and z."""
    return (("x", "y"), ("x", "z")) if {"x", "y", "z"} <= set(study.loop.channels) else ()


def quiet_toolbar(plot: figure) -> None:
    """Show a figure's tools only under the pointer, and no logo."""
    plot.toolbar.logo, plot.toolbar.autohide = None, True


def signal_title(about: dict[str, str]) -> Title:
    """Meaning and unit of a signal above its figure, where a long text has room; as plain text."""
    unit = about["units"]
    text = about["long_name"] if unit in ("", "1") else f"{about['long_name']} [{unit}]"
    return Title(text=PlainText(text=text), text_font_style="normal")


def drawable(values: np.ndarray) -> np.ndarray:
    """Values that an axis can show: what is larger is left out."""
    return np.where(np.abs(values) < DRAWABLE, values, np.nan)


def shown_signals(study: Study) -> Sequence[str]:
    """Signals that get a fan: output, error and command of a plant of one channel; the errors of a vehicle."""
    if len(study.loop.channels) == 1:
        return ("y", "e", "u_total")
    return tuple(f"{channel}_e" for channel in study.loop.channels)
