"""Recorded draws of a study in strict arithmetic: what its controllers get and give, sample by sample.

The numbers of the controllers are inputs of the recorded program, as they are in C. In float64 that makes no difference
to an analysis that compiles them in. In float32 it does: what follows from constants alone is rounded once there, and
at each operation here.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.sample import LoopState, held_between_samples, initial_state, step
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import Scalar
from dssc_jax.engine.compiled_lanes import compiled_lanes
from dssc_jax.engine.sampling import draw_key
from dssc_jax.flight_code.controller import COMMAND, SampledController, command_parts, study_values, takes_signals
from dssc_jax.flight_code.parameters import numbers_of_draws
from dssc_jax.lanes.llvm.machine import usable_cores
from dssc_jax.study import Study

MAGIC = b"dssc-jax recording 1"
BATCH_BYTES = 64 << 20
"""Memory for the rows of the draws that are recorded together."""

Rows: TypeAlias = list[tuple[Scalar, ...]]
"""One row for each channel."""


class RecordedDraw(NamedTuple):
    """One draw of one channel."""

    channel: int  # position of the channel
    parameters: np.ndarray  # its controller's numbers
    rows: np.ndarray  # for each sample the signals, the command, the state after it and the telemetry


def recording_lane(
    study: Study, controllers: Sequence[SampledController], samples: int
) -> Callable[[dict[str, Scalar], jax.Array], Rows]:
    """The program of a lane: (numbers by name, draw index) -> for each channel a column of each member of a row."""

    signals = takes_signals(study)

    def lane(values: dict[str, Scalar], index: jax.Array) -> Rows:
        loop = study.loop
        params = study.params(values)
        key = draw_key(study.config.seed, index)
        advance = held_between_samples(loop, params)

        def sample(carry: tuple[LoopState, Scalar], _: None) -> tuple[tuple[LoopState, Scalar], Rows]:
            state, k = carry
            after, recorded = step(loop, params, key, state, k, advance)
            rows = []
            for channel, reference, controlled in zip(
                after.channels, recorded.references, recorded.controlled, strict=True
            ):
                command = command_parts(controlled.command)
                results = jax.tree.leaves((channel.control, controlled.info))
                reading = controlled.reading if signals else controlled.reading._replace(signals=())
                rows.append((*jax.tree.leaves(reading), *reference, *command, *results))
            real = jnp.result_type(float)
            return (after, k + 1), jax.tree.map(lambda x: jnp.asarray(x, real), rows)

        initial = (initial_state(loop, params, key), jnp.zeros((), jnp.int32))
        return jax.lax.scan(sample, initial, length=samples)[1]

    return lane


def recorded_draws(
    study: Study, controllers: Sequence[SampledController], draws: int, samples: int
) -> Iterator[RecordedDraw]:
    """Record the first draws of a study in strict arithmetic."""
    constants = study_values(controllers)
    with arithmetic(study.config.loop.precision):
        number = jax.ShapeDtypeStruct((), jnp.result_type(float))
        index = jax.ShapeDtypeStruct((), jnp.uint32)
        names = sorted({*study.laws, *constants})
        lane = recording_lane(study, controllers, samples)
        lanes = compiled_lanes(lane, dict.fromkeys(names, number), index, strict=True)
        width = lanes.signature.width
        group_bytes = samples * len(lanes.signature.outputs) * np.dtype(number.dtype).itemsize * width
        batch = max(1, BATCH_BYTES // group_bytes) * width
        for first_draw in range(0, draws, batch):
            indices = np.arange(first_draw, min(first_draw + batch, draws))
            values = numbers_of_draws(study, indices, constants)
            inputs = {name: values[name] for name in names}
            channels = lanes.start((inputs, indices), len(indices), usable_cores())()
            for place in range(len(indices)):
                for controller, columns in zip(controllers, channels, strict=True):
                    parameters = [values[parameter.key][place] for parameter in controller.parameters]
                    rows = np.stack([column[place] for column in columns], axis=1)
                    yield RecordedDraw(controller.index, np.asarray(parameters, controller.real), rows)


def row_names(controller: SampledController) -> list[str]:
    """Names of the results in a row, after the signals."""
    commands = [f"command.{member}" for member in COMMAND]
    states = [f"state.{state}" for state in controller.states]
    return [*commands, *states, *(f"telemetry.{info}" for info in controller.infos)]


def recording(draws: Iterator[RecordedDraw], precision: int) -> Iterator[bytes]:
    """The bytes of recorded draws for the bench: little-endian, each draw with its channel and number of samples."""
    real = np.dtype(f"<f{precision // 8}")
    yield MAGIC + bytes([precision]) + bytes(3)
    for draw in draws:
        yield np.array([draw.channel, len(draw.rows)], "<u4").tobytes()
        yield draw.parameters.astype(real).tobytes() + np.ascontiguousarray(draw.rows, real).tobytes()
