"""The operations of random programs as functions of JAX, each with what is fixed as its first argument."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from benchmarks.fuzz.program import traceable

Parameters = dict[str, Any]

UNARY = (
    "abs", "neg", "sign", "floor", "ceil", "is_finite", "sqrt", "rsqrt", "cbrt", "square", "exp", "exp2", "expm1",
    "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh",
    "logistic", "erf", "erfc", "erf_inv", "lgamma", "digamma", "bessel_i0e", "bessel_i1e", "bitwise_not",
    "population_count", "clz", "real", "imag", "conj", "stop_gradient", "reciprocal",
)  # fmt: skip
BINARY = (
    "add", "sub", "mul", "div", "rem", "max", "min", "pow", "atan2", "nextafter", "bitwise_and", "bitwise_or",
    "bitwise_xor", "shift_left", "shift_right_arithmetic", "shift_right_logical", "eq", "ne", "lt", "le", "gt", "ge",
    "complex", "igamma", "igammac", "mulhi",
)  # fmt: skip
REDUCTIONS = ("reduce_sum", "reduce_prod", "reduce_max", "reduce_min", "reduce_and", "reduce_or", "reduce_xor")
CUMULATIVE = ("cumsum", "cumprod", "cummax", "cummin", "cumlogsumexp")
SCATTERS = ("scatter", "scatter_add", "scatter_mul", "scatter_min", "scatter_max", "scatter_sub")
MODES = {
    "clip": lax.GatherScatterMode.CLIP, "fill": lax.GatherScatterMode.FILL_OR_DROP,
    "promise": lax.GatherScatterMode.PROMISE_IN_BOUNDS,
}  # fmt: skip


def plain(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function without parameters."""
    return lambda params, *operands: function(*operands)


def gather(params: Parameters, operand: Any, index: Any) -> Any:
    """Rows of an array at one or several indices."""
    indices = jnp.reshape(index, (-1, 1))
    numbers = lax.GatherDimensionNumbers(
        offset_dims=tuple(range(1, operand.ndim)), collapsed_slice_dims=(0,), start_index_map=(0,)
    )
    sizes = (1, *operand.shape[1:])
    return lax.gather(operand, indices, numbers, sizes, mode=MODES[params["mode"]], fill_value=params["fill"])


def scatter(params: Parameters, operand: Any, index: Any, update: Any) -> Any:
    """A row of an array combined with another at an index."""
    numbers = lax.ScatterDimensionNumbers(
        update_window_dims=tuple(range(1, operand.ndim)), inserted_window_dims=(0,), scatter_dims_to_operand_dims=(0,)
    )
    indices = jnp.reshape(index, (-1, 1))
    updates = jnp.broadcast_to(update, (indices.shape[0], *operand.shape[1:]))
    return getattr(lax, params["name"])(operand, indices, updates, numbers, mode=MODES[params["mode"]])


def dot(params: Parameters, left: Any, right: Any) -> Any:
    """A product of two arrays over the last axis of the first and the first of the second."""
    numbers = (((left.ndim - 1,), (0,)), ((), ()))
    wanted = params["preferred"]
    return lax.dot_general(left, right, numbers, preferred_element_type=jnp.dtype(wanted) if wanted else None)


def call(params: Parameters, *operands: Any) -> Any:
    """An inner program by one of the ways of calling a function."""
    function = traceable(params["body"])

    def inner(*arguments: Any) -> Any:
        return function(*arguments)[0]

    match params["way"]:
        case "jit":
            return jax.jit(inner)(*operands)
        case "checkpoint":
            return jax.checkpoint(inner)(*operands)
        case "custom_jvp":
            ruled = jax.custom_jvp(inner)
            ruled.defjvp(lambda primals, tangents: (inner(*primals), tangents[0]))
            return ruled(*operands)
        case _:
            ruled = jax.custom_vjp(inner)
            ruled.defvjp(lambda *arguments: (inner(*arguments), None), lambda _, slope: (slope,))
            return ruled(*operands)


def cond(params: Parameters, which: Any, *operands: Any) -> Any:
    """One of two inner programs."""
    sides = [traceable(side) for side in params["sides"]]
    return lax.cond(which, *(lambda *inside, side=side: side(*inside)[0] for side in sides), *operands)


def switch(params: Parameters, which: Any, *operands: Any) -> Any:
    """One of several inner programs."""
    sides = [traceable(side) for side in params["sides"]]
    return lax.switch(which, [lambda *inside, side=side: side(*inside)[0] for side in sides], *operands)


def fori(params: Parameters, *operands: Any) -> Any:
    """A loop of a fixed number of turns; its body reads the turn, one or two states and what is constant."""
    *begin, constant = operands
    body = traceable(params["body"])

    def turn(k: Any, states: Any) -> Any:
        return body(lax.convert_element_type(k, jnp.int32), *states, constant)

    return lax.fori_loop(0, params["turns"], turn, begin)[0]


def while_loop(params: Parameters, limit: Any, begin: Any, *constants: Any) -> Any:
    """A loop whose number of turns, 0 to 7, is a lane's."""
    body, most = traceable(params["body"]), lax.bitwise_and(lax.convert_element_type(limit, jnp.int32), np.int32(7))

    def turn(carry: Any) -> Any:
        return carry[0] + 1, body(carry[0], carry[1], *constants)[0]

    return lax.while_loop(lambda carry: carry[0] < most, turn, (jnp.int32(0), begin))[1]


def scan(params: Parameters, begin: Any, rows: Any, *constants: Any) -> Any:
    """A loop over the rows of an array; its body reads the row, the state and what is constant."""
    body, record = traceable(params["body"]), params["record"]

    def turn(state: Any, row: Any) -> Any:
        (after,) = body(row, state, *constants)
        return after, after if record else None

    return lax.scan(turn, begin, rows, reverse=params["reverse"])[1 if record else 0]


def random_number(params: Parameters, seed: Any) -> Any:
    """Numbers from a key of a seed."""
    key = jax.random.key(seed)
    match params["way"]:
        case "bits":
            return jax.random.bits(key, dtype=jnp.dtype(params["dtype"]))
        case "folded":
            return jax.random.bits(jax.random.fold_in(key, 7))
        case "split":
            return jax.random.key_data(jax.random.split(key, 3)[1])[0]
        case "uniform":
            return jax.random.uniform(key, dtype=jnp.dtype(params["dtype"]))
        case "several":
            return jax.random.bits(key, (3,))[2]
        case _:
            return jax.random.normal(key, dtype=jnp.dtype(params["dtype"]))


OPERATIONS: dict[str, Callable[..., Any]] = {
    "constant": lambda params: jnp.asarray(params["value"]),  # what is NumPy's, JAX computes by NumPy
    **{name: plain(getattr(lax, name)) for name in (*UNARY, *BINARY) if hasattr(lax, name)},
    "clamp": plain(lax.clamp),
    "select_n": plain(lax.select_n),
    "convert": lambda params, x: lax.convert_element_type(x, jnp.dtype(params["dtype"])),
    "bitcast": lambda params, x: lax.bitcast_convert_type(x, jnp.dtype(params["dtype"])),
    "reduce_precision": lambda params, x: lax.reduce_precision(x, params["exponent"], params["mantissa"]),
    "round": lambda params, x: lax.round(x, lax.RoundingMethod[params["method"]]),
    "integer_pow": lambda params, x: lax.integer_pow(x, params["y"]),
    "stack": lambda params, *operands: jnp.stack(operands),
    "reshape": lambda params, x: lax.reshape(x, params["shape"]),
    "broadcast": lambda params, x: lax.broadcast(x, params["shape"]),
    "transpose": lambda params, x: lax.transpose(x, params["axes"]),
    "rev": lambda params, x: lax.rev(x, params["axes"]),
    "slice": lambda params, x: lax.slice(x, params["start"], params["stop"], params["step"]),
    "pad": lambda params, x, margin: lax.pad(x, margin, params["config"]),
    "concatenate": lambda params, *operands: lax.concatenate(operands, params["axis"]),
    "iota": lambda params: lax.iota(jnp.dtype(params["dtype"]), params["size"]),
    "gather": gather,
    "scatter": scatter,
    "dynamic_slice": lambda params, x, *starts: lax.dynamic_slice(x, starts, params["sizes"]),
    "dynamic_update_slice": lambda params, x, update, *starts: lax.dynamic_update_slice(x, update, starts),
    "dot_general": dot,
    "argmax": lambda params, x: lax.argmax(x, 0, jnp.dtype(params["dtype"])),
    "argmin": lambda params, x: lax.argmin(x, 0, jnp.dtype(params["dtype"])),
    "sort": lambda params, x: lax.sort(x, dimension=0),
    "top_k": lambda params, x: lax.top_k(x, 2)[0],
    "reduce": lambda params, x: lax.reduce(x, np.zeros((), x.dtype), lax.add, (0,)),
    **{name: lambda params, x, name=name: getattr(lax, name)(x, params["axes"]) for name in REDUCTIONS},
    **{
        name: lambda params, x, name=name: getattr(lax, name)(x, params["axis"], params["reverse"])
        for name in CUMULATIVE
    },
    "call": call,
    "cond": cond,
    "switch": switch,
    "fori": fori,
    "while": while_loop,
    "scan": scan,
    "random": random_number,
}
"""Function of each operation by its name."""
