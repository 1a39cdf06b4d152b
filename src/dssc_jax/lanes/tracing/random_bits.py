"""Random numbers of a lane: JAX's default generator, Threefry-2x32 with 20 rounds, bit for bit.

Reference:
    J. K. Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jax.extend.core import JaxprEqn

from dssc_jax.lanes.builder import Builder
from dssc_jax.lanes.program import Value
from dssc_jax.lanes.tracing.arrays import as_tensor
from dssc_jax.lanes.tracing.specification import (
    KEY,
    UNSIGNED_INTEGERS,
    WHOLE,
    Condition,
    Parameters,
    Specification,
    TranslationRule,
    Types,
    anything,
    array_type,
    one_of,
    rule,
)
from dssc_jax.lanes.unsupported import Unsupported

WORD = np.dtype(np.uint32)
ROTATIONS = (13, 15, 26, 6), (17, 29, 16, 24)
PARITY = 0x1BD11BDA


@dataclass(frozen=True, eq=False)
class Key:
    """A random key: two words."""

    high: Value
    low: Value


def rotated(build: Builder, x: Value, count: int) -> Value:
    """The bits of a word moved up in a circle."""
    up = build.add("shl", x, build.constant(count, WORD))
    return build.add("or", up, build.add("shr", x, build.constant(32 - count, WORD)))


def threefry(build: Builder, key: Key, high: Value, low: Value) -> tuple[Value, Value]:
    """A block of two words, enciphered with a key."""
    parity = build.add("xor", build.add("xor", key.high, key.low), build.constant(PARITY, WORD))
    schedule = key.high, key.low, parity
    x = build.add("add", high, key.high)
    y = build.add("add", low, key.low)
    for group in range(5):
        for count in ROTATIONS[group % 2]:
            x = build.add("add", x, y)
            y = build.add("xor", x, rotated(build, y, count))
        x = build.add("add", x, schedule[(group + 1) % 3])
        y = build.add("add", y, build.add("add", schedule[(group + 2) % 3], build.constant(group + 1, WORD)))
    return x, y


def require_threefry(key_type: Any) -> None:
    """Require keys of this generator.

    Raises:
        Unsupported: They belong to another.
    """
    if "fry" not in str(key_type):
        raise Unsupported(f"random numbers of another generator, {key_type}")


def fold_in(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Key:
    """A key derived from a key and a number."""
    key, number = operands
    return Key(*threefry(build, key, build.constant(0, WORD), build.add("convert", number, dtype=WORD)))


def seed(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Key:
    """The key of a seed: its upper and its lower word."""
    (number,) = operands
    if number.dtype.itemsize < 8:
        return Key(build.constant(0, WORD), build.add("convert", number, dtype=WORD))
    wide = np.dtype(np.uint64)
    bits = build.add("bitcast", number, dtype=wide)
    upper = build.add("shr", bits, build.constant(32, wide))
    return Key(build.add("convert", upper, dtype=WORD), build.add("convert", bits, dtype=WORD))


def counter_blocks(build: Builder, key: Key, shape: tuple[int, ...]) -> list[tuple[Value, Value]]:
    """The blocks 0, 1, 2, ... of a key, one for each element of an array."""
    if not jax.config.jax_threefry_partitionable:  # pyright: ignore[reportAttributeAccessIssue]
        raise Unsupported("jax_threefry_partitionable is off")
    zero = build.constant(0, WORD)
    return [threefry(build, key, zero, build.constant(i, WORD)) for i in range(int(np.prod(shape)))]


def with_shape(elements: Sequence[Any], shape: tuple[int, ...]) -> Any:
    """The elements as an array of a shape; of shape (), the one element itself."""
    if not shape:
        return elements[0]
    tensor = np.empty(len(elements), object)
    tensor[:] = elements
    return tensor.reshape(shape)


def bits(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """Random words of 8, 16, 32 or 64 bits."""
    (key,), width, shape = operands, params["bit_width"], params["shape"]
    dtype = np.dtype(f"u{width // 8}")
    words = []
    for high, low in counter_blocks(build, key, shape):
        if width == 64:
            upper = build.add("shl", build.add("convert", high, dtype=dtype), build.constant(32, dtype))
            words.append(build.add("or", upper, build.add("convert", low, dtype=dtype)))
        else:
            words.append(build.add("convert", build.add("xor", high, low), dtype=dtype))
    return with_shape(words, shape)


def split_key(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """Several keys from one, as rows of words."""
    (key,), shape = operands, params["shape"]
    return shaped_keys([Key(*pair) for pair in counter_blocks(build, key, shape)], shape)


def shaped_keys(keys: Sequence[Key], shape: tuple[int, ...]) -> Any:
    """Keys as an array; a single key by itself."""
    if not shape:
        return keys[0]
    tensor = np.empty(len(keys), object)
    for position, key in enumerate(keys):
        tensor[position] = key
    return tensor.reshape(shape)


def unwrap(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """The two words of a key as an array."""
    return with_shape([operands[0].high, operands[0].low], (2,))


def wrap(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Key:
    """A key from an array of two words."""
    words = as_tensor(operands[0], build)
    if words.shape != (2,):
        raise Unsupported(f"an array of keys of shape {words.shape[:-1]}")
    return Key(*words)


def of_scalars(equation: JaxprEqn) -> str | None:
    """Refuse arrays of keys or seeds."""
    return "an array of random keys" if any(array_type(variable).shape for variable in equation.invars) else None


def of_single_key(translate: Callable[..., Any], types: Types, **parameters: Condition) -> TranslationRule:
    """A rule for a single key or seed."""
    return TranslationRule(translate, Specification(types, parameters, of_scalars))


RANDOM_RULES: dict[str, TranslationRule] = {
    "random_fold_in": of_single_key(fold_in, WHOLE | {KEY}),
    "random_seed": of_single_key(seed, WHOLE | {KEY}, impl=anything),
    "random_bits": of_single_key(bits, UNSIGNED_INTEGERS | {KEY}, bit_width=one_of(8, 16, 32, 64), shape=anything),
    "random_split": of_single_key(split_key, frozenset({KEY}), shape=anything),
    "random_unwrap": of_single_key(unwrap, UNSIGNED_INTEGERS | {KEY}),
    "random_wrap": rule(wrap, UNSIGNED_INTEGERS | {KEY}, impl=anything),
}
"""TranslationRule of each primitive by its name; a generator is refused by the type of its keys."""
