"""Widgets for an error of the laws, and texts with the failure probability under such an error."""

import math
from collections.abc import Callable

import htpy as h
import numpy as np
import panel as pn

from dssc_jax.analyses.defaults import LIMIT
from dssc_jax.analyses.laws.law_errors import laws
from dssc_jax.console.stated import interval_text
from dssc_jax.core.errors import ConfigError
from dssc_jax.exploration.page import html_pane, markup
from dssc_jax.results.result import Result
from dssc_jax.results.scored_draws import ScoredDraws
from dssc_jax.results.stated_errors import StatedAmounts, StatedError, confidence_of
from dssc_jax.statistics import Method
from dssc_jax.statistics.divergence_balls import BALLS
from dssc_jax.study import Study

MOST_ERROR = 1.0
"""Largest size of an error, at the end of the slider."""
STEP = 0.01
"""Step of the slider."""
ALL_MEANS = "shift of all means [standard deviations]"
ALL_WIDTHS = "widening of all laws [share of their width]"
DIVERGENCES = {ball.title: name for name, ball in BALLS.items()}
"""Names of the divergences between two laws, by title."""
ERROR_KINDS = (ALL_MEANS, ALL_WIDTHS, *DIVERGENCES)
"""Kinds of errors of the laws."""


class WrongLaws:
    """Widgets for the kind and the size of an error of the laws, and for the answer.

    Args:
        on_change: Called when the kind or the size changes; the page answers by :meth:`show`.
        on_search: Called when the largest errors are requested; the page answers by :meth:`show`.
    """

    def __init__(self, on_change: Callable[[], None], on_search: Callable[[], None]) -> None:
        """Make the widgets; the size is 0, and there is no answer yet.

        Args:
            on_change: Called when the kind or the size of the law errors changes.
            on_search: Called when the button for the largest law errors is clicked.
        """
        self.kind = pn.widgets.Select(label="The laws may be wrong by a", options=list(ERROR_KINDS), width=300)
        self.size = pn.widgets.FloatSlider(label="of up to", start=0.0, end=MOST_ERROR, step=STEP, value=0.0, width=260)
        self.limit = pn.widgets.FloatInput(label="may fail", value=LIMIT, start=0.0, end=1.0, step=0.01, width=100)
        self.how_wrong = pn.widgets.Button(label="Largest law errors")
        self.how_wrong.on_click(lambda _: on_search())
        self.answer = html_pane("")
        for widget in (self.kind, self.size):
            widget.param.watch(lambda _: on_change(), "value")

    @property
    def view(self) -> pn.Column:
        """The widgets and the answer for Panel."""
        return pn.Column(pn.Row(self.kind, self.size, self.limit, self.how_wrong), self.answer)

    @property
    def amounts(self) -> StatedAmounts:
        """The error of the present kind and size, as one of the amounts that a user may state."""
        size = float(self.size.value)
        if self.kind.value == ALL_MEANS:
            return StatedAmounts({}, shift=size, widening=None)
        if self.kind.value == ALL_WIDTHS:
            return StatedAmounts({}, shift=None, widening=1.0 + size)
        return StatedAmounts({DIVERGENCES[self.kind.value]: size}, shift=None, widening=None)

    @property
    def largest_share(self) -> float:
        """The largest share of draws that may fail; NaN for an empty field, which is refused."""
        value = self.limit.value
        return math.nan if value is None else float(value)

    def show(self, text: str) -> None:
        """Show an answer."""
        self.answer.object = markup(h.p(role="status")[text])


def largest_errors_text(subject: Study | Result, limit: float) -> str:
    """Tell how far the laws may be wrong before too many draws can fail, or why there is no answer.

    Args:
        subject: The study, or its result.
        limit: Largest share of draws that may fail.
    """
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


def probability_text(amounts: StatedAmounts, study: Study, failed: np.ndarray, method: Method) -> str:
    """Tell the failure probability under laws that are wrong by an amount, or why there is no answer.

    Args:
        amounts: The amount, which must be a single one.
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
    """Tell the bounds of the failure probability under laws that are wrong by an amount."""
    parts = []
    if error.interval is not None:
        parts.append(f"in {interval_text(error.interval)} whatever draws fail")
    if error.weighted_interval is not None:
        parts.append(f"in {interval_text(error.weighted_interval)} by the draws' weights")
    elif error.weights_refused:
        parts.append(f"not known better: {error.weights_refused}")
    return f"{error.text}: failure probability {'; '.join(parts)}"
