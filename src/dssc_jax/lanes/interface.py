"""What the program of a lane, its machine code and its callers agree on."""

from typing import Any, NamedTuple

import numpy as np

AXIS = "lanes"
"""Name of the axis over the lanes that run together, for :func:`jax.lax.pmax` in a lane's program."""

ENTRY_POINT = "lanes"
"""Name of the function that runs a range of lanes."""


class Signature(NamedTuple):
    """What a caller of a lane's machine code must know.

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


def stored_type(dtype: np.dtype) -> np.dtype:
    """The type of a value in memory: a truth value is a byte."""
    return np.dtype(np.uint8) if dtype.kind == "b" else dtype
