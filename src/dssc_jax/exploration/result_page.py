"""Explore a result on a page: brush its draws, replay one by a click, and pin it for comparison."""

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import htpy as h
import numpy as np
import panel as pn
import xarray as xr
from bokeh.models import ColumnDataSource
from bokeh.plotting import figure
from panel.viewable import Viewable

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
"""Colours of the present flight, and then of the pinned flights."""


class ResultPage(Page):
    """The page of a result.

    Args:
        result: A loaded or new result of a run or a sweep.
        background: Whether draws are simulated in a thread, as on a served page.
    """

    def __init__(self, result: Result, background: bool = False) -> None:
        """Make the figures and widgets; no draw is replayed yet."""
        super().__init__(background)
        self.result = result
        self.table = DrawTable(result)
        self.brushing = Brushing(self.table, str(result.path or f"results/{result.study.name}"))
        self.flight: xr.Dataset | None = None
        self.pinned: list[xr.Dataset] = []
        self.legend = html_pane("")
        self.wrong_laws = WrongLaws(self.show_wrong_laws, self.show_how_wrong)
        self.show_status("click a draw to see its flight")
        if not result.study.axes:
            self.show_wrong_laws()
        self.draw_buttons = [self._draw_button(choice) for choice in (WORST_DRAW, MEDIAN_DRAW, RANDOM_DRAW)]
        self.pin = pn.widgets.Button(label="Pin this draw", color="primary")
        self.clear = pn.widgets.Button(label="Unpin all")
        self.pin.on_click(lambda _: self.pin_draw())
        self.clear.on_click(lambda _: self.unpin())
        self.sources: dict[str, ColumnDataSource] = {}
        self.figures = [self._figure(name) for name in displayed_signals(result.study)]
        self.paths = [self._path(*pair) for pair in path_views(result.study)]
        self.flight_view = FlightView() if has_vehicle(result.study) else None
        self.brushing.clicked_row.on_change("data", self._clicked)

    def _draw_button(self, choice: str) -> pn.widgets.Button:
        """Make a button that replays the worst, the median or a random draw, see :meth:`Page.choose`."""
        button = pn.widgets.Button(label=choice.capitalize())
        button.on_click(lambda _: self.replay(self.row_of(choice)))
        return button

    def _figure(self, name: str) -> figure:
        """Make an empty figure of one signal, for all displayed flights."""
        source = ColumnDataSource({"t": [], "value": [], "colour": [], "draw": []})
        self.sources[name] = source
        plot = signal_figure(name, self.result.study)
        plot.multi_line("t", "value", source=source, line_color="colour", line_width=1.5)
        return plot

    def _path(self, across: str, upward: str) -> figure:
        """Make an empty figure of paths over two channels, with the present draw's desired path as a dashed line."""
        source = ColumnDataSource({"across": [], "upward": [], "colour": []})
        desired = ColumnDataSource({"across": [], "upward": []})
        self.sources[across + upward] = source
        self.sources[f"desired {across}{upward}"] = desired
        plot = path_figure(across, upward)
        plot.multi_line("across", "upward", source=desired, line_color=GREY, line_width=1.5, line_dash="dashed")
        plot.multi_line("across", "upward", source=source, line_color="colour", line_width=2)
        return plot

    def show_wrong_laws(self) -> None:
        """Show the failure probability under laws that are wrong by the amount of the slider."""
        result = self.result
        amounts = self.wrong_laws.amounts
        compute = partial(probability_text, amounts, result.study, result.failed.values, result.method)
        self.show_later(compute, self.wrong_laws.show)

    def show_how_wrong(self) -> None:
        """Show how far the laws may be wrong before too many draws fail."""
        compute = partial(largest_errors_text, self.result, self.wrong_laws.largest_share)
        self.show_later(compute, self.wrong_laws.show)

    @property
    def view(self) -> pn.Column:
        """The page for Panel."""
        figures = [pn.pane.Bokeh(plot, sizing_mode="stretch_width") for plot in (*self.paths, *self.figures)]
        parts: list[Viewable] = [pn.pane.Bokeh(self.brushing.layout)]
        if not self.result.study.axes:
            parts.append(self.wrong_laws.view)
        parts.append(pn.Row(*self.draw_buttons, self.pin, self.clear))
        parts += [self.status, self.legend, pn.GridBox(*figures, ncols=3, sizing_mode="stretch_width")]
        if self.flight_view is not None:
            parts.append(pn.pane.Bokeh(self.flight_view.layout))
        return pn.Column(*parts, sizing_mode="stretch_width")

    @cached_property
    def order(self) -> np.ndarray:
        """Rows from the worst to the best, by smallest slack; of rows with equal slack, the earlier end comes first."""
        requirements = self.result.study.requirements
        lanes = {}
        for name in ("outcome", "failed_at", *(requirement.name for requirement in requirements)):
            lanes[name] = self.result.dataset[name].values.reshape(-1)[self.table.rows]
        end_times = np.nan_to_num(lanes["failed_at"], nan=np.inf)
        return np.lexsort((end_times, worst_slack(requirements, lanes)))

    def row_of(self, choice: str) -> int:
        """Return the row of the worst, the median or a random draw, see :meth:`Page.choose`."""
        return self.choose(choice, self.order)

    @cached_property
    def _record(self) -> Callable[[int, dict[str, float]], xr.Dataset]:
        """The program that simulates a draw at a point of the sweep; it is compiled once."""
        study = self.result.study
        return recorder(study, max(1, study.loop.steps // MOST_SAMPLES))

    def _clicked(self, attr: str, old: dict[str, list[int]], new: dict[str, list[int]]) -> None:
        """Replay the draw that was clicked.

        Args:
            attr: Name of the changed property; the arguments are those of Bokeh's callbacks.
            old: Data of ``clicked_row`` before the click.
            new: Data of ``clicked_row`` after the click; without a row, no draw was clicked.
        """
        if len(new["row"]):
            self.replay(int(new["row"][0]))

    def replay(self, row: int) -> None:
        """Simulate the draw in a row of :attr:`table` again, and show its flight.

        A study whose code is not loaded cannot be simulated, and the status line says so.
        """
        if isinstance(self.result.study, Described):
            self.show_status("the study's own code is not loaded; trust the code to simulate its draws")
            return
        self.show_status(f"simulating draw {self.table.draw[row]} ...")
        self.run_task(partial(self._simulate, row))

    def _simulate(self, row: int, stale: Stale) -> None:
        """Simulate a draw, show it unless a newer click has come, and then compare it with the stored draw.

        Args:
            row: Row of the draw in the table.
            stale: Returns whether a newer click has come.
        """
        try:
            flight = self._record(int(self.table.draw[row]), self.table.point(row))
        except ConfigError as error:
            self.update(self.show_error, str(error))
        except Exception as error:  # a user's model may raise anything, and the page goes on
            self.update(self.show_error, f"the draw cannot be simulated: {type(error).__name__}: {error}")
        else:
            if not stale():
                self.update(self.show, flight)
                self.run_second_task(partial(self._compare, flight))

    def _compare(self, flight: xr.Dataset, stale: Stale) -> None:
        """Compare a flight with the stored draw, and show whether they agree, unless a newer click has come.

        The comparison is a task of the second thread, because it may take long: if rounding decides the draw's outcome,
        the draw is simulated once more, by a program that compiles slowly.

        Args:
            flight: The simulated draw.
            stale: Returns whether a newer click has come.
        """
        flight.attrs["agreement"] = agreement_of(self.result, flight).verdict
        if not stale():
            self.update(self._show_agreement, flight)

    def show(self, flight: xr.Dataset) -> None:
        """Show a flight beside the pinned ones."""
        self.flight = flight
        self._fill_figures()
        self.show_status(f"{self._name(flight)}: {flight.attrs['verdict']}; comparing it with what is stored ...")

    def _show_agreement(self, flight: xr.Dataset) -> None:
        """Show whether a flight agrees with the stored draw, if it is still the present flight."""
        if flight is self.flight:
            text = f"{flight.attrs['verdict']}; stored metrics: {flight.attrs['agreement']}"
            self.show_status(f"{self._name(flight)}: {text}")

    def _name(self, flight: xr.Dataset) -> str:
        """Name a flight by its draw and its point of the sweep."""
        parts = [f"draw {flight.attrs['draw']}"]
        for name in self.result.study.axes:
            parts.append(f"{name} = {flight.attrs[name]:.4g}")
        return ", ".join(parts)

    def pin_draw(self) -> None:
        """Pin the present flight, so that it stays when another draw is replayed.

        Each pinned flight has its own colour. Nothing happens if only the colour of the present flight is left.
        """
        most_pinned = len(COLOURS) - 1
        if self.flight is not None and len(self.pinned) < most_pinned:
            self.pinned.append(self.flight)
            draws = ", ".join(str(flight.attrs["draw"]) for flight in self.pinned)
            self.show_status(f"pinned: {draws}")

    def unpin(self) -> None:
        """Remove all flights but the present one."""
        self.pinned.clear()
        self._fill_figures()

    def _fill_figures(self) -> None:
        """Fill the figures with the present flight in red, and each pinned flight in another colour."""
        flights = [flight for flight in self.pinned if flight is not self.flight]
        if self.flight is not None:
            flights.insert(0, self.flight)
        colours = list(COLOURS[: len(flights)])
        entries = []
        for flight, colour in zip(flights, colours, strict=True):
            entries.append(h.span(style=f"color: {colour}")[f"\u25a0 {self._name(flight)}  "])
        self.legend.object = markup(h.p[entries])
        for name in displayed_signals(self.result.study):
            self.sources[name].data = {
                "t": [flight["t"].values for flight in flights],
                "value": [drawable(flight[name].values) for flight in flights],
                "colour": colours,
                "draw": [flight.attrs["draw"] for flight in flights],
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
    """Return two signals of flights as the columns of a figure of paths.

    Args:
        flights: The flights.
        across: Signal of the horizontal axis.
        upward: Signal of the vertical axis.
    """
    return {
        "across": [drawable(flight[across].values) for flight in flights],
        "upward": [drawable(flight[upward].values) for flight in flights],
    }
