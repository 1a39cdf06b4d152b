"""Programs of lanes that take and return vectors, as machine code if possible, else by plain XLA.

A lane is the work for one draw. Compiled lanes know only numbers, so a vector is passed as one number per entry.
"""

from collections.abc import Callable
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.numerics import arithmetic
from dssc_jax.engine import kernels
from dssc_jax.engine.kernels import Form, Start
from dssc_jax.engine.sampling import Arrays

BATCH_LANES = 4096  # most lanes that run at once

LaneValues: TypeAlias = dict[str, jax.Array]
"""Numbers or vectors of one lane by name."""

Entries: TypeAlias = tuple[jax.Array, ...]
"""The entries of a vector."""

VectorLane: TypeAlias = Callable[[LaneValues, LaneValues, jax.Array], tuple[jax.Array, ...]]
"""The program of a lane with vectors: ``(numbers of the study, vectors, draw index) -> vectors``."""


class LaneProgram:
    """The program of a lane with vectors, compiled in float64 when it first runs; a call runs many lanes.

    Args:
        lane: The program.
    """

    def __init__(self, lane: VectorLane) -> None:
        """Keep the program; the first call determines the sizes of its vectors, and compiles it."""
        self.lane = lane
        self.start: Start | None = None

    def __call__(self, numbers: Arrays, vectors: Arrays, indices: np.ndarray) -> list[np.ndarray]:
        """Run n lanes.

        Args:
            numbers: Numbers of the study by name, each of shape (n,).
            vectors: Vectors by name, each of shape (n, size); their sizes are the same in every call.
            indices: Draw index of each lane, shape (n,).

        Returns:
            Each vector that the lanes return, shape (n, size).
        """
        columns = {name: np.asarray(column, float) for name, column in numbers.items()}
        for name, rows in vectors.items():
            for i, column in enumerate(rows.T):
                columns[entry_name(name, i)] = np.asarray(column, float)
        batches = []
        with arithmetic():
            if self.start is None:
                sizes = {name: rows.shape[1] for name, rows in vectors.items()}
                lane = lane_of_numbers(self.lane, sizes)
                self.start = kernels.compile_batches(
                    cpu_form(), lane, list(columns), BATCH_LANES, tile=None, devices=None
                )
            for first in range(0, len(indices), BATCH_LANES):
                part = slice(first, first + BATCH_LANES)
                finish = self.start({name: column[part] for name, column in columns.items()}, indices[part])
                entries_by_vector, _ = finish()  # and the time at which the batch ended
                batches.append(entries_by_vector)
        results = []
        for entries_by_batch in zip(*batches, strict=True):
            has_entries = len(entries_by_batch[0]) > 0
            rows_by_batch = [np.stack(entries, axis=1) for entries in entries_by_batch if has_entries]
            results.append(np.concatenate(rows_by_batch) if has_entries else np.zeros((len(indices), 0)))
        return results


def entry_name(vector: str, index: int) -> str:
    """The name of a vector's entry among the numbers of a lane; no name of a study contains the blank in it."""
    return f"{vector} {index}"


def lane_of_numbers(lane: VectorLane, sizes: dict[str, int]) -> Callable[[LaneValues, jax.Array], tuple[Entries, ...]]:
    """Return a program with vectors as a function of numbers only, which include the entries of the vectors.

    Args:
        lane: The program.
        sizes: Size of each vector that the program takes, by name.
    """

    def run_lane(values: LaneValues, index: jax.Array) -> tuple[Entries, ...]:
        """The entries of each vector that the program returns."""
        numbers = dict(values)
        vectors = {}
        for name, size in sizes.items():
            vectors[name] = jnp.array([numbers.pop(entry_name(name, i)) for i in range(size)], float)
        return tuple(tuple(vector) for vector in lane(numbers, vectors, index))

    return run_lane


def cpu_form() -> str:
    """The form in which programs of the linearisation run, always on the CPU.

    It is the requested form, or the CPU's counterpart of a form for a GPU.
    """
    counterparts = {Form.GPU.value: Form.LANES, Form.GPU_STRICT.value: Form.STRICT}
    requested_form = kernels.requested_form()
    return counterparts.get(requested_form, requested_form)
