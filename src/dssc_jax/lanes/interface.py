"""The interface between the program of a lane, its machine code and its callers."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

AXIS = "lanes"
"""Name of the axis along which lanes that run together are reduced by :func:`jax.lax.pmax`."""

ENTRY_POINT = "lanes"
"""Name of the function that runs a range of lanes."""


class Signature(NamedTuple):
    """The signature of a lane's machine code: all that a caller must know of it.

    Args:
        width: Lanes of a vector.
        inputs: Dtype of each column that the code reads.
        outputs: Dtype of each column that the code writes, with the length of a recording, or None for a number.
        results: The tree of results, with 0 in place of each result.
        code: Name of the machine code in the cache.
    """

    width: int
    inputs: tuple[np.dtype, ...]
    outputs: tuple[tuple[np.dtype, int | None], ...]
    results: Any
    code: str


class Loaded(Protocol):
    """Machine code of a lane that is ready to run."""

    def start(
        self, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray], lanes: int, width: int, threads: int
    ) -> Callable[[], float]:
        """Begin to run all lanes.

        Args:
            inputs: Columns of at least ``lanes`` numbers each.
            outputs: Columns for the results.
            lanes: Number of lanes, a multiple of ``width``.
            width: Lanes of a vector.
            threads: Number of threads of the CPU.

        Returns:
            A function that waits for the lanes, and returns the time of :func:`time.perf_counter` at which they ended.
        """
        ...


def stored_type(dtype: np.dtype) -> np.dtype:
    """The dtype in which a value of some dtype is stored in memory: a truth value is a byte."""
    return np.dtype(np.uint8) if dtype.kind == "b" else dtype
