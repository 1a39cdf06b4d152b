"""Conversion of a loop's states between the values of a trace and the scalars of a program.

A value of a trace is a scalar, an array, a random key, or an array in memory. A program's loop carries scalars alone.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dssc_jax.lanes.builder import Builder
from dssc_jax.lanes.program import Recording, Value
from dssc_jax.lanes.tracing.arrays import as_tensor
from dssc_jax.lanes.tracing.memory import Memory
from dssc_jax.lanes.tracing.random_bits import Key
from dssc_jax.lanes.unsupported import Unsupported


def flags_of_components(flags: Sequence[int], values: Sequence[Any], build: Builder) -> list[bool]:
    """Repeat the flag of each value for every scalar of the value; return one list of truth values.

    Args:
        flags: The flag of each value; 0 means false, any other number true.
        values: The values.
        build: The builder.
    """
    repeated_flags = []
    for flag, value in zip(flags, values, strict=True):
        repeated_flags += [bool(flag)] * len(components(value, build))
    return repeated_flags


def components(value: Any, build: Builder) -> list[Value]:
    """Return the scalars of a value, in order.

    They are the value itself if it is a scalar, the two words of a key, the token of an array in memory, or the
    elements of any other array.

    Raises:
        Unsupported: The value is a recording, an array of keys, or an array in memory that was read before.
    """
    if isinstance(value, Value):
        return [value]
    if isinstance(value, Key):
        return [value.high, value.low]
    if isinstance(value, Memory):
        return [value.initial_token()]
    if isinstance(value, Recording):
        raise Unsupported("a recorded array within a loop")
    scalars = list(as_tensor(value, build).ravel())
    if any(isinstance(scalar, Key) for scalar in scalars):
        raise Unsupported("an array of random keys as the state of a loop")
    return scalars


def refuse_recordings(operands: Sequence[Any]) -> None:
    """Require that no operand is a recording or an array in memory, of which most operations cannot read the elements.

    Raises:
        Unsupported: An operand is such an array.
    """
    if any(isinstance(operand, Recording | Memory) for operand in operands):
        raise Unsupported("an array that a loop records or carries, as an operand")


def assemble(likes: Sequence[Any], scalars: Sequence[Value]) -> list[Any]:
    """Build values from their scalars; the inverse of :func:`flatten`.

    Args:
        likes: For each value to build, a value of the same kind and shape. An array in memory among these counts as
            overwritten afterwards.
        scalars: The scalars of all values, in order.
    """
    remaining = list(scalars)
    values = []
    for like in likes:
        if isinstance(like, Value):
            values.append(remaining.pop(0))
        elif isinstance(like, Key):
            values.append(Key(remaining.pop(0), remaining.pop(0)))
        elif isinstance(like, Memory):
            values.append(like.successor(remaining.pop(0)))
        else:
            tensor = np.empty(like.shape, object)
            tensor.ravel()[:] = remaining[: tensor.size]
            del remaining[: tensor.size]
            values.append(tensor)
    return values


def flatten(values: Sequence[Any], build: Builder) -> list[Value]:
    """Return the scalars of several values in one list, in order."""
    return [scalar for value in values for scalar in components(value, build)]


def is_varying(value: Any) -> bool:
    """Whether any scalar of a value may differ between lanes; an array in memory always may."""
    if isinstance(value, Value):
        return value.varying
    if isinstance(value, Key):
        return value.high.varying or value.low.varying
    if isinstance(value, Memory):
        return True
    return isinstance(value, np.ndarray) and value.dtype == object and any(map(is_varying, value.ravel()))
