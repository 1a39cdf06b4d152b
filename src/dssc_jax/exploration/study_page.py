"""The page of a study, whose sliders move its numbers, and whose failures, signals and draws follow."""

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
from dssc_jax.exploration.sliders import MEDIAN, Slider, position_text, slider_positions
from dssc_jax.exploration.worker import Stale
from dssc_jax.exploration.wrong_laws import WrongLaws, largest_errors_text, probability_text
from dssc_jax.flight_logs.reading.reader import FlightLog
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.result import interval_method

COLOUR_KEY = "blue: now (median, half and 90 % of the draws); grey: before; red: one draw, chosen here or by a click"
SIDE = 330  # px


class StudyPage(Page):
    """The page of a study: when a slider moves, all draws are simulated again.

    In a notebook or a program, a move returns when its run is shown. With ``background`` runs happen in a thread, and
    a newer move replaces an older one.

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
        super().__init__(background)
        self.flights = LoggedFlights(logs, self.ask_flights) if logs else None
        self.live = live
        self.folder = folder or Path.cwd()
        self.now: LiveRun | None = None
        self.before: LiveRun | None = None
        self.draw = 0
        self._moving = False
        self.sliders = {slider: slider_widget(slider) for slider in live.sliders}
        self._make_widgets()
        self._make_figures()
        for widget in self.sliders.values():
            widget.param.watch(self._on_move, "value")
        self.show(live.first)

    def _make_widgets(self) -> None:
        """Make buttons, inputs and panes of text."""
        self.headline = html_pane("")
        self.details = html_pane("")
        self.keep = pn.widgets.Button(label="Compare with this", color="primary")
        self.reset = pn.widgets.Button(label="Reset")
        choices = [WORST_DRAW, MEDIAN_DRAW, RANDOM_DRAW]
        self.draw_choice = pn.widgets.RadioButtonGroup(label="Draw", options=choices, value=WORST_DRAW)
        self.draw_axis = pn.widgets.Select(label="", options=list(self.live.first.values) or [""], width=220)
        self.draw_axis.param.watch(lambda _: self._choose_draw(), "value")
        by_name = {slider.name: slider for slider in reversed(self.sliders) if slider.part in ("", MEDIAN)}
        self.margin_number = pn.widgets.Select(label="", options=dict(sorted(by_name.items())), width=220)
        self.margin = pn.widgets.Button(label="Margin of")
        self.prove = pn.widgets.Button(label="Prove")
        self.ranges = pn.widgets.Button(label="Over all ranges of laws")
        self.ranges.on_click(lambda _: self.ask_ranges())
        self.answer = html_pane("")
        self.wrong_laws = WrongLaws(self.show_wrong_laws, self.show_how_wrong)
        self.margin.on_click(lambda _: self.ask_margin(self.margin_number.value))
        self.prove.on_click(lambda _: self.ask(proof, "searching for a proof"))
        self.file = pn.widgets.TextInput(label="Save as study", value=f"{self.live.base.name}-explored.toml")
        self.save = pn.widgets.Button(label="Save")
        self.keep.on_click(lambda _: self.compare_with_this())
        self.reset.on_click(lambda _: self.move({slider.key: slider.start for slider in self.sliders}))
        self.save.on_click(lambda _: self.save_as(self.file.value))
        self.draw_choice.param.watch(lambda _: self._choose_draw(), "value")

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
        ranges = [self.ranges] if self.live.ranged.ranged_laws else []
        figures = [
            pn.pane.Bokeh(part.figure, sizing_mode="stretch_width") for part in (*self.fans, self.draws, *self.paths)
        ]
        save = pn.Column(self.file, self.save, pn.Row(self.keep, self.reset))
        side = pn.Column(*self.sliders.values(), save, width=SIDE)
        probability = pn.pane.Bokeh(self.probability.figure, sizing_mode="stretch_width")
        main = pn.Column(
            self.headline,
            probability,
            self.wrong_laws.view,
            self.details,
            pn.Row(self.draw_choice, self.draw_axis),
            pn.Row(self.margin, self.margin_number, self.prove, *ranges),
            self.answer,
            *([self.flights.view] if self.flights else []),
            html_pane(markup(h.p[COLOUR_KEY])),
            pn.GridBox(*figures, ncols=2, sizing_mode="stretch_width"),
            *([pn.pane.Bokeh(self.flight.layout)] if self.flight else []),
            self.status,
            sizing_mode="stretch_width",
        )
        return pn.Row(side, main, sizing_mode="stretch_width")

    @property
    def positions(self) -> dict[Slider, float]:
        """The present position of each slider."""
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
        """Run when the user moves a slider, but not for each of several sliders that :meth:`move` moves."""
        if not self._moving:
            self.start()

    def start(self) -> None:
        """Simulate all draws at the present positions."""
        self.say("running ...")
        self.work(partial(self._run, self.positions))

    def _run(self, positions: dict[Slider, float], stale: Stale) -> None:
        """Simulate at positions of the sliders, and show the run or the reason why there is none.

        Args:
            positions: Position of each slider.
            stale: Whether newer positions have come; then nothing is shown.
        """
        try:
            run = self.live.run(positions, stale, partial(self.update, self.say))
        except ConfigError as error:
            self.update(self.complain, f"{error}; the figures show the run before")
        except MemoryError:
            self.update(self.complain, "not enough memory for so many draws")
        except Exception as error:  # a user's model may raise anything, and the page goes on
            self.update(self.complain, f"the study cannot run: {type(error).__name__}: {error}")
        else:
            if run is not None and not stale():
                self.update(self.show, run)

    def show(self, run: LiveRun) -> None:
        """Show a run."""
        if run is not self.now:
            self.answer.object = ""
            if self.flights is not None:
                self.flights.clear()
            self.now = run
            self.show_wrong_laws()
        self.before = self.before or run
        self._show(run, self.choose(self.draw_choice.value, run.order))

    def show_wrong_laws(self) -> None:
        """Show the failure probability of the present run if its laws are wrong by the amount of the slider."""
        run = self.now
        if run is None:
            return
        amounts = self.wrong_laws.amounts
        compute = partial(probability_text, amounts, run.study, run.failed, interval_method(run.study))
        self.show_aside(compute, self.wrong_laws.show)

    def show_how_wrong(self) -> None:
        """Show how far the laws of the present run may be wrong."""
        if self.now is not None:
            compute = partial(largest_errors_text, self.now.study, self.wrong_laws.largest_share)
            self.show_aside(compute, self.wrong_laws.show)

    def choose_draw(self, draw: int) -> None:
        """Show a draw of the present run."""
        if self.now is not None:
            self._show(self.now, draw)

    def _show(self, run: LiveRun, draw: int) -> None:
        """Show a run and one of its draws."""
        self.draw = draw
        previous = self.before if self.before is not run else None
        self.headline.object = markup(h.p(".headline")[run.statement])
        lines = [f"{text}: violated by {count:,} of {run.failed.size:,} draws" for text, count in run.by_requirement]
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
        self._say_draw(run)

    def _say_draw(self, run: LiveRun) -> None:
        """Show the number of draws and the verdict of the selected draw as the status."""
        verb = "fails" if run.failed[self.draw] else "passes"
        self.say(f"{run.failed.size:,} draws; red: draw {self.draw}, which {verb}")

    def _choose_draw(self) -> None:
        """Show the present run again, with the draw that the buttons select."""
        if self.now is not None:
            self.show(self.now)

    def ask_margin(self, slider: Slider) -> None:
        """Show how far the number of a slider may go before draws fail, with all other numbers at their positions."""
        self.ask(margin_question(slider, self.positions[slider]), f"walking along {slider.name}")

    def ask_ranges(self) -> None:
        """Show the failure probability over all laws within their ranges, with all other numbers at their positions."""
        study = self.live.ranged_at(self.positions)
        self.ask(law_range_question(study), "simulating the laws within their ranges")

    def ask_flights(self) -> None:
        """Compare the logged flights with the draws of the present run, and show the answer."""
        if self.flights is not None:
            self.answer_by(self.tell_flights, self.flights.question, "comparing the flights with the draws")

    def ask(self, question: Question[str], activity: str) -> None:
        """Answer a question about the present run, unless a newer move supersedes it.

        Args:
            question: The question.
            activity: Description of the work, for the status.
        """
        self.answer_by(self.tell, question, activity)

    def answer_by(self, tell: Callable[[LiveRun, Answer], None], question: Question[Answer], activity: str) -> None:
        """Answer a question as :meth:`ask` does, and show the answer by the function ``tell``."""
        run = self.now
        if run is None:
            return
        self.say(f"{activity} ...")

        def work(stale: Stale) -> None:
            try:
                answer = question(run, stop_when_stale(stale))
            except Superseded:
                return
            except Exception as error:  # as of a run: the page goes on
                self.update(self.complain, f"{activity} ended: {error}")
            else:
                if not stale():
                    self.update(tell, run, answer)

        self.work(work)

    def tell(self, run: LiveRun, text: str) -> None:
        """Show the answer to a question about a run."""
        self.answer.object = markup(h.p(role="status")[text])
        self._say_draw(run)

    def tell_flights(self, run: LiveRun, analysis: Analysis) -> None:
        """Show how the logged flights compare with the draws of a run."""
        if self.flights is not None:
            self.flights.show(analysis)
        self._say_draw(run)

    def compare_with_this(self) -> None:
        """Compare later runs with the present one."""
        self.before = self.now
        if self.now is not None:
            self.show(self.now)

    def save_as(self, name: str) -> None:
        """Write the present study to a new file in the page's folder, and compare a run of it with the present run."""
        run = self.now
        if run is None:
            self.complain("nothing to save yet")
            return
        try:
            path = save_study(run, self.folder, name)
        except ConfigError as error:
            self.complain(str(error))
            return
        command = f"dssc-jax run {path.name}"
        self.say(f"saved {path}; {command} is being compared with what is shown ...")

        def compare(_: Stale) -> None:
            try:
                count = count_differing_draws(run, path)
            except ConfigError as error:
                self.update(self.complain, str(error))
                return
            verdict = f"another outcome in {count:,} draws" if count else "the same outcome in every draw"
            self.update(self.say, f"saved {path}; {command} gives {verdict}")

        self.work(compare)


def slider_widget(slider: Slider) -> pn.widgets.DiscreteSlider:
    """The widget of a slider, which shows positions with four digits."""
    options = {position_text(value): value for value in slider_positions(slider)}
    return pn.widgets.DiscreteSlider(label=slider.label, options=options, value=slider.start, width=SIDE - 20)
