"""Operations that move the elements of arrays, on batches along the first axis, by NumPy."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np


def behind(axes: tuple[int, ...]) -> tuple[int, ...]:
    """Axes within a lane as axes of a batch."""
    return tuple(axis + 1 for axis in axes)


def padded(params: dict[str, Any], x: np.ndarray, margin: np.ndarray) -> np.ndarray:
    """A margin around an array; a negative one cuts."""
    sizes = [
        low + size + max(size - 1, 0) * gap + high
        for size, (low, high, gap) in zip(x.shape[1:], params["config"], strict=True)
    ]
    result = np.empty((len(x), *sizes), x.dtype)
    result[:] = margin.reshape((-1,) + (1,) * len(sizes))
    for place in np.ndindex(*x.shape[1:]):
        there = [low + i * (gap + 1) for i, (low, _, gap) in zip(place, params["config"], strict=True)]
        if all(0 <= i < size for i, size in zip(there, sizes, strict=True)):
            result[(slice(None), *there)] = x[(slice(None), *place)]
    return result


def sliced(params: dict[str, Any], x: np.ndarray) -> np.ndarray:
    """A part between fixed indices."""
    parts = zip(params["start"], params["stop"], params["step"], strict=True)
    return x[(slice(None), *(slice(*part) for part in parts))]


def selected(params: dict[str, Any], which: np.ndarray, *cases: np.ndarray) -> np.ndarray:
    """The case that the first operand counts."""
    value = cases[-1]
    for number, case in enumerate(cases[:-1]):
        value = np.where(which == number, case, value)
    return value


def broadcast(params: dict[str, Any], x: np.ndarray) -> np.ndarray:
    """A scalar repeated."""
    shape = params["shape"]
    return np.broadcast_to(x.reshape((-1,) + (1,) * len(shape)), (len(x), *shape))


def whole(index: np.ndarray, low: int, high: int) -> np.ndarray:
    """Indices of any integer type moved into a range."""
    least, most = index.dtype.type(low), index.dtype.type(min(high, int(jnp.iinfo(index.dtype).max)))
    return np.clip(index, least, most).astype(np.int64)


def gather(params: dict[str, Any], x: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Rows at an index or several; what an index beyond the array reads is fixed."""
    indices, rows, last = index.reshape(len(x), -1), np.arange(len(x)), x.shape[1] - 1
    fill = params["fill"]
    if fill is None and x.dtype.kind in "iu":
        limits = np.iinfo(x.dtype)
        fill = limits.min if x.dtype.kind == "i" else limits.max
    missing = np.array({"f": np.nan, "b": True}.get(x.dtype.kind, 0) if fill is None else fill).astype(x.dtype)
    parts = []
    for row in indices.T:
        inside = (row >= 0) & (row <= last)
        part = x[rows, whole(row, 0, last)]
        filled = np.where(inside.reshape((-1,) + (1,) * (part.ndim - 1)), part, missing)
        parts.append(filled if params["mode"] == "fill" else part)
    return np.stack(parts, 1)


def dynamic_slice(params: dict[str, Any], x: np.ndarray, start: np.ndarray, *others: np.ndarray) -> np.ndarray:
    """A window of rows, moved inside if it would reach beyond."""
    size = params["sizes"][0]
    first = whole(from_the_end(start, x.shape[1]), 0, x.shape[1] - size)
    return np.stack([x[np.arange(len(x)), first + i] for i in range(size)], 1)


def dynamic_update_slice(params: dict[str, Any], x: np.ndarray, update: np.ndarray, start: np.ndarray) -> np.ndarray:
    """An array with a window replaced."""
    result, size = x.copy(), update.shape[1]
    first = whole(from_the_end(start, x.shape[1]), 0, x.shape[1] - size)
    for i in range(size):
        result[np.arange(len(x)), first + i] = update[:, i]
    return result


def from_the_end(index: np.ndarray, size: int) -> np.ndarray:
    """A negative index counts from the end, in the index's own type."""
    if index.dtype.kind == "u":
        return index
    return np.where(index < 0, index + np.array(size).astype(index.dtype), index)


COMBINED: dict[str, Callable[..., np.ndarray]] = {
    "scatter": lambda old, new: new, "scatter_add": np.add, "scatter_mul": np.multiply, "scatter_min": np.minimum,
    "scatter_max": np.maximum, "scatter_sub": np.subtract,
}  # fmt: skip


def scatter(params: dict[str, Any], x: np.ndarray, index: np.ndarray, update: np.ndarray) -> np.ndarray:
    """Rows combined with others, in order."""
    result, indices, last = x.copy(), index.reshape(len(x), -1), x.shape[1] - 1
    new = update.reshape((-1,) + (1,) * (x.ndim - 2))
    for row in indices.T:
        inside = np.full(len(x), True) if params["mode"] == "clip" else (row >= 0) & (row <= last)
        lanes = np.flatnonzero(inside)
        place = lanes, whole(row, 0, last)[lanes]
        result[place] = COMBINED[params["name"]](result[place], new[lanes])
    return result


MOVING: dict[str, Callable[..., np.ndarray]] = {
    "stack": lambda params, *operands: np.stack(operands, 1),
    "reshape": lambda params, x: x.reshape(len(x), *params["shape"]),
    "broadcast": broadcast,
    "transpose": lambda params, x: np.transpose(x, (0, *behind(params["axes"]))),
    "rev": lambda params, x: np.flip(x, behind(params["axes"])),
    "slice": sliced,
    "pad": padded,
    "concatenate": lambda params, *operands: np.concatenate(operands, params["axis"] + 1),
    "select_n": selected,
    "gather": gather,
    "dynamic_slice": dynamic_slice,
    "dynamic_update_slice": dynamic_update_slice,
}
"""Function of each operation by its name."""
