"""Functions of C within a lane: ``void function(void *memory)`` as a pure function of scalars.

A call gets memory with its operands at fixed places and zeros elsewhere, and leaves its results at other places. There
is no other input or output, so a function whose state is part of that memory is pure: the loop carries the state. In
machine code each lane makes a call; in plain XLA the call is a callback of the host.
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
from dssc_jax.lanes.unsupported import Unsupported

WORD = 4
"""Bytes of a word; every number has one or two words."""

ALIGNMENT = 64
"""Bytes to which the memory of a call is aligned."""

FOREIGN_CALL = "foreign_call"
"""Name of the primitive of JAX that stands for a call."""

ADDRESSES: dict[str, int] = {}
"""Addresses of the functions that lanes of this process may call, by symbol; LLVM has the same table."""


class MemoryPlace(NamedTuple):
    """The place of a number in the memory of a call.

    Args:
        dtype: Dtype of the number, of 32 or 64 bits.
        offset: Distance of the number from the start of the memory [bytes].
    """

    dtype: np.dtype
    offset: int


class ForeignFunction(NamedTuple):
    """A function of C with one argument, the address of the memory that holds its operands and its results.

    Args:
        symbol: Name of the function. Functions with different code need different names: the cache of compiled programs
            compares only the programs' texts, which contain the name but not the code.
        size: Size of the memory of a call [bytes].
        operands: Places of the operands.
        results: Places of the results.
    """

    symbol: str
    size: int
    operands: tuple[MemoryPlace, ...]
    results: tuple[MemoryPlace, ...]


Operand: TypeAlias = jax.Array | np.ndarray | np.generic | float
"""A number that :func:`call` takes."""


def provide(symbol: str, address: int) -> None:
    """Register a function of this process, so that lanes can call it.

    Args:
        symbol: Name of the function.
        address: Address of the function's code, which must stay loaded.
    """
    ADDRESSES[symbol] = address
    machine.add_symbol(symbol, address)


def call(function: ForeignFunction, *operands: Operand) -> list[jax.Array]:
    """Call a function of C for scalars; return its results as JAX's arrays of shape ().

    Args:
        function: The function.
        operands: Numbers, or JAX's tracers of numbers, in the order of the function's operands.

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


def call_batch(function: ForeignFunction, operands: np.ndarray) -> np.ndarray:
    """Call a function of C for each row of operands, in this process and without compiled lanes.

    Args:
        function: The function.
        operands: The operands of each call as words of 32 bits, one after another, shape (..., operand words).

    Returns:
        The results of each call as words of 32 bits, shape (..., result words).
    """
    native = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(ADDRESSES[function.symbol])
    rows = operands.reshape(-1, operands.shape[-1])
    blocks = -(-function.size // ALIGNMENT)  # aligned blocks of memory for a call, rounded up
    memory = np.zeros((len(rows), blocks * ALIGNMENT // WORD), np.uint32)
    memory[:, word_positions(function.operands)] = rows
    for lane_memory in memory:
        native(lane_memory.ctypes.data)
    results = memory[:, word_positions(function.results)]
    return results.reshape(*operands.shape[:-1], results.shape[-1])


def word_positions(places: Sequence[MemoryPlace]) -> np.ndarray:
    """Return the positions in memory of the words of 32 bits that numbers at some places consist of, shape (words,)."""
    positions = [np.arange(place.offset, place.offset + place.dtype.itemsize, WORD) // WORD for place in places]
    return np.concatenate(positions)


# The primitive


def by_callback(*operands: jax.Array, function: ForeignFunction) -> list[jax.Array]:
    """Call a function of C in plain XLA, through a callback of the host; return its results in the operands' shape.

    JAX passes arrays to a callback in another thread, whose precision is always 32 bits, and would truncate longer
    numbers. So all numbers are passed as words of 32 bits.
    """
    shape = operands[0].shape
    operand_words = jnp.concatenate([as_words(operand) for operand in operands], axis=-1)
    words_per_row = len(word_positions(function.results))
    words_type = jax.ShapeDtypeStruct((*shape, words_per_row), np.uint32)
    result_words = jax.pure_callback(lambda rows: call_batch(function, np.asarray(rows)), words_type, operand_words)
    results = []
    first = 0
    for place in function.results:
        size = place.dtype.itemsize // WORD
        words = result_words[..., first] if size == 1 else result_words[..., first : first + size]
        results.append(jax.lax.bitcast_convert_type(words, place.dtype))
        first += size
    return results


def as_words(operand: jax.Array) -> jax.Array:
    """Return the words of 32 bits of each number, along a new last axis of size 1 (32 bits) or 2 (64 bits)."""
    words = jax.lax.bitcast_convert_type(operand, jnp.uint32)  # JAX adds the axis for two words only
    return words[..., None] if operand.dtype.itemsize == WORD else words


def abstract(*operands: jax.ShapeDtypeStruct, function: ForeignFunction) -> list[object]:
    """Return the shapes and dtypes of the results, for which JAX asks when it traces the primitive.

    Each result has the shape of the operands, and the dtype that the function declares.
    """
    return [jax.typeof(jax.ShapeDtypeStruct(operands[0].shape, place.dtype)) for place in function.results]


def batched(
    operands: Sequence[jax.Array], axes: Sequence[int | None], *, function: ForeignFunction
) -> tuple[list[jax.Array], list[int]]:
    """Call the primitive for a batch, as ``jax.vmap`` requires it.

    Args:
        operands: The operands.
        axes: The batch's axis in each operand; None: the operand is the same in the whole batch.
        function: The function.

    Returns:
        The results, and the batch's axis in each result, which is 0.
    """
    pairs = list(zip(operands, axes, strict=True))
    size = next(operand.shape[axis] for operand, axis in pairs if axis is not None)
    columns = []
    for operand, axis in pairs:
        column = jnp.broadcast_to(operand, (size, *operand.shape)) if axis is None else jnp.moveaxis(operand, axis, 0)
        columns.append(column)
    results = PRIMITIVE.bind(*columns, function=function)
    return results, [0] * len(results)


def refuse_derivative(*_: object, function: ForeignFunction) -> None:
    """Refuse to differentiate the primitive: a function of C has no derivative, whatever the arguments.

    Raises:
        Unsupported: Always. Analyses that need derivatives refuse native code earlier, with a better message.
    """
    raise Unsupported(f"a derivative of native code: {function.symbol} has none")


PRIMITIVE = Primitive(FOREIGN_CALL)
PRIMITIVE.multiple_results = True
PRIMITIVE.def_impl(by_callback)
PRIMITIVE.def_abstract_eval(abstract)
batching.primitive_batchers[PRIMITIVE] = batched
ad.primitive_jvps[PRIMITIVE] = refuse_derivative
mlir.register_lowering(PRIMITIVE, mlir.lower_fun(by_callback, multiple_results=True))
