"""The interface between the program of a lane, its machine code and its callers."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

AXIS = "lanes"
"""Name of the axis along which lanes that run together are reduced by :func:`jax.lax.pmax`."""

ENTRY_POINT = "lanes"
"""Name of the function that runs a range of lanes."""


class Signature(NamedTuple):
    """The signature of a lane's machine code: all that a caller must know to run the code.

    Args:
        width: Number of lanes in a vector.
        inputs: Dtype of each column that the code reads.
        outputs: For each column that the code writes, its dtype and the length of a recording in one lane. The length
            is None if the column has one number for each lane.
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
            outputs: Columns that the code fills with results, one number or one recording for each lane.
            lanes: Number of lanes, a multiple of ``width``.
            width: Number of lanes in a vector.
            threads: Number of threads of the CPU; without effect on a GPU.

        Returns:
            A function that waits for the lanes, and returns the time of :func:`time.perf_counter` at which they ended.
        """
        ...


def stored_type(dtype: np.dtype) -> np.dtype:
    """Return the dtype in which memory holds values of a dtype: a byte for truth values, else the dtype itself."""
    return np.dtype(np.uint8) if dtype.kind == "b" else dtype
