"""Conversion of a loop's states between the values of a trace and the scalars of a program."""

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
    """The flag of each state of a loop, repeated for each of its :func:`components`."""
    return [bool(flag) for flag, value in zip(flags, values, strict=True) for _ in components(value, build)]


def components(value: Any, build: Builder) -> list[Value]:
    """The scalars of a value, in order: itself, the words of a key, the token of a memory, or an array's elements.

    Raises:
        Unsupported: The value is a recording, or an array of keys.
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
    """Require that no operand is an array that a loop records or carries in memory, which no operation can read.

    Raises:
        Unsupported: An operand is one.
    """
    if any(isinstance(operand, Recording | Memory) for operand in operands):
        raise Unsupported("an array that a loop records or carries, as an operand")


def assemble(likes: Sequence[Any], scalars: Sequence[Value]) -> list[Any]:
    """Build values of the kinds and shapes of ``likes`` from their scalars; the inverse of :func:`flatten`."""
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
    """The scalars of several values in one list."""
    return [scalar for value in values for scalar in components(value, build)]


def is_varying(value: Any) -> bool:
    """Whether a scalar of a value may differ between lanes."""
    if isinstance(value, Value):
        return value.varying
    if isinstance(value, Key):
        return value.high.varying or value.low.varying
    if isinstance(value, Memory):
        return True
    return isinstance(value, np.ndarray) and value.dtype == object and any(map(is_varying, value.ravel()))
