"""Recorded flights of a study, tick by tick: what its software on board reads and holds, in strict arithmetic."""

from collections.abc import Callable, Iterator
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.estimates import estimation_of
from dssc_jax.closed_loop.hold import advance_by_steps
from dssc_jax.closed_loop.sample import LoopState, held_parts, initial_state, step
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import PlantInput, Scalar, State
from dssc_jax.engine.compiled_lanes import compiled_lanes
from dssc_jax.engine.sampling import draw as draw_values
from dssc_jax.engine.sampling import draw_key
from dssc_jax.flight_code.onboard import TracedSoftware, without_held
from dssc_jax.lanes.llvm.machine import usable_cores
from dssc_jax.study import Study

MAGIC = b"dssc-jax inner loop 1"

Row: TypeAlias = tuple[Scalar, ...]
"""Readings, commands and held numbers of one tick."""


def recording_lane(study: Study, samples: int) -> Callable[[dict[str, Scalar], jax.Array], list[Row]]:
    """The program of a lane: (numbers by name, draw index) -> for each tick of a sample a column of each number."""
    loop = study.loop
    software = loop.mimo_plant.software
    assert software is not None

    def lane(values: dict[str, Scalar], index: jax.Array) -> list[Row]:
        params = study.params(values)
        key = draw_key(study.config.seed, index)
        real = jnp.result_type(float)

        def sample(carry: tuple[LoopState, Scalar], slot: None) -> tuple[tuple[LoopState, Scalar], list[Row]]:
            state, k = carry
            rows: list[Row] = []

            def observe(earlier: State, drive: PlantInput, after: State) -> None:
                estimation = estimation_of(loop, params)
                known = earlier if estimation is None else estimation.seen(params.plant, earlier)
                readings = jax.tree.leaves(without_held(software, known))
                commands = (u + d for u, d in zip(drive.command, drive.disturbance, strict=True))
                row = (*readings, *commands, *jax.tree.leaves(software.held(after)))
                rows.append(tuple(jnp.asarray(number, real) for number in row))

            advance = advance_by_steps(held_parts(loop), params.plant, params.unmodelled, observe)
            del slot
            following, _ = step(loop, params, key, state, k, advance)
            return (following, k + 1), rows

        initial = (initial_state(loop, params, key), jnp.zeros((), jnp.int32))
        return jax.lax.scan(sample, initial, length=samples)[1]

    return lane


def recorded_ticks(study: Study, traced: TracedSoftware, draws: int, samples: int) -> Iterator[np.ndarray]:
    """The rows of the first draws of a study, shape (ticks, numbers of a row) each."""
    with arithmetic(traced.precision):
        number = jax.ShapeDtypeStruct((), jnp.result_type(float))
        index = jax.ShapeDtypeStruct((), jnp.uint32)
        lane = recording_lane(study, samples)
        lanes = compiled_lanes(lane, dict.fromkeys(study.laws, number), index, strict=True)
        width = lanes.signature.width
        for first in range(0, draws, width):
            indices = np.arange(first, min(first + width, draws))
            ticks = lanes.start((draw_values(study, indices), indices), len(indices), usable_cores())()
            for place in range(len(indices)):
                parts = [np.stack([column[place] for column in columns], axis=1) for columns in ticks]
                yield np.stack(parts, axis=1).reshape(-1, parts[0].shape[1])


def software_recording(flights: Iterator[np.ndarray], precision: int) -> Iterator[bytes]:
    """The bytes of recorded flights for the bench: little-endian, each with its number of ticks."""
    real = np.dtype(f"<f{precision // 8}")
    yield MAGIC + bytes([precision]) + bytes(2)
    for rows in flights:
        yield np.array([len(rows)], "<u4").tobytes() + np.ascontiguousarray(rows, real).tobytes()
