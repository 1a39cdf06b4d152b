"""The page of a study: sliders, and what they do to failures, signals and the worst draw."""

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
    differing_draws,
    ending_when,
    margins_of,
    over_ranges,
    proof,
    save_study,
)
from dssc_jax.exploration.figures import (
    DrawsFigure,
    FanFigure,
    PathFigure,
    ProbabilityFigure,
    seen_paths,
    shown_signals,
)
from dssc_jax.exploration.flight_view import FlightView
from dssc_jax.exploration.live import LiveRun, LiveStudy, flies
from dssc_jax.exploration.logged_flights import LoggedFlights
from dssc_jax.exploration.page import MEDIAN_DRAW, RANDOM_DRAW, WORST_DRAW, Page, html_pane, markup
from dssc_jax.exploration.sliders import MEDIAN, Slider, grid, position_text
from dssc_jax.exploration.worker import Stale
from dssc_jax.exploration.wrong_laws import WrongLaws, answer_text, how_wrong_text
from dssc_jax.flight_logs.reading.reader import FlightLog
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.result import interval_method

COLOUR_KEY = "blue: now (median, half and 90 % of the draws); grey: before; red: one draw, chosen here or by a click"
SIDE = 330  # px


class StudyPage(Page):
    """A study to explore: moving a slider simulates all draws again.

    In a notebook or a program, a move returns when its run is shown. With ``background`` runs happen in a thread, and
    a newer move replaces an older one.

    Args:
        live: The study with its sliders.
        background: Whether to run in a thread; a served page does.
        folder: Where "save as study" writes.
        logs: Logged flights; with at least one, the page has the card "The next flight".
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
        """Buttons and texts."""
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
        """The figures; their time axes move together."""
        study = self.live.base
        self.probability = ProbabilityFigure()
        self.fans: list[FanFigure] = []
        for name in shown_signals(study):
            x_range = self.fans[0].figure.x_range if self.fans else None
            self.fans.append(FanFigure(study, name, x_range))
        self.draws = DrawsFigure(self.choose_draw)
        self.paths = [PathFigure(*pair) for pair in seen_paths(study)]
        self.flight = FlightView() if flies(study) else None

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
        """Where the sliders stand."""
        return {slider: float(widget.value) for slider, widget in self.sliders.items()}

    def move(self, positions: dict[str, float]) -> None:
        """Move some sliders together, each to its nearest position, and run once.

        Args:
            positions: Positions by the slider's key: the number's dotted name, for a law with ``(median)`` or
                ``(width)``.

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
                values = np.asarray(grid(slider))
                self.sliders[slider].value = float(values[np.argmin(np.abs(values - position))])
        finally:
            self._moving = False
        self.start()

    def _on_move(self, _: object) -> None:
        if not self._moving:
            self.start()

    def start(self) -> None:
        """Run at the present positions."""
        self.say("running ...")
        self.work(partial(self._run, self.positions))

    def _run(self, positions: dict[Slider, float], stale: Stale) -> None:
        """Simulate at the sliders' positions and show the result, or why there is none.

        Args:
            positions: Position of each slider.
            stale: Whether newer positions have arrived; then nothing is shown.
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
        """Show the failure probability of the present run if its laws are wrong as the slider says."""
        run = self.now
        if run is None:
            return
        amounts = self.wrong_laws.amounts

        def answer(stale: Stale) -> None:
            text = answer_text(amounts, run.study, run.failed, interval_method(run.study))
            if not stale():
                self.update(self.wrong_laws.show, text)

        self.work_aside(answer)

    def show_how_wrong(self) -> None:
        """Show how wrong the laws of the present run may be."""
        run = self.now
        if run is None:
            return
        limit = float(self.wrong_laws.limit.value)

        def answer(stale: Stale) -> None:
            text = how_wrong_text(run.study, limit)
            if not stale():
                self.update(self.wrong_laws.show, text)

        self.work_aside(answer)

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
        verb = "fails" if run.failed[self.draw] else "passes"
        self.say(f"{run.failed.size:,} draws; red: draw {self.draw}, which {verb}")

    def _choose_draw(self) -> None:
        if self.now is not None:
            self.show(self.now)

    def ask_margin(self, slider: Slider) -> None:
        """Tell how far a slider's number may go, other numbers as they stand."""
        self.ask(margins_of(slider, self.positions[slider]), f"walking along {slider.name}")

    def ask_ranges(self) -> None:
        """Tell the failure probability over all laws within their ranges, other numbers as they stand."""
        study = self.live.ranged_at(self.positions)
        self.ask(over_ranges(study), "simulating the laws within their ranges")

    def ask_flights(self) -> None:
        """Tell what the logged flights say of the next one, and of the study as it stands."""
        if self.flights is not None:
            self.answer_by(self.tell_flights, self.flights.question, "comparing the flights with the draws")

    def ask(self, question: Question[str], activity: str) -> None:
        """Answer a question about the present run; a newer move ends the search for the answer."""
        self.answer_by(self.tell, question, activity)

    def answer_by(self, tell: Callable[[LiveRun, Answer], None], question: Question[Answer], activity: str) -> None:
        """Answer a question as :meth:`ask` does, and show the answer by a function."""
        run = self.now
        if run is None:
            return
        self.say(f"{activity} ...")

        def work(stale: Stale) -> None:
            try:
                answer = question(run, ending_when(stale))
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
        """Show what the logged flights say of a run's study."""
        if self.flights is not None:
            self.flights.show(analysis)
        self._say_draw(run)

    def compare_with_this(self) -> None:
        """Make the present run the one that later ones are compared with."""
        self.before = self.now
        if self.now is not None:
            self.show(self.now)

    def save_as(self, name: str) -> None:
        """Write the study that is shown as a new file of the page's folder, and compare the outcomes of its run."""
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
                count = differing_draws(run, path)
            except ConfigError as error:
                self.update(self.complain, str(error))
                return
            verdict = f"another outcome in {count:,} draws" if count else "the same outcome in every draw"
            self.update(self.say, f"saved {path}; {command} gives {verdict}")

        self.work(compare)


def slider_widget(slider: Slider) -> pn.widgets.DiscreteSlider:
    """The widget of a slider; its texts are numbers with four digits."""
    options = {position_text(value): value for value in grid(slider)}
    return pn.widgets.DiscreteSlider(label=slider.label, options=options, value=slider.start, width=SIDE - 20)
