"""Explore a study on a page: sliders move its numbers, and its failures, signals and draws follow."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import htpy as h
import numpy as np
import panel as pn

from dssc_jax.core.errors import ConfigError
from dssc_jax.exploration.actions import (
    Answer,
    Question,
    Superseded,
    count_differing_draws,
    law_range_question,
    margin_question,
    proof,
    save_study,
    stop_when_stale,
)
from dssc_jax.exploration.figures import (
    DrawsFigure,
    FanFigure,
    PathFigure,
    ProbabilityFigure,
    displayed_signals,
    path_views,
)
from dssc_jax.exploration.flight_view import FlightView
from dssc_jax.exploration.live import LiveRun, LiveStudy, has_vehicle
from dssc_jax.exploration.logged_flights import LoggedFlights
from dssc_jax.exploration.page import MEDIAN_DRAW, RANDOM_DRAW, WORST_DRAW, Page, html_pane, markup
from dssc_jax.exploration.positions import position_text, slider_positions
from dssc_jax.exploration.sliders import MEDIAN, Slider
from dssc_jax.exploration.worker import Stale
from dssc_jax.exploration.wrong_laws import WrongLaws, largest_errors_text, probability_text
from dssc_jax.flight_logs.reading.reader import FlightLog
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.result import interval_method

LEGEND = "blue: now (median, half and 90 % of the draws); grey: before; red: one draw, chosen here or by a click"
SIDE = 330
"""Width of the column of sliders [px]."""


class StudyPage(Page):
    """The page of a study: when a slider moves, all draws are simulated again.

    In a notebook or a program, a move returns as soon as its run is shown. With ``background``, runs happen in a
    thread, and a newer move replaces an older one. ``now`` is the run that is shown, and ``before`` is the run to
    compare it with.

    Args:
        live: The study with its sliders.
        background: Whether runs happen in a thread, as on a served page.
        folder: Folder of saved studies; None: the current folder.
        logs: Logged flights, which get a card on the page.
    """

    def __init__(
        self,
        live: LiveStudy,
        background: bool = False,
        folder: Path | None = None,
        logs: Sequence[FlightLog] = (),
    ) -> None:
        """Make the widgets and figures, and show the run at the start of all sliders."""
        super().__init__(background)
        self.flights = LoggedFlights(logs, self.ask_flights) if logs else None
        self.live = live
        self.folder = folder or Path.cwd()
        self.now: LiveRun | None = None
        self.before: LiveRun | None = None
        self.draw = 0
        self._moving = False  # whether :meth:`move` is moving sliders
        self.sliders = {slider: slider_widget(slider) for slider in live.sliders}
        self._make_widgets()
        self._make_figures()
        for widget in self.sliders.values():
            widget.param.watch(self._on_move, "value")
        self.show(live.first_run)

    def _make_widgets(self) -> None:
        """Make buttons, inputs and panes of text, and connect them with the methods that they call."""
        self.headline = html_pane("")
        self.details = html_pane("")
        self.compare = pn.widgets.Button(label="Compare with this", color="primary")
        self.compare.on_click(lambda _: self.compare_with_this())
        self.reset = pn.widgets.Button(label="Reset")
        self.reset.on_click(lambda _: self.move({slider.key: slider.start for slider in self.sliders}))
        self.file = pn.widgets.TextInput(label="Save as study", value=f"{self.live.base.name}-explored.toml")
        self.save = pn.widgets.Button(label="Save")
        self.save.on_click(lambda _: self.save_as(self.file.value))
        choices = [WORST_DRAW, MEDIAN_DRAW, RANDOM_DRAW]
        self.draw_choice = pn.widgets.RadioButtonGroup(label="Draw", options=choices, value=WORST_DRAW)
        self.draw_choice.param.watch(lambda _: self._choose_draw(), "value")
        drawn_names = list(self.live.first_run.values) or [""]  # without uncertain numbers: the index of the draw
        self.draw_axis = pn.widgets.Select(label="", options=drawn_names, width=220)
        self.draw_axis.param.watch(lambda _: self._choose_draw(), "value")
        self.margin_number = pn.widgets.Select(label="", options=margin_sliders(self.live.sliders), width=220)
        self.margin = pn.widgets.Button(label="Margin of")
        self.margin.on_click(lambda _: self.ask_margin(self.margin_number.value))
        self.prove = pn.widgets.Button(label="Prove")
        self.prove.on_click(lambda _: self.ask(proof, "searching for a proof"))
        self.ranges = pn.widgets.Button(label="Over all ranges of laws")
        self.ranges.on_click(lambda _: self.ask_ranges())
        self.answer = html_pane("")
        self.wrong_laws = WrongLaws(self.show_wrong_laws, self.show_how_wrong)

    def _make_figures(self) -> None:
        """Make the figures, whose time axes move together."""
        study = self.live.base
        self.probability = ProbabilityFigure()
        self.fans: list[FanFigure] = []
        for name in displayed_signals(study):
            x_range = self.fans[0].figure.x_range if self.fans else None
            self.fans.append(FanFigure(study, name, x_range))
        self.draws = DrawsFigure(self.choose_draw)
        self.paths = [PathFigure(*pair) for pair in path_views(study)]
        self.flight = FlightView() if has_vehicle(study) else None

    @property
    def view(self) -> pn.Row:
        """The page for Panel."""
        save = pn.Column(self.file, self.save, pn.Row(self.compare, self.reset))
        side = pn.Column(*self.sliders.values(), save, width=SIDE)
        questions = pn.Row(self.margin, self.margin_number, self.prove)
        if self.live.ranged.ranged_laws:
            questions.append(self.ranges)
        main = pn.Column(
            self.headline,
            pn.pane.Bokeh(self.probability.figure, sizing_mode="stretch_width"),
            self.wrong_laws.view,
            self.details,
            pn.Row(self.draw_choice, self.draw_axis),
            questions,
            self.answer,
            sizing_mode="stretch_width",
        )
        if self.flights is not None:
            main.append(self.flights.view)
        figures = []
        for part in (*self.fans, self.draws, *self.paths):
            figures.append(pn.pane.Bokeh(part.figure, sizing_mode="stretch_width"))
        main.append(html_pane(markup(h.p[LEGEND])))
        main.append(pn.GridBox(*figures, ncols=2, sizing_mode="stretch_width"))
        if self.flight is not None:
            main.append(pn.pane.Bokeh(self.flight.layout))
        main.append(self.status)
        return pn.Row(side, main, sizing_mode="stretch_width")

    @property
    def positions(self) -> dict[Slider, float]:
        """Present position of each slider."""
        return {slider: float(widget.value) for slider, widget in self.sliders.items()}

    def move(self, positions: dict[str, float]) -> None:
        """Move several sliders together, each to the nearest of its positions, and run once.

        Args:
            positions: Positions by key of the slider: the dotted name of the number, followed by ``(median)`` or
                ``(width)`` for a law.

        Raises:
            ConfigError: There is no such slider.
        """
        by_key = {slider.key: slider for slider in self.sliders}
        unknown_names = sorted(positions.keys() - by_key.keys())
        if unknown_names:
            raise ConfigError("move", f"'{unknown_names[0]}' is none of the sliders: {', '.join(by_key)}")
        self._moving = True
        try:
            for key, position in positions.items():
                slider = by_key[key]
                values = np.asarray(slider_positions(slider))
                self.sliders[slider].value = float(values[np.argmin(np.abs(values - position))])
        finally:
            self._moving = False
        self.start()

    def _on_move(self, _: object) -> None:
        """Run when the user moves a slider.

        While :meth:`move` moves sliders, nothing runs here; :meth:`move` runs once at its end.
        """
        if not self._moving:
            self.start()

    def start(self) -> None:
        """Simulate all draws at the present positions."""
        self.show_status("running ...")
        self.run_task(partial(self._run, self.positions))

    def _run(self, positions: dict[Slider, float], stale: Stale) -> None:
        """Simulate at positions of the sliders, and show the run or the reason why there is none.

        Args:
            positions: Position of each slider.
            stale: Returns whether newer positions have come; then nothing is shown.
        """
        try:
            run = self.live.run(positions, stale, partial(self.update, self.show_status))
        except ConfigError as error:
            self.update(self.show_error, f"{error}; the figures show the run before")
        except MemoryError:
            self.update(self.show_error, "not enough memory for so many draws")
        except Exception as error:  # a user's model may raise anything, and the page goes on
            self.update(self.show_error, f"the study cannot run: {type(error).__name__}: {error}")
        else:
            if run is not None and not stale():
                self.update(self.show, run)

    def show(self, run: LiveRun) -> None:
        """Show a run; answers to questions about another run are removed."""
        if run is not self.now:
            self.answer.object = ""
            if self.flights is not None:
                self.flights.clear()
            self.now = run
            self.show_wrong_laws()
        if self.before is None:
            self.before = run
        self._show(run, self.choose(self.draw_choice.value, run.order))

    def show_wrong_laws(self) -> None:
        """Show the present run's failure probability under laws that are wrong by the amount of the slider."""
        run = self.now
        if run is None:
            return
        amounts = self.wrong_laws.amounts
        compute = partial(probability_text, amounts, run.study, run.failed, interval_method(run.study))
        self.show_later(compute, self.wrong_laws.show)

    def show_how_wrong(self) -> None:
        """Show how far the laws of the present run may be wrong before too many draws fail."""
        if self.now is not None:
            compute = partial(largest_errors_text, self.now.study, self.wrong_laws.largest_share)
            self.show_later(compute, self.wrong_laws.show)

    def choose_draw(self, draw: int) -> None:
        """Show a draw of the present run."""
        if self.now is not None:
            self._show(self.now, draw)

    def _show(self, run: LiveRun, draw: int) -> None:
        """Show a run and one of its draws in all texts and figures."""
        self.draw = draw
        previous = self.before if self.before is not run else None
        self.headline.object = markup(h.p(".headline")[run.statement])
        lines = []
        for text, count in run.by_requirement:
            lines.append(f"{text}: violated by {count:,} of {run.failed.size:,} draws")
        if run.ended_early:
            lines.append(f"{run.ended_early:,} draws ended early")
        lines.append(run.certificate)
        self.details.object = markup(h.div[[h.p[line] for line in lines]])
        self.probability.show(run, previous)
        for fan in self.fans:
            fan.show(run, previous, self.draw)
        self.draws.show(run, self.draw_axis.value, draw)
        for path in self.paths:
            path.show_draw(run, self.draw)
        if self.flight is not None:
            self.flight.show(run, self.draw)
        self._show_draw_status(run)

    def _show_draw_status(self, run: LiveRun) -> None:
        """Show the number of draws and the verdict of the selected draw in the status line."""
        verb = "fails" if run.failed[self.draw] else "passes"
        self.show_status(f"{run.failed.size:,} draws; red: draw {self.draw}, which {verb}")

    def _choose_draw(self) -> None:
        """Show the draw of the present run that the buttons select."""
        if self.now is not None:
            self.show(self.now)

    def ask_margin(self, slider: Slider) -> None:
        """Show how far the number of a slider may go before draws fail.

        All other numbers stay at the positions of their sliders.
        """
        self.ask(margin_question(slider, self.positions[slider]), f"walking along {slider.name}")

    def ask_ranges(self) -> None:
        """Show the failure probability over all laws within their ranges.

        All other numbers stay at the positions of their sliders.
        """
        study = self.live.ranged_study_at(self.positions)
        self.ask(law_range_question(study), "simulating the laws within their ranges")

    def ask_flights(self) -> None:
        """Compare the logged flights with the draws of the present run, and show the answer."""
        if self.flights is not None:
            self._answer(self.flights.question, "comparing the flights with the draws", self._show_flights_answer)

    def ask(self, question: Question[str], activity: str) -> None:
        """Show the answer to a question about the present run, unless a newer move supersedes it.

        Args:
            question: The question.
            activity: Description of the work, for the status line.
        """
        self._answer(question, activity, self._show_answer)

    def _answer(
        self, question: Question[Answer], activity: str, show_answer: Callable[[LiveRun, Answer], None]
    ) -> None:
        """Compute the answer to a question about the present run, and show it unless a newer move supersedes the run.

        Args:
            question: The question.
            activity: Description of the work, for the status line.
            show_answer: Shows the answer on the page, with the run that it is about.
        """
        run = self.now
        if run is None:
            return
        self.show_status(f"{activity} ...")

        def task(stale: Stale) -> None:
            """Compute the answer and show it, or the error in its place."""
            try:
                answer = question(run, stop_when_stale(stale))
            except Superseded:
                return
            except Exception as error:  # a user's model may raise anything, and the page goes on
                self.update(self.show_error, f"{activity} ended: {error}")
            else:
                if not stale():
                    self.update(show_answer, run, answer)

        self.run_task(task)

    def _show_answer(self, run: LiveRun, text: str) -> None:
        """Show a text that answers a question about a run."""
        self.answer.object = markup(h.p(role="status")[text])
        self._show_draw_status(run)

    def _show_flights_answer(self, run: LiveRun, analysis: Analysis) -> None:
        """Show how the logged flights compare with the draws of a run."""
        if self.flights is not None:
            self.flights.show(analysis)
        self._show_draw_status(run)

    def compare_with_this(self) -> None:
        """Make the present run the one with which later runs are compared."""
        self.before = self.now
        if self.now is not None:
            self.show(self.now)

    def save_as(self, name: str) -> None:
        """Write the present study to a new file, and compare a run of this file with the present run.

        Args:
            name: Name of the file in the page's folder; if the name is refused, the status line says why.
        """
        run = self.now
        if run is None:
            self.show_error("nothing to save yet")
            return
        try:
            path = save_study(run, self.folder, name)
        except ConfigError as error:
            self.show_error(str(error))
            return
        command = f"dssc-jax run {path.name}"
        self.show_status(f"saved {path}; {command} is being compared with what is shown ...")

        def compare(_: Stale) -> None:
            """Run the saved study, and show in how many draws it has another outcome."""
            try:
                count = count_differing_draws(run, path)
            except ConfigError as error:
                self.update(self.show_error, str(error))
                return
            verdict = f"another outcome in {count:,} draws" if count else "the same outcome in every draw"
            self.update(self.show_status, f"saved {path}; {command} gives {verdict}")

        self.run_task(compare)


def margin_sliders(sliders: Sequence[Slider]) -> dict[str, Slider]:
    """Return the slider of each number whose margin can be asked for, by the number's name in alphabetical order.

    A margin can be asked for a plain number and for the median of a law, but not for other properties of a law.
    """
    by_name: dict[str, Slider] = {}
    for slider in sliders:
        if slider.part in ("", MEDIAN):
            by_name.setdefault(slider.name, slider)
    return dict(sorted(by_name.items()))


def slider_widget(slider: Slider) -> pn.widgets.DiscreteSlider:
    """Make the widget of a slider, which shows positions with four significant digits."""
    options = {position_text(value): value for value in slider_positions(slider)}
    return pn.widgets.DiscreteSlider(label=slider.label, options=options, value=slider.start, width=SIDE - 20)
