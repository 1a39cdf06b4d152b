"""Recorded draws of a study in strict arithmetic: the inputs and results of its controllers, sample by sample.

The numbers of the controllers are inputs of the recorded program, as they are in C, whereas an analysis compiles them
in. In float64 that makes no difference. In float32 it does: a result of constants alone is rounded once in an analysis,
and after each operation here.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.closed_loop.sample import LoopState, held_between_samples, step
from dssc_jax.core.signals import Scalar
from dssc_jax.engine.sampling import draw_key
from dssc_jax.flight_code.controller import COMMAND, SampledController, command_parts, study_values, takes_signals
from dssc_jax.flight_code.replay_bench import recorded_columns
from dssc_jax.study import Study

MAGIC = b"dssc-jax recording 1"
"""Bytes with which a recording begins."""

Rows: TypeAlias = list[tuple[Scalar, ...]]
"""A row for each channel."""


class RecordedDraw(NamedTuple):
    """The recording of one draw of one channel.

    Args:
        channel: Position of the channel.
        parameters: Parameters of its controller.
        rows: For each sample the signals, the command, the state after the sample and the telemetry, shape (samples,
            members of a row).
    """

    channel: int
    parameters: np.ndarray
    rows: np.ndarray


def recording_lane(study: Study, samples: int) -> Callable[[dict[str, Scalar], jax.Array], Rows]:
    """Make the program that records a draw: ``(numbers by name, draw index) -> a row for each channel``.

    Each member of a row is a column of shape (samples,).

    Args:
        study: The study.
        samples: Number of samples of a draw.
    """
    has_signals = takes_signals(study)

    def lane(values: dict[str, Scalar], index: jax.Array) -> Rows:
        """Simulate a draw, and return the rows of its channels."""
        loop = study.loop
        params = study.params(values)
        key = draw_key(study.config.seed, index)
        advance = held_between_samples(loop, params)

        def sample(carry: tuple[LoopState, Scalar], _: None) -> tuple[tuple[LoopState, Scalar], Rows]:
            """Simulate one sample, and record signals, command, state and telemetry of each channel."""
            state, k = carry
            after, recorded = step(loop, params, key, state, k, advance)
            rows = []
            for channel, reference, controlled in zip(
                after.channels, recorded.references, recorded.controlled, strict=True
            ):
                command = command_parts(controlled.command)
                results = jax.tree.leaves((channel.control, controlled.info))
                reading = controlled.reading if has_signals else controlled.reading._replace(signals=())
                rows.append((*jax.tree.leaves(reading), *reference, *command, *results))
            real = jnp.result_type(float)
            return (after, k + 1), jax.tree.map(lambda x: jnp.asarray(x, real), rows)

        first_sample = jnp.zeros((), jnp.int32)
        _, rows = jax.lax.scan(sample, (initial_state(loop, params, key), first_sample), length=samples)
        return rows

    return lane


def recorded_draws(
    study: Study, controllers: Sequence[SampledController], draws: int, samples: int
) -> Iterator[RecordedDraw]:
    """Record the first draws of a study in strict arithmetic, all channels of a draw before the next draw.

    Args:
        study: The study.
        controllers: The controller of each channel.
        draws: Number of draws.
        samples: Number of samples of a draw.

    Raises:
        Unsupported: The loop has no strict machine code.
    """
    lane = recording_lane(study, samples)
    for values, channels in recorded_columns(study, lane, draws, study_values(controllers)):
        for controller, columns in zip(controllers, channels, strict=True):
            parameters = [values[parameter.key] for parameter in controller.parameters]
            yield RecordedDraw(controller.index, np.asarray(parameters, controller.real), np.stack(columns, axis=1))


def row_names(controller: SampledController) -> list[str]:
    """Names of the members of a row after the signals."""
    commands = [f"command.{member}" for member in COMMAND]
    states = [f"state.{state}" for state in controller.states]
    return [*commands, *states, *(f"telemetry.{info}" for info in controller.infos)]


def recording(draws: Iterator[RecordedDraw], precision: int) -> Iterator[bytes]:
    """The bytes of recorded draws for the bench, little-endian; each begins with its channel and number of samples.

    Args:
        draws: The recorded draws.
        precision: Bits of a number.
    """
    real = np.dtype(f"<f{precision // 8}")
    yield MAGIC + bytes([precision]) + bytes(3)  # three zeros, so that words of 4 bytes follow in their places
    for draw in draws:
        yield np.array([draw.channel, len(draw.rows)], "<u4").tobytes()
        yield draw.parameters.astype(real).tobytes() + np.ascontiguousarray(draw.rows, real).tobytes()
