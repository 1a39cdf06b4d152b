"""The robustness of a formula's text over given signals, as the package streams it."""

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.metrics.formulas import formula_metric
from dssc_jax.closed_loop.metrics.instants import Instant, Sample
from dssc_jax.closed_loop.metrics.signal_metrics import SampledSignal
from dssc_jax.closed_loop.metrics.streaming import Span
from dssc_jax.closed_loop.metrics.window import WHOLE_RUN
from dssc_jax.core.numerics import as_arrays
from dssc_jax.study.formulas import FormulaParser

BLANK = Sample(0, 0.0, *[0.0] * 7, info=())
NAMED = {
    "e": SampledSignal("1", "e", lambda instant: instant.channels[0].e),
    "u": SampledSignal("1", "u", lambda instant: instant.channels[0].u),
}


def parsed(text, sample_time, steps):
    """The formula of a text that names e and u."""
    return FormulaParser(text, NAMED, float, sample_time, steps).parse().formula


def lane_of(formula, signals, width=0.0):
    """The function ``scale -> (robustness, samples after which its sign was certain)`` of signals times a scale."""
    metric = formula_metric(formula, "1", "", width)
    certain_after = metric.certain_after
    assert certain_after is not None
    steps = len(signals["e"])
    columns = {name: np.asarray(column) for name, column in signals.items()}

    def lane(scale):
        e, u = (jnp.asarray(columns[name]) for name in ("e", "u"))

        def sample(k, state):
            instant = Instant(0.0, 0.0, (BLANK._replace(k=k, e=scale * e[k], u=scale * u[k]),), ())
            return metric.update(state, instant, WHOLE_RUN)

        state = jax.lax.fori_loop(0, steps, sample, as_arrays(metric.start))
        return metric.value(state, WHOLE_RUN, Span(steps, steps, 0.0)), 1.0 * certain_after(state)

    return lane
