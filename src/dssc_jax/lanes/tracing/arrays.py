"""Rules of operations on small arrays within a lane.

Elements are moved when the program is translated, so that only arithmetic is left to run. An array of values is a NumPy
array of objects; a constant array stays an array of numbers.

All translations have the same arguments ``(build, operands, params, equation) -> result``, of which each uses what it
needs:

    build: The builder of the program.
    operands: The operands: a value for a scalar, an array for an array.
    params: Parameters of JAX's equation by name.
    equation: The equation itself.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from itertools import pairwise
from typing import Any, NamedTuple

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
"""An array of values, with dtype ``object``; or a constant array of numbers."""


def as_tensor(value: Any, build: Builder) -> Tensor:
    """Return a value as an array of objects: numbers become constants of the program, a scalar gets the shape ()."""
    if not isinstance(value, np.ndarray):
        tensor = np.empty((), object)
        tensor[()] = value
        return tensor
    if value.dtype == object:
        return value
    tensor = np.empty(value.shape, object)
    tensor.ravel()[:] = [build.constant(number, value.dtype) for number in value.ravel()]
    return tensor


def as_array(value: Any, build: Builder) -> Tensor:
    """Return a value as an array: a constant array stays an array of numbers, and a scalar gets the shape ()."""
    return value if isinstance(value, np.ndarray) else as_tensor(value, build)


def from_tensor(tensor: Any) -> Any:
    """Return an array of objects, or its only element if its shape is (); anything else is returned unchanged."""
    is_scalar = isinstance(tensor, np.ndarray) and tensor.dtype == object and tensor.shape == ()
    return tensor[()] if is_scalar else tensor


def elementwise(function: Callable[..., Any], build: Builder, operands: Sequence[Any]) -> Any:
    """Apply a function of scalars to each element of the operands; return an array, or a value if all are scalars.

    Args:
        function: ``(*scalars) -> value``, called once for each element.
        build: The builder.
        operands: Scalars, and arrays of one shape.
    """
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
    axes = params["broadcast_dimensions"]  # the axis of the result for each axis of the operand
    if not shape:
        return operands[0]
    source = as_array(operands[0], build)
    sizes = [1] * len(shape)
    for axis, size in zip(axes, source.shape, strict=True):
        sizes[axis] = size
    return np.broadcast_to(source.reshape(sizes), shape)


def movement_rule(function: Callable[[Any, Mapping[str, Any]], Any]) -> Callable[..., Any]:
    """Return the translation of an operation that only moves elements.

    Args:
        function: ``(array, params) -> array``: the operation on a NumPy array, whatever its elements are.
    """

    def rule(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
        """Return the operand with its elements moved."""
        result = np.asarray(function(as_array(operands[0], build), params))
        return scalar_of(build, result)

    return rule


def scalar_of(build: Builder, result: Tensor) -> Any:
    """Return an array unchanged, but its only element as a value of the program if its shape is ()."""
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
    """``jnp.unstack``: the slices of an array along an axis, without that axis."""
    parts = np.moveaxis(as_tensor(operands[0], build), params["axis"], 0)
    return [from_tensor(np.asarray(part, object)) for part in parts]


def split_array(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> list[Any]:
    """``lax.split``: consecutive parts of an array along an axis."""
    starts = np.cumsum(params["sizes"])[:-1]  # of the parts after the first
    return np.split(operands[0], starts, params["axis"])


def pad(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.pad``: an array with a margin around it, and gaps between its elements, filled with one value."""
    operand = as_tensor(operands[0], build)
    filler = operands[1]
    margins = params["padding_config"]  # for each axis: size before, size after, size of the gaps
    if any(before < 0 or after < 0 for before, after, _ in margins):
        raise Unsupported("a negative margin")
    result = np.empty(array_type(equation.outvars[0]).shape, object)
    result.ravel()[:] = [filler] * result.size
    element_slices = []
    for size, (before, _, gap) in zip(operand.shape, margins, strict=True):
        step = gap + 1
        end = before + (size - 1) * step + 1 if size else before
        element_slices.append(slice(before, end, step))
    result[tuple(element_slices)] = operand
    return result


def iota(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.iota``: an array whose elements are their indices along an axis."""
    shape = params["shape"]
    axis = params["dimension"]
    sizes = [1] * len(shape)
    sizes[axis] = shape[axis]
    indices = np.arange(shape[axis], dtype=params["dtype"])
    return np.broadcast_to(indices.reshape(sizes), shape)


def reduction(operation: str) -> Callable[..., Any]:
    """Return the translation of a reduction, which combines the elements along some axes by an operation, in order."""

    def rule(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
        """Return the array of the combined elements, along the axes that remain.

        Raises:
            Unsupported: The reduction has no elements to combine.
        """
        axes = params["axes"]
        tensor = as_tensor(operands[0], build)
        remaining_axes = [axis for axis in range(tensor.ndim) if axis not in axes]
        remaining_shape = [tensor.shape[axis] for axis in remaining_axes]
        rows = np.transpose(tensor, [*remaining_axes, *axes]).reshape(*remaining_shape, -1)
        if rows.shape[-1] == 0:
            raise Unsupported("a reduction of nothing")
        return reduce_rows(lambda row: reduce(lambda x, y: build.add(operation, x, y), row), rows)

    return rule


def reduce_rows(function: Callable[[Sequence[Value]], Value], rows: Tensor) -> Any:
    """Apply a function to each row along the last axis; return the array of the results, shape ``rows.shape[:-1]``."""
    result = np.empty(rows.shape[:-1], object)
    for position in np.ndindex(result.shape):
        result[position] = function(list(rows[position]))
    return from_tensor(result)


def dot_general(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``lax.dot_general``: sums of products over some axes of two arrays.

    The axes of the two arrays are of three kinds: summed, batch (common to both arrays), and free (of one array alone).
    The result has the batch axes, then the free axes of the first array, then those of the second.
    """
    summed_axes, batch_axes = params["dimension_numbers"]  # each: axes of the first array, axes of the second
    left, right = (
        arranged_factor(as_tensor(operand, build), batch, summed)
        for operand, summed, batch in zip(operands, summed_axes, batch_axes, strict=True)
    )
    batches, left_rows, _ = left.tensor.shape
    _, right_rows, _ = right.tensor.shape
    result = np.empty((batches, left_rows, right_rows), object)
    for batch, i, j in np.ndindex(*result.shape):
        pairs = zip(left.tensor[batch, i], right.tensor[batch, j], strict=True)
        products = [build.add("mul", x, y) for x, y in pairs]
        zero = build.constant(0, np.dtype(array_type(equation.outvars[0]).dtype))
        result[batch, i, j] = reduce(lambda x, y: build.add("add", x, y), products) if products else zero
    return from_tensor(result.reshape(left.batch_shape + left.free_shape + right.free_shape))


class ArrangedFactor(NamedTuple):
    """A factor of a product of arrays, with its axes joined into three.

    Args:
        tensor: The elements, shape (batches, rows, terms of a sum).
        batch_shape: Sizes of the batch axes, which are joined into the first axis.
        free_shape: Sizes of the free axes, which are joined into the second axis.
    """

    tensor: Tensor
    batch_shape: list[int]
    free_shape: list[int]


def arranged_factor(tensor: Tensor, batch: Sequence[int], summed: Sequence[int]) -> ArrangedFactor:
    """Arrange the axes of a factor: batch axes first, free axes second, summed axes last, each kind joined into one.

    Args:
        tensor: The factor.
        batch: The batch axes.
        summed: The summed axes; the remaining axes are free.
    """
    free = [axis for axis in range(tensor.ndim) if axis not in (*summed, *batch)]
    batch_shape, free_shape, summed_shape = ([tensor.shape[axis] for axis in axes] for axes in (batch, free, summed))
    sizes = [int(np.prod(shape)) for shape in (batch_shape, free_shape, summed_shape)]
    joined = np.transpose(tensor, [*batch, *free, *summed]).reshape(sizes)
    return ArrangedFactor(joined, batch_shape, free_shape)


def cumulation(operation: str) -> Callable[..., Any]:
    """Return the translation of a cumulative operation, which combines each element with all elements before it."""

    def rule(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
        """Return the array of the combined elements, in the operand's shape."""
        tensor = np.moveaxis(as_tensor(operands[0], build), params["axis"], -1).copy()
        order = list(range(tensor.shape[-1]))
        if params["reverse"]:
            order.reverse()
        for row in np.ndindex(tensor.shape[:-1]):
            for previous, current in pairwise(order):
                combined = build.add(operation, tensor[(*row, previous)], tensor[(*row, current)])
                tensor[(*row, current)] = combined
        return np.moveaxis(tensor, -1, params["axis"])

    return rule


def same_precision(precision: Any, equation: JaxprEqn) -> bool:
    """Whether a product's precision is None or a value of JAX's enumeration, which all give the same result here.

    JAX also allows the name of an algorithm as a precision; such a product is refused. The equation is not needed.
    """
    parts = precision if isinstance(precision, tuple) else (precision,)
    return all(part is None or getattr(part, "name", "") in ("DEFAULT", "HIGH", "HIGHEST") for part in parts)


def refuse_mixed_types(equation: JaxprEqn) -> str | None:
    """Return the reason why a sum of products is not translated, if operands and result differ in type; else None."""
    types = {element_type(variable.aval) for variable in (*equation.invars, *equation.outvars)}
    return None if len(types) == 1 else "operands and results of several types"


def reduction_rule(operation: str, types: Any) -> TranslationRule:
    """Return the rule of a reduction by an operation, such as "add" for ``reduce_sum``, for elements of some types."""
    return rule(reduction(operation), types, axes=any_value, out_sharding=no_value)


def cumulative_rule(operation: str) -> TranslationRule:
    """Return the rule of a cumulative operation, such as "add" for ``cumsum``."""
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
"""The rules of operations on arrays, by the name of JAX's primitive."""
