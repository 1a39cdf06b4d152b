"""A logged flight through the analysed controller, and the signals that the study's draws would log."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.control import ControlState, control, initial_control, near_reference
from dssc_jax.closed_loop.draw import Progress, initial_progress, sampler
from dssc_jax.closed_loop.time_loops import scan_recorded
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic, as_arrays
from dssc_jax.core.signals import Measurement, Outcome, ReferencePoint, Scalar
from dssc_jax.engine import kernels
from dssc_jax.engine.batching import drawn
from dssc_jax.engine.plain import plain_options
from dssc_jax.engine.sampling import draw_key
from dssc_jax.flight_logs.reader import forward_filled
from dssc_jax.study import Study

REPLAY_SHARE = 0.95
"""Share of the samples at which a replay needs the measured output."""
REFERENCE_TOLERANCE = 1e-3  # of a reference's size: resolution and rounding of a log


class ChannelCurves(NamedTuple):
    """A channel's signals in a log: the sensor's readings and the command; of one draw, shape (samples,).

    Args:
        y: Measured output; an angle lies within pi of its reference.
        y_dot: Its measured derivative.
        u_total: The command u + u_n (11).
    """

    y: jax.Array
    y_dot: jax.Array
    u_total: jax.Array


DrawCurves: TypeAlias = tuple[ChannelCurves, ...]
"""The curves of each channel."""


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
    """The command of a channel's analysed differentiator and controller for logged measurements.

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
    if loop.controller[index].takes(study.template.controller[index]):
        raise ConfigError("controller", "takes measured signals beside y and y', which a log does not have")

    def commands(signals: tuple[Measurement, ReferencePoint]) -> jax.Array:
        params = study.params(median_values(study))

        def sample(state: ControlState, signals: tuple[Measurement, ReferencePoint]) -> tuple[ControlState, jax.Array]:
            after, controlled = control(loop, params, index, state, *signals)
            return as_arrays(after), jnp.asarray(controlled.command.total)

        first = jax.tree.map(lambda column: column[0], signals)
        initial = as_arrays(initial_control(loop, params, index, *first))
        return jax.lax.scan(sample, initial, signals)[1]

    with arithmetic(study.config.loop.precision):
        real = jnp.result_type(float)
        measurement = Measurement(*jnp.asarray(readings, real))
        reference = ReferencePoint(*jnp.asarray(references, real))
        compiled = jax.jit(commands, compiler_options=plain_options())
        return np.asarray(compiled((measurement, reference)), float)


def replayed_channel(
    study: Study, index: int, logged: dict[str, np.ndarray], reference: np.ndarray
) -> np.ndarray | str:
    """The command of the analysed controller for a channel's sampled log, or why there is none.

    The study's reference, of shape (3, samples), fills in for the log's, if the logged reference agrees with it.
    """
    if "y" not in logged:
        return "the log has no measured output y"
    share = float(np.mean(np.isfinite(logged["y"])))
    if share < REPLAY_SHARE:
        return (
            f"the log has y at {100 * share:.3g} % of the controller's samples; a replay needs {100 * REPLAY_SHARE:g} %"
            ", and makes up none: log it as often as the controller runs, or set loop.sample_time to the log's"
        )
    signals = {name: forward_filled(values) for name, values in logged.items() if np.isfinite(values).any()}
    defaults = {"y_ref": reference[0]}
    if "y_ref" not in signals or is_close(signals["y_ref"], reference[0]):
        defaults |= {"y_ref_dot": reference[1], "y_ref_ddot": reference[2]}
    signals = {**defaults, **signals}
    missing = [name for name in ("y_dot", "y_ref_dot", "y_ref_ddot") if name not in signals]
    for name in missing:
        signals[name] = np.full(len(signals["y"]), np.nan)
    readings = np.array([signals["y"], signals["y_dot"]])
    desired = np.array([signals["y_ref"], signals["y_ref_dot"], signals["y_ref_ddot"]])
    command = commanded(study, index, readings, desired)
    if np.isfinite(command).all():
        return command
    if missing:
        return f"the controller needs {' or '.join(missing)}, which the log lacks"
    return "the controller's command is not finite for these measurements"


def is_close(logged: np.ndarray, reference: np.ndarray) -> bool:
    """Whether a logged reference is that of the study."""
    size = max(float(np.abs(reference).max()), float(np.ptp(reference)), 1e-300)
    return float(np.abs(logged - reference).max()) <= REFERENCE_TOLERANCE * size


def curves_of_draws(study: Study, samples: int, stride: int = 1) -> Iterator[DrawCurves]:
    """Simulate every draw of a study: the curves of each channel, with every ``stride``-th of the samples.

    A draw that has ended early is NaN from then on; none ends because it has settled.
    """
    program = recorded_lane(study, samples, stride)
    draws = study.config.draws
    values = drawn(study, slice(0, draws))
    with arithmetic(study.config.loop.precision):
        compiled = kernels.compiled_single(program, list(study.laws))
    for index in range(draws):
        with arithmetic(study.config.loop.precision):
            yield compiled({name: float(column[index]) for name, column in values.items()}, index)


def recorded_lane(study: Study, samples: int, stride: int) -> Callable[[dict[str, Scalar], jax.Array], DrawCurves]:
    """The program of a draw: (numbers by name, draw index) -> the curves of each channel."""
    loop = replace(study.loop, settled=None)

    def lane(values: dict[str, Scalar], index: jax.Array) -> DrawCurves:
        params = study.params(values)
        key = draw_key(study.config.seed, index)
        advance = sampler(loop, params, key, (), (), freeze=True)

        def sample(progress: Progress) -> tuple[Progress, DrawCurves]:
            after, recorded = advance(progress)
            running = after.outcome == Outcome.OK
            curves = []
            for i, controlled in enumerate(recorded.controlled):
                reading = near_reference(loop, i, controlled.reading, recorded.references[i])
                signals = map(jnp.asarray, (reading.y, reading.y_dot, controlled.command.total))
                curves.append(ChannelCurves(*signals))
            return after, jax.tree.map(lambda x: jnp.where(running, x, jnp.nan), tuple(curves))

        return scan_recorded(sample, initial_progress(loop, params, key, ()), samples, stride)[1]

    return lane
