"""Rules of gathers, scatters and slices: elements of an array within a lane at indices that the run computes.

An element of a constant table is read from memory. An element of any other array is chosen by a chain of selects. Every
index is first converted to a signed type that can hold the size of the array.

A *window* is a block of neighbouring elements, with the same number of axes as the array. Its *start* is the index of
its first element. Translations are called as in :mod:`~dssc_jax.lanes.tracing.arrays`.
"""

from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np
from jax.extend.core import JaxprEqn

from dssc_jax.lanes.builder import Builder
from dssc_jax.lanes.program import Value
from dssc_jax.lanes.tracing.arrays import Tensor, as_array, as_tensor, elementwise, from_tensor
from dssc_jax.lanes.tracing.memory import Memory
from dssc_jax.lanes.tracing.random_bits import Key
from dssc_jax.lanes.tracing.specification import (
    NUMBER_TYPES,
    SCALARS,
    Parameters,
    TranslationRule,
    any_value,
    array_type,
    no_value,
    one_of,
    rule,
)
from dssc_jax.lanes.unsupported import Unsupported

MOST_SELECTS = 1024  # largest number of elements among which a chain of selects chooses
MOST_COMPARISONS = 16 * MOST_SELECTS  # largest product of the sizes of a written array and its window
INDEX_TYPE = np.dtype(np.int32)
MODES = one_of("CLIP", "FILL_OR_DROP", "PROMISE_IN_BOUNDS")
"""Condition of the mode of a gather or scatter, which tells what happens at indices beyond the array."""


def element(build: Builder, table: Tensor, position: Value) -> Value | Key:
    """Return the element of a one-dimensional array at a position.

    Args:
        build: The builder.
        table: The array: constant, of values or of random keys.
        position: The position, which must lie within the array.

    Raises:
        Unsupported: The array is not constant, and has more than :data:`MOST_SELECTS` elements.
    """
    if table.dtype != object or not table.size or not isinstance(table[0], Key):
        return value_at(build, table, position)
    highs = np.empty_like(table)
    lows = np.empty_like(table)
    for number, key in enumerate(table):
        highs[number] = key.high
        lows[number] = key.low
    return Key(value_at(build, highs, position), value_at(build, lows, position))


def value_at(build: Builder, table: Tensor, position: Value) -> Value:
    """Return the value of a one-dimensional array, constant or of values, at a position; see :func:`element`."""
    if position.operation == "constant":
        entry = table[int(position.detail)]
        return entry if table.dtype == object else build.constant(entry, table.dtype)
    if table.dtype != object:
        return build.add("lookup", position, dtype=table.dtype, detail=table)
    if table.size > MOST_SELECTS:
        raise Unsupported(f"an array of {table.size} numbers that change, read at an index")
    selected = table[-1]
    for number in range(table.size - 2, -1, -1):
        is_at_most = build.add("le", position, build.constant(number, position.dtype))
        selected = build.add("select", is_at_most, table[number], selected)
    return selected


def row(build: Builder, table: Any, at: Value) -> Any:
    """Return the row of an array at an index along its first axis: an array, or a value if the rows are scalars.

    Args:
        build: The builder.
        table: The array, constant or of values.
        at: The index, which must lie within the array.
    """
    row_shape = table.shape[1:]
    row_size = int(np.prod(row_shape))
    columns = table.reshape(table.shape[0], row_size)
    elements = np.empty(row_size, object)
    for column in range(row_size):
        elements[column] = element(build, np.ascontiguousarray(columns[:, column]), at)
    return from_tensor(elements.reshape(row_shape))


def wide_index(build: Builder, start: Value) -> Value:
    """Convert an index to a signed type of 32 or 64 bits.

    The converted index has the same value, except that a value too large for 64 bits becomes the largest one, which is
    beyond the end of every array as well.
    """
    if start.dtype == np.dtype(np.uint64):
        limit = build.constant(np.iinfo(np.int64).max, start.dtype)
        return build.add("convert", build.add("min", start, limit), dtype=np.dtype(np.int64))
    needs_64_bits = start.dtype.itemsize == 8 or start.dtype == np.dtype(np.uint32)
    return build.add("convert", start, dtype=np.dtype(np.int64) if needs_64_bits else INDEX_TYPE)


def clip_index(build: Builder, start: Value, limit: int) -> Value:
    """Return a signed index, clipped to 0, 1, ..., limit."""
    at_least_zero = build.add("max", start, build.constant(0, start.dtype))
    return build.add("min", at_least_zero, build.constant(limit, start.dtype))


def window(build: Builder, operand: Any, starts: Sequence[Value], sizes: Sequence[int]) -> Tensor:
    """Return the window of an array at a start that the run computes, as ``lax.dynamic_slice`` reads the window.

    A start at which the window would reach beyond the array is moved inwards. Each element of the window is selected
    among candidates: the elements of the array that it may be, one for every possible start.

    Args:
        build: The builder.
        operand: The array.
        starts: Start of the window along each axis.
        sizes: Size of the window along each axis.
    """
    limits = largest_starts(operand.shape, sizes)
    start = flat_start(build, starts, limits)
    result = np.empty(tuple(sizes), object)
    for position in np.ndindex(*sizes):
        slices = tuple(slice(at, at + limit + 1) for at, limit in zip(position, limits, strict=True))
        candidates = np.ascontiguousarray(operand[slices]).reshape(-1)
        result[position] = element(build, candidates, start)
    return result


def largest_starts(shape: Sequence[int], sizes: Sequence[int]) -> list[int]:
    """Return, along each axis of an array, the largest start with which a window still lies within the array.

    Args:
        shape: Shape of the array.
        sizes: Size of the window along each axis.
    """
    return [length - size for length, size in zip(shape, sizes, strict=True)]


def flat_start(build: Builder, starts: Sequence[Value], limits: Sequence[int]) -> Value:
    """Return the number of a start among all possible starts, counted from 0 in C's order, the last axis fastest.

    Args:
        build: The builder.
        starts: Start along each axis; it is clipped to 0, ..., the axis's limit.
        limits: Largest possible start along each axis; the smallest is 0.
    """
    free_axes = [axis for axis, limit in enumerate(limits) if limit > 0]
    if not free_axes:
        return build.constant(0, INDEX_TYPE)

    def term(axis: int) -> Value:
        """Return the start along an axis, times the number of possible starts along all later axes."""
        start = build.add("convert", clip_index(build, starts[axis], limits[axis]), dtype=INDEX_TYPE)
        stride = int(np.prod([limits[later] + 1 for later in free_axes if later > axis]))
        return build.add("mul", start, build.constant(stride, INDEX_TYPE))

    total = term(free_axes[0])
    for axis in free_axes[1:]:
        total = build.add("add", total, term(axis))
    return total


def index_vectors(build: Builder, indices: Any) -> list[list[Value]]:
    """Return the index vectors of a gather or scatter, one for each window, with each index in a signed type."""
    tensor = as_tensor(indices, build)
    rows = tensor.reshape(-1, tensor.shape[-1])
    return [[wide_index(build, index) for index in vector] for vector in rows]


def gather(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.gather``: windows of an array at several starts; the new axes that count the windows are batch axes."""
    operand = as_array(operands[0], build)
    indices = operands[1]
    numbers = params["dimension_numbers"]
    sizes = params["slice_sizes"]
    result_type = array_type(equation.outvars[0])
    windows = []
    zero = build.constant(0, INDEX_TYPE)
    for vector in index_vectors(build, indices):
        starts = [zero] * operand.ndim
        for axis, start in zip(numbers.start_index_map, vector, strict=True):
            starts[axis] = start
        elements = window(build, operand, starts, sizes)
        if params["mode"].name == "FILL_OR_DROP":
            is_inside = is_window_inside(build, operand.shape, starts, sizes)
            filler = fill_value_of(build, params["fill_value"], np.dtype(result_type.dtype))
            elements = select_each(build, is_inside, elements, filler)
        windows.append(np.squeeze(elements, tuple(numbers.collapsed_slice_dims)))
    return arranged_windows(windows, result_type.shape, numbers.offset_dims)


def select_each(build: Builder, condition: Value, elements: Tensor, otherwise: Value) -> Tensor:
    """Return an array of selects: each element if the condition holds, else ``otherwise``."""
    return elementwise(lambda element: build.add("select", condition, element, otherwise), build, [elements])


def arranged_windows(windows: Sequence[Tensor], shape: tuple[int, ...], window_axes: Sequence[int]) -> Any:
    """Join windows into one array, whose axes are in the order of a gather's result.

    Args:
        windows: The windows, in C's order of the batch axes.
        shape: Shape of the result.
        window_axes: Axes of the result that are axes of a window; the others are batch axes.
    """
    window_shape = windows[0].shape
    stacked = np.empty((len(windows), *window_shape), object)
    for i, elements in enumerate(windows):
        stacked[i] = from_tensor(elements)
    batch_axes = [axis for axis in range(len(shape)) if axis not in window_axes]
    batch_shape = [shape[axis] for axis in batch_axes]
    batch_first = stacked.reshape((*batch_shape, *window_shape))
    if not shape:
        return from_tensor(batch_first)
    order = np.argsort([*batch_axes, *window_axes])  # the inverse of the permutation that put the batch axes first
    return from_tensor(np.transpose(batch_first, order))


def is_window_inside(build: Builder, shape: Sequence[int], starts: Sequence[Value], sizes: Sequence[int]) -> Value:
    """Return the truth value whether a window lies within an array.

    Args:
        build: The builder.
        shape: Shape of the array.
        starts: Start of the window along each axis.
        sizes: Size of the window along each axis.
    """
    is_inside = build.constant(True, np.dtype(bool))
    for start, limit in zip(starts, largest_starts(shape, sizes), strict=True):
        for operation, bound in (("ge", 0), ("le", limit)):
            is_inside = build.add("and", build.add(operation, start, build.constant(bound, start.dtype)), is_inside)
    return is_inside


def fill_value_of(build: Builder, fill: Any, dtype: np.dtype) -> Value:
    """Return the value that a gather reads beyond its array: ``fill``, or JAX's default for the dtype if that is None.

    JAX's default is the least signed integer, the largest unsigned integer, NaN, or true.
    """
    if fill is not None:
        return build.constant(fill, dtype)
    match dtype.kind:
        case "i":
            return build.constant(np.iinfo(dtype).min, dtype)
        case "u":
            return build.constant(np.iinfo(dtype).max, dtype)
        case "f":
            return build.constant(np.nan, dtype)
    return build.constant(True, dtype)


def combine_window(
    build: Builder, operand: Tensor, starts: Sequence[Value], update: Tensor, combine: Callable[[Value, Value], Value]
) -> Tensor:
    """Return an array in which each element of a window is combined with a new value.

    The start of the window is known only when the lane runs. So for each element of the array and each place that it
    could have in the window, the start is compared with the one that puts the element there.

    Args:
        build: The builder.
        operand: The array.
        starts: Start of the window along each axis; a window that reaches beyond the array changes nothing.
        update: The new values, in the shape of the window.
        combine: ``(old element, new element) -> element``.

    Raises:
        Unsupported: Too many elements would have to be compared.
    """
    if operand.size * update.size > MOST_COMPARISONS:
        raise Unsupported(f"{update.size} of {operand.size} numbers written at an index")
    result = operand.copy()
    limits = largest_starts(operand.shape, update.shape)
    for offset in np.ndindex(update.shape):  # place of an element in the window
        possible_positions = [range(at, at + limit + 1) for at, limit in zip(offset, limits, strict=True)]
        for position in product(*possible_positions):
            is_in_window = build.constant(True, np.dtype(bool))
            for axis, at in enumerate(position):
                start = build.constant(at - offset[axis], starts[axis].dtype)
                is_in_window = build.add("and", build.add("eq", starts[axis], start), is_in_window)
            old_value: Any = result[position]
            new_value: Any = update[offset]
            result[position] = build.add("select", is_in_window, combine(old_value, new_value), old_value)
    return result


def dynamic_slice(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.dynamic_slice``: a window of an array; of an array in memory, a single element."""
    operand, *starts = operands
    if isinstance(operand, Memory):
        return np.array([operand.read(build, wide_index(build, starts[0]))], object)
    wide_starts = [wide_index(build, start) for start in starts]
    return window(build, as_array(operand, build), wide_starts, params["slice_sizes"])


def dynamic_update_slice(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.dynamic_update_slice``: an array with a window replaced; in an array in memory, a single element."""
    operand, update, *starts = operands
    if isinstance(operand, Memory):
        return operand.write(build, wide_index(build, starts[0]), as_tensor(update, build)[0])
    target = as_tensor(operand, build)
    replacement = as_tensor(update, build)
    limits = largest_starts(target.shape, replacement.shape)
    pairs = zip(starts, limits, strict=True)
    clipped_starts = [clip_index(build, wide_index(build, start), limit) for start, limit in pairs]
    return combine_window(build, target, clipped_starts, replacement, lambda old, new: new)


def scatter(operation: str) -> Callable[..., Tensor]:
    """Return the translation of ``lax.scatter``: an array in which several windows are combined with new values.

    Args:
        operation: Operation that combines an old and a new element; empty: the new elements replace the old ones.
    """

    def rule(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
        """Return the changed array; the windows change the array one after another."""
        operand, indices, updates = operands
        numbers = params["dimension_numbers"]
        target = as_tensor(operand, build)
        vectors = index_vectors(build, indices)
        windows = update_windows(as_tensor(updates, build), numbers.update_window_dims, len(vectors))
        clip = params["mode"].name == "CLIP"

        def combined(old: Value, new: Value) -> Value:
            """Return the combination of an old and a new element."""
            return build.add(operation, old, new) if operation else new

        for elements, vector in zip(windows, vectors, strict=True):
            update = np.expand_dims(elements, tuple(numbers.inserted_window_dims))
            limits = largest_starts(target.shape, update.shape)
            starts = [build.constant(0, INDEX_TYPE)] * target.ndim
            for axis, start in zip(numbers.scatter_dims_to_operand_dims, vector, strict=True):
                starts[axis] = clip_index(build, start, limits[axis]) if clip else start
            target = combine_window(build, target, starts, update, combined)
        return target

    return rule


def update_windows(updates: Tensor, window_axes: Sequence[int], count: int) -> Tensor:
    """Return the windows of a scatter's new values, shape (count, ...).

    Args:
        updates: The new values of all windows.
        window_axes: Axes of ``updates`` that are axes of a window; the other axes number the windows.
        count: Number of windows.
    """
    batch_axes = [axis for axis in range(updates.ndim) if axis not in window_axes]
    batch_first = np.transpose(updates, [*batch_axes, *window_axes])
    return batch_first.reshape(count, *(updates.shape[axis] for axis in window_axes))


def has_no_batches(numbers: Any, equation: JaxprEqn) -> bool:
    """Whether a gather or scatter is translated: the dimension numbers name no batch axis of the array itself.

    This is the condition of a parameter; the equation is not needed.
    """
    return not numbers.operand_batching_dims


def scatter_rule(operation: str) -> TranslationRule:
    """Return the rule of a scatter; ``operation`` combines old and new elements, and an empty one replaces the old."""
    return rule(
        scatter(operation), NUMBER_TYPES if operation else SCALARS, dimension_numbers=has_no_batches, mode=MODES,
        update_jaxpr=any_value, update_consts=no_value, indices_are_sorted=any_value, unique_indices=any_value,
    )  # fmt: skip


INDEXING_RULES: dict[str, TranslationRule] = {
    "gather": rule(
        gather, SCALARS, dimension_numbers=has_no_batches, slice_sizes=any_value, mode=MODES, fill_value=any_value,
        indices_are_sorted=any_value, unique_indices=any_value,
    ),
    "dynamic_slice": rule(dynamic_slice, SCALARS, slice_sizes=any_value),
    "dynamic_update_slice": rule(dynamic_update_slice, SCALARS),
    "scatter": scatter_rule(""),
    "scatter-add": scatter_rule("add"),
}  # fmt: skip
"""The rules of gathers, scatters and slices, by the name of JAX's primitive."""
