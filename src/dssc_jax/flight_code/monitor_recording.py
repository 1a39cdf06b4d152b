"""Recorded flights of a study with the states and flags of its monitor, in strict arithmetic, for the bench.

Each draw flies twice: as it is, and with deviations that grow from sample to sample and with missing numbers, so that
most flags are raised.
"""

from collections.abc import Callable, Iterator
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.closed_loop.sample import LoopState, Recorded, held_between_samples, step
from dssc_jax.core.signals import Scalar
from dssc_jax.engine.sampling import draw_key
from dssc_jax.flight_code.monitor import ChannelSample, MonitorSample, MonitorState, initial_monitor, monitor
from dssc_jax.flight_code.premises import Premises
from dssc_jax.flight_code.replay_bench import recorded_columns
from dssc_jax.flight_code.traced_monitor import TracedMonitor, typed
from dssc_jax.study import Study

GROWTH = 0.25
"""Growth of the deviations from sample to sample, relative to those of the flight."""
MISSING_EVERY = 61
"""Number of samples from one missing number to the next."""

Row: TypeAlias = tuple[Scalar, ...]
"""The inputs of a sample, its flags, the latched flags, and the floating-point numbers of the state after it."""
Carry: TypeAlias = tuple[LoopState, Scalar, tuple[MonitorState, MonitorState]]
"""State of the loop, number of the sample, and the states of the monitors of both flights."""


def sample_of(premises: Premises, recorded: Recorded) -> MonitorSample:
    """The monitor's inputs at a simulated sample; () in place of each number that no bound of ``premises`` uses.

    Args:
        premises: The bounds of the monitor.
        recorded: The record of one sample of the simulated loop.
    """
    channels = []
    for channel, controlled, reference in zip(premises.channels, recorded.controlled, recorded.references, strict=True):
        command = () if channel.disturbance is None else controlled.command.total
        margin = controlled.info.sliding_margin if channel.slides else ()
        reading = controlled.reading
        channels.append(
            ChannelSample(
                y=reading.y,
                y_dot=reading.y_dot,
                y_ref=reference.y,
                y_ref_dot=reference.y_dot,
                u_p=command,
                sliding_margin=margin,
            )
        )
    vehicle = recorded.instant.plant
    tilt = () if premises.tilt is None else vehicle.tilt
    return MonitorSample(tuple(channels), tilt, tuple(vehicle.rotor) if premises.rotor_count else ())


def exaggerate(premises: Premises, sample: MonitorSample, k: Scalar) -> MonitorSample:
    """The sample k with deviations that grow with k; in one of :data:`MISSING_EVERY` samples, y is missing.

    Args:
        premises: The bounds, which tell the signals that a sample has.
        sample: The sample as the simulation gives it.
        k: Number of the sample.
    """
    factor = 1.0 + GROWTH * k
    is_missing = k % MISSING_EVERY == MISSING_EVERY - 1
    channels = []
    for channel, channel_sample in zip(premises.channels, sample.channels, strict=True):
        y = channel_sample.y_ref + (channel_sample.y - channel_sample.y_ref) * factor
        y_dot = channel_sample.y_ref_dot + (channel_sample.y_dot - channel_sample.y_ref_dot) * factor
        command = () if channel.disturbance is None else channel_sample.u_p * factor
        margin = channel_sample.sliding_margin - 0.01 * factor if channel.slides else ()
        y = jnp.where(is_missing, jnp.nan, y)
        channels.append(channel_sample._replace(y=y, y_dot=y_dot, u_p=command, sliding_margin=margin))
    tilt = () if premises.tilt is None else sample.tilt * factor
    return MonitorSample(tuple(channels), tilt, tuple(rotor + 0.1 * (k % 9 - 4) for rotor in sample.rotor))


def recording_lane(
    study: Study, premises: Premises, samples: int
) -> Callable[[dict[str, Scalar], jax.Array], tuple[Row, Row]]:
    """Make the program that records a draw: ``(numbers by name, draw index) -> rows`` of both flights.

    Each member of a row is a column of shape (samples,).

    Args:
        study: The study.
        premises: The bounds of the monitor.
        samples: Number of samples of a draw.
    """

    def lane(values: dict[str, Scalar], index: jax.Array) -> tuple[Row, Row]:
        """Simulate a draw with two monitors, and return the rows of both flights."""
        loop = study.loop
        params = study.params(values)
        key = draw_key(study.config.seed, index)
        advance = held_between_samples(loop, params)

        def sample(carry: Carry, _: None) -> tuple[Carry, tuple[Row, Row]]:
            """Simulate one sample, and show it to one monitor as it is, and to the other exaggerated."""
            state, k, (plain_monitor, exaggerated_monitor) = carry
            after, recorded = step(loop, params, key, state, k, advance)
            monitor_sample = sample_of(premises, recorded)
            plain_state, plain_row = monitor_row(premises, plain_monitor, monitor_sample)
            exaggerated_sample = exaggerate(premises, monitor_sample, k)
            exaggerated_state, exaggerated_row = monitor_row(premises, exaggerated_monitor, exaggerated_sample)
            return (after, k + 1, (plain_state, exaggerated_state)), (plain_row, exaggerated_row)

        monitors = (typed(initial_monitor(premises)), typed(initial_monitor(premises)))
        first_sample = jnp.zeros((), jnp.int32)
        _, rows = jax.lax.scan(sample, (initial_state(loop, params, key), first_sample, monitors), length=samples)
        return rows

    return lane


def monitor_row(premises: Premises, state: MonitorState, sample: MonitorSample) -> tuple[MonitorState, Row]:
    """The state of the monitor after a sample, and the row to record.

    Args:
        premises: The bounds of the monitor.
        state: The state of the monitor before the sample.
        sample: The monitor's inputs at the sample.
    """
    next_state, current = monitor(premises, state, sample)
    next_state = typed(next_state)
    # The floating-point leaves; the row has the latched flags already, and leaves out the counts of samples.
    memories = [leaf for leaf in jax.tree.leaves(next_state) if leaf.dtype.kind == "f"]
    row = (*jax.tree.leaves(sample), current, next_state.latched, *memories)
    real = jnp.result_type(float)
    return next_state, tuple(jnp.asarray(number, real) for number in row)


def recorded_flights(study: Study, traced_monitor: TracedMonitor, draws: int, samples: int) -> Iterator[np.ndarray]:
    """The rows of a study's first draws, two flights each: an array of shape (samples, members of a row) a flight.

    Args:
        study: The study.
        traced_monitor: The monitor.
        draws: Number of draws.
        samples: Number of samples of a flight.
    """
    lane = recording_lane(study, traced_monitor.premises, samples)
    for _, flights in recorded_columns(study, lane, draws):
        for columns in flights:
            yield np.stack(columns, axis=1)
