"""The interface between the program of a lane, its machine code and its callers."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

AXIS = "lanes"
"""Name of the axis over the lanes that run together, for :func:`jax.lax.pmax` in a lane's program."""

ENTRY_POINT = "lanes"
"""Name of the function that runs a range of lanes."""


class Signature(NamedTuple):
    """The signature of a lane's machine code, for its callers.

    Args:
        width: Lanes of a vector.
        inputs: Types of the columns that it reads.
        outputs: Type of each column that it writes, and the length of a recording; None for a number.
        results: The tree of results, with 0 in place of each.
        code: The name of the machine code.
    """

    width: int
    inputs: tuple[np.dtype, ...]
    outputs: tuple[tuple[np.dtype, int | None], ...]
    results: Any
    code: str


class Loaded(Protocol):
    """Code of a lane's program that can run."""

    def start(
        self, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray], lanes: int, width: int, threads: int
    ) -> Callable[[], float]:
        """Begin to run all lanes, and return a function that waits for them and tells when they ended.

        Args:
            inputs: Columns of at least ``lanes`` numbers each.
            outputs: Columns for the results.
            lanes: Number of lanes, a multiple of ``width``.
            width: Lanes of a vector.
            threads: How many threads of the CPU to use.

        Returns:
            The function; its result is a time of :func:`time.perf_counter`.
        """
        ...


def stored_type(dtype: np.dtype) -> np.dtype:
    """The type of a value in memory: a truth value is a byte."""
    return np.dtype(np.uint8) if dtype.kind == "b" else dtype
