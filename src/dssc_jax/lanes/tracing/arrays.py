"""Rules of operations on small arrays within a lane.

Elements are moved when the program is translated, so that only arithmetic is left to run. An array of values is a NumPy
array of objects; a constant array stays an array of numbers.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from itertools import pairwise
from typing import Any

import numpy as np
from jax.extend.core import JaxprEqn

from dssc_jax.lanes.builder import Builder
from dssc_jax.lanes.program import Value
from dssc_jax.lanes.tracing.specification import (
    MOVED_TYPES,
    NUMBER_TYPES,
    SCALARS,
    TRUTH,
    WHOLE,
    Parameters,
    Specification,
    TranslationRule,
    any_value,
    array_type,
    element_type,
    no_value,
    result_type,
    rule,
)
from dssc_jax.lanes.unsupported import Unsupported

Tensor = np.ndarray


def as_tensor(value: Any, build: Builder) -> Tensor:
    """A value as an array of objects: numbers become constants, and a scalar becomes an array of shape ()."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return value
    tensor = np.empty(np.shape(value) if isinstance(value, np.ndarray) else (), object)
    if isinstance(value, np.ndarray):
        tensor.ravel()[:] = [build.constant(number, value.dtype) for number in value.ravel()]
    else:
        tensor[()] = value
    return tensor


def from_tensor(tensor: Any) -> Any:
    """An array of objects, or its only element if its shape is ()."""
    return tensor[()] if isinstance(tensor, np.ndarray) and tensor.dtype == object and not tensor.shape else tensor


def elementwise(function: Callable[..., Any], build: Builder, operands: Sequence[Any]) -> Any:
    """Apply a function of scalars to each element of operands, which are scalars and arrays of one shape."""
    if not any(isinstance(operand, np.ndarray) for operand in operands):
        return function(*operands)
    tensors = np.broadcast_arrays(*(as_tensor(operand, build) for operand in operands))
    results = np.empty(tensors[0].shape, object)
    for position in np.ndindex(results.shape):
        results[position] = function(*(tensor[position] for tensor in tensors))
    return results


def broadcast(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.broadcast_in_dim``: an array repeated along new axes."""
    shape = params["shape"]
    axes = params["broadcast_dimensions"]
    if not shape:
        return operands[0]
    source = operands[0] if isinstance(operands[0], np.ndarray) else as_tensor(operands[0], build)
    sizes = [1] * len(shape)
    for axis, size in zip(axes, source.shape, strict=True):
        sizes[axis] = size
    return np.broadcast_to(source.reshape(sizes), shape)


def movement_rule(function: Callable[[Any, Mapping[str, Any]], Any]) -> Callable[..., Any]:
    """The translation of an operation that only moves elements, by ``(array, parameters) -> array`` of NumPy."""

    def rule(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
        operand = operands[0] if isinstance(operands[0], np.ndarray) else as_tensor(operands[0], build)
        result = np.asarray(function(operand, params))
        return scalar_of(build, result)

    return rule


def scalar_of(build: Builder, result: Tensor) -> Any:
    """An array, or a value if its shape is ()."""
    if result.shape:
        return result
    return result[()] if result.dtype == object else build.constant(result, result.dtype)


def static_slice(operand: Tensor, params: Parameters) -> Tensor:
    """``lax.slice``: a part of an array between constant indices."""
    strides = params["strides"] or [1] * operand.ndim
    parts = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return operand[tuple(slice(start, stop, step) for start, stop, step in parts)]


def reshape(operand: Tensor, params: Parameters) -> Tensor:
    """``lax.reshape``: an array in another shape."""
    return operand.reshape(params["new_sizes"])


def squeeze(operand: Tensor, params: Parameters) -> Tensor:
    """``lax.squeeze``: an array without some axes of size 1."""
    return np.squeeze(operand, tuple(params["dimensions"]))


def expand_dims(operand: Tensor, params: Parameters) -> Tensor:
    """``lax.expand_dims``: an array with new axes of size 1."""
    return np.expand_dims(operand, tuple(params["dimensions"]))


def transpose(operand: Tensor, params: Parameters) -> Tensor:
    """``lax.transpose``: an array with its axes in another order."""
    return np.transpose(operand, params["permutation"])


def reverse(operand: Tensor, params: Parameters) -> Tensor:
    """``lax.rev``: an array reversed along some axes."""
    return np.flip(operand, params["dimensions"])


def concatenate(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.concatenate``: arrays one after another along an axis."""
    are_constant = all(operand.dtype != object for operand in operands)
    parts = operands if are_constant else [as_tensor(operand, build) for operand in operands]
    return np.concatenate(parts, params["dimension"])


def stack(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``jnp.stack``: arrays side by side along a new axis."""
    return np.stack([as_tensor(operand, build) for operand in operands], params["axis"])


def unstack(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> list[Any]:
    """``jnp.unstack``: the parts of an array along an axis, without that axis."""
    parts = np.moveaxis(as_tensor(operands[0], build), params["axis"], 0)
    return [from_tensor(np.asarray(part, object)) for part in parts]


def split_array(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> list[Any]:
    """``lax.split``: consecutive parts of an array along an axis."""
    return np.split(operands[0], np.cumsum(params["sizes"])[:-1], params["axis"])


def pad(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.pad``: an array with a margin around it, and gaps between its elements."""
    operand = as_tensor(operands[0], build)
    margin = operands[1]
    if any(low < 0 or high < 0 for low, high, _ in params["padding_config"]):
        raise Unsupported("a negative margin")
    result = np.empty(array_type(equation.outvars[0]).shape, object)
    result.ravel()[:] = [margin] * result.size
    element_slices = tuple(
        slice(low, low + (size - 1) * (gap + 1) + 1 if size else low, gap + 1)
        for size, (low, _, gap) in zip(operand.shape, params["padding_config"], strict=True)
    )
    result[element_slices] = operand
    return result


def iota(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.iota``: an array whose elements are their indices along an axis."""
    shape = params["shape"]
    axis = params["dimension"]
    line = np.arange(shape[axis], dtype=params["dtype"])
    return np.broadcast_to(line.reshape([-1 if i == axis else 1 for i in range(len(shape))]), shape)


def reduction(operation: str) -> Callable[..., Any]:
    """The translation of a reduction, which combines the elements along some axes by an operation."""

    def rule(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
        axes = params["axes"]
        tensor = as_tensor(operands[0], build)
        remaining_axes = [axis for axis in range(tensor.ndim) if axis not in axes]
        remaining_shape = [tensor.shape[axis] for axis in remaining_axes]
        rows = np.transpose(tensor, [*remaining_axes, *axes]).reshape(*remaining_shape, -1)
        if not rows.shape[-1]:
            raise Unsupported("a reduction of nothing")
        return reduce_rows(lambda row: reduce(lambda x, y: build.add(operation, x, y), row), rows)

    return rule


def reduce_rows(function: Callable[[Sequence[Value]], Value], rows: Tensor) -> Any:
    """Apply a function to each row along the last axis; return the array of its results."""
    result = np.empty(rows.shape[:-1], object)
    for position in np.ndindex(result.shape):
        result[position] = function(list(rows[position]))
    return from_tensor(result)


def dot_general(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.dot_general``: sums of products over some axes of two arrays."""
    sides = []
    for operand, sums, batch in zip(operands, *params["dimension_numbers"], strict=True):
        tensor = as_tensor(operand, build)
        free = [axis for axis in range(tensor.ndim) if axis not in (*sums, *batch)]
        shapes = [[tensor.shape[axis] for axis in axes] for axes in (batch, free, sums)]
        sizes = [int(np.prod(shape)) for shape in shapes]
        sides.append((np.transpose(tensor, [*batch, *free, *sums]).reshape(sizes), shapes))
    (left_tensor, left_shapes), (right_tensor, right_shapes) = sides
    result = np.empty((left_tensor.shape[0], left_tensor.shape[1], right_tensor.shape[1]), object)
    for batch, i, j in np.ndindex(*result.shape):
        products = [build.add("mul", x, y) for x, y in zip(left_tensor[batch, i], right_tensor[batch, j], strict=True)]
        zero = build.constant(0, np.dtype(array_type(equation.outvars[0]).dtype))
        result[batch, i, j] = reduce(lambda x, y: build.add("add", x, y), products) if products else zero
    return from_tensor(result.reshape(left_shapes[0] + left_shapes[1] + right_shapes[1]))


def cumulation(operation: str) -> Callable[..., Any]:
    """The translation of a cumulative operation, such as ``cumsum``."""

    def rule(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
        tensor = np.moveaxis(as_tensor(operands[0], build), params["axis"], -1).copy()
        steps = range(tensor.shape[-1])
        order = list(reversed(steps)) if params["reverse"] else list(steps)
        for position in np.ndindex(tensor.shape[:-1]):
            for previous, current in pairwise(order):
                tensor[(*position, current)] = build.add(
                    operation, tensor[(*position, previous)], tensor[(*position, current)]
                )
        return np.moveaxis(tensor, -1, params["axis"])

    return rule


def same_precision(precision: Any, equation: JaxprEqn) -> bool:
    """The condition of a product's precision: one of JAX's enumeration, which mean the same here; no algorithm."""
    parts = precision if isinstance(precision, tuple) else (precision,)
    return all(part is None or getattr(part, "name", "") in ("DEFAULT", "HIGH", "HIGHEST") for part in parts)


def refuse_mixed_types(equation: JaxprEqn) -> str | None:
    """Why a sum of products is not translated: its operands and result differ in type; None if they do not."""
    types = {element_type(variable.aval) for variable in (*equation.invars, *equation.outvars)}
    return None if len(types) == 1 else "operands and results of several types"


def reduction_rule(operation: str, types: Any) -> TranslationRule:
    """The rule of a reduction by an operation."""
    return rule(reduction(operation), types, axes=any_value, out_sharding=no_value)


def cumulative_rule(operation: str) -> TranslationRule:
    """The rule of a cumulative operation."""
    return rule(cumulation(operation), NUMBER_TYPES, axis=any_value, reverse=any_value)


ARRAY_RULES: dict[str, TranslationRule] = {
    "broadcast_in_dim": rule(
        broadcast, MOVED_TYPES, shape=any_value, broadcast_dimensions=any_value, sharding=no_value
    ),
    "reshape": rule(movement_rule(reshape), MOVED_TYPES, new_sizes=any_value, dimensions=no_value, sharding=no_value),
    "squeeze": rule(movement_rule(squeeze), MOVED_TYPES, dimensions=any_value),
    "expand_dims": rule(movement_rule(expand_dims), MOVED_TYPES, dimensions=any_value),
    "transpose": rule(movement_rule(transpose), MOVED_TYPES, permutation=any_value),
    "rev": rule(movement_rule(reverse), MOVED_TYPES, dimensions=any_value),
    "slice": rule(
        movement_rule(static_slice), MOVED_TYPES, start_indices=any_value, limit_indices=any_value, strides=any_value
    ),
    "concatenate": rule(concatenate, MOVED_TYPES, dimension=any_value),
    "stack": rule(stack, MOVED_TYPES, axis=any_value),
    "unstack": rule(unstack, MOVED_TYPES, axis=any_value),
    "split": rule(split_array, MOVED_TYPES, sizes=any_value, axis=any_value),
    "pad": rule(pad, SCALARS, padding_config=any_value),
    "iota": rule(iota, NUMBER_TYPES, dtype=any_value, shape=any_value, dimension=any_value, sharding=no_value),
    "reduce_sum": reduction_rule("add", NUMBER_TYPES),
    "reduce_prod": reduction_rule("mul", NUMBER_TYPES),
    "reduce_max": reduction_rule("max", NUMBER_TYPES),
    "reduce_min": reduction_rule("min", NUMBER_TYPES),
    "reduce_and": reduction_rule("and", WHOLE | TRUTH),
    "reduce_or": reduction_rule("or", WHOLE | TRUTH),
    "cumsum": cumulative_rule("add"),
    "cumprod": cumulative_rule("mul"),
    "cummax": cumulative_rule("max"),
    "cummin": cumulative_rule("min"),
    "dot_general": TranslationRule(dot_general, Specification(NUMBER_TYPES, {
        "dimension_numbers": any_value, "precision": same_precision, "preferred_element_type": result_type,
        "out_sharding": no_value}, refuse_mixed_types)),
}  # fmt: skip
"""The rule of each primitive by its name."""
