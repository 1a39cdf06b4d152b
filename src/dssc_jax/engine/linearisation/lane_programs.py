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

MARK = "@"
"""First character of the names of what a lane is given beside the study's numbers."""
STATE = "@state"
SAMPLE = "@sample"

Numbers: TypeAlias = tuple[jax.Array, ...]
"""A vector as numbers, which are what a lane returns."""

Lane: TypeAlias = Callable[[dict[str, jax.Array], jax.Array], tuple[Numbers, ...]]
"""(numbers by name, draw index) -> vectors."""


def numbers_of(vector: jax.Array) -> Numbers:
    """The numbers of a vector."""
    return tuple(vector[i] for i in range(vector.shape[0]))


def columns_of(label: str, rows: np.ndarray) -> Arrays:
    """Vectors of shape (n, size) as columns of their numbers, which :func:`vector_in` joins in a lane.

    A label begins with :data:`MARK`.
    """
    return {f"{label} {i}": column for i, column in enumerate(rows.T)}


def vector_in(values: dict[str, jax.Array], label: str) -> jax.Array:
    """The vector with a label among the numbers of a lane."""
    size = sum(name.rpartition(" ")[0] == label for name in values)
    return jnp.stack([values[f"{label} {i}"] for i in range(size)]) if size else jnp.zeros(0)


def numbers_of_study(values: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """The study's numbers among those of a lane."""
    return {name: value for name, value in values.items() if not name.startswith(MARK)}


class LaneProgram:
    """A lane's program, compiled in float64 when it first runs.

    Args:
        lane: The program.
    """

    def __init__(self, lane: Lane) -> None:
        self.lane = lane
        self.start: Start | None = None

    def __call__(self, columns: Arrays, indices: np.ndarray) -> list[np.ndarray]:
        """Every vector that the lanes return, shape (n, size) each.

        Args:
            columns: Numbers by name, each of shape (n,).
            indices: Draw index of each lane, shape (n,).
        """
        count = len(indices)
        batches = []
        with arithmetic():
            if self.start is None:
                self.start = kernels.compiled(form(), self.lane, list(columns), BATCH_LANES, None, None)
            for first in range(0, count, BATCH_LANES):
                part = slice(first, first + BATCH_LANES)
                finish = self.start(
                    {name: np.asarray(column[part], float) for name, column in columns.items()}, indices[part]
                )
                batches.append(finish()[0])
        vectors = []
        for parts in zip(*batches, strict=True):
            empty = np.zeros((count, 0))
            vectors.append(np.concatenate([np.stack(part, axis=1) for part in parts]) if parts[0] else empty)
        return vectors


def form() -> str:
    """The form in which the lanes run: on a CPU also where flights run on a GPU by this package's kernel."""
    on_cpu = {Form.GPU.value: Form.LANES, Form.GPU_STRICT.value: Form.STRICT}
    requested = kernels.requested()
    return on_cpu.get(requested, requested)
