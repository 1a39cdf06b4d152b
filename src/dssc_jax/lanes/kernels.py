"""GPU kernels that simulate a batch of lanes with the state in registers for the whole run.

A plain loop over time launches kernels at every sample and keeps the state of all lanes in memory. Here each program
of a Pallas grid loads the numbers of a warp of lanes, runs the lanes from start to end, and stores the results. The
kernel is traced from the lane program itself, so the physics is not duplicated.

Three things are rewritten, because Triton, which compiles the kernel, treats them differently:

* a weakly typed float64 (the sine of a plain number) would be computed in float32;
* its minimum and maximum ignore NaN, which would hide a diverged draw from the loop;
* it has no random keys. If no random number is drawn, they are unused and removed; otherwise the program is
unsuitable, and the engine keeps the loop over time.
"""

import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, DebugInfo, Jaxpr, JaxprEqn, Literal, Var, jaxpr_as_fun

from dssc_jax.lanes.unsupported import Unfit

DEPRECATED = "The Pallas Triton backend is deprecated"  # by JAX 0.11; pyproject.toml admits no version without it
CALLS = ("jit", "closed_call", "custom_jvp_call", "custom_vjp_call")
LANES, WARPS = 32, 1  # of a program: one lane a thread, so that registers are all that bounds how many run
KEYS = {"random_seed", "random_fold_in", "random_wrap"}
ELEMENTWISE = {
    "abs", "acos", "acosh", "add", "and", "asin", "asinh", "atan", "atan2", "atanh", "bitcast_convert_type",
    "broadcast_in_dim", "cbrt", "ceil", "convert_element_type", "cos", "cosh", "div", "eq", "exp", "exp2", "expm1",
    "floor", "ge", "gt", "integer_pow", "is_finite", "le", "log", "log1p", "lt", "mul", "ne", "neg", "not", "or", "pow",
    "rem", "rsqrt", "select_n", "shift_left", "shift_right_arithmetic", "sign", "sin", "sinh", "sqrt", "square",
    "stop_gradient", "sub", "tan", "tanh", "xor",
}  # fmt: skip
"""Primitives that Triton supports and that act on every lane separately."""

ORDERED = {"max": jnp.greater_equal, "min": jnp.less_equal}

Batch = Callable[[dict[str, jax.Array], jax.Array], Any]
"""(numbers of n lanes, their indices) -> a tree of arrays of shape (n,), for any n."""


def in_registers(batch: Batch, interpret: bool | None = None) -> Batch:
    """The same batch as a Pallas kernel with :data:`LANES` lanes per program.

    Args:
        batch: The computation for independent lanes.
        interpret: Run it by XLA instead of Triton; None: if there is no GPU.

    Raises:
        Unfit: When traced, if the program draws random numbers or needs array operations.
    """
    import jax.experimental.pallas as pl  # not at import: most runs need neither
    from jax.experimental.pallas import triton

    warnings.filterwarnings("ignore", DEPRECATED, DeprecationWarning)

    def advance(values: dict[str, jax.Array], index: jax.Array) -> Any:
        count, real = len(index), jnp.result_type(float)
        warp = jax.tree.map(lambda x: jax.ShapeDtypeStruct((LANES,), x.dtype), (values, index))
        program, shape = jax.make_jaxpr(batch, return_shape=True)(*warp)
        results, tree = jax.tree.flatten(shape)
        read, written = power_of_two(len(values)), power_of_two(len(results))

        def kernel(numbers: Any, index: Any, outputs: Any) -> None:
            columns = [column.reshape(LANES) for column in lax.split(numbers[...], [1] * read, axis=1)]
            lanes = dict(zip(values, columns, strict=False)), index[...]
            out = translated(program, jax.tree.leaves(lanes))
            out += [jnp.zeros(LANES, real)] * (written - len(out))
            outputs[...] = stacked([x.astype(real) for x in out])

        numbers = jnp.stack([*values.values(), *[jnp.zeros(count, real)] * (read - len(values))], axis=1)
        spare = -count % LANES
        outputs = pl.pallas_call(
            kernel,
            out_shape=jax.ShapeDtypeStruct((count + spare, written), real),
            grid=((count + spare) // LANES,),
            in_specs=[pl.BlockSpec((LANES, read), lambda i: (i, 0)), pl.BlockSpec((LANES,), lambda i: (i,))],
            out_specs=pl.BlockSpec((LANES, written), lambda i: (i, 0)),
            compiler_params=triton.CompilerParams(num_warps=WARPS, num_stages=1),
            interpret=jax.default_backend() != "gpu" if interpret is None else interpret,
        )(jnp.pad(numbers, ((0, spare), (0, 0)), mode="edge"), jnp.pad(index, (0, spare), mode="edge"))
        columns = [outputs[:count, i].astype(result.dtype) for i, result in enumerate(results)]
        return jax.tree.unflatten(tree, columns)

    return advance


def power_of_two(count: int) -> int:
    """The smallest power of two that is not below ``count``; Triton has no other lengths."""
    return 1 << max(count - 1, 0).bit_length()


def stacked(columns: list[jax.Array]) -> jax.Array:
    """2^m columns as one array of shape (LANES, 2^m), two at a time: Triton's way.

    One store replaces many, because the compile time grows with the number of stores times the square of the program
    size.
    """
    while len(columns) > 1:
        half = len(columns) // 2
        pairs = zip(columns[:half], columns[half:], strict=True)
        columns = [jnp.concatenate([jnp.expand_dims(x, -1) for x in pair], axis=-1) for pair in pairs]
    return columns[0].reshape(LANES, -1)


def translated(program: ClosedJaxpr, arguments: Sequence[Any]) -> list[Any]:
    """Trace a program again in the form Triton needs; nested programs are inlined.

    Raises:
        Unfit: It cannot be expressed in the primitives of :data:`ELEMENTWISE` and loops over them.
    """
    if any(np.ndim(constant) for constant in program.consts):
        raise Unfit(f"the loop holds an array of shape {max(map(np.shape, program.consts))}")
    scope: dict[Var, Any] = dict(zip(program.jaxpr.constvars, program.consts, strict=True))
    scope.update(zip(program.jaxpr.invars, arguments, strict=True))

    def values(atoms: Sequence[Any]) -> list[Any]:
        return [typed(atom, atom.val) if isinstance(atom, Literal) else scope[atom] for atom in atoms]

    for equation in needed(program.jaxpr):
        results = [strong(x) for x in applied(equation, values(equation.invars))]
        scope.update(zip(equation.outvars, results, strict=True))
    return values(program.jaxpr.outvars)


def needed(jaxpr: Jaxpr) -> list[JaxprEqn]:
    """The equations that a result depends on."""
    wanted = {atom for atom in jaxpr.outvars if isinstance(atom, Var)}
    equations = []
    for equation in reversed(jaxpr.eqns):
        if equation.effects or not wanted.isdisjoint(equation.outvars):
            wanted.update(atom for atom in equation.invars if isinstance(atom, Var))
            equations.append(equation)
    return equations[::-1]


def evaluated(equation: JaxprEqn, operands: list[Any]) -> list[Any]:
    """The results of one equation, as JAX evaluates a program that consists of it."""
    variables = {atom: x for atom, x in zip(equation.invars, operands, strict=True) if isinstance(atom, Var)}
    about = DebugInfo(equation.primitive.name, __name__, None, None)
    alone = Jaxpr((), list(variables), equation.outvars, [equation], equation.effects, about)
    return list(jaxpr_as_fun(ClosedJaxpr(alone, ()))(*variables.values()))


def applied(equation: JaxprEqn, operands: list[Any]) -> Sequence[Any]:
    """The results of one equation."""
    name, params = equation.primitive.name, equation.params
    if name in KEYS:
        return [None]  # of a key, which nobody may look into
    if name.startswith(("random", "threefry")):
        raise Unfit(f"the loop draws random numbers ({name}), and a kernel cannot")
    if name in CALLS:
        return translated(params["call_jaxpr" if "call_jaxpr" in params else "jaxpr"], operands)
    if name in LOOP_TRANSLATIONS:
        return LOOP_TRANSLATIONS[name](equation, operands)
    if name in ORDERED:
        return [extreme(ORDERED[name], *operands)]
    if name == "pmax" and params["axes"] == (0,):  # over the lanes, which may tell each other that much
        return [jnp.max(x, axis=0) for x in operands]
    if name not in ELEMENTWISE:
        raise Unfit(f"the loop uses '{name}', which does not act on each lane by itself")
    shape = equation.outvars[0].aval.shape  # pyright: ignore[reportAttributeAccessIssue]
    if len(shape) > 1:
        raise Unfit(f"the loop computes with arrays ('{name}' has {shape[1:]} in a lane)")
    if shape or any(isinstance(operand, jax.Array) for operand in operands):
        return evaluated(equation, operands)
    with jax.ensure_compile_time_eval():  # Triton has no rule for functions of constants
        return [np.asarray(x)[()] for x in evaluated(equation, operands)]


def typed(atom: Any, value: Any) -> Any:
    """The value of a variable or literal; a literal has its type in the program."""
    return np.asarray(value, jax.typeof(value).dtype)[()] if isinstance(atom, Literal) else value


def strong(x: Any) -> Any:
    """The same value with a strong type, which is not promoted to others."""
    return lax.convert_element_type(x, x.dtype) if getattr(x, "weak_type", False) else x


def extreme(before: Callable[[Any, Any], Any], x: Any, y: Any) -> Any:
    """The minimum or maximum; NaN if either is NaN."""
    return jnp.where(before(x, y) | (x != x), x, y)


def scan(equation: JaxprEqn, operands: list[Any]) -> Sequence[Any]:
    """A loop of known length that carries numbers only; its body has the inputs and outputs of the whole loop."""
    body: ClosedJaxpr = equation.params["jaxpr"]
    if shapes(x.aval for x in (*equation.invars, *equation.outvars)) != shapes((*body.in_avals, *body.out_avals)):
        raise Unfit("the loop keeps its samples")
    constants, carry = split_before_last(len(equation.outvars), operands)

    def turn(carry: list[Any], _: None) -> tuple[list[Any], None]:
        return translated(body, [*constants, *carry]), None

    return lax.scan(turn, carry, length=equation.params["length"])[0]


def while_loop(equation: JaxprEqn, operands: list[Any]) -> Sequence[Any]:
    """A loop that all lanes of a warp leave together."""
    goes_on, body = equation.params["cond_jaxpr"], equation.params["body_jaxpr"]
    constants, carry = split_before_last(len(equation.outvars), operands)
    condition_constants, constants = split_before_last(len(body.in_avals) - len(carry), constants)
    return lax.while_loop(
        lambda carry: translated(goes_on, [*condition_constants, *carry])[0],
        lambda carry: translated(body, [*constants, *carry]),
        carry,
    )


def shapes(avals: Iterable[Any]) -> list[tuple[int, ...]]:
    """Shape of each."""
    return [aval.shape for aval in avals]


def split_before_last(count: int, values: list[Any]) -> tuple[list[Any], list[Any]]:
    """The values before the last ``count``, and the last ``count``."""
    return values[: len(values) - count], values[len(values) - count :]


LOOP_TRANSLATIONS = {"scan": scan, "while": while_loop}
"""Loops, handled through data available in every supported version of JAX: programs, inputs and outputs."""
