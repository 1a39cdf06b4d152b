"""Small arrays within a lane: moved element by element at translation, so that only arithmetic is left to run.

An array of values is a NumPy array of objects. An array that is known before the run keeps its numbers; if it is read
at an index that is only known in the run, it becomes a table in memory. Any other array read so is a chain of selects.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from itertools import pairwise, product
from typing import Any

import numpy as np

from dssc_jax.backend.program import Builder, Value
from dssc_jax.backend.specification import (
    KEY, MOVABLE, NUMBERS, REAL, SCALARS, TRUTH, WHOLE, Rule, Specification, absent, anything, element_type, one_of,
    result_type, rule,
)  # fmt: skip
from dssc_jax.backend.unsupported import Unsupported

Tensor = np.ndarray
MOST_SELECTS = 1024  # elements of an array that are chosen from one by one
INDEX_TYPE = np.dtype(np.int32)


def as_tensor(value: Any, build: Builder) -> Tensor:
    """The elements of a value as an array of objects; of shape () for a scalar."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return value
    tensor = np.empty(np.shape(value) if isinstance(value, np.ndarray) else (), object)
    if isinstance(value, np.ndarray):
        tensor.ravel()[:] = [build.constant(number, value.dtype) for number in value.ravel()]
    else:
        tensor[()] = value
    return tensor


def from_tensor(tensor: Any) -> Any:
    """An array of objects; of shape (), its element."""
    return tensor[()] if isinstance(tensor, np.ndarray) and tensor.dtype == object and not tensor.shape else tensor


def elementwise(function: Callable[..., Any], build: Builder, operands: Sequence[Any]) -> Any:
    """A function of scalars applied to arrays of equal shape, and scalars."""
    if not any(isinstance(operand, np.ndarray) for operand in operands):
        return function(*operands)
    tensors = np.broadcast_arrays(*(as_tensor(operand, build) for operand in operands))
    results = np.empty(tensors[0].shape, object)
    for position in np.ndindex(results.shape):
        results[position] = function(*(tensor[position] for tensor in tensors))
    return results


def element(build: Builder, table: Tensor, position: Value) -> Value:
    """The element of a flat array at a position of the run, which lies within it."""
    if position.operation == "constant":
        found = table[int(position.detail)]
        return found if table.dtype == object else build.constant(found, table.dtype)
    if table.dtype != object:
        return build.add("lookup", position, dtype=table.dtype, detail=table)
    if table.size > MOST_SELECTS:
        raise Unsupported(f"an array of {table.size} numbers that change, read at an index")
    chosen = table[-1]
    for number in range(table.size - 2, -1, -1):
        chosen = build.add("select", build.add("le", position, build.constant(number, position.dtype)), table[number],
                           chosen)  # fmt: skip
    return chosen


def row(build: Builder, table: Any, at: Value) -> Any:
    """A row of an array at an index of the run."""
    inner, count = table.shape[1:], int(np.prod(table.shape[1:]))
    columns = table.reshape(table.shape[0], count)
    elements = np.empty(count, object)
    for column in range(count):
        elements[column] = element(build, np.ascontiguousarray(columns[:, column]), at)
    return from_tensor(elements.reshape(inner))


def wide_index(build: Builder, start: Value) -> Value:
    """An index in a signed type that holds every array's size and all of the index's own values that matter."""
    if start.dtype == np.dtype(np.uint64):  # beyond the largest signed number: the end of every array
        most = build.constant(np.iinfo(np.int64).max, start.dtype)
        return build.add("convert", build.add("min", start, most), dtype=np.dtype(np.int64))
    wide = start.dtype.itemsize == 8 or start.dtype == np.dtype(np.uint32)
    return build.add("convert", start, dtype=np.dtype(np.int64) if wide else INDEX_TYPE)


def clipped(build: Builder, start: Value, most: int) -> Value:
    """A wide index within 0 .. most."""
    return build.add("min", build.add("max", start, build.constant(0, start.dtype)), build.constant(most, start.dtype))


def window(build: Builder, operand: Any, starts: Sequence[Value], sizes: Sequence[int]) -> Tensor:
    """A part of an array of fixed size that begins at indices of the run; moved inside if it would reach beyond."""
    varied = [axis for axis, start in enumerate(starts) if operand.shape[axis] > sizes[axis]]
    limits = [size - part for size, part in zip(operand.shape, sizes, strict=True)]
    flat_start: Value | None = None
    for axis in varied:
        start = clipped(build, starts[axis], limits[axis])
        start = build.add("convert", start, dtype=INDEX_TYPE)
        stride = int(np.prod([limits[later] + 1 for later in varied if later > axis]))
        part = build.add("mul", start, build.constant(stride, INDEX_TYPE))
        flat_start = part if flat_start is None else build.add("add", flat_start, part)
    result = np.empty(tuple(sizes), object)
    for position in np.ndindex(*sizes):
        candidates = operand[tuple(
            slice(at, at + limit + 1) for at, limit in zip(position, limits, strict=True))]  # fmt: skip
        flat = np.ascontiguousarray(candidates).reshape(-1)
        result[position] = element(build, flat, build.constant(0, INDEX_TYPE) if flat_start is None else flat_start)
    return result


def index_rows(build: Builder, indices: Any) -> list[list[Value]]:
    """The index vectors of a gather or scatter, one for each of its points, as wide indices."""
    tensor = as_tensor(indices, build)
    rows = tensor.reshape(-1, tensor.shape[-1])
    return [[wide_index(build, index) for index in vector] for vector in rows]


def gather(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> Any:
    """Windows of an array at indices of the run."""
    operand, indices = operands
    numbers, sizes = params["dimension_numbers"], params["slice_sizes"]
    fill = params["mode"].name == "FILL_OR_DROP"
    if not isinstance(operand, np.ndarray):
        operand = as_tensor(operand, build)
    points, zero = [], build.constant(0, INDEX_TYPE)
    for vector in index_rows(build, indices):
        starts = [zero] * operand.ndim
        for axis, start in zip(numbers.start_index_map, vector, strict=True):
            starts[axis] = start
        part = window(build, operand, starts, sizes)
        if fill:
            inside = lies_within(build, operand.shape, starts, sizes)
            missing = filler(build, params["fill_value"], np.dtype(equation.outvars[0].aval.dtype))
            part = elementwise(lambda x, inside=inside, missing=missing: build.add("select", inside, x, missing),
                               build, [part])  # fmt: skip
        points.append(np.squeeze(part, tuple(numbers.collapsed_slice_dims)))
    stacked = np.empty((len(points), *points[0].shape), object)
    for i, part in enumerate(points):
        stacked[i] = from_tensor(part)
    shape = equation.outvars[0].aval.shape
    batch = [axis for axis in range(len(shape)) if axis not in numbers.offset_dims]
    grid = stacked.reshape((*(shape[axis] for axis in batch), *points[0].shape))
    return from_tensor(np.transpose(grid, np.argsort([*batch, *numbers.offset_dims])) if shape else grid)


def lies_within(build: Builder, shape: Sequence[int], starts: Sequence[Value], sizes: Sequence[int]) -> Value:
    """Whether a window lies within an array."""
    inside = build.constant(True, np.dtype(bool))
    for size, start, part in zip(shape, starts, sizes, strict=True):
        for operation, bound in (("ge", 0), ("le", size - part)):
            inside = build.add("and", build.add(operation, start, build.constant(bound, start.dtype)), inside)
    return inside


def filler(build: Builder, fill: Any, dtype: np.dtype) -> Value:
    """What an index beyond an array reads."""
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


def replaced(
    build: Builder, operand: Tensor, starts: Sequence[Value], update: Tensor, combine: Callable[[Value, Value], Value]
) -> Tensor:
    """An array with a window combined with other values, at indices of the run that lie within it."""
    if operand.size * update.size > MOST_SELECTS * 16:
        raise Unsupported(f"{update.size} of {operand.size} numbers written at an index")
    result = operand.copy()
    for offset in np.ndindex(update.shape):
        choices = [
            range(at, at + size - part + 1) for at, size, part in zip(offset, operand.shape, update.shape, strict=True)
        ]
        for position in product(*choices):
            here = build.constant(True, np.dtype(bool))
            for axis, at in enumerate(position):
                start = build.constant(at - offset[axis], starts[axis].dtype)
                here = build.add("and", build.add("eq", starts[axis], start), here)
            old: Any = result[position]
            new: Any = update[offset]
            result[position] = build.add("select", here, combine(old, new), old)
    return result


def dynamic_slice(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> Any:
    """A window of an array."""
    operand, *starts = operands
    wide = [wide_index(build, start) for start in starts]
    return window(build, as_tensor(operand, build) if not isinstance(operand, np.ndarray) else operand, wide,
                  params["slice_sizes"])  # fmt: skip


def dynamic_update_slice(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> Any:
    """An array with a window replaced."""
    operand, update, *starts = operands
    target, new = as_tensor(operand, build), as_tensor(update, build)
    limits = [size - part for size, part in zip(target.shape, new.shape, strict=True)]
    inside = [clipped(build, wide_index(build, start), limit) for start, limit in zip(starts, limits, strict=True)]
    return replaced(build, target, inside, new, lambda old, new: new)


def scatter(operation: str) -> Callable[[Builder, Sequence[Any], Mapping[str, Any], Any], Any]:
    """An array with windows combined with others, at indices of the run."""

    def rule(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> Any:
        operand, indices, updates = operands
        numbers = params["dimension_numbers"]
        target, new = as_tensor(operand, build), as_tensor(updates, build)
        vectors = index_rows(build, indices)
        batch = [axis for axis in range(new.ndim) if axis not in numbers.update_window_dims]
        windows = np.transpose(new, [*batch, *numbers.update_window_dims])
        windows = windows.reshape(len(vectors), *(new.shape[axis] for axis in numbers.update_window_dims))
        clip = params["mode"].name == "CLIP"
        for i, vector in enumerate(vectors):
            update = np.expand_dims(windows[i], tuple(numbers.inserted_window_dims))
            starts = [build.constant(0, INDEX_TYPE)] * target.ndim
            for axis, start in zip(numbers.scatter_dims_to_operand_dims, vector, strict=True):
                limit = target.shape[axis] - update.shape[axis]
                starts[axis] = clipped(build, start, limit) if clip else start
            target = replaced(build, target, starts, update, lambda old, new: (
                build.add(operation, old, new) if operation else new))  # fmt: skip
        return target

    return rule


def broadcast(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> Any:
    """An array repeated along new axes."""
    shape, axes = params["shape"], params["broadcast_dimensions"]
    if not shape:
        return operands[0]
    source = operands[0] if isinstance(operands[0], np.ndarray) else as_tensor(operands[0], build)
    sizes = [1] * len(shape)
    for axis, size in zip(axes, source.shape, strict=True):
        sizes[axis] = size
    return np.broadcast_to(source.reshape(sizes), shape)


def moving(function: Callable[[Any, Mapping[str, Any]], Any]) -> Callable[..., Any]:
    """A rule that moves the elements of one array by a function of NumPy."""

    def rule(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> Any:
        operand = operands[0] if isinstance(operands[0], np.ndarray) else as_tensor(operands[0], build)
        result = np.asarray(function(operand, params))
        return scalar_of(build, result)

    return rule


def scalar_of(build: Builder, result: Tensor) -> Any:
    """An array; of shape (), the value in it."""
    if result.shape:
        return result
    return result[()] if result.dtype == object else build.constant(result, result.dtype)


def strided(operand: Tensor, params: Mapping[str, Any]) -> Tensor:
    """A part of an array between fixed indices."""
    strides = params["strides"] or [1] * operand.ndim
    parts = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return operand[tuple(slice(start, stop, step) for start, stop, step in parts)]


def reshaped(operand: Tensor, params: Mapping[str, Any]) -> Tensor:
    """The same elements in another shape."""
    return operand.reshape(params["new_sizes"])


def squeezed(operand: Tensor, params: Mapping[str, Any]) -> Tensor:
    """Without axes of size 1."""
    return np.squeeze(operand, tuple(params["dimensions"]))


def expanded(operand: Tensor, params: Mapping[str, Any]) -> Tensor:
    """With new axes of size 1."""
    return np.expand_dims(operand, tuple(params["dimensions"]))


def transposed(operand: Tensor, params: Mapping[str, Any]) -> Tensor:
    """With its axes in another order."""
    return np.transpose(operand, params["permutation"])


def reversed_along(operand: Tensor, params: Mapping[str, Any]) -> Tensor:
    """Backwards along some axes."""
    return np.flip(operand, params["dimensions"])


def concatenate(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> Any:
    """Arrays one after another."""
    known = all(operand.dtype != object for operand in operands)
    parts = operands if known else [as_tensor(operand, build) for operand in operands]
    return np.concatenate(parts, params["dimension"])


def stack(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> Any:
    """Arrays beside one another along a new axis."""
    return np.stack([as_tensor(operand, build) for operand in operands], params["axis"])


def unstack(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> list[Any]:
    """The parts of an array along an axis, without that axis."""
    parts = np.moveaxis(as_tensor(operands[0], build), params["axis"], 0)
    return [from_tensor(np.asarray(part, object)) for part in parts]


def split_array(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> list[Any]:
    """An array in several parts."""
    return np.split(operands[0], np.cumsum(params["sizes"])[:-1], params["axis"])


def pad(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> Any:
    """An array with a margin, and gaps between its elements."""
    operand, margin = as_tensor(operands[0], build), operands[1]
    if any(low < 0 or high < 0 for low, high, _ in params["padding_config"]):
        raise Unsupported("a negative margin")
    result = np.empty(equation.outvars[0].aval.shape, object)
    result.ravel()[:] = [margin] * result.size
    inside = tuple(
        slice(low, low + (size - 1) * (gap + 1) + 1 if size else low, gap + 1)
        for size, (low, _, gap) in zip(operand.shape, params["padding_config"], strict=True)
    )
    result[inside] = operand
    return result


def iota(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> Any:
    """The index of each element along an axis."""
    shape, axis = params["shape"], params["dimension"]
    line = np.arange(shape[axis], dtype=params["dtype"])
    return np.broadcast_to(line.reshape([-1 if i == axis else 1 for i in range(len(shape))]), shape)


def reduction(operation: str) -> Callable[..., Any]:
    """A rule that combines the elements along some axes."""

    def rule(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> Any:
        axes, tensor = params["axes"], as_tensor(operands[0], build)
        others = [axis for axis in range(tensor.ndim) if axis not in axes]
        rows = np.transpose(tensor, [*others, *axes]).reshape(*(tensor.shape[axis] for axis in others), -1)
        if not rows.shape[-1]:
            raise Unsupported("a reduction of nothing")
        return combined(lambda row: reduce(lambda x, y: build.add(operation, x, y), row), rows)

    return rule


def combined(function: Callable[[Sequence[Value]], Value], rows: Tensor) -> Any:
    """A function of the last axis."""
    result = np.empty(rows.shape[:-1], object)
    for position in np.ndindex(result.shape):
        result[position] = function(list(rows[position]))
    return from_tensor(result)


def dot_general(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> Any:
    """Sums of products."""
    (left_sum, right_sum), (left_batch, right_batch) = params["dimension_numbers"]
    sides = []
    for operand, sums, batch in zip(operands, (left_sum, right_sum), (left_batch, right_batch), strict=True):
        tensor = as_tensor(operand, build)
        free = [axis for axis in range(tensor.ndim) if axis not in (*sums, *batch)]
        shapes = [[tensor.shape[axis] for axis in axes] for axes in (batch, free, sums)]
        sizes = [int(np.prod(shape)) for shape in shapes]
        sides.append((np.transpose(tensor, [*batch, *free, *sums]).reshape(sizes), shapes))
    (left, left_shapes), (right, right_shapes) = sides
    result = np.empty((left.shape[0], left.shape[1], right.shape[1]), object)
    for batch, i, j in np.ndindex(*result.shape):
        products = [build.add("mul", x, y) for x, y in zip(left[batch, i], right[batch, j], strict=True)]
        nothing = build.constant(0, np.dtype(equation.outvars[0].aval.dtype))
        result[batch, i, j] = reduce(lambda x, y: build.add("add", x, y), products) if products else nothing
    return from_tensor(result.reshape(left_shapes[0] + left_shapes[1] + right_shapes[1]))


def cumulative_rule(operation: str) -> Callable[..., Any]:
    """A rule for partial sums and their like."""

    def rule(build: Builder, operands: Sequence[Any], params: Mapping[str, Any], equation: Any) -> Any:
        tensor = np.moveaxis(as_tensor(operands[0], build), params["axis"], -1).copy()
        steps = range(tensor.shape[-1])
        order = list(reversed(steps)) if params["reverse"] else list(steps)
        for position in np.ndindex(tensor.shape[:-1]):
            for before, after in pairwise(order):
                tensor[(*position, after)] = build.add(
                    operation, tensor[(*position, before)], tensor[(*position, after)]
                )
        return np.moveaxis(tensor, -1, params["axis"])

    return rule


def unbatched(numbers: Any, equation: Any) -> bool:
    """Dimension numbers of a gather or scatter without batches."""
    return not numbers.operand_batching_dims


def same_precision(precision: Any, equation: Any) -> bool:
    """Any precision of JAX's enumeration: a processor computes all in the type itself. An algorithm is none."""
    parts = precision if isinstance(precision, tuple) else (precision,)
    return all(part is None or getattr(part, "name", "") in ("DEFAULT", "HIGH", "HIGHEST") for part in parts)


def of_one_type(equation: Any) -> str | None:
    """Refuse a sum of products whose operands and result differ in type."""
    types = {element_type(variable.aval) for variable in (*equation.invars, *equation.outvars)}
    return None if len(types) == 1 else "operands and results of several types"


def mode_of(*names: str) -> Any:
    """The condition of a gather's or scatter's mode."""
    return one_of("CLIP", "FILL_OR_DROP", "PROMISE_IN_BOUNDS", *names)


def scatter_rule(operation: str) -> Rule:
    """The rule of a scatter."""
    return rule(
        scatter(operation), NUMBERS if operation else SCALARS, dimension_numbers=unbatched, mode=mode_of(),
        update_jaxpr=anything, update_consts=absent, indices_are_sorted=anything, unique_indices=anything,
    )  # fmt: skip


def reduction_rule(operation: str, types: Any) -> Rule:
    """The rule of a reduction."""
    return rule(reduction(operation), types, axes=anything, out_sharding=absent)


def partial_rule(operation: str) -> Rule:
    """The rule of partial sums and their like."""
    return rule(cumulative_rule(operation), NUMBERS, axis=anything, reverse=anything)


ARRAY_RULES: dict[str, Rule] = {
    "broadcast_in_dim": rule(broadcast, MOVABLE, shape=anything, broadcast_dimensions=anything, sharding=absent),
    "reshape": rule(moving(reshaped), MOVABLE, new_sizes=anything, dimensions=absent, sharding=absent),
    "squeeze": rule(moving(squeezed), MOVABLE, dimensions=anything),
    "expand_dims": rule(moving(expanded), MOVABLE, dimensions=anything),
    "transpose": rule(moving(transposed), MOVABLE, permutation=anything),
    "rev": rule(moving(reversed_along), MOVABLE, dimensions=anything),
    "slice": rule(moving(strided), MOVABLE, start_indices=anything, limit_indices=anything, strides=anything),
    "concatenate": rule(concatenate, MOVABLE, dimension=anything),
    "stack": rule(stack, MOVABLE, axis=anything),
    "unstack": rule(unstack, MOVABLE, axis=anything),
    "split": rule(split_array, MOVABLE, sizes=anything, axis=anything),
    "pad": rule(pad, SCALARS, padding_config=anything),
    "iota": rule(iota, NUMBERS, dtype=anything, shape=anything, dimension=anything, sharding=absent),
    "gather": rule(
        gather, SCALARS, dimension_numbers=unbatched, slice_sizes=anything, mode=mode_of(), fill_value=anything,
        indices_are_sorted=anything, unique_indices=anything,
    ),
    "dynamic_slice": rule(dynamic_slice, SCALARS, slice_sizes=anything),
    "dynamic_update_slice": rule(dynamic_update_slice, SCALARS),
    "scatter": scatter_rule(""),
    "scatter-add": scatter_rule("add"),
    "reduce_sum": reduction_rule("add", NUMBERS),
    "reduce_prod": reduction_rule("mul", NUMBERS),
    "reduce_max": reduction_rule("max", NUMBERS),
    "reduce_min": reduction_rule("min", NUMBERS),
    "reduce_and": reduction_rule("and", WHOLE | TRUTH),
    "reduce_or": reduction_rule("or", WHOLE | TRUTH),
    "cumsum": partial_rule("add"),
    "cumprod": partial_rule("mul"),
    "cummax": partial_rule("max"),
    "cummin": partial_rule("min"),
    "dot_general": Rule(dot_general, Specification(NUMBERS, {
        "dimension_numbers": anything, "precision": same_precision, "preferred_element_type": result_type,
        "out_sharding": absent}, of_one_type)),
}  # fmt: skip
"""Rule of each primitive by its name."""
