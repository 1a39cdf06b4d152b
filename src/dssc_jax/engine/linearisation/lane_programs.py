"""Programs of one lane with vectors, for any number of lanes: machine code where there is one, else plain XLA."""

from collections.abc import Callable
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.numerics import arithmetic
from dssc_jax.engine import kernels
from dssc_jax.engine.kernels import Form, Start
from dssc_jax.engine.sampling import Arrays

BATCH_LANES = 4096  # that run at once

Values: TypeAlias = dict[str, jax.Array]
"""Numbers or vectors of one lane by name."""

Entries: TypeAlias = tuple[jax.Array, ...]
"""A vector entry by entry."""

Lane: TypeAlias = Callable[[Values, Values, jax.Array], tuple[jax.Array, ...]]
"""(numbers of the study, vectors, draw index) -> vectors."""


class LaneProgram:
    """A lane's program, compiled in float64 when it first runs.

    Compiled lanes take and return numbers. A vector is one column for each of its entries.

    Args:
        lane: The program.
    """

    def __init__(self, lane: Lane) -> None:
        self.lane = lane
        self.start: Start | None = None

    def __call__(self, numbers: Arrays, vectors: Arrays, indices: np.ndarray) -> list[np.ndarray]:
        """Every vector that the lanes return, shape (n, size) each.

        Args:
            numbers: Numbers of the study by name, each of shape (n,).
            vectors: Vectors by name, each of shape (n, size); their sizes are the same in every call.
            indices: Draw index of each lane, shape (n,).
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
    """The name of an entry of a vector; the numbers of a study have no blanks in their names."""
    return f"{vector} {index}"


def lane_of_numbers(lane: Lane, sizes: dict[str, int]) -> Callable[[Values, jax.Array], tuple[Entries, ...]]:
    """A program of a lane, whose vectors it takes entry by entry.

    Args:
        lane: The program.
        sizes: Sizes of its vectors, by name.
    """
    entries = {name: [entry_name(name, i) for i in range(size)] for name, size in sizes.items()}
    of_vectors = {entry for names in entries.values() for entry in names}

    def run_lane(values: Values, index: jax.Array) -> tuple[Entries, ...]:
        numbers = {name: value for name, value in values.items() if name not in of_vectors}
        vectors = {name: jnp.array([values[entry] for entry in names], float) for name, names in entries.items()}
        return tuple(tuple(vector) for vector in lane(numbers, vectors, index))

    return run_lane


def form() -> str:
    """The form in which the lanes run: on a CPU also where flights run on a GPU by this package's kernel."""
    on_cpu = {Form.GPU.value: Form.LANES, Form.GPU_STRICT.value: Form.STRICT}
    requested_form = kernels.requested_form()
    return on_cpu.get(requested_form, requested_form)
