"""Rules of gathers, scatters and slices: elements of an array within a lane at indices that the run computes.

An element of a constant table is read from memory, that of any other array by a chain of selects. Every index is first
converted to a signed type that can hold the size of the array.
"""

from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np
from jax.extend.core import JaxprEqn

from dssc_jax.lanes.builder import Builder
from dssc_jax.lanes.program import Value
from dssc_jax.lanes.tracing.arrays import Tensor, as_tensor, elementwise, from_tensor
from dssc_jax.lanes.tracing.memory import Memory
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
INDEX_TYPE = np.dtype(np.int32)
MODES = one_of("CLIP", "FILL_OR_DROP", "PROMISE_IN_BOUNDS")
"""Condition of the mode of a gather or scatter."""


def element(build: Builder, table: Tensor, position: Value) -> Value:
    """The element of a one-dimensional array at a position, which must lie within it.

    Raises:
        Unsupported: The array is neither constant nor short.
    """
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
    """The row of an array at an index along its first axis."""
    inner = table.shape[1:]
    count = int(np.prod(inner))
    columns = table.reshape(table.shape[0], count)
    elements = np.empty(count, object)
    for column in range(count):
        elements[column] = element(build, np.ascontiguousarray(columns[:, column]), at)
    return from_tensor(elements.reshape(inner))


def wide_index(build: Builder, start: Value) -> Value:
    """An index converted to a signed type, in which it has the same value or is beyond the end of every array."""
    if start.dtype == np.dtype(np.uint64):
        limit = build.constant(np.iinfo(np.int64).max, start.dtype)
        return build.add("convert", build.add("min", start, limit), dtype=np.dtype(np.int64))
    wide = start.dtype.itemsize == 8 or start.dtype == np.dtype(np.uint32)
    return build.add("convert", start, dtype=np.dtype(np.int64) if wide else INDEX_TYPE)


def clip_index(build: Builder, start: Value, limit: int) -> Value:
    """A signed index, clipped to 0 .. limit."""
    at_least_zero = build.add("max", start, build.constant(0, start.dtype))
    return build.add("min", at_least_zero, build.constant(limit, start.dtype))


def window(build: Builder, operand: Any, starts: Sequence[Value], sizes: Sequence[int]) -> Tensor:
    """The window of an array at some start, as ``lax.dynamic_slice`` reads it.

    A start at which the window would reach beyond the array is moved inwards. Each element of the window is selected
    among its candidates: the array's elements at that position for every possible start.

    Args:
        build: The builder.
        operand: The array.
        starts: Start of the window along each axis.
        sizes: Size of the window along each axis.
    """
    limits = [size - part for size, part in zip(operand.shape, sizes, strict=True)]
    start = flat_start(build, starts, limits)
    result = np.empty(tuple(sizes), object)
    for position in np.ndindex(*sizes):
        slices = tuple(slice(at, at + limit + 1) for at, limit in zip(position, limits, strict=True))
        candidates = np.ascontiguousarray(operand[slices]).reshape(-1)
        result[position] = element(build, candidates, start)
    return result


def flat_start(build: Builder, starts: Sequence[Value], limits: Sequence[int]) -> Value:
    """The number of a start among all possible ones, in C order.

    Args:
        build: The builder.
        starts: Start along each axis.
        limits: Largest start along each axis; the smallest is 0.
    """
    axes = [axis for axis, limit in enumerate(limits) if limit]
    if not axes:
        return build.constant(0, INDEX_TYPE)

    def term(axis: int) -> Value:
        start = build.add("convert", clip_index(build, starts[axis], limits[axis]), dtype=INDEX_TYPE)
        stride = int(np.prod([limits[inner] + 1 for inner in axes if inner > axis]))
        return build.add("mul", start, build.constant(stride, INDEX_TYPE))

    total = term(axes[0])
    for axis in axes[1:]:
        total = build.add("add", total, term(axis))
    return total


def index_rows(build: Builder, indices: Any) -> list[list[Value]]:
    """The index vectors of a gather or scatter, one for each of its points, in signed types."""
    tensor = as_tensor(indices, build)
    rows = tensor.reshape(-1, tensor.shape[-1])
    return [[wide_index(build, index) for index in vector] for vector in rows]


def gather(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.gather``: windows of an array at several starts."""
    operand, indices = operands
    numbers = params["dimension_numbers"]
    sizes = params["slice_sizes"]
    fill = params["mode"].name == "FILL_OR_DROP"
    if not isinstance(operand, np.ndarray):
        operand = as_tensor(operand, build)
    points = []
    zero = build.constant(0, INDEX_TYPE)
    for vector in index_rows(build, indices):
        starts = [zero] * operand.ndim
        for axis, start in zip(numbers.start_index_map, vector, strict=True):
            starts[axis] = start
        part = window(build, operand, starts, sizes)
        if fill:
            is_inside = is_window_inside(build, operand.shape, starts, sizes)
            fill_value = fill_value_of(build, params["fill_value"], np.dtype(array_type(equation.outvars[0]).dtype))
            part = elementwise(
                lambda x, mask=is_inside, other=fill_value: build.add("select", mask, x, other), build, [part]
            )
        points.append(np.squeeze(part, tuple(numbers.collapsed_slice_dims)))
    stacked = np.empty((len(points), *points[0].shape), object)
    for i, part in enumerate(points):
        stacked[i] = from_tensor(part)
    shape = array_type(equation.outvars[0]).shape
    batch = [axis for axis in range(len(shape)) if axis not in numbers.offset_dims]
    grid = stacked.reshape((*(shape[axis] for axis in batch), *points[0].shape))
    return from_tensor(np.transpose(grid, np.argsort([*batch, *numbers.offset_dims])) if shape else grid)


def is_window_inside(build: Builder, shape: Sequence[int], starts: Sequence[Value], sizes: Sequence[int]) -> Value:
    """Whether a window lies within an array of a shape."""
    is_inside = build.constant(True, np.dtype(bool))
    for size, start, part in zip(shape, starts, sizes, strict=True):
        for operation, bound in (("ge", 0), ("le", size - part)):
            is_inside = build.add("and", build.add(operation, start, build.constant(bound, start.dtype)), is_inside)
    return is_inside


def fill_value_of(build: Builder, fill: Any, dtype: np.dtype) -> Value:
    """The value that a gather reads beyond its array: the given one, or JAX's default for the dtype."""
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
    """An array of which a window is combined with other values.

    Args:
        build: The builder.
        operand: The array.
        starts: Start of the window along each axis; a window that reaches beyond the array changes nothing.
        update: The other values, in the shape of the window.
        combine: ``(old element, new element) -> element``.

    Raises:
        Unsupported: Too many elements would have to be compared.
    """
    if operand.size * update.size > MOST_SELECTS * 16:
        raise Unsupported(f"{update.size} of {operand.size} numbers written at an index")
    result = operand.copy()
    for offset in np.ndindex(update.shape):
        choices = [
            range(at, at + size - part + 1) for at, size, part in zip(offset, operand.shape, update.shape, strict=True)
        ]
        for position in product(*choices):
            is_in_window = build.constant(True, np.dtype(bool))
            for axis, at in enumerate(position):
                start = build.constant(at - offset[axis], starts[axis].dtype)
                is_in_window = build.add("and", build.add("eq", starts[axis], start), is_in_window)
            old_value: Any = result[position]
            new_value: Any = update[offset]
            result[position] = build.add("select", is_in_window, combine(old_value, new_value), old_value)
    return result


def dynamic_slice(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.dynamic_slice``: a window of an array."""
    operand, *starts = operands
    if isinstance(operand, Memory):
        return np.array([operand.read(build, wide_index(build, starts[0]))], object)
    wide = [wide_index(build, start) for start in starts]
    return window(build, as_tensor(operand, build) if not isinstance(operand, np.ndarray) else operand, wide,
                  params["slice_sizes"])  # fmt: skip


def dynamic_update_slice(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.dynamic_update_slice``: an array with a window replaced."""
    operand, update, *starts = operands
    if isinstance(operand, Memory):
        return operand.write(build, wide_index(build, starts[0]), as_tensor(update, build)[0])
    target = as_tensor(operand, build)
    new = as_tensor(update, build)
    limits = [size - part for size, part in zip(target.shape, new.shape, strict=True)]
    pairs = zip(starts, limits, strict=True)
    clipped_starts = [clip_index(build, wide_index(build, start), limit) for start, limit in pairs]
    return combine_window(build, target, clipped_starts, new, lambda old, new: new)


def scatter(operation: str) -> Callable[..., Tensor]:
    """The translation of ``lax.scatter``: an array with several windows combined with other values.

    Args:
        operation: Operation of the combination; empty: replacement.
    """

    def rule(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
        operand, indices, updates = operands
        numbers = params["dimension_numbers"]
        target = as_tensor(operand, build)
        new = as_tensor(updates, build)
        vectors = index_rows(build, indices)
        batch = [axis for axis in range(new.ndim) if axis not in numbers.update_window_dims]
        windows = np.transpose(new, [*batch, *numbers.update_window_dims])
        windows = windows.reshape(len(vectors), *(new.shape[axis] for axis in numbers.update_window_dims))
        clip = params["mode"].name == "CLIP"

        def combined(old: Value, new: Value) -> Value:
            return build.add(operation, old, new) if operation else new

        for i, vector in enumerate(vectors):
            update = np.expand_dims(windows[i], tuple(numbers.inserted_window_dims))
            starts = [build.constant(0, INDEX_TYPE)] * target.ndim
            for axis, start in zip(numbers.scatter_dims_to_operand_dims, vector, strict=True):
                limit = target.shape[axis] - update.shape[axis]
                starts[axis] = clip_index(build, start, limit) if clip else start
            target = combine_window(build, target, starts, update, combined)
        return target

    return rule


def has_no_batches(numbers: Any, equation: JaxprEqn) -> bool:
    """The condition of a gather's or scatter's dimension numbers: there are no batches."""
    return not numbers.operand_batching_dims


def scatter_rule(operation: str) -> TranslationRule:
    """The rule of a scatter with an operation; see :func:`scatter`."""
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
"""The rule of each primitive by its name."""
