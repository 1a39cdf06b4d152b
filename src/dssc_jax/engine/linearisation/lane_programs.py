"""Programs of lanes whose numbers and results include vectors, as machine code if possible, else by plain XLA."""

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

Values: TypeAlias = dict[str, jax.Array]
"""Numbers or vectors of one lane by name."""

Entries: TypeAlias = tuple[jax.Array, ...]
"""The entries of a vector."""

Lane: TypeAlias = Callable[[Values, Values, jax.Array], tuple[jax.Array, ...]]
"""(numbers of the study, vectors, draw index) -> vectors."""


class LaneProgram:
    """The program of a lane with vectors, compiled in float64 when it first runs.

    Compiled lanes take and return numbers, so a vector becomes one column for each of its entries.

    Args:
        lane: The program.
    """

    def __init__(self, lane: Lane) -> None:
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
            columns |= {entry_name(name, i): np.asarray(column, float) for i, column in enumerate(rows.T)}
        batches = []
        with arithmetic():
            if self.start is None:
                sizes = {name: rows.shape[1] for name, rows in vectors.items()}
                lane = lane_of_numbers(self.lane, sizes)
                self.start = kernels.compiled(form(), lane, list(columns), BATCH_LANES, None, None)
            for first in range(0, len(indices), BATCH_LANES):
                part = slice(first, first + BATCH_LANES)
                finish = self.start({name: column[part] for name, column in columns.items()}, indices[part])
                batches.append(finish()[0])
        results = []
        for parts in zip(*batches, strict=True):
            empty = np.zeros((len(indices), 0))
            results.append(np.concatenate([np.stack(part, axis=1) for part in parts]) if parts[0] else empty)
        return results


def entry_name(vector: str, index: int) -> str:
    """The name of a vector's entry as a number; its blank tells it from numbers of a study."""
    return f"{vector} {index}"


def lane_of_numbers(lane: Lane, sizes: dict[str, int]) -> Callable[[Values, jax.Array], tuple[Entries, ...]]:
    """The program of a lane as a function of numbers only, with the entries of vectors among them.

    Args:
        lane: The program.
        sizes: Size of each vector that the program takes, by name.
    """

    def run_lane(values: Values, index: jax.Array) -> tuple[Entries, ...]:
        numbers = dict(values)
        vectors = {}
        for name, size in sizes.items():
            vectors[name] = jnp.array([numbers.pop(entry_name(name, i)) for i in range(size)], float)
        return tuple(tuple(vector) for vector in lane(numbers, vectors, index))

    return run_lane


def form() -> str:
    """The form in which the lanes run; it is one for the CPU even where flights run as a kernel on a GPU."""
    on_cpu = {Form.GPU.value: Form.LANES, Form.GPU_STRICT.value: Form.STRICT}
    requested_form = kernels.requested_form()
    return on_cpu.get(requested_form, requested_form)
