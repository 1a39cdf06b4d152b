"""The page of a result, on which its draws are brushed, replayed by a click, and pinned for comparison."""

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import htpy as h
import numpy as np
import panel as pn
import xarray as xr
from bokeh.models import ColumnDataSource
from bokeh.plotting import figure

from dssc_jax.closed_loop.metrics.requirements import worst_slack
from dssc_jax.core.errors import ConfigError
from dssc_jax.exploration.brushing import Brushing
from dssc_jax.exploration.draw_table import DrawTable
from dssc_jax.exploration.figures import displayed_signals, path_figure, path_views, signal_figure
from dssc_jax.exploration.flight_view import FlightView, recorded_flights
from dssc_jax.exploration.live import has_vehicle
from dssc_jax.exploration.page import MEDIAN_DRAW, RANDOM_DRAW, WORST_DRAW, Page, html_pane, markup
from dssc_jax.exploration.worker import Stale
from dssc_jax.exploration.wrong_laws import WrongLaws, largest_errors_text, probability_text
from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, VIOLET, drawable
from dssc_jax.results.result import Result
from dssc_jax.runs.trajectory import agreement_of, recorder
from dssc_jax.study import Described

MOST_SAMPLES = 1500
"""Approximate number of samples of a replayed flight."""
COLOURS = (RED, BLUE, GREEN, VIOLET, ORANGE)
"""Colours of the present flight and of the pinned flights."""


class ResultPage(Page):
    """The page of a result.

    Args:
        result: A loaded or new result of a run or a sweep.
        background: Whether draws are simulated in a thread, as on a served page.
    """

    def __init__(self, result: Result, background: bool = False) -> None:
        super().__init__(background)
        self.result = result
        self.table = DrawTable(result)
        self.brushing = Brushing(self.table, str(result.path or f"results/{result.study.name}"))
        self.flight: xr.Dataset | None = None
        self.pinned: list[xr.Dataset] = []
        self.key = html_pane("")
        self.wrong_laws = WrongLaws(self.show_wrong_laws, self.show_how_wrong)
        self.say("click a draw to see its flight")
        if not result.study.axes:
            self.show_wrong_laws()
        self.choices: list[pn.widgets.Button] = []
        for name in (WORST_DRAW, MEDIAN_DRAW, RANDOM_DRAW):
            button = pn.widgets.Button(label=name.capitalize())
            button.on_click(lambda _, name=name: self.replay(self.row_of(name)))
            self.choices.append(button)
        self.pin = pn.widgets.Button(label="Pin this draw", color="primary")
        self.clear = pn.widgets.Button(label="Unpin all")
        self.pin.on_click(lambda _: self.pin_draw())
        self.clear.on_click(lambda _: self.unpin())
        self.sources: dict[str, ColumnDataSource] = {}
        self.figures = [self._figure(name) for name in displayed_signals(result.study)]
        self.paths = [self._path(*pair) for pair in path_views(result.study)]
        self.flight_view = FlightView() if has_vehicle(result.study) else None
        self.brushing.clicked_row.on_change("data", self._clicked)

    def _figure(self, name: str) -> figure:
        """An empty figure of one signal of all displayed flights."""
        source = ColumnDataSource({"t": [], "value": [], "colour": [], "draw": []})
        self.sources[name] = source
        plot = signal_figure(name, self.result.study)
        plot.multi_line("t", "value", source=source, line_color="colour", line_width=1.5)
        return plot

    def _path(self, across: str, upward: str) -> figure:
        """An empty figure of paths over two channels, with the desired path of the present draw as a dashed line."""
        source = ColumnDataSource({"across": [], "upward": [], "colour": []})
        desired = ColumnDataSource({"across": [], "upward": []})
        self.sources[across + upward] = source
        self.sources[f"desired {across}{upward}"] = desired
        plot = path_figure(across, upward)
        plot.multi_line("across", "upward", source=desired, line_color=GREY, line_width=1.5, line_dash="dashed")
        plot.multi_line("across", "upward", source=source, line_color="colour", line_width=2)
        return plot

    def show_wrong_laws(self) -> None:
        """Show the failure probability if the laws are wrong by the amount of the slider."""
        result = self.result
        amounts = self.wrong_laws.amounts
        compute = partial(probability_text, amounts, result.study, result.failed.values, result.method)
        self.show_aside(compute, self.wrong_laws.show)

    def show_how_wrong(self) -> None:
        """Show how far the laws may be wrong."""
        compute = partial(largest_errors_text, self.result, self.wrong_laws.largest_share)
        self.show_aside(compute, self.wrong_laws.show)

    @property
    def view(self) -> pn.Column:
        """The page for Panel."""
        figures = [pn.pane.Bokeh(plot, sizing_mode="stretch_width") for plot in (*self.paths, *self.figures)]
        return pn.Column(
            pn.pane.Bokeh(self.brushing.layout),
            *([] if self.result.study.axes else [self.wrong_laws.view]),
            pn.Row(*self.choices, self.pin, self.clear),
            self.status,
            self.key,
            pn.GridBox(*figures, ncols=3, sizing_mode="stretch_width"),
            *([pn.pane.Bokeh(self.flight_view.layout)] if self.flight_view else []),
            sizing_mode="stretch_width",
        )

    @cached_property
    def order(self) -> np.ndarray:
        """Rows from the worst to the best, by smallest slack; among equals an early end comes first."""
        requirements = self.result.study.requirements
        lanes = {}
        for name in ("outcome", "failed_at", *(requirement.name for requirement in requirements)):
            lanes[name] = self.result.dataset[name].values.reshape(-1)[self.table.rows]
        end_times = np.nan_to_num(lanes["failed_at"], nan=np.inf)
        return np.lexsort((end_times, worst_slack(requirements, lanes)))

    def row_of(self, choice: str) -> int:
        """The row of the worst, the median or a random draw, see :meth:`Page.choose`."""
        return self.choose(choice, self.order)

    @cached_property
    def _record(self) -> Callable[[int, dict[str, float]], xr.Dataset]:
        """The program that simulates one draw, compiled once."""
        study = self.result.study
        return recorder(study, max(1, study.loop.steps // MOST_SAMPLES))

    def _clicked(self, attr: str, old: dict[str, list[int]], new: dict[str, list[int]]) -> None:
        """Replay the draw that was clicked; the arguments are those of Bokeh's callbacks."""
        if len(new["row"]):
            self.replay(int(new["row"][0]))

    def replay(self, row: int) -> None:
        """Simulate the draw in a row of :attr:`table` again, and show its flight."""
        if isinstance(self.result.study, Described):
            self.say("the study's own code is not loaded; trust the code to simulate its draws")
            return
        self.say(f"simulating draw {self.table.draw[row]} ...")
        self.work(partial(self._simulate, row))

    def _simulate(self, row: int, stale: Stale) -> None:
        """Simulate a draw, show it unless a newer click has come, and then compare it with the stored draw."""
        try:
            run = self._record(int(self.table.draw[row]), self.table.point(row))
        except ConfigError as error:
            self.update(self.complain, str(error))
        except Exception as error:  # a user's model may raise anything, and the page goes on
            self.update(self.complain, f"the draw cannot be simulated: {type(error).__name__}: {error}")
        else:
            if not stale():
                self.update(self.show, run)
                self.work_aside(partial(self._compare, run))

    def _compare(self, run: xr.Dataset, stale: Stale) -> None:
        """Compare a flight with the stored draw.

        It happens aside, because a draw that rounding decides is simulated once more by a program that compiles slowly.
        """
        run.attrs["agreement"] = agreement_of(self.result, run).verdict
        if not stale():
            self.update(self._say_agreement, run)

    def show(self, run: xr.Dataset) -> None:
        """Show a flight beside the pinned ones."""
        self.flight = run
        self._draw()
        self.say(f"{self._name(run)}: {run.attrs['verdict']}; comparing it with what is stored ...")

    def _say_agreement(self, run: xr.Dataset) -> None:
        """Tell how a flight agrees with the stored draw, if it is still the present one."""
        if run is self.flight:
            self.say(f"{self._name(run)}: {run.attrs['verdict']}; stored metrics: {run.attrs['agreement']}")

    def _name(self, run: xr.Dataset) -> str:
        """The draw of a flight, and its point of the sweep, in words."""
        point = "".join(f", {name} = {run.attrs[name]:.4g}" for name in self.result.study.axes)
        return f"draw {run.attrs['draw']}{point}"

    def pin_draw(self) -> None:
        """Pin the present flight, so that it stays when another draw is replayed.

        Nothing happens if all colours but the present flight's are taken.
        """
        most_pinned = len(COLOURS) - 1
        if self.flight is not None and len(self.pinned) < most_pinned:
            self.pinned.append(self.flight)
            draws = ", ".join(str(run.attrs["draw"]) for run in self.pinned)
            self.say(f"pinned: {draws}")

    def unpin(self) -> None:
        """Remove all flights but the present one."""
        self.pinned.clear()
        self._draw()

    def _draw(self) -> None:
        """Fill the figures with the present flight in red, and each pinned flight in a colour of its own."""
        flights = [run for run in self.pinned if run is not self.flight]
        if self.flight is not None:
            flights.insert(0, self.flight)
        colours = list(COLOURS[: len(flights)])
        names = []
        for run, colour in zip(flights, colours, strict=True):
            names.append(h.span(style=f"color: {colour}")[f"\u25a0 {self._name(run)}  "])
        self.key.object = markup(h.p[names])
        for name in displayed_signals(self.result.study):
            self.sources[name].data = {
                "t": [run["t"].values for run in flights],
                "value": [drawable(run[name].values) for run in flights],
                "colour": colours,
                "draw": [run.attrs["draw"] for run in flights],
            }
        for across, upward in path_views(self.result.study):
            desired = path_lines(flights[:1], f"{across}_y_ref", f"{upward}_y_ref")
            self.sources[f"desired {across}{upward}"].data = desired
            paths = {**path_lines(flights, f"{across}_y", f"{upward}_y"), "colour": colours}
            self.sources[across + upward].data = paths
        if self.flight_view is not None and flights:
            draw_name = str(flights[0].attrs["draw"])
            self.flight_view.show(recorded_flights(self.result.study, flights), 0, name=draw_name)


def path_lines(flights: list[xr.Dataset], across: str, upward: str) -> dict[str, Any]:
    """Two signals of flights as the columns of a figure of paths."""
    return {
        "across": [drawable(run[across].values) for run in flights],
        "upward": [drawable(run[upward].values) for run in flights],
    }
