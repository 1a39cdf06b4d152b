"""Hostile numbers of every type: zeros, ends of ranges, powers of two and their neighbours, NaN."""

from functools import cache

import jax.numpy as jnp
import numpy as np

FLOATS = ("float64", "float32", "float16", "bfloat16", "float8_e4m3fn", "float8_e5m2")
SIGNED = ("int64", "int32", "int16", "int8", "int4")
UNSIGNED = ("uint64", "uint32", "uint16", "uint8", "uint4")
COMPLEX = ("complex128", "complex64")
TYPES = (*FLOATS, *SIGNED, *UNSIGNED, "bool", *COMPLEX)
MAIN = ("float64", "float32")
"""Types whose arithmetic the referee computes itself."""

SLOTS = 3
"""Columns of each type that a program can read."""

MAGNITUDES = (
    0.0, 0.1, 0.25, 0.3, 1.0 / 3.0, 0.49999999999999994, 0.5, 0.7, 0.9, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 5.0, 7.0, 8.0,
    10.0, 20.0, 36.8, 37.5, 50.0, 88.7, 88.72284, 89.0, 100.0, 103.98, 104.5, 127.0, 128.0, 129.0, 150.0, 254.6, 255.0,
    255.5, 256.0, 709.78, 709.79, 710.0, 710.4758, 711.0, 745.13, 745.2, 1000.0, 1074.5, 4095.9, 32767.5, 32768.0,
    65504.0, 65535.5, 65536.0, 1e5, 1e8, 2.0**24 + 1.0, 2.0**31 - 1.0, 2.0**31, 2.0**32 - 1.0, 2.0**32, 2.0**33,
    2.0**52 + 0.5, 2.0**53 - 1.0, 2.0**53, 2.0**62, 2.0**63, 2.0**63 - 1024.0, 2.0**64, 2.0**64 - 2048.0, 1e22, 1e30,
    1e38, 3e38, 2.0**127.5, 1e100, 1e154, 1.4e154, 1e200, 1e300, 2.0**1022.5, 2.0**1023, 1e-5, 1e-8, 1e-16, 1e-30,
    1e-38, 1e-40, 1e-45, 1e-100, 1e-154, 1e-200, 1e-300, 2.0**-1022, 2.0**-1023, 1e-310, 5e-324,
)  # fmt: skip
QUARTER_TURNS = (1, 2, 3, 4, 5, 1000, 2**12, 2**12 + 1, 2**20 - 1, 2**20, 2**20 + 1, 2**21, 2**30 + 3, 2**40, 2**52 + 1)
WHOLE = (0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 15, 16, 31, 32, 33, 63, 64, 65, 100, 127, 128, 200, 255, 256, 257, 300, 1000)
POWERS = (15, 16, 24, 31, 32, 53, 62, 63)


def real_numbers(dtype: np.dtype) -> np.ndarray:
    """Hostile floating-point numbers."""
    limits = jnp.finfo(dtype)
    ends = (limits.tiny, limits.smallest_subnormal, limits.max, limits.eps)
    magnitudes = [*MAGNITUDES, *(float(end) for end in ends), *(turns * np.pi / 2.0 for turns in QUARTER_TURNS)]
    with np.errstate(all="ignore"):
        numbers = np.array(magnitudes).astype(dtype)
        if dtype.name in MAIN:
            around = [np.nextafter(numbers, dtype.type(towards)) for towards in (0.0, np.inf)]
            numbers = np.concatenate([numbers, *around])
    whole = np.concatenate([numbers, np.array([np.inf]).astype(dtype)])
    both = np.concatenate([whole, -whole, np.array([np.nan]).astype(dtype)])
    return distinct(both)


def distinct(numbers: np.ndarray) -> np.ndarray:
    """The numbers without repetition, by their bits."""
    known = {number.tobytes(): number for number in numbers}
    return np.array(list(known.values()), numbers.dtype)


def whole_numbers(dtype: np.dtype) -> np.ndarray:
    """Hostile integers."""
    limits = jnp.iinfo(dtype)
    least, most = int(limits.min), int(limits.max)
    around = [2**power + offset for power in POWERS for offset in (-1, 0, 1)]
    candidates = [*WHOLE, *(-number for number in WHOLE), *around, *(-number for number in around)]
    candidates += [least, least + 1, most - 1, most, most // 2, most // 3]
    inside = dict.fromkeys(number for number in candidates if least <= number <= most)
    return np.array(list(inside), object).astype(np.uint64 if least == 0 else np.int64).astype(dtype)


@cache
def hostile(name: str) -> np.ndarray:
    """The hostile numbers of a type."""
    dtype = jnp.dtype(name)
    if name == "bool":
        return np.array([False, True])
    if name in COMPLEX:
        real = real_numbers(np.dtype(f"f{dtype.itemsize // 2}"))[::7]
        with np.errstate(all="ignore"):
            return distinct((real[:, None] + 1j * real[None, :]).ravel().astype(dtype))
    return real_numbers(dtype) if name in FLOATS else whole_numbers(dtype)


def ordinary(name: str, count: int, rng: np.random.Generator) -> np.ndarray:
    """Numbers of moderate size."""
    dtype = jnp.dtype(name)
    if name in FLOATS or name in COMPLEX:
        numbers = rng.normal(size=count) * 10.0 ** rng.uniform(-3.0, 2.0, count)
        return numbers.astype(dtype)
    if name == "bool":
        return rng.random(count) < 0.5
    return rng.integers(-9 if name in SIGNED else 0, 10, count).clip(jnp.iinfo(dtype).min, jnp.iinfo(dtype).max).astype(
        dtype)  # fmt: skip


@cache
def column(name: str, slot: int, count: int, seed: int) -> np.ndarray:
    """A column of inputs: two thirds hostile, the rest ordinary; of every slot other pairs."""
    rng = np.random.default_rng([TYPES.index(name), slot, count, seed])
    numbers = hostile(name)
    order = rng.permutation(count * 2 // 3)
    chosen = numbers[(order + slot * (order // len(numbers))) % len(numbers)]
    whole = np.concatenate([chosen, ordinary(name, count - len(chosen), rng)])
    return whole[rng.permutation(count)]
