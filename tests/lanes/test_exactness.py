"""What the compiler translates has the values of plain XLA, of hostile operands, too; the rest it refuses by name."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from dssc_jax.lanes.functions.elementary import ELEMENTARY
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.lanes.tracing.arrays import ARRAY_RULES
from dssc_jax.lanes.tracing.indexing import INDEXING_RULES
from dssc_jax.lanes.tracing.loops import LOOPS
from dssc_jax.lanes.tracing.primitives import ELEMENT_RULES
from dssc_jax.lanes.tracing.random_bits import RANDOM_RULES
from dssc_jax.lanes.tracing.specification import Specification, TranslationRule, no_value
from dssc_jax.lanes.tracing.translate import INLINED, OVER_LANES
from dssc_jax.lanes.unsupported import Unsupported
from tests.lanes.against_plain import both

WHOLE = [np.dtype(f"{kind}{size}") for kind in "iu" for size in (1, 2, 4, 8)]
TABLE = np.linspace(0.0, 1.0, 2000) ** 2
FLAGS = TABLE > 0.3


def pairs(*values):
    """Every value beside every other, as two columns."""
    return tuple(column.ravel().copy() for column in np.meshgrid(*values))


def hostile_integers(dtype):
    """The ends of a type's range, small numbers and powers of two."""
    limits = np.iinfo(dtype)
    near = [limits.min, limits.min + 1, limits.max, limits.max - 1, limits.max // 2]
    small = [number for number in (-65, -2, -1, 0, 1, 2, 3, 7, 31, 32, 63, 64, 100) if number >= limits.min]
    return np.unique(np.array(near + small, dtype))


@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("dtype", WHOLE, ids=str)
def test_integers_are_those_of_xla(dtype, strict):
    """Among them division by zero, the least number by -1, and shifts by more than the width."""
    x, y = pairs(hostile_integers(dtype), hostile_integers(dtype))

    def results(x, y):
        compared = [x < y, x <= y, x > y, x >= y, x == y, x != y]
        shifted = [lax.shift_left(x, y), lax.shift_right_arithmetic(x, y), lax.shift_right_logical(x, y)]
        logic = [x & y, x | y, x ^ y, ~x]
        others = [lax.sign(x), lax.clamp(y, x, jnp.asarray(7, dtype)), lax.integer_pow(x, 3), lax.neg(x)]
        sums = [lax.add(x, y), lax.sub(x, y), lax.mul(x, y), lax.max(x, y), lax.min(x, y)]
        return *sums, lax.div(x, y), lax.rem(x, y), *compared, *shifted, *logic, *others

    for lanes, plain in zip(*both(results, x, y, strict=strict), strict=True):
        assert lanes.dtype == plain.dtype
        np.testing.assert_array_equal(lanes, plain)


@pytest.mark.parametrize("dtype", [*WHOLE, np.dtype(bool)], ids=str)
@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_conversions_are_those_of_xla(dtype, real):
    """Out of range they stop at the ends, and NaN becomes 0."""
    edges = [0.0, 0.5, 1.0, 1.5, 127.0, 128.0, 255.9, 256.0, 2.0**31, 2.0**32, 2.0**63, 2.0**64, 1e30, np.inf, np.nan]
    x = np.array([*edges, *(-edge for edge in edges)], real)
    lanes, plain = both(lambda x: x.astype(dtype), x)
    assert lanes.dtype == plain.dtype
    np.testing.assert_array_equal(lanes, plain)
    whole = hostile_integers(dtype) if dtype.kind != "b" else np.array([False, True, True])
    for other in (np.int8, np.uint16, np.int32, np.uint32, np.int64, np.uint64, np.float32, np.float64, np.bool_):
        np.testing.assert_array_equal(*both(lambda x, other=other: x.astype(other), whole))


@pytest.mark.parametrize("width", [1, 8])
def test_truth_values_are_read_from_bytes(width):
    x, y = pairs(np.array([True, False, True, True]), np.array([False, True, False]))

    def results(x, y):
        where = jnp.where(x, 3.0, jnp.where(y, 2.0, 1.0))
        return where, x & y, x ^ y, lax.max(x, y), lax.min(x, y), x < y, x == y, x.astype(jnp.int32), ~x

    for lanes, plain in zip(*both(results, x, y, width=width), strict=True):
        np.testing.assert_array_equal(lanes, plain)
    np.testing.assert_array_equal(*both(lambda i: jnp.asarray(FLAGS)[i], np.arange(0, 2000, 37), width=width))


@pytest.mark.parametrize("dtype", WHOLE, ids=str)
@pytest.mark.parametrize("mode", ["clip", "fill", "promise_in_bounds"])
def test_an_index_of_any_type_reads_what_xla_reads(dtype, mode):
    """Also in tables longer than the type counts, from the end, and beyond it."""
    i = hostile_integers(dtype)
    size = 100 if dtype == np.int8 else 300  # JAX itself adds the size to such an index

    def results(i, x):
        changing = jnp.arange(1.0 * size) * x
        tables = TABLE[:100] if dtype == np.int8 else TABLE, FLAGS[-size:], changing
        read = [jnp.asarray(array).at[i].get(mode=mode) for array in tables]
        part = lax.dynamic_slice(changing, (i,), (3,))
        return *read, part[0], part[2], lax.dynamic_slice(jnp.asarray(TABLE), (i,), (5,))[4]

    for lanes, plain in zip(*both(results, i, np.linspace(1.0, 2.0, len(i))), strict=True):
        np.testing.assert_array_equal(lanes, plain)


@pytest.mark.parametrize("dtype", [np.int16, np.uint8, np.int32, np.uint64])
def test_an_index_of_any_type_writes_what_xla_writes(dtype):
    i = hostile_integers(np.dtype(dtype))

    def results(i, x):
        start = jnp.zeros(150)
        added = start.at[i].add(x, mode="drop")
        clipped = start.at[i].set(x, mode="clip")
        replaced = lax.dynamic_update_slice(start, jnp.stack([x, 2.0 * x]), (i,))
        return tuple(array[at] for array in (added, clipped, replaced) for at in (0, 1, 7, 126, 127, 148, 149))

    for lanes, plain in zip(*both(results, i, np.linspace(1.0, 2.0, len(i))), strict=True):
        np.testing.assert_array_equal(lanes, plain)


def test_a_table_may_be_read_at_a_fixed_index():
    """An index from a plain number of a study is a constant of the program."""

    def lane(x):
        return jnp.asarray(TABLE)[jnp.int32(7)] * x + lax.dynamic_index_in_dim(TABLE, np.int32(9), keepdims=False)

    np.testing.assert_array_equal(*both(lane, np.array([0.0, 1.0, -2.0])))


@pytest.mark.parametrize("strict", [False, True])
def test_a_constant_factor_is_moved_only_if_it_keeps_its_digits(strict):
    """1/1e-310 is infinite, and 1e300 times 1e300, too."""

    def lane(x):
        def turn(k, s):
            return s + (k * x) / 1e-310 * 0.0 + (x * k * 1e300) * 1e300

        return lax.fori_loop(0, 5, turn, 0.0)

    x = np.array([0.0, 1e-320, 1e-306, -3e-307])
    expected = sum((x * k * 1e300) * 1e300 for k in range(5))
    found = CompiledLanes(lane, jax.ShapeDtypeStruct((), np.float64), strict=strict).start((x,), len(x), 1)()
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_extremes_of_zeros_have_the_signs_of_xla():
    x, y = pairs(np.array([0.0, -0.0, np.nan, 1.0]), np.array([0.0, -0.0, 1.0, np.nan]))

    def results(x, y):
        return lax.max(x, y), lax.min(x, y), lax.max(x, 0.0), lax.min(x, -0.0)

    for lanes, plain in zip(*both(results, x, y, strict=True), strict=True):
        np.testing.assert_array_equal(lanes, plain)
        known = ~np.isnan(plain)
        np.testing.assert_array_equal(np.signbit(lanes[known]), np.signbit(plain[known]))


SMALL_TYPES = ["bfloat16", "float16", "float8_e4m3fn", "int4"]


def through(name):
    """A sum in another type."""

    def lane(values, index):
        x = values["a"].astype(name)
        return {"sum": (x + x).astype(float)}

    return lane


def complex_equality(values, index):
    z = values["a"] + 1j
    return {"equal": (z == jnp.conj(z)).astype(float)}


def complex_constant(values, index):
    return {"real": jnp.real(jnp.asarray([1.0 + 2.0j, 3.0])[0] * values["a"])}


def less_precise(values, index):
    return {"rounded": lax.reduce_precision(values["a"], 5, 5)}


def wider_sums(values, index):
    x = jnp.stack([values["a"], 1.0]).astype(jnp.float32)
    return {"product": lax.dot(x, x, preferred_element_type=jnp.float64)}


def wider_products(values, index):
    x = jnp.int8(100.0 * jnp.tanh(values["a"]))
    return {
        "product": lax.mul_p.bind(x, x, out_dtype=None) + lax.dot(x[None], x[None], preferred_element_type=jnp.int32)
    }


def narrower_bits(values, index):
    return {"bits": lax.bitcast_convert_type(values["a"], jnp.uint32)[0].astype(float)}


def wider_bits(values, index):
    words = jnp.stack([values["a"], 1.0]).astype(jnp.float32)
    return {"bits": lax.bitcast_convert_type(words, jnp.float64)}


def accurate(values, index):
    return {"exponential": lax.exp(values["a"], accuracy=lax.AccuracyMode.HIGHEST)}


def algorithm(values, index):
    x = jnp.stack([values["a"], 1.0]).astype(jnp.float32)
    return {"product": lax.dot(x, x, precision=lax.DotAlgorithmPreset.BF16_BF16_F32)}


REFUSED = {
    **{name: (through(name), f"elements of type {name}") for name in SMALL_TYPES},
    "complex equality": (complex_equality, "elements of type complex128"),
    "complex constant": (complex_constant, "elements of type complex128"),
    "reduce_precision": (less_precise, "fewer bits than the type has"),
    "preferred type": (wider_sums, "preferred_element_type = float64"),
    "preferred integer": (wider_products, "preferred_element_type = int32"),
    "narrower bits": (narrower_bits, "bits of another width"),
    "wider bits": (wider_bits, "bits of another width"),
    "accuracy": (accurate, "the parameter accuracy"),
    "algorithm": (algorithm, "the parameter precision"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_exact_is_refused_by_name(name):
    lane, reason = REFUSED[name]
    with pytest.raises(Unsupported, match=f"test_exactness.*{reason}|{reason}.*test_exactness"):
        CompiledLanes(lane, {"a": jax.ShapeDtypeStruct((), np.float64)}, jax.ShapeDtypeStruct((), np.uint32))


ALL_RULES = {
    **INLINED, **LOOPS, **OVER_LANES, **RANDOM_RULES, **ELEMENT_RULES, **ELEMENTARY, **ARRAY_RULES, **INDEXING_RULES,
}  # fmt: skip


def test_every_rule_says_what_it_is_exact_for():
    assert all(
        isinstance(rule, TranslationRule) and isinstance(rule.specification, Specification)
        for rule in ALL_RULES.values()
    )
    inside = {**INLINED, **LOOPS}
    assert {name for name, rule in ALL_RULES.items() if rule.specification.types is None} == set(inside)


def test_a_parameter_of_a_newer_jax_is_refused(monkeypatch):
    """As if the rule of multiplication had been written before its ``out_dtype``."""
    known = ELEMENT_RULES["mul"]
    older = TranslationRule(known.translate, Specification(known.specification.types, {}))
    monkeypatch.setitem(ELEMENT_RULES, "mul", older)
    with pytest.raises(Unsupported, match=r"'mul' in .*: an unknown parameter out_dtype = None"):
        CompiledLanes(lambda x: x * x, jax.ShapeDtypeStruct((), np.float64), width=4)
    assert known.specification.parameters["out_dtype"] is no_value


def test_another_type_is_refused_as_input_and_as_result():
    for dtype in (jnp.bfloat16, np.float16, np.complex64):
        with pytest.raises(Unsupported, match="elements of type"):
            CompiledLanes(lambda x: x, jax.ShapeDtypeStruct((), dtype))


def test_arrays_of_keys_are_refused_where_they_cannot_be_told_apart():
    def lane(i):
        keys = jax.random.split(jax.random.key(i), 3)
        return jax.random.bits(keys[i])

    with pytest.raises(Unsupported, match="random key"):
        CompiledLanes(lane, jax.ShapeDtypeStruct((), np.uint32))
