"""Recorded draws of a study in strict arithmetic: what its controllers get and give, sample by sample.

The numbers of the controllers are inputs of the recorded program, as they are in C. In float64 that makes no difference
to an analysis that compiles them in. In float32 it does: what follows from constants alone is rounded once there, and
at each operation here.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.sample import LoopState, held_between_samples, initial_state, step
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import Scalar
from dssc_jax.engine.sampling import draw, draw_key
from dssc_jax.flight_code.controller import SampledController, numbers_by_key
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.lanes.machine import usable_cores
from dssc_jax.study import Study

MAGIC = b"dssc-jax recording 1"
BYTES = 64 << 20
"""Memory for the rows of the draws that are recorded together."""


class RecordedDraw(NamedTuple):
    """One draw of one channel.

    Args:
        channel: Position of the channel.
        parameters: Its controller's numbers.
        rows: For each sample the signals, the command, the state after it and what the controller reports.
    """

    channel: int
    parameters: np.ndarray
    rows: np.ndarray


def recording_lane(study: Study, controllers: Sequence[SampledController], samples: int) -> Any:
    """The program of a lane: (numbers by name, draw index) -> for each channel a column of each member of a row."""

    def lane(values: dict[str, jax.Array], index: jax.Array) -> Any:
        loop, params = study.loop, study.params(values)
        key = draw_key(study.config.seed, index)
        advance = held_between_samples(loop, params)

        def sample(at: tuple[LoopState, Scalar], _: None) -> tuple[tuple[LoopState, Scalar], Any]:
            state, k = at
            after, recorded = step(loop, params, key, state, k, advance)
            rows = []
            for channel, reference, controlled in zip(
                after.channels, recorded.references, recorded.controlled, strict=True
            ):
                command = controlled.command
                given = (command.robust, command.nominal, command.total)
                rows.append(
                    (*controlled.reading, *reference, *given, *jax.tree.leaves((channel.control, controlled.info)))
                )
            real = jnp.result_type(float)
            return (after, k + 1), jax.tree.map(lambda x: jnp.asarray(x, real), rows)

        begin = initial_state(loop, params, key), jnp.zeros((), jnp.int32)
        return jax.lax.scan(sample, begin, length=samples)[1]

    return lane


def recorded_draws(
    study: Study, controllers: Sequence[SampledController], draws: int, samples: int
) -> Iterator[RecordedDraw]:
    """Record draws in strict arithmetic.

    Args:
        study: The study; its sweep is ignored.
        controllers: Its controllers.
        draws: Draws from the first on.
        samples: Samples of each.

    Raises:
        Unsupported: The loop has no machine code.
    """
    constants = numbers_by_key(list(controllers))
    with arithmetic(study.config.loop.precision):
        number = jax.ShapeDtypeStruct((), jnp.result_type(float))
        names = sorted({*study.laws, *constants})
        index = jax.ShapeDtypeStruct((), jnp.uint32)
        lanes = CompiledLanes(
            recording_lane(study, controllers, samples), dict.fromkeys(names, number), index, strict=True
        )
        width, columns = lanes.signature.width, len(lanes.signature.outputs)
        together = max(1, BYTES // (samples * columns * np.dtype(number.dtype).itemsize * width)) * width
        for first in range(0, draws, together):
            indices = np.arange(first, min(first + together, draws))
            drawn = draw(study, indices)
            values = {name: drawn.get(name, np.full(len(indices), constants.get(name))) for name in names}
            channels = lanes.start((values, indices), len(indices), usable_cores())()
            for place in range(len(indices)):
                for controller, rows in zip(controllers, channels, strict=True):
                    parameters = [values[each.key][place] for each in controller.parameters]
                    yield RecordedDraw(
                        controller.index,
                        np.asarray(parameters, controller.real),
                        np.stack([column[place] for column in rows], axis=1),
                    )


def row_names(controller: SampledController) -> tuple[str, ...]:
    """Names of the results in a row, after the signals."""
    states = (f"state.{name}" for name in controller.states)
    return ("command.u", "command.u_n", "command.u_p", *states, *(f"telemetry.{name}" for name in controller.infos))


def recording(draws: Iterator[RecordedDraw], precision: int) -> Iterator[bytes]:
    """The bytes of recorded draws for the bench: little-endian, each draw with its channel and number of samples."""
    real = np.dtype(f"<f{precision // 8}")
    yield MAGIC + bytes([precision]) + bytes(3)
    for each in draws:
        yield np.array([each.channel, len(each.rows)], "<u4").tobytes()
        yield each.parameters.astype(real).tobytes() + np.ascontiguousarray(each.rows, real).tobytes()
