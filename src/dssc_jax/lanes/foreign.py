"""Functions of C within a lane: ``void function(void *memory)`` as a pure function of scalars.

A call gets memory that is zero but for its operands, which stand at fixed places, and leaves its results at others.
Nothing else goes in or out, so a function whose state is part of that memory is pure: the loop carries the state. As
machine code a call is one call a lane; in plain XLA it is a callback of the host.
"""

import ctypes
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from dssc_jax.lanes.llvm import machine

FOREIGN_CALL = "foreign_call"
"""Name of the primitive."""

ADDRESSES: dict[str, int] = {}
"""Addresses of the functions that this process may call, by symbol; LLVM knows them for the whole process, too."""


class MemoryPlace(NamedTuple):
    """A number in the memory of a call: its type, and its distance from the start in bytes."""

    dtype: np.dtype
    offset: int


class ForeignFunction(NamedTuple):
    """A function of C with one argument, the address of its memory.

    Args:
        symbol: Its name, unique for its code: machine code is kept under a text that contains it.
        size: Bytes of its memory.
        operands: Where a call's operands stand.
        results: Where its results stand.
    """

    symbol: str
    size: int
    operands: tuple[MemoryPlace, ...]
    results: tuple[MemoryPlace, ...]


Operand: TypeAlias = jax.Array | np.ndarray | np.generic | float


def provide(symbol: str, address: int) -> None:
    """Let lanes call a function of this process; its code must stay loaded."""
    ADDRESSES[symbol] = address
    machine.add_symbol(symbol, address)


def call(function: ForeignFunction, *operands: Operand) -> list[jax.Array]:
    """The results of a call for scalars, within a trace or not.

    Raises:
        TypeError: The number of operands is wrong, or JAX's precision lacks a type of the function.
    """
    if len(operands) != len(function.operands):
        raise TypeError(f"{function.symbol} takes {len(function.operands)} operands, got {len(operands)}")
    for place in (*function.operands, *function.results):
        if jax.dtypes.canonicalize_dtype(place.dtype) != place.dtype:
            raise TypeError(f"{function.symbol} computes in {place.dtype}, which needs 64 bits in JAX")
    arrays = [jnp.asarray(x, place.dtype) for x, place in zip(operands, function.operands, strict=True)]
    return PRIMITIVE.bind(*arrays, function=function)


def call_batch(function: ForeignFunction, *columns: Operand) -> tuple[np.ndarray, ...]:
    """Call a function on the host for each element of arrays of one shape."""
    address = ADDRESSES[function.symbol]
    called = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(address)
    arrays = [np.asarray(column) for column in columns]
    shape = arrays[0].shape
    memory = np.zeros((arrays[0].size, -(-function.size // 64) * 64), np.uint8)
    for array, place in zip(arrays, function.operands, strict=True):
        stored_at(memory, place)[:] = array.ravel()
    for lane in range(len(memory)):
        called(memory[lane].ctypes.data)
    return tuple(stored_at(memory, place).reshape(shape) for place in function.results)


def stored_at(memory: np.ndarray, place: MemoryPlace) -> np.ndarray:
    """The numbers at a place of each row of memory, as a view."""
    return memory[:, place.offset : place.offset + place.dtype.itemsize].view(place.dtype)[:, 0]


# The primitive


def by_callback(*operands: jax.Array, function: ForeignFunction) -> Sequence[jax.Array]:
    """The call in plain XLA."""
    shape = operands[0].shape
    results = [jax.ShapeDtypeStruct(shape, place.dtype) for place in function.results]
    return jax.pure_callback(lambda *columns: call_batch(function, *columns), results, *operands)


def abstract(*operands: jax.core.ShapedArray, function: ForeignFunction) -> list[jax.core.ShapedArray]:
    """Shapes and types of the results."""
    return [jax.core.ShapedArray(operands[0].shape, place.dtype) for place in function.results]


def batched(
    operands: Sequence[jax.Array], axes: Sequence[int | None], *, function: ForeignFunction
) -> tuple[list[jax.Array], list[int]]:
    """The call over one more axis, which comes first."""
    pairs = list(zip(operands, axes, strict=True))
    (size, *_) = [operand.shape[axis] for operand, axis in pairs if axis is not None]
    columns = []
    for operand, axis in pairs:
        along = jnp.broadcast_to(operand, (size, *operand.shape)) if axis is None else jnp.moveaxis(operand, axis, 0)
        columns.append(along)
    results = PRIMITIVE.bind(*columns, function=function)
    return results, [0] * len(results)


def refuse_derivative(*_: object, function: ForeignFunction) -> None:
    """Refuse a derivative: C has none.

    Raises:
        NotImplementedError: always.
    """
    raise NotImplementedError(f"a derivative of native code: {function.symbol} has none")


PRIMITIVE = Primitive(FOREIGN_CALL)
PRIMITIVE.multiple_results = True
PRIMITIVE.def_impl(by_callback)
PRIMITIVE.def_abstract_eval(abstract)
batching.primitive_batchers[PRIMITIVE] = batched
ad.primitive_jvps[PRIMITIVE] = refuse_derivative
mlir.register_lowering(PRIMITIVE, mlir.lower_fun(by_callback, multiple_results=True))
