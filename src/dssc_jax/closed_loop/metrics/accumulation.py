"""The metrics of a draw during its flight: their accumulators at the start, after each sample, and their values."""

from collections.abc import Mapping
from functools import partial

import jax
import jax.numpy as jnp

from dssc_jax.closed_loop.metrics.instants import Instant
from dssc_jax.closed_loop.metrics.margin_kinds import NO_MARGINS
from dssc_jax.closed_loop.metrics.streaming import Accumulator, Measure
from dssc_jax.closed_loop.metrics.window import in_window, span_of
from dssc_jax.core.errors import errors_in_code
from dssc_jax.core.signals import Scalar


def initial_accumulators(
    measures: tuple[Measure, ...], margins: Mapping[str, Scalar] = NO_MARGINS
) -> tuple[Accumulator, ...]:
    """The accumulator of every measure before the first sample.

    A margin of the linearised loop is known before the flight, and no sample changes it. Therefore the accumulator of a
    margin is the margin itself.

    Args:
        measures: The measures.
        margins: Value of each margin of the linearised loop among the measures, by the measure's name.
    """
    accumulators = []
    for measure in measures:
        is_margin = measure.metric.margin is not None
        accumulators.append(margins[measure.name] if is_margin else measure.metric.start)
    return tuple(accumulators)


def update_accumulators(
    measures: tuple[Measure, ...], accumulators: tuple[Accumulator, ...], instant: Instant, k: Scalar, t_s: float
) -> tuple[Accumulator, ...]:
    """The accumulator of every measure after sample k; a measure whose window does not contain k keeps its accumulator.

    Args:
        measures: The measures.
        accumulators: Accumulator of each measure before the sample.
        instant: The loop at the sample.
        k: Index of the sample.
        t_s: Sample time T_s [s].
    """
    updated = []
    for measure, acc in zip(measures, accumulators, strict=True):
        with errors_in_code(f"metric '{measure.kind}'", measure.metric.update):
            new_acc = measure.metric.update(acc, measure.of(instant), measure.window)
            require_like(new_acc, acc)
        is_inside = in_window(measure.window, k, t_s)
        if is_inside is not None:  # None: all samples lie in the window
            new_acc = jax.tree.map(partial(jnp.where, is_inside), new_acc, acc)
        updated.append(new_acc)
    return tuple(updated)


def final_values(
    measures: tuple[Measure, ...], accumulators: tuple[Accumulator, ...], steps: Scalar, t_s: float
) -> dict[str, Scalar]:
    """The value of every measure, by name, at the end of a run.

    Args:
        measures: The measures.
        accumulators: Accumulator of each measure after the last sample.
        steps: Number of samples of the run.
        t_s: Sample time T_s [s].
    """
    computed = {}
    for measure, acc in zip(measures, accumulators, strict=True):
        span = span_of(measure.window, steps, t_s)
        with errors_in_code(f"metric '{measure.kind}'", measure.metric.value):
            value = measure.metric.value(acc, measure.window, span)
            require_like(value, 0.0)  # one number
        computed[measure.name] = value
    return computed


def require_like(value: Accumulator, pattern: Accumulator) -> None:
    """Require that the result of a metric's code has the structure of a pattern, and arrays of the same shapes.

    Args:
        value: The result.
        pattern: An accumulator of the expected form.

    Raises:
        TypeError: The result has another structure, or other shapes.
    """
    structure = jax.tree.structure(value)
    expected = jax.tree.structure(pattern)
    if structure != expected:
        raise TypeError(f"it must return {expected}, got {structure}")
    shapes = [jnp.shape(leaf) for leaf in jax.tree.leaves(value)]
    if shapes != [jnp.shape(leaf) for leaf in jax.tree.leaves(pattern)]:
        raise TypeError(f"it must return numbers, got arrays of shapes {shapes}")
