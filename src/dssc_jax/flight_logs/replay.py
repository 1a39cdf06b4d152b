"""A logged flight through the analysed controller, and the same signals of the study's draws."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.control import ControlState, control, initial_control, near_reference
from dssc_jax.closed_loop.draw import Progress, initial_progress, sampler
from dssc_jax.closed_loop.sample import as_arrays
from dssc_jax.closed_loop.time_loops import scan_recorded
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import Measurement, Outcome, ReferencePoint
from dssc_jax.engine.batching import drawn
from dssc_jax.engine.sampling import draw_key
from dssc_jax.lanes import forms
from dssc_jax.lanes.plain import plain_options
from dssc_jax.study import Study


class ChannelCurves(NamedTuple):
    """What a flight computer logs of a channel: the sensor's readings and the command; of one draw or of many.

    Args:
        y: Measured output; an angle lies within pi of its reference.
        y_dot: Its measured derivative.
        u_total: The command u + u_n (11).
    """

    y: Any
    y_dot: Any
    u_total: Any


def median_values(study: Study) -> dict[str, float]:
    """The median of every law of the study."""
    return {name: float(law.median) for name, law in study.laws.items()}


def study_references(study: Study, samples: int) -> np.ndarray:
    """The study's reference of each channel with its derivatives, shape (channels, 3, samples); medians of laws."""
    with arithmetic(study.config.loop.precision):
        params = study.params(median_values(study)).reference
        times = study.loop.sample_time * jnp.arange(samples)
        points = jax.vmap(lambda t: as_arrays(study.loop.mimo_reference.at(params, t)))(times)
    return np.array([[np.asarray(part, float) for part in point] for point in points])


def commanded(study: Study, index: int, readings: np.ndarray, references: np.ndarray) -> np.ndarray:
    """What the analysed differentiator and controller of a channel command for logged measurements.

    They start from the first sample, as after a reset. Uncertain gains have the medians of their laws.

    Args:
        study: The study, without a sweep.
        index: Position of the channel.
        readings: Measured output and its derivative, shape (2, samples).
        references: Desired output with two derivatives, shape (3, samples).

    Returns:
        The command u + u_n, shape (samples,).
    """
    loop = study.loop

    def flown(measured: tuple[Any, ...], desired: tuple[Any, ...]) -> Any:
        params = study.params(median_values(study))

        def sample(state: ControlState, signals: tuple[Measurement, ReferencePoint]) -> tuple[ControlState, Any]:
            after, controlled = control(loop, params, index, state, *signals)
            return as_arrays(after), controlled.command.total

        columns = Measurement(*measured), ReferencePoint(*desired)
        first = jax.tree.map(lambda column: column[0], columns)
        begin = as_arrays(initial_control(loop, params, index, *first))
        return jax.lax.scan(sample, begin, columns)[1]

    with arithmetic(study.config.loop.precision):
        real = jnp.result_type(float)
        given = [tuple(jnp.asarray(column, real) for column in columns) for columns in (readings, references)]
        return np.asarray(jax.jit(flown, compiler_options=plain_options())(*given), float)


def curves_of_draws(study: Study, samples: int, every: int = 1) -> Iterator[tuple[ChannelCurves, ...]]:
    """Simulate every draw of a study, and give what a flight computer would log of each channel.

    A draw that has ended early is NaN from then on; none ends because it has settled.

    Args:
        study: The study, without a sweep.
        samples: Samples to simulate.
        every: Keep every ``every``-th sample.

    Yields:
        For each draw the curves of each channel, of shape (ceil(samples/every),).
    """
    program, draws = recorded_lane(study, samples, every), study.config.draws
    values = drawn(study, slice(0, draws))
    with arithmetic(study.config.loop.precision):
        single = forms.compiled_single(program, list(study.laws))
    for index in range(draws):
        with arithmetic(study.config.loop.precision):
            yield single({name: float(column[index]) for name, column in values.items()}, index)


def recorded_lane(study: Study, samples: int, every: int) -> Callable[..., tuple[ChannelCurves, ...]]:
    """The program of a draw: (numbers by name, draw index) -> the curves of each channel."""
    loop = replace(study.loop, settled=None)

    def lane(values: dict[str, jax.Array], index: jax.Array) -> tuple[ChannelCurves, ...]:
        params, key = study.params(values), draw_key(study.config.seed, index)
        advance = sampler(loop, params, key, (), freeze=True)

        def sample(at: Progress) -> tuple[Progress, tuple[ChannelCurves, ...]]:
            after, recorded = advance(at)
            going = after.outcome == Outcome.OK
            curves = []
            for i, controlled in enumerate(recorded.controlled):
                reading = near_reference(loop, i, controlled.reading, recorded.references[i])
                curves.append(ChannelCurves(*reading, controlled.command.total))
            return after, jax.tree.map(lambda x: jnp.where(going, x, jnp.nan), as_arrays(tuple(curves)))

        return scan_recorded(sample, initial_progress(loop, params, key, ()), samples, every)[1]

    return lane
