"""The program of a lane: every kind of operation against plain XLA, random numbers bit for bit, and what is refused."""

import time
import warnings

import jax
import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np
import pytest

from dssc_jax.lanes.interface import AXIS
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.lanes.llvm import machine
from dssc_jax.lanes.llvm.module_text import module_text
from dssc_jax.lanes.passes.liveness import operation_counts
from dssc_jax.lanes.passes.negated_states import loops_of
from dssc_jax.lanes.tracing.translate import translate
from dssc_jax.lanes.unsupported import Unsupported
from tests.lanes.against_plain import LANES, RNG, ROUNDING, X, both

PLACES = RNG.integers(-2, 9, LANES, dtype=np.int32)
TABLE = np.linspace(0.0, 1.0, 2000) ** 2
TABLE[500:1500] += 1.0
MATRIX = np.arange(12.0).reshape(3, 4)


def ring(x, i):
    """A memory of five numbers, written and read at indices of the run."""

    def turn(k, memory):
        return memory.at[k % 5].set(memory[(k + 2) % 5] + x * k)

    return jax.lax.fori_loop(0, 17, turn, jnp.zeros(5))[i % 5]


def newton(x, i):
    """A loop whose number of turns is a lane's own."""
    return jax.lax.while_loop(lambda r: jnp.abs(r * r - jnp.abs(x)) > 1e-9, lambda r: 0.5 * (r + jnp.abs(x) / r), 1.0)


def drawn(x, i):
    """A loop with a key for each turn."""
    keys = jax.random.split(jax.random.fold_in(jax.random.key(3), i), 5)
    return jax.lax.scan(lambda state, key: (state + x * jax.random.uniform(key), None), x, keys)[0]


CASES = {
    "keys of turns": drawn,
    "matrix": lambda x, i: jnp.sum(MATRIX @ jnp.stack([x, 2.0 * x, x * x, 1.0])),
    "table": lambda x, i: jnp.asarray(TABLE)[i * 150],
    "table, clipped": lambda x, i: jnp.take(jnp.asarray(TABLE), i * 400, mode="clip"),
    "table, filled": lambda x, i: jnp.take(jnp.asarray(TABLE), i * 400),
    "row of a matrix": lambda x, i: jnp.sum(jnp.take(MATRIX, i, axis=0, mode="clip") * x),
    "dynamic slice": lambda x, i: jax.lax.dynamic_slice(jnp.arange(8.0) * x, (i,), (3,)).sum(),
    "update": lambda x, i: jax.lax.dynamic_update_slice(jnp.arange(8.0), jnp.stack([x, x]), (i,))[3],
    "scatter": lambda x, i: jnp.zeros(6).at[i].add(x).at[2].set(1.0).prod() + jnp.zeros(6).at[i].set(x).sum(),
    "ring": ring,
    "newton": newton,
    "cond": lambda x, i: jax.lax.cond(x > 0.0, lambda: jnp.sin(x), lambda: x * x),
    "switch": lambda x, i: jax.lax.switch(i, [lambda: x, lambda: 2.0 * x, lambda: x * x]),
    "shifts": lambda x, i: (i << 3) + (i >> 1) + jax.lax.shift_right_logical(i, jnp.int32(2)) + (i << 40),
    "integers": lambda x, i: jnp.where(i > 3, i // 2, i % 3) + i.astype(jnp.int64) * 3 + jax.lax.div(jnp.int32(7), i),
    "remainder": lambda x, i: jax.lax.rem(x, 0.3) + jnp.mod(x, 0.7),
    "rounding": lambda x, i: jnp.round(4.0 * x) + jnp.floor(x) + jnp.ceil(x) + jnp.trunc(x) + jnp.sign(x),
    "conversion": lambda x, i: (100.0 * x).astype(jnp.int32) + (x > 0.0).astype(jnp.int32) + jnp.isfinite(x),
    "cumulative": lambda x, i: jnp.cumsum(x * jnp.arange(4.0))[2] + jnp.max(jnp.stack([x, 0.5, -x])),
    "concatenation": lambda x, i: jnp.concatenate([jnp.stack([x, x]), jnp.arange(3.0)])[::-1][jnp.clip(i, 0, 4)],
    "logarithms": lambda x, i: jnp.log2(1.0 + x * x) + jnp.exp2(x) + jnp.log10(i),
    "power": lambda x, i: x**3 + x**-2 + jnp.sqrt(jnp.abs(x)) + jax.lax.rsqrt(1.0 + x * x),
    "scan over rows": lambda x, i: jax.lax.scan(lambda s, row: (s * x + row, None), x, jnp.arange(5.0))[0],
    "no turns": lambda x, i: jax.lax.fori_loop(1, 1, lambda k, s: 2.0 * s, x),
    "search": lambda x, i: jnp.searchsorted(jnp.linspace(-1.0, 1.0, 9), jnp.where(i > 3, jnp.nan, x)),
    "search from the right": lambda x, i: jnp.searchsorted(jnp.array([-1.0, x, jnp.nan]), i - 3.0, side="right"),
    "tangent": lambda x, i: jax.jvp(lambda z: jnp.tanh(z) * jnp.exp(-z * z), (x,), (1.0,))[1],
    "tangent of a loop": lambda x, i: jax.jvp(
        lambda z: jax.lax.scan(lambda s, row: (s * z + row, None), z, jnp.arange(5.0))[0], (x,), (1.0,)
    )[1],
    "checkpoint": lambda x, i: jax.checkpoint(lambda z: jnp.sin(z) * z)(x),
    "together": lambda x, i: jax.lax.pmax(jnp.where(i > 100, 1, 0), AXIS) + i,
}


@pytest.mark.parametrize("name", CASES)
def test_an_operation_is_that_of_plain_xla(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        lanes, plain = both(CASES[name], X, PLACES)
    assert lanes.dtype == plain.dtype
    np.testing.assert_allclose(lanes, plain, rtol=ROUNDING, atol=1e-14)


@pytest.mark.parametrize("function", [jnp.maximum, jnp.minimum, lambda x, y: jnp.clip(x, y, 1.0)])
def test_a_nan_is_kept(function):
    x, y = np.array([1.0, np.nan, 2.0, np.inf, -0.5]), np.array([np.nan, 1.0, 3.0, 1.0, -np.inf])
    np.testing.assert_array_equal(*both(function, x, y))
    np.testing.assert_array_equal(*both(lambda x, y: function(x, 0.5) + 0.0 * y, x, np.zeros(5)))


RANDOM = {
    "normal": lambda i: jax.random.normal(jax.random.fold_in(jax.random.key(3), i)),
    "bits": lambda i: jax.random.bits(jax.random.fold_in(jax.random.key(3), i), (3,)),
    "wide bits": lambda i: jax.random.bits(jax.random.fold_in(jax.random.key(2**40 + 3), i), dtype=jnp.uint64),
    "split": lambda i: jax.random.key_data(jax.random.split(jax.random.fold_in(jax.random.key(3), i), 3)[1]),
    "uniform": lambda i: jax.random.uniform(jax.random.key(i), minval=-1.0, maxval=3.0),
    "folded twice": lambda i: jax.random.key_data(jax.random.fold_in(jax.random.fold_in(jax.random.key(i), 7), i)),
    "wrapped": lambda i: jax.random.bits(jax.random.wrap_key_data(jnp.stack([i, i + jnp.uint32(1)]))),
}


@pytest.mark.parametrize("name", RANDOM)
def test_random_numbers_are_those_of_jax(name):
    """Words bit for bit; normal numbers by another polynomial."""
    i = np.arange(LANES, dtype=np.uint32) * 1234567

    def numbers(i):
        drawn = RANDOM[name](i)
        return tuple(drawn) if drawn.ndim else (drawn,)

    for lanes, plain in zip(*both(numbers, i), strict=True):
        if name == "normal":
            np.testing.assert_allclose(lanes, plain, rtol=1e-14)
        else:
            np.testing.assert_array_equal(lanes, plain)


def test_a_key_may_be_the_state_of_a_loop():
    def lane(i):
        def turn(carry, _):
            key, total = carry
            key, own = jax.random.split(key)
            return (key, total + jax.random.uniform(own)), None

        return jax.lax.scan(turn, (jax.random.key(i), 0.0), length=20)[0][1]

    np.testing.assert_allclose(*both(lane, np.arange(9, dtype=np.uint32)), rtol=ROUNDING)


@pytest.mark.parametrize("width", [1, 8])
def test_llvm_does_not_take_the_sums_of_random_words_apart(width):
    """Otherwise it needs seconds for a noisy loop of one lane; vectors it leaves alone by itself."""

    def lane(i):
        def turn(k, total):
            return total + jax.random.uniform(jax.random.fold_in(jax.random.key(i), k))

        return jax.lax.fori_loop(0, 20, turn, 0.0)

    program, _ = translate(lane, jax.ShapeDtypeStruct((), np.uint32))
    sums, frozen = set(), set()
    for line in module_text(program, width, False).splitlines():
        name, _, instruction = line.strip().partition(" = ")
        if instruction.startswith("add i32 "):
            sums.add(name)
        if instruction.startswith("freeze i32 "):
            frozen.add(instruction.rpartition(" ")[2])
    assert frozen <= sums
    assert (len(frozen) >= 2 * 20) == (width == 1)  # two blocks of twenty rounds
    np.testing.assert_allclose(*both(lane, np.arange(9, dtype=np.uint32), width=width), rtol=ROUNDING)


@pytest.mark.parametrize("width", [1, 8, 16])
def test_a_recording_has_its_samples_in_order(width):
    def lane(x):
        return jax.lax.scan(lambda s, _: (s * 0.9 + x, (s, s > 1.0)), x, length=50)

    lanes, plain = both(lane, X, width=width)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=ROUNDING), lanes, plain)
    assert lanes[1][1].dtype == bool


def sine_and_state(x):
    """A loop in which much follows from the time alone."""

    def turn(carry):
        k, s = carry
        t = 0.01 * k
        return k + 1, s + 0.01 * (jnp.sin(3.0 * t) * x - s * jnp.exp(-t) + jnp.where(k < 30, 1.0, jnp.cos(t)))

    return jax.lax.while_loop(lambda carry: carry[0] < 203, turn, (0, x))[1]


def test_values_of_the_time_alone_are_computed_ahead():
    """203 turns are no multiple of the turns of a vector along time."""
    np.testing.assert_allclose(*both(sine_and_state, X), rtol=ROUNDING)
    program, _ = translate(sine_and_state, jax.ShapeDtypeStruct((), np.float64))
    assert "alloca <8 x double>" in module_text(program, 8)
    assert "alloca" not in module_text(program, 1)


def with_branches(x):
    """Waves that a branch of some lanes reads, within another branch, and that all lanes read after it."""

    def turn(carry):
        k, s = carry
        wave = jnp.sin(0.1 * k) + jnp.sin(0.2 * k)
        far = jax.lax.cond(
            s > 1.5, lambda: jax.lax.cond(x > 0.0, lambda: jnp.exp(-wave * s), lambda: wave / s), lambda: s
        )
        return k + 1, 0.9 * s + 0.1 * far * wave + 0.2 * x

    return jax.lax.while_loop(lambda carry: carry[0] < 203, turn, (0, x))[1]


@pytest.mark.parametrize("strict", [False, True])
def test_they_are_computed_ahead_for_branches_too(strict):
    np.testing.assert_allclose(*both(with_branches, X, strict=strict), rtol=1e-13)
    program, _ = translate(with_branches, jax.ShapeDtypeStruct((), np.float64))
    assert "alloca <8 x double>" in module_text(program, 8, strict)


def test_a_side_that_computes_nothing_is_no_branch():
    def lane(x):
        near = x * x + 1.0
        return jax.lax.cond(x > 1.0, lambda: jnp.exp(x), lambda: near)

    np.testing.assert_allclose(*both(lane, X), rtol=ROUNDING)
    text = module_text(translate(lane, jax.ShapeDtypeStruct((), np.float64))[0], 8)
    assert text.count("vector.reduce.or") == 2  # declared, and called for one side


@pytest.mark.parametrize("cpu", ["haswell", "skylake-avx512"])
def test_vectors_on_the_stack_are_aligned(cpu):
    """One across two lines of the cache takes twice as long. Code for these processors can be read anywhere."""

    def lane(x):
        waves = [jnp.exp(x * n) for n in range(70)]
        far = jax.lax.cond(x > 1.0, lambda: jnp.log(x), lambda: x)
        return sum(wave * waves[n * n % 70] for n, wave in enumerate(waves)) + far

    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    there = llvm.Target.from_triple("x86_64-unknown-linux-gnu").create_target_machine(cpu=cpu)
    module = llvm.parse_assembly(module_text(translate(lane, jax.ShapeDtypeStruct((), np.float64))[0], 16))
    module.triple, module.data_layout = there.triple, str(there.target_data)
    text = there.emit_assembly(module)
    moves = [line.split()[0] for line in text.splitlines() if "(%rsp)" in line and "vmov" in line and "mm" in line]
    assert moves.count("vmovapd") + moves.count("vmovaps") > 20
    assert not any(move.startswith(("vmovup", "vmovdqu")) for move in moves)


@pytest.mark.parametrize("lane", [sine_and_state, with_branches])
@pytest.mark.parametrize("vectors", [1, 2, 4])
def test_code_for_few_registers_gives_the_same_bits(lane, vectors, monkeypatch):
    """It reads constants from memory where it uses them, and computes each hardware vector on its own."""
    hardware_width = machine.vector_bits() // 64
    found = []
    products = []  # of hardware vectors
    for near in (False, True):
        monkeypatch.setattr(machine, "has_near_constants", lambda near=near: near)
        number = jax.ShapeDtypeStruct((), np.float64)
        compiled = CompiledLanes(lane, number, strict=True, width=vectors * hardware_width)
        text = compiled.traced.text
        assert ("@number." in text) == near
        products.append(text.count(f"fmul <{hardware_width} x double>"))
        found.append(compiled.start((X,), LANES, 1)())
    assert (products[1] > products[0]) == (vectors > 1)
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("strict", [False, True])
def test_only_fast_arithmetic_contracts(strict):
    program, _ = translate(sine_and_state, jax.ShapeDtypeStruct((), np.float64))
    text = module_text(program, 8, strict)
    assert ("contract" in text) != strict
    assert not any(word in text for word in ("nnan", "ninf", " fast "))


def test_strict_arithmetic_has_the_same_bits_for_every_width():
    results = [both(sine_and_state, X, strict=True, width=width)[0] for width in (1, 2, 8, 16, 64)]
    for other in results[1:]:
        np.testing.assert_array_equal(other, results[0])


def test_what_does_not_change_leaves_a_loop():
    def lane(x):
        return jax.lax.fori_loop(0, 9, lambda k, s: s + jnp.sqrt(x) * 3.0, x)

    program, _ = translate(lane, jax.ShapeDtypeStruct((), np.float64))
    (loop,) = (node for node in program.body.nodes if hasattr(node, "body"))
    assert not any(getattr(node, "operation", "") in ("sqrt", "mul") for node in loop.body.nodes)
    assert operation_counts(program)["sqrt"] == 1


@pytest.mark.parametrize(
    ("begin", "strict", "carried"),
    [((0.0, 0.0), False, 1), ((1.0, -1.0), False, 1), ((1.0, 1.0), False, 2), ((0.0, 0.0), True, 2)],
)
def test_a_loop_need_not_carry_the_negative_of_a_state(begin, strict, carried):
    """A command u = -u_av in a loop within a loop. Where they begin otherwise, or zeros have signs, both are kept."""

    def lane(x):
        def turn(_, state):
            average = 0.9 * state[0] + 0.1 * jnp.sin(x + state[1])
            return average, -average

        return jax.lax.fori_loop(0, 5, lambda _, state: jax.lax.fori_loop(0, 7, turn, state), begin)

    lanes, plain = both(lane, X, strict=strict)
    np.testing.assert_allclose(lanes, plain, rtol=ROUNDING)
    compiled = CompiledLanes(lane, jax.ShapeDtypeStruct((), np.float64), strict=strict)
    for loop in loops_of(compiled.traced.program.body):
        assert sum(state.dtype.kind == "f" for state in loop.states) == carried


def test_no_delayed_negative_is_carried():
    """Each pair follows from the one before it in the delay, and the first from its command."""

    def lane(x):
        def turn(_, state):
            (u, *line), (_, *mirrored) = state[:4], state[4:]
            now = 0.9 * u + 0.1 * jnp.sin(x + line[-1])
            return now, u, *line[:-1], -now, -u, *mirrored[:-1]

        return jax.lax.fori_loop(0, 9, turn, (0.0,) * 8)

    lanes, plain = both(lane, X)
    np.testing.assert_allclose(lanes, plain, rtol=ROUNDING)
    (loop,) = loops_of(CompiledLanes(lane, jax.ShapeDtypeStruct((), np.float64)).traced.program.body)
    assert sum(state.dtype.kind == "f" for state in loop.states) == 4


def test_equal_tables_are_told_apart_by_their_numbers():
    other = TABLE.copy()
    other[1000] += 0.25
    lanes, plain = both(lambda i: jnp.asarray(TABLE)[i * 125] - jnp.asarray(other)[i * 125], np.full(9, 8, np.int32))
    np.testing.assert_array_equal(lanes, plain)
    assert np.all(lanes == -0.25)


def test_another_generator_is_refused():
    with pytest.raises(Unsupported, match="another generator"):
        translate(lambda i: jax.random.bits(jax.random.key(i, impl="rbg")), jax.ShapeDtypeStruct((), np.uint32))


def sorts(values, index):
    return {"largest": jnp.sort(jnp.stack([values["a"], 1.0, -1.0]))[-1]}


def test_lanes_tell_when_they_ended_not_when_somebody_asks():
    finish = CompiledLanes(jnp.sin, jax.ShapeDtypeStruct((), np.float64)).start_timed((X,), LANES, 2)
    (_, ended), asked, (_, again) = finish(), time.perf_counter(), finish()
    assert ended == again <= asked


def test_a_loop_over_what_another_one_recorded_is_refused():
    def twice(x):
        _, recorded = jax.lax.scan(lambda state, _: (state + x, state), x, None, length=4)
        return jax.lax.scan(lambda state, value: (state + value, None), x, recorded)[0]

    with pytest.raises(Unsupported, match="an array that a loop records or carries"):
        translate(twice, jax.ShapeDtypeStruct((), np.float64))


def test_what_has_no_translation_is_named():
    with pytest.raises(Unsupported, match=r"'sort' in sorts .*test_translation.py"):
        CompiledLanes(sorts, {"a": jax.ShapeDtypeStruct((), np.float64)}, jax.ShapeDtypeStruct((), np.uint32))


def test_a_recording_may_be_a_result_twice_and_a_lane_needs_no_input():
    def lane(x):
        several = jax.lax.scan(lambda s, k: (0.5 * s + k, s), x, jnp.arange(5.0))[1]
        return several, several

    (one, other), (plain, _) = both(lane, X)
    np.testing.assert_allclose(one, plain, rtol=ROUNDING)
    np.testing.assert_array_equal(one, other)
    assert CompiledLanes(lambda: jnp.sin(1.0)).start((), 3, 1)() == pytest.approx(3 * [np.sin(1.0)])
