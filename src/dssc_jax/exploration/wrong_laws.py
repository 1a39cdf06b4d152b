"""A slider for how wrong the laws may be, beside the failure probability that follows."""

from collections.abc import Callable

import htpy as h
import numpy as np
import panel as pn

from dssc_jax.analyses.defaults import LIMIT
from dssc_jax.analyses.laws.law_errors import laws
from dssc_jax.core.errors import ConfigError
from dssc_jax.exploration.page import html_pane, markup
from dssc_jax.results.result import Result
from dssc_jax.results.scored_draws import ScoredDraws
from dssc_jax.results.stated_errors import StatedAmounts, StatedError, confidence_of
from dssc_jax.statistics import Method, rounded_probability
from dssc_jax.statistics.divergence_balls import BALLS
from dssc_jax.study import Study

MOST, STEP = 1.0, 0.01  # end and step of the slider
ALL_MEANS = "shift of all means [standard deviations]"
ALL_WIDTHS = "widening of all laws [share of their width]"
AMOUNTS: dict[str, Callable[[float], StatedAmounts]] = {
    ALL_MEANS: lambda size: StatedAmounts({}, size, None),
    ALL_WIDTHS: lambda size: StatedAmounts({}, None, 1.0 + size),
} | {ball.title: lambda size, name=name: StatedAmounts({name: size}, None, None) for name, ball in BALLS.items()}
"""How the laws may be wrong, and the amounts of a slider's position."""


class WrongLaws:
    """How wrong the laws may be, as a choice and a slider, and what follows for the failure probability.

    Args:
        follow: Called when the choice or the slider moves; the page answers by :meth:`show`.
        search: Called when the page is asked how wrong the laws may be.
    """

    def __init__(self, follow: Callable[[], None], search: Callable[[], None]) -> None:
        self.kind = pn.widgets.Select(label="The laws may be wrong by a", options=list(AMOUNTS), width=300)
        self.size = pn.widgets.FloatSlider(label="of up to", start=0.0, end=MOST, step=STEP, value=0.0, width=260)
        self.limit = pn.widgets.FloatInput(label="may fail", value=LIMIT, start=0.0, end=1.0, step=0.01, width=100)
        self.how_wrong = pn.widgets.Button(label="Largest law errors")
        self.how_wrong.on_click(lambda _: search())
        self.answer = html_pane("")
        for widget in (self.kind, self.size):
            widget.param.watch(lambda _: follow(), "value")

    @property
    def view(self) -> pn.Column:
        """The widgets and the answer for Panel."""
        return pn.Column(pn.Row(self.kind, self.size, self.limit, self.how_wrong), self.answer)

    @property
    def amounts(self) -> StatedAmounts:
        """The amounts that the slider stands for."""
        return AMOUNTS[self.kind.value](float(self.size.value))

    def show(self, text: str) -> None:
        """Show an answer."""
        self.answer.object = markup(h.p(role="status")[text])


def how_wrong_text(subject: Study | Result, limit: float) -> str:
    """How wrong the laws may be before more than a share of all draws can fail, in words, or why there is no answer."""
    try:
        law_errors = laws(subject, limit=limit)
    except ConfigError as error:
        return str(error)
    answer = law_errors.answer
    texts = [law_errors.headline, f"Kullback-Leibler {answer.kl:.3g}, total variation {answer.total_variation:.3g}"]
    if answer.most_important:
        texts.append(f"the law of {answer.most_important} may be least wrong")
    if answer.measure_next:
        texts.append(f"measure {answer.measure_next} next")
    return "; ".join(texts)


def answer_text(amounts: StatedAmounts, study: Study, failed: np.ndarray, method: Method) -> str:
    """The failure probability if the laws are wrong by an amount, in words, or why there is no answer.

    Args:
        amounts: One amount.
        study: The study, without a sweep.
        failed: Whether each draw failed, shape (draws,).
        method: Method of the interval of the failure probability.
    """
    try:
        amounts.require(study)
    except ConfigError as error:
        return str(error)
    low, high = method.failure_interval(failed).tolist()
    (error,) = amounts.errors(ScoredDraws.of(study, failed), (low, high), confidence_of(method))
    return error_text(error)


def error_text(error: StatedError) -> str:
    """What follows from an amount, in words."""
    parts = []
    if error.interval is not None:
        parts.append(f"in {interval_text(error.interval)} whatever draws fail")
    if error.weighted_interval is not None:
        parts.append(f"in {interval_text(error.weighted_interval)} by the draws' weights")
    elif error.weights_refused:
        parts.append(f"not known better: {error.weights_refused}")
    return f"{error.text}: failure probability {'; '.join(parts)}"


def interval_text(interval: tuple[float, float]) -> str:
    """An interval of a probability as text."""
    low, high = interval
    return f"[{rounded_probability(low)}, {rounded_probability(high)}]"
