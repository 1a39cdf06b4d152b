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
    any_value,
    array_type,
    one_of,
    rule,
)
from dssc_jax.lanes.unsupported import Unsupported

WORD = np.dtype(np.uint32)
ROTATIONS = (13, 15, 26, 6), (17, 29, 16, 24)
"""Bits by which Threefry rotates a word in four rounds, and in the next four."""
PARITY = 0x1BD11BDA
"""Threefry's constant; its exclusive or with both words of a key is the key's third word."""


@dataclass(frozen=True, eq=False)
class Key:
    """A random key, which consists of two words of 32 bits.

    Args:
        high: The upper word.
        low: The lower word.
    """

    high: Value
    low: Value


def rotate_left(build: Builder, x: Value, count: int) -> Value:
    """Return a word of 32 bits, rotated left by ``count`` bits, of which 0 < count < 32."""
    upper_part = build.add("shl", x, build.constant(count, WORD))
    return build.add("or", upper_part, build.add("shr", x, build.constant(32 - count, WORD)))


def threefry(build: Builder, key: Key, high: Value, low: Value) -> tuple[Value, Value]:
    """Encrypt a block of two words with a key by Threefry's cipher; return the two encrypted words.

    After every four of the 20 rounds, the cipher adds two of the key's three words, in turn, and the number of groups
    of four rounds so far.

    Args:
        build: The builder.
        key: The key.
        high: First word of the block.
        low: Second word of the block.
    """
    third_word = build.add("xor", build.add("xor", key.high, key.low), build.constant(PARITY, WORD))
    key_words = key.high, key.low, third_word
    x = build.add("add", high, key.high)
    y = build.add("add", low, key.low)
    for group in range(5):
        for count in ROTATIONS[group % 2]:
            x = build.add("add", x, y)
            y = build.add("xor", x, rotate_left(build, y, count))
        x = build.add("add", x, key_words[(group + 1) % 3])
        y = build.add("add", y, build.add("add", key_words[(group + 2) % 3], build.constant(group + 1, WORD)))
    return x, y


def require_threefry(key_type: Any) -> None:
    """Require that keys of a type belong to the generator Threefry.

    Raises:
        Unsupported: The keys belong to another generator.
    """
    if "fry" not in str(key_type):  # JAX prints Threefry's type as key<fry>
        raise Unsupported(f"random numbers of another generator, {key_type}")


def fold_in(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Key:
    """``jax.random.fold_in``: a new key from a key and a number, which is the block that the key encrypts."""
    key, number = operands
    return Key(*threefry(build, key, build.constant(0, WORD), build.add("convert", number, dtype=WORD)))


def seed(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Key:
    """``jax.random.key``: the key that consists of the upper and the lower word of a seed."""
    number = operands[0]
    if number.dtype.itemsize < 8:
        return Key(build.constant(0, WORD), build.add("convert", number, dtype=WORD))
    wide = np.dtype(np.uint64)
    bits = build.add("bitcast", number, dtype=wide)
    upper = build.add("shr", bits, build.constant(32, wide))
    return Key(build.add("convert", upper, dtype=WORD), build.add("convert", bits, dtype=WORD))


def counter_blocks(build: Builder, key: Key, shape: tuple[int, ...]) -> list[tuple[Value, Value]]:
    """Return the counters 0, 1, 2, ... encrypted by a key: two random words for each element of an array of a shape.

    Raises:
        Unsupported: JAX is set to another scheme of counters.
    """
    if not jax.config.jax_threefry_partitionable:  # pyright: ignore[reportAttributeAccessIssue]
        raise Unsupported("jax_threefry_partitionable is off")
    zero = build.constant(0, WORD)
    return [threefry(build, key, zero, build.constant(i, WORD)) for i in range(int(np.prod(shape)))]


def with_shape(elements: Sequence[Any], shape: tuple[int, ...]) -> Any:
    """Return elements as an array of a shape; for the shape (), return the only element itself."""
    if not shape:
        return elements[0]
    tensor = np.empty(len(elements), object)
    tensor[:] = elements
    return tensor.reshape(shape)


def bits(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``jax.random.bits``: an array of random words of 8, 16, 32 or 64 bits, from the encrypted counters of a key."""
    key = operands[0]
    shape = params["shape"]
    bit_width = params["bit_width"]
    dtype = np.dtype(f"u{bit_width // 8}")
    words = []
    for high, low in counter_blocks(build, key, shape):
        if bit_width == 64:
            upper = build.add("shl", build.add("convert", high, dtype=dtype), build.constant(32, dtype))
            words.append(build.add("or", upper, build.add("convert", low, dtype=dtype)))
        else:
            words.append(build.add("convert", build.add("xor", high, low), dtype=dtype))
    return with_shape(words, shape)


def split_key(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``jax.random.split``: an array of new keys, which are the encrypted counters of one key."""
    shape = params["shape"]
    keys = [Key(high, low) for high, low in counter_blocks(build, operands[0], shape)]
    return with_shape(keys, shape)


def words_of_key(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Any:
    """``jax.random.key_data``: the two words of a key as an array."""
    return with_shape([operands[0].high, operands[0].low], (2,))


def key_of_words(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> Key:
    """``jax.random.wrap_key_data``: a key from an array of two words; an array of several keys is refused."""
    words = as_tensor(operands[0], build)
    if words.shape != (2,):
        raise Unsupported(f"an array of keys of shape {words.shape[:-1]}")
    return Key(*words)


def refuse_arrays(equation: JaxprEqn) -> str | None:
    """Return the reason why an equation is not translated, if an operand is an array of keys or seeds; else None."""
    has_array = any(array_type(variable).shape != () for variable in equation.invars)
    return "an array of random keys" if has_array else None


def single_key_rule(translate: Callable[..., Any], types: Types, **parameters: Condition) -> TranslationRule:
    """Return a rule for equations whose operands are single keys or seeds.

    Args:
        translate: Builds the operations of an equation.
        types: Types that every operand and result may have.
        parameters: The condition of each parameter of the equation.
    """
    return TranslationRule(translate, Specification(types, parameters, refuse_arrays))


RANDOM_RULES: dict[str, TranslationRule] = {
    "random_fold_in": single_key_rule(fold_in, WHOLE | {KEY}),
    "random_seed": single_key_rule(seed, WHOLE | {KEY}, impl=any_value),
    "random_bits": single_key_rule(bits, UNSIGNED_INTEGERS | {KEY}, bit_width=one_of(8, 16, 32, 64), shape=any_value),
    "random_split": single_key_rule(split_key, frozenset({KEY}), shape=any_value),
    "random_unwrap": single_key_rule(words_of_key, UNSIGNED_INTEGERS | {KEY}),
    "random_wrap": rule(key_of_words, UNSIGNED_INTEGERS | {KEY}, impl=any_value),
}
"""The rules of random numbers, by the name of JAX's primitive; another generator is refused by the type of its keys."""
