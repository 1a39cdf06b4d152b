"""Rewriting of batched programs so that shared values are computed once, which XLA:CPU does not ensure.

XLA:CPU fuses a chain of elementwise operations into one kernel for each of its results, and recomputes in every
kernel the values that several results share. Here such a value gets its own buffer if recomputing it would cost more
than reading it. The boundary is a call that the compiler may not inline. A value that crosses it is stored in a
buffer. Within a loop that is compiled as a whole (see :mod:`dssc_jax.backend.xla`) the call itself costs nothing.
"""

from collections import Counter
from collections.abc import Callable, Hashable, Mapping, Sequence
from enum import Enum
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, Var, jaxpr_as_fun

COSTLY = 3  # operations beyond which a shared value is kept: writing and reading it costs about two
CALLS = ("jit", "closed_call", "custom_jvp_call", "custom_vjp_call")
BODIES = ("jaxpr", "body_jaxpr")  # of a scan, of a while loop
LOOP_PRIMITIVES = ("scan", "while", "cond")
FREE = {"broadcast_in_dim", "reshape", "squeeze", "convert_element_type", "copy"}
REPEATED = {
    *("add", "sub", "mul", "neg", "abs", "sign", "square", "integer_pow", "floor", "ceil", "round", "is_finite"),
    *("max", "min", "clamp", "select_n", "lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not"),
}
"""Operations that XLA repeats instead of storing their results; it stores the others, including division and roots."""


def deduplicated(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function with its shared values buffered; for arrays with one batch axis, without side effects."""

    def once(*args: Any) -> Any:
        program, shape = jax.make_jaxpr(function, return_shape=True)(*args)
        results = jaxpr_as_fun(rewritten(program))(*jax.tree.leaves(args))
        return jax.tree.unflatten(jax.tree.structure(shape), results)

    return once


def rewritten(program: ClosedJaxpr) -> ClosedJaxpr:
    """The same program with calls inlined, equal expressions merged and shared values buffered, also in its loops."""
    inputs = program.in_avals
    flat = jax.make_jaxpr(lambda *args: Merged().run(program, args))(*inputs)
    return jax.make_jaxpr(lambda *args: keeping(flat, args))(*inputs)


@jax.jit
def barrier(value: jax.Array) -> jax.Array:
    """Return the value."""
    return value


def kept(value: jax.Array) -> jax.Array:
    """Return the value, in its own buffer."""
    with set_xla_metadata(inlineable="false"):
        return barrier(value)


class VariableValues:
    """Values of a program's variables while it is evaluated."""

    def __init__(self, program: ClosedJaxpr, args: Sequence[Any]) -> None:
        jaxpr = program.jaxpr
        self.values: dict[Var, Any] = dict(zip(jaxpr.constvars, program.consts, strict=True))
        self.values.update(zip(jaxpr.invars, args, strict=True))

    def read(self, atoms: Sequence[Var | Literal]) -> list[Any]:
        """Values of variables and literals."""
        return [atom.val if isinstance(atom, Literal) else self.values[atom] for atom in atoms]

    def write(self, variables: Sequence[Var], values: Sequence[Any]) -> None:
        """Set the variables that an equation defines."""
        self.values.update(zip(variables, values, strict=True))


class Merged:
    """Evaluation with calls inlined; equal expressions are evaluated once.

    Objects compared by identity are kept with the results, so that no later object reuses their id.
    """

    def __init__(self) -> None:
        self.known: dict[Hashable, tuple[list[Any], Any]] = {}

    def run(self, program: ClosedJaxpr, args: Sequence[Any]) -> list[Any]:
        """Results of the program."""
        scope = VariableValues(program, args)
        for eqn in program.jaxpr.eqns:
            operands = scope.read(eqn.invars)
            inner = eqn.params.get("jaxpr", eqn.params.get("call_jaxpr"))
            called = eqn.primitive.name in CALLS and isinstance(inner, ClosedJaxpr)
            scope.write(eqn.outvars, self.run(inner, operands) if called else self.results(eqn, operands))
        return scope.read(program.jaxpr.outvars)

    def results(self, eqn: JaxprEqn, operands: list[Any]) -> list[Any]:
        """The values that one equation defines."""
        if eqn.primitive.name in LOOP_PRIMITIVES or eqn.effects:
            params = {
                name: rewritten(value) if name in BODIES and isinstance(value, ClosedJaxpr) else value
                for name, value in eqn.params.items()
            }
            return bound(eqn, operands, params)
        key = (eqn.primitive, content_key(eqn.params), *map(content_key, operands))
        if key not in self.known:
            self.known[key] = bound(eqn, operands, eqn.params), (operands, eqn.params)
        return self.known[key][0]


def content_key(value: Any) -> Hashable:
    """A key that is equal only for equal operands and parameters.

    Arrays and numbers are compared by type and bytes, containers element by element, names by value, and everything
    else, including traced values and programs, by identity. (Printed text is not suitable, because NumPy abbreviates
    it.)
    """
    if value is None or isinstance(value, str | bytes | Enum | np.dtype):
        return type(value), value
    if isinstance(value, Mapping):
        return type(value), tuple((name, content_key(part)) for name, part in value.items())
    if isinstance(value, tuple | list):
        return type(value), tuple(map(content_key, value))
    if isinstance(value, bool | int | float | complex | np.generic | np.ndarray | jax.Array) and not_traced(value):
        array = np.asarray(value)
        return type(value), str(jax.typeof(value)), array.shape, array.tobytes()
    return id(value)


def not_traced(value: Any) -> bool:
    """Whether a value is known and not a random key, whose bytes only JAX can read."""
    return not isinstance(value, Tracer) and not jnp.issubdtype(jax.typeof(value).dtype, jax.dtypes.extended)


def bound(eqn: JaxprEqn, operands: Sequence[Any], params: dict[str, Any]) -> list[Any]:
    """Results of an equation's primitive."""
    results = eqn.primitive.bind(*operands, **params)
    return list(results) if eqn.primitive.multiple_results else [results]


def needed(jaxpr: Jaxpr) -> list[JaxprEqn]:
    """The equations that a result depends on."""
    wanted = {atom for atom in jaxpr.outvars if isinstance(atom, Var)}
    equations = []
    for eqn in reversed(jaxpr.eqns):
        if eqn.effects or not wanted.isdisjoint(eqn.outvars):
            wanted.update(variables_of(eqn))
            equations.append(eqn)
    return equations[::-1]


def variables_of(eqn: JaxprEqn) -> set[Var]:
    """Variables that an equation reads."""
    return {atom for atom in eqn.invars if isinstance(atom, Var)}


def keeping(program: ClosedJaxpr, args: Sequence[Any]) -> list[Any]:
    """Results of a program without calls; shared values are buffered if that is cheaper than recomputing them."""
    scope, equations = VariableValues(program, args), needed(program.jaxpr)
    keep = worth_keeping(equations, {atom for atom in program.jaxpr.outvars if isinstance(atom, Var)})
    for eqn in equations:
        results = bound(eqn, scope.read(eqn.invars), eqn.params)
        pairs = zip(eqn.outvars, results, strict=True)
        scope.write(eqn.outvars, [kept(value) if variable in keep else value for variable, value in pairs])
    return scope.read(program.jaxpr.outvars)


def worth_keeping(equations: Sequence[JaxprEqn], results: set[Var]) -> set[Var]:
    """Variables that several kernels read and that cost too much to compute in each of them.

    A kernel is identified by the value that it stores. A backward pass assigns a variable to the kernels of its
    readers; a variable read by only one kernel is computed within it. A forward pass counts operations from the last
    stored values.

    XLA itself stores arrays whose operation is not in :data:`REPEATED`. It stores no scalars, which kernels
    broadcast: the sine of the time would be computed in each kernel that reads the reference.
    """
    again = repeated_work(equations, results)
    kernels: dict[Var, set[Var]] = {variable: {variable} for variable in results}
    keep = set()
    for eqn in reversed(equations):
        readers: set[Var] = set()
        for variable in eqn.outvars:
            own = kernels.get(variable, set())
            repeated, reused = eqn.primitive.name in REPEATED, len(own) > 1 and eqn.primitive.name not in FREE
            worth = (repeated and again[variable] >= COSTLY) if size(variable) > 1 else not repeated
            if reused and worth:
                keep.add(variable)
            stored = variable in keep or variable in results or (reused and not repeated)
            readers |= {variable} if stored and eqn.primitive.name not in FREE else own
        for variable in variables_of(eqn):
            kernels.setdefault(variable, set()).update(readers)
    return keep


def repeated_work(equations: Sequence[JaxprEqn], results: set[Var]) -> dict[Var, int]:
    """Number of operations to compute each variable from the values that several others read."""
    uses = Counter(results) + Counter(variable for eqn in equations for variable in variables_of(eqn))
    again: dict[Var, int] = {}
    left: dict[Var, int] = Counter()
    for eqn in equations:
        cost = sum(left[variable] for variable in variables_of(eqn)) + (eqn.primitive.name not in FREE)
        for variable in eqn.outvars:
            again[variable] = cost
            stored = uses[variable] > 1 and (cost >= COSTLY or eqn.primitive.name not in REPEATED | FREE)
            left[variable] = 0 if stored else cost
    return again


def size(variable: Var) -> int:
    """Number of elements in a variable's array."""
    return getattr(variable.aval, "size", 1)
