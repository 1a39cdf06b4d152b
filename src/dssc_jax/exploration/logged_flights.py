"""Compare logged flights with the draws, on a card of a study's page."""

import math
from collections.abc import Callable, Sequence

import htpy as h
import panel as pn

from dssc_jax.console.flight import beyond_text, counts_table, limit_table
from dssc_jax.exploration.actions import Question
from dssc_jax.exploration.live import LiveRun
from dssc_jax.exploration.page import PAGE_STYLE, markup
from dssc_jax.flight_logs.comparison import compare_log
from dssc_jax.flight_logs.next_flight import PROBABILITY, NextFlight, next_flight
from dssc_jax.flight_logs.reading.reader import FlightLog
from dssc_jax.plotting import BLUE, GREEN, GREY, ORANGE, RED
from dssc_jax.report import analysis_sections
from dssc_jax.report.elements import table
from dssc_jax.report.subject import AnalysisSubject
from dssc_jax.report.vector import inline_svg
from dssc_jax.results.analysis import Analysis

CONDITION = "This is exact for sliders that were set without looking at these flights."
"""Shown under each answer: sliders that are fitted to the flights make the test too favourable."""
CARD_STYLE = f"""
:host {{ --blue: {BLUE}; --orange: {ORANGE}; --green: {GREEN}; --red: {RED}; --grey: {GREY}; }}
svg.plot {{ width: 100%; max-width: 1000px; height: auto; }}
table {{ margin: 8px 0; }}
caption {{ text-align: left; font-weight: 600; }}
th, td {{ text-align: left; font-weight: 400; padding: 2px 16px 2px 0; vertical-align: top; }}
.meaning {{ display: block; color: #555c64; font-size: 12px; }}
"""


class LoggedFlights:
    """The card about logged flights.

    It compares a single flight with the draws, or compares several flights with the draws and predicts the next one.

    Args:
        logs: The flights, at least one.
        search: Called when the comparison is requested; the page answers by :meth:`show`.
    """

    def __init__(self, logs: Sequence[FlightLog], search: Callable[[], None]) -> None:
        """Make the card's widgets, without an answer."""
        self.logs = tuple(logs)
        self.title = "The next flight" if len(self.logs) > 1 else "The logged flight"
        self.probability = pn.widgets.FloatInput(
            label="in the set with probability", value=PROBABILITY, start=0.0, end=1.0, step=0.01, width=180
        )
        self.compare = pn.widgets.Button(label=f"Compare {len(self.logs)} flights with the draws")
        self.compare.on_click(lambda _: search())
        self.answer = pn.pane.HTML("", stylesheets=[PAGE_STYLE, CARD_STYLE], sizing_mode="stretch_width")

    @property
    def view(self) -> pn.Card:
        """The card for Panel."""
        inputs = [self.probability] if len(self.logs) > 1 else []
        row = pn.Row(*inputs, self.compare)
        return pn.Card(row, self.answer, title=self.title, collapsible=False, sizing_mode="stretch_width")

    @property
    def question(self) -> Question[Analysis]:
        """The question how the flights compare with the draws of a run, for the probability in the field."""
        logs = self.logs
        value = self.probability.value
        probability = math.nan if value is None else float(value)  # NaN: an empty field, which is refused

        def answer(run: LiveRun, check: Callable[..., None]) -> Analysis:
            """Compare a single flight, or predict the next flight."""
            if len(logs) == 1:
                return compare_log(run.study, logs[0], progress=check)
            return next_flight(run.study, logs, probability=probability, progress=check)

        return answer

    def show(self, analysis: Analysis) -> None:
        """Show an answer: the headline, the numbers and the figure."""
        if isinstance(analysis, NextFlight):
            answer = analysis.answer
            limits = table("Limits of the next flight", *limit_table(answer))
            counts = table("Flights that refute or confirm the study", *counts_table(answer.study_test))
            numbers = [limits, h.p[f"{beyond_text(answer)}."], counts]
            if answer.warnings:
                rows = [(warning.log, warning.signal, warning.text) for warning in answer.warnings]
                numbers.append(table("Warnings", ("log", "signal", "warning"), rows, text_columns=3))
        else:
            numbers = analysis_sections.numbers(AnalysisSubject(analysis)).body
        headline = f"{analysis.headline}."
        picture = inline_svg(analysis.figure, headline, "flights")
        self.answer.object = markup(h.div(role="status")[h.p[h.strong[headline]], h.p[CONDITION], numbers, picture])

    def clear(self) -> None:
        """Remove the answer, which belongs to an earlier run."""
        self.answer.object = ""
