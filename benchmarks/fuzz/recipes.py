"""How each operation enters a random program: which operands, and what is fixed."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from benchmarks.fuzz.draft import Draft, Misfit, is_float
from benchmarks.fuzz.operations import BINARY, CUMULATIVE, OPERATIONS, REDUCTIONS, SCATTERS, UNARY
from benchmarks.fuzz.program import Kind, Node, Program
from benchmarks.fuzz.values import COMPLEX, TYPES

Recipe = Callable[[Draft, str], int]
SHAPES = ((2,), (3,), (5,), (2, 3), (3, 2))
INNER = ("add", "sub", "mul", "max", "min", "neg", "abs", "div", "sin", "exp", "sqrt", "bitwise_xor", "select_n", "lt",
         "convert", "floor", "shift_left", "clamp", "rem", "log", "tanh", "cond", "fori", "gather", "mul", "add",
         "mul", "add")  # fmt: skip
"""Operations of the bodies of loops and branches."""


def unary(name: str) -> Recipe:
    """One operand, now and then an array."""

    def recipe(draft: Draft, dtype: str) -> int:
        return draft.add(name, [draft.array(dtype, draft.pick(SHAPES)) if draft.chance(0.1) else draft.scalar(dtype)])

    return recipe


def binary(name: str) -> Recipe:
    """Two operands of one type."""

    def recipe(draft: Draft, dtype: str) -> int:
        if name == "pow" and is_float(dtype) and draft.chance(0.1):
            return draft.add(name, [draft.scalar(dtype), draft.scalar("int32")])
        if draft.chance(0.1):
            shape = draft.pick(SHAPES)
            return draft.add(name, [draft.array(dtype, shape), draft.array(dtype, shape)])
        return draft.add(name, [draft.scalar(dtype), draft.scalar(dtype)])

    return recipe


def clamp(draft: Draft, dtype: str) -> int:
    """The middle of three."""
    return draft.add("clamp", [draft.scalar(dtype) for _ in range(3)])


def select_n(draft: Draft, dtype: str) -> int:
    """One of two by a truth value, or of three by an integer."""
    if draft.chance(0.7):
        return draft.add("select_n", [draft.scalar("bool"), draft.scalar(dtype), draft.scalar(dtype)])
    number = draft.add("constant", value=np.int32(2))
    which = draft.add("clamp", [draft.add("constant", value=np.int32(0)), draft.scalar("int32"), number])
    return draft.add("select_n", [which, *(draft.scalar(dtype) for _ in range(3))])


def convert(draft: Draft, dtype: str) -> int:
    """Another type."""
    return draft.add("convert", [draft.scalar(dtype)], dtype=draft.pick(TYPES))


def bitcast(draft: Draft, dtype: str) -> int:
    """The same bits as another type; of other width, an array."""
    size = jnp.dtype(dtype).itemsize
    alike = [name for name in TYPES if jnp.dtype(name).itemsize == size]
    wanted = draft.pick(alike) if draft.chance(0.8) else draft.pick(TYPES)
    return draft.add("bitcast", [draft.scalar(dtype)], dtype=wanted)


def reduce_precision(draft: Draft, dtype: str) -> int:
    """Fewer digits."""
    exponent, mantissa = draft.pick(((5, 10), (8, 7), (8, 23), (11, 52), (4, 3), (2, 1), (11, 30), (8, 52)))
    return draft.add("reduce_precision", [draft.scalar(dtype)], exponent=exponent, mantissa=mantissa)


def rounded(draft: Draft, dtype: str) -> int:
    """The nearest whole number."""
    return draft.add("round", [draft.scalar(dtype)], method=draft.pick(("TO_NEAREST_EVEN", "AWAY_FROM_ZERO")))


def integer_pow(draft: Draft, dtype: str) -> int:
    """A fixed whole power."""
    powers = (0, 1, 2, 3, 5, 7, 16, -1, -2, -3, 31) if is_float(dtype) else (0, 1, 2, 3, 5, 16, 31)
    return draft.add("integer_pow", [draft.scalar(dtype)], y=draft.pick(powers))


def moved(draft: Draft, dtype: str) -> int:
    """Elements of an array moved."""
    matrix = draft.array(dtype, draft.pick(((2, 3), (3, 2))))
    rows, columns = draft.kinds[matrix].shape
    match int(draft.rng.integers(8)):
        case 0:
            return draft.add("transpose", [matrix], axes=(1, 0))
        case 1:
            return draft.add("rev", [matrix], axes=draft.pick(((0,), (1,), (0, 1))))
        case 2:
            return draft.add("slice", [matrix], start=(0, 1), stop=(rows, columns), step=(1, draft.pick((1, 2))))
        case 3:
            low, high, gap = (int(draft.rng.integers(least, 3)) for least in (-1, -1, 0))
            config = ((low, high, gap), (0, 1, 0))
            return draft.add("pad", [matrix, draft.scalar(dtype)], config=config)
        case 4:
            second = draft.array(dtype, (rows, columns))
            return draft.add("concatenate", [matrix, second], axis=int(draft.rng.integers(2)))
        case 5:
            return draft.add("reshape", [matrix], shape=(6,))
        case 6:
            return draft.add("broadcast", [draft.scalar(dtype)], shape=(3,))
        case _:
            return draft.add("iota", [], dtype=dtype, size=4)


def table(draft: Draft, dtype: str) -> int:
    """An array to be read at an index: short or long, fixed or of the lane."""
    if draft.chance(0.5):
        return draft.constant(dtype, (draft.pick((3, 5, 130, 300, 40)),))
    return draft.array(dtype, draft.pick(((3,), (5,), (3, 2))))


def gather(draft: Draft, dtype: str) -> int:
    """A row of an array at an index of any type, in every mode."""
    operand = table(draft, dtype)
    index, mode = draft.index(), draft.pick(("clip", "fill", "fill", "promise"))
    if mode == "promise":  # beyond the array nothing is promised
        kind = draft.kinds[index].dtype
        ends = [draft.add("constant", value=np.array(end).astype(kind)) for end in (0, 2)]
        index = draft.add("clamp", [ends[0], index, ends[1]])
    elif draft.chance(0.2):
        second = draft.scalar(draft.kinds[index].dtype)
        index = draft.add("stack", [index, second])
    fill = draft.pick((None, None, 1)) if mode == "fill" else None
    return draft.add("gather", [operand, index], mode=mode, fill=fill)


def scatter(name: str) -> Recipe:
    """A row of an array combined with another at an index of any type."""

    def recipe(draft: Draft, dtype: str) -> int:
        operand = draft.array(dtype, draft.pick(((3,), (5,), (3, 2))))
        index, update = draft.index(), draft.scalar(dtype)
        mode = draft.pick(("clip", "fill"))
        if name != "scatter" and draft.chance(0.2):
            index = draft.add("stack", [index, draft.scalar(draft.kinds[index].dtype)])
        return draft.add("scatter", [operand, index, update], name=name, mode=mode)

    return recipe


def dynamic_slice(draft: Draft, dtype: str) -> int:
    """A window of an array."""
    operand = table(draft, dtype)
    shape = draft.kinds[operand].shape
    start = draft.index()
    starts = [start, *(draft.add("constant", value=np.zeros((), draft.kinds[start].dtype)) for _ in shape[1:])]
    return draft.add("dynamic_slice", [operand, *starts], sizes=(2, *shape[1:]))


def dynamic_update_slice(draft: Draft, dtype: str) -> int:
    """An array with a window replaced."""
    operand, update = draft.array(dtype, (5,)), draft.array(dtype, (2,))
    return draft.add("dynamic_update_slice", [operand, update, draft.index()])


def dot_general(draft: Draft, dtype: str) -> int:
    """A product of a matrix and a vector, or of two vectors."""
    left = draft.array(dtype, draft.pick(((3,), (2, 3))))
    preferred = draft.pick(TYPES) if draft.chance(0.4) else None
    return draft.add("dot_general", [left, draft.array(dtype, (3,))], preferred=preferred)


def reduction(name: str) -> Recipe:
    """Elements combined along axes."""

    def recipe(draft: Draft, dtype: str) -> int:
        array = draft.array(dtype, draft.pick(SHAPES))
        axes = draft.pick(((0,), tuple(range(len(draft.kinds[array].shape)))))
        return draft.add(name, [array], axes=axes)

    return recipe


def cumulative(name: str) -> Recipe:
    """Elements combined with those before."""
    return lambda draft, dtype: draft.add(name, [draft.array(dtype, (4,))], axis=0, reverse=draft.chance(0.4))


def over_array(name: str) -> Recipe:
    """Algorithms on an array."""

    def recipe(draft: Draft, dtype: str) -> int:
        array = draft.array(dtype, (4,))
        return draft.add(name, [array], dtype="int32") if name.startswith("arg") else draft.add(name, [array])

    return recipe


def body(draft: Draft, kinds: list[Kind], result: Kind) -> Program:
    """An inner program of a few operations whose result is of a kind."""
    inside = Draft(draft.rng, kinds)
    value = draft.pick([i for i, kind in enumerate(kinds) if kind == result])
    if kinds[0] != result and draft.chance(0.5):  # what follows from the turn of a loop alone
        inside.add("convert", [0], dtype=result.dtype)
    for _ in range(int(draft.rng.integers(1, 4))):
        try:
            number = RECIPES[inside.pick(INNER)](inside, result.dtype)
        except Misfit:
            continue
        if inside.kinds[number].shape == result.shape:
            value = number
    if inside.kinds[value] != result:
        value = inside.add("convert", [value], dtype=result.dtype)  # a misfit, if it is a constant
    return inside.program([value])


def opposite(draft: Draft, inner: Program) -> Program:
    """An inner program of a loop with two states, whose second result is the negative of the first."""
    (first,), kind = inner.outputs, inner.kinds()[inner.outputs[0]]
    negative = Node("neg", (first,), {}, kind)
    return Program(inner.inputs, [], [*inner.nodes, negative], [first, len(inner.inputs) + len(inner.nodes)])


def call(draft: Draft, dtype: str) -> int:
    """A function that is called."""
    kind = Kind(dtype)
    inner = body(draft, [kind, kind], kind)
    way = draft.pick(("jit", "checkpoint", "custom_jvp", "custom_vjp"))
    return draft.add("call", [draft.scalar(dtype), draft.scalar(dtype)], way=way, body=inner)


def branch(name: str) -> Recipe:
    """One of several programs."""

    def recipe(draft: Draft, dtype: str) -> int:
        kind = Kind(dtype)
        sides = tuple(body(draft, [kind, kind], kind) for _ in range(2 if name == "cond" else 3))
        which = draft.scalar("bool" if name == "cond" else draft.pick(("int32", "int64", "uint8", "uint32", "int8")))
        return draft.add(name, [which, draft.scalar(dtype), draft.scalar(dtype)], sides=sides)

    return recipe


def loop(name: str) -> Recipe:
    """A loop."""

    def recipe(draft: Draft, dtype: str) -> int:
        kind = Kind(dtype)
        begin, constant = draft.scalar(dtype), draft.scalar(dtype)
        if name == "scan":
            rows = draft.array(dtype, draft.pick(((3,), (5,)))) if draft.chance(0.5) else draft.constant(dtype, (19,))
            inner = body(draft, [kind, kind, kind], kind)
            ways = {"reverse": draft.chance(0.3), "record": draft.chance(0.3)}
            return draft.add("scan", [begin, rows, constant], body=inner, **ways)
        if name == "while":
            inner = body(draft, [Kind("int32"), kind, kind], kind)
            return draft.add("while", [draft.scalar("int32"), begin, constant], body=inner)
        turns = draft.pick((0, 1, 3, 9, 19))
        if draft.chance(0.7):
            inner = body(draft, [Kind("int32"), kind, kind], kind)
            return draft.add("fori", [begin, constant], body=inner, turns=turns)
        if dtype == "bool":
            raise Misfit("a truth value has no negative")
        inner = opposite(draft, body(draft, [Kind("int32"), kind, kind, kind], kind))
        second = draft.add("neg", [begin]) if draft.chance(0.7) else draft.scalar(dtype)
        return draft.add("fori", [begin, second, constant], body=inner, turns=turns)

    return recipe


def random_number(draft: Draft, dtype: str) -> int:
    """A random number of a seed."""
    way = draft.pick(("bits", "folded", "split", "uniform", "several", "normal"))
    if way in ("uniform", "normal") and not is_float(dtype):
        raise Misfit(way)
    params = {"dtype": dtype} if way in ("bits", "uniform", "normal") else {}
    seed = draft.scalar("uint32" if draft.chance(0.7) else draft.pick(("int32", "int64", "uint8")))
    return draft.add("random", [seed], way=way, **params)


RECIPES: dict[str, Recipe] = {
    **{name: unary(name) for name in UNARY if name in OPERATIONS},
    **{name: binary(name) for name in BINARY if name in OPERATIONS},
    "clamp": clamp, "select_n": select_n, "convert": convert, "bitcast": bitcast,
    "reduce_precision": reduce_precision, "round": rounded, "integer_pow": integer_pow, "moved": moved,
    "gather": gather, **{name: scatter(name) for name in SCATTERS}, "dynamic_slice": dynamic_slice,
    "dynamic_update_slice": dynamic_update_slice, "dot_general": dot_general,
    **{name: reduction(name) for name in REDUCTIONS}, **{name: cumulative(name) for name in CUMULATIVE},
    **{name: over_array(name) for name in ("argmax", "argmin", "sort", "top_k", "reduce")},
    "call": call, "cond": branch("cond"), "switch": branch("switch"),
    **{name: loop(name) for name in ("fori", "while", "scan")}, "random": random_number,
}  # fmt: skip
"""Recipe of each operation by its name."""

SELDOM = {*COMPLEX, "float16", "bfloat16", "float8_e4m3fn", "float8_e5m2", "int4", "uint4"}
UNUSUAL = {"cbrt", "asinh", "acosh", "atanh", "erf", "erfc", "lgamma", "digamma", "bessel_i0e", "bessel_i1e", "real",
           "imag", "conj", "complex", "igamma", "igammac", "mulhi", "argmax", "argmin", "sort", "top_k", "reduce",
           "cumlogsumexp", "population_count", "clz", "nextafter", "reduce_xor", "scatter_mul", "scatter_min",
           "scatter_max", "scatter_sub"}  # fmt: skip
"""What a lane is not expected to have: covered one by one, and seldom among others."""

LONG = {"sin", "cos", "tan", "exp", "exp2", "expm1", "log", "log1p", "asin", "acos", "atan", "sinh", "cosh", "tanh",
        "logistic", "erf_inv", "pow", "atan2", "random"}  # fmt: skip
"""What is hundreds of instructions: covered one by one, and less often among others."""
