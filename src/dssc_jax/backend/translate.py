"""Translation of JAX's trace of one lane into a :class:`~dssc_jax.backend.program.Program`.

This module and those it lists its rules in are the only ones that know JAX's primitives. Calls are inlined. A small
array within a lane becomes that many scalars; a constant array stays a table. A random key is a pair of words.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, JaxprEqn, Literal, Var

from dssc_jax.backend import arrays, random_bits
from dssc_jax.backend.arrays import as_tensor, elementwise
from dssc_jax.backend.elementary import ELEMENTARY
from dssc_jax.backend.interface import AXIS
from dssc_jax.backend.primitives import ELEMENT_RULES
from dssc_jax.backend.program import BOOL, Builder, Program, Recording, Value
from dssc_jax.backend.random_bits import Key
from dssc_jax.backend.unsupported import Unsupported
from dssc_jax.backend.varying import VaryingResults, is_key, parts_of_scan

INLINED = {"jit", "pjit", "closed_call", "core_call", "remat", "remat2", "checkpoint", "custom_jvp_call",
         "custom_vjp_call", "custom_vjp_call_jaxpr", "custom_lin"}  # fmt: skip
REDUCTIONS_OVER_LANES = ("pmax", "pmax_p")


def translate(lane: Callable[..., Any], *arguments: Any, fast: bool = False) -> tuple[Program, Any]:
    """Trace the program of one lane and translate it.

    Args:
        lane: A function of scalars; its results may be reduced over the other lanes by ``pmax`` along
            :data:`~dssc_jax.backend.interface.AXIS`.
        arguments: Trees of ``jax.ShapeDtypeStruct`` with shape ().
        fast: See :class:`~dssc_jax.backend.program.Builder`.

    Returns:
        The program, with one input for each leaf of the arguments; and the tree of results, with shapes and types.

    Raises:
        Unsupported: An operation has no rule.
    """
    return traced_program(Translator(Builder(fast)), lane, *arguments)


def traced_program(own: "Translator", lane: Callable[..., Any], *arguments: Any) -> tuple[Program, Any]:
    """As :func:`translate`, by a given translator."""
    traced, shape = jax.make_jaxpr(lane, axis_env=[(AXIS, 1)], return_shape=True)(*arguments)
    build = own.build
    types = [np.dtype(leaf.dtype) for leaf in jax.tree.leaves(arguments)]
    inputs = [build.input(position, dtype) for position, dtype in enumerate(types)]
    outputs = own.run(traced, inputs)
    return Program(types, build.here, [output(value) for value in outputs]), shape


def type_of(atom: Any) -> Any:
    """Shape and type of a variable or literal of a trace."""
    return atom.aval


def output(value: Any) -> Value | Recording:
    """A result of a lane, which is a scalar or a recorded array."""
    if not isinstance(value, Value | Recording):
        raise Unsupported("an array as a result")
    return value


class Translator:
    """Translates equations, in order, into operations of a builder."""

    def __init__(self, build: Builder) -> None:
        self.build = build
        self.varying_results = VaryingResults()
        self._functions: dict[Any, ClosedJaxpr] = {}

    def run(self, program: ClosedJaxpr, operands: Sequence[Any]) -> list[Any]:
        """The results of a traced program for the given operands."""
        jaxpr = program.jaxpr
        scope: dict[Var, Any] = dict(zip(jaxpr.constvars, map(self.constant, program.consts), strict=True))
        scope.update(zip(jaxpr.invars, operands, strict=True))

        def read(atom: Any) -> Any:
            return self.constant(atom.val, type_of(atom).dtype) if isinstance(atom, Literal) else scope[atom]

        for equation in jaxpr.eqns:
            try:
                results = self.equation(equation, [read(atom) for atom in equation.invars])
            except Unsupported as problem:
                raise problem.at(equation) from None
            scope.update(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def constant(self, number: Any, dtype: Any = None) -> Any:
        """A number, a table or a random key that is known before the lane begins."""
        if is_key(jax.typeof(number)):
            random_bits.require_threefry(number.dtype)
            words = np.asarray(jax.random.key_data(number))
            if words.shape != (2,):
                raise Unsupported(f"a constant array of random keys of shape {words.shape}")
            return Key(*(self.build.constant(word, words.dtype) for word in words))
        array = np.asarray(number, dtype or np.asarray(number).dtype)
        return array if array.shape else self.build.constant(array, array.dtype)

    def equation(self, equation: JaxprEqn, operands: list[Any]) -> Sequence[Any]:
        """The results of one equation."""
        name, params = equation.primitive.name, equation.params
        if name in INLINED:
            inner: Any = params.get("jaxpr", params.get("call_jaxpr", params.get("fun_jaxpr")))
            return self.run(inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ()), operands)
        if name in LOOPS:
            return LOOPS[name](self, equation, operands)
        if name in REDUCTIONS_OVER_LANES:
            return [self.over_lanes(operand) for operand in operands]
        if name in random_bits.RANDOM_RULES:
            return [random_bits.RANDOM_RULES[name](self.build, operands, params, equation)]
        if any(isinstance(operand, Recording) for operand in operands):
            raise Unsupported(f"'{name}' of a recorded array")
        dtype = np.dtype(type_of(equation.outvars[0]).dtype) if not is_key(type_of(equation.outvars[0])) else BOOL
        if name in ELEMENT_RULES:
            rule = ELEMENT_RULES[name]
            return [elementwise(lambda *scalars: rule(self.build, scalars, params, dtype), self.build, operands)]
        if name in ELEMENTARY:
            function = self.function(name, [np.dtype(type_of(atom).dtype) for atom in equation.invars])
            return [elementwise(lambda *scalars: self.run(function, scalars)[0], self.build, operands)]
        if name in arrays.ARRAY_RULES:
            results = arrays.ARRAY_RULES[name](self.build, operands, params, equation)
            return results if equation.primitive.multiple_results else [results]
        raise Unsupported("no rule for it")

    def function(self, name: str, types: Sequence[np.dtype]) -> ClosedJaxpr:
        """The trace of an elementary function."""
        key = name, *types
        if key not in self._functions:
            scalars = [jax.ShapeDtypeStruct((), dtype) for dtype in types]
            self._functions[key] = jax.make_jaxpr(ELEMENTARY[name])(*scalars)
        return self._functions[key]

    def over_lanes(self, operand: Any) -> Value:
        """The maximum over all lanes of a truth value, 0 or 1."""
        if not isinstance(operand, Value) or operand.dtype.kind not in "iu":
            raise Unsupported("a maximum over the lanes of anything but 0 and 1")
        zero = self.build.constant(0, operand.dtype)
        some = self.build.add("any", self.build.add("ne", operand, zero))
        return self.build.add("convert", some, dtype=operand.dtype)


def components(value: Any, build: Builder) -> list[Value]:
    """The scalars of a value, in order."""
    if isinstance(value, Value):
        return [value]
    if isinstance(value, Key):
        return [value.high, value.low]
    if isinstance(value, Recording):
        raise Unsupported("a recorded array within a loop")
    return list(as_tensor(value, build).ravel())


def assembled(likes: Sequence[Any], scalars: Sequence[Value]) -> list[Any]:
    """Values of the same kinds from their scalars, the inverse of :func:`components`."""
    rest, values = list(scalars), []
    for like in likes:
        if isinstance(like, Value):
            values.append(rest.pop(0))
        elif isinstance(like, Key):
            values.append(Key(rest.pop(0), rest.pop(0)))
        else:
            tensor = np.empty(like.shape, object)
            tensor.ravel()[:] = rest[: tensor.size]
            del rest[: tensor.size]
            values.append(tensor)
    return values


def flat(values: Sequence[Any], build: Builder) -> list[Value]:
    """All scalars of some values."""
    return [scalar for value in values for scalar in components(value, build)]


def is_varying(value: Any) -> bool:
    """Whether a part of a value differs between lanes."""
    if isinstance(value, Value):
        return value.varying
    if isinstance(value, Key):
        return value.high.varying or value.low.varying
    return isinstance(value, np.ndarray) and value.dtype == object and any(map(is_varying, value.ravel()))


def while_rule(own: Translator, equation: JaxprEqn, operands: list[Any]) -> list[Any]:
    """A loop that ends when no lane goes on; a lane that ended before keeps its state."""
    params, build = equation.params, own.build
    head, body = params["cond_jaxpr"], params["body_jaxpr"]
    first, second = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    head_constants, constants, begin = operands[:first], operands[first:second], operands[second:]
    flags = [is_varying(value) for value in operands]
    varying, lanes_differ = own.varying_results.of_while(head.jaxpr, body.jaxpr, flags, first, second)
    enter = own.run(head, [*head_constants, *begin])[0]
    scalars = flat(begin, build)
    differs = [bool(flag) for flag, value in zip(varying, begin, strict=True) for _ in components(value, build)]
    guard = None if enter.operation == "constant" and enter.detail else build.add("any", enter)
    loop = build.loop(
        [*scalars, *([enter] if lanes_differ else [])], [*differs, *([True] if lanes_differ else [])], guard
    )
    states = loop.states[: len(scalars)]
    then = own.run(body, [*constants, *assembled(begin, states)])
    after = flat(then, build)
    again = own.run(head, [*head_constants, *then])[0]
    if lanes_differ:
        running = loop.states[-1]
        after = [build.add("select", running, new, old) for new, old in zip(after, states, strict=True)]
        again = build.add("and", running, again)
        after.append(again)
        again = build.add("any", again)
    return assembled(begin, build.close(loop, after, again)[: len(scalars)])


def scan_rule(own: Translator, equation: JaxprEqn, operands: list[Any]) -> list[Any]:
    """A loop of known length over the rows of some arrays; what it stacks is recorded."""
    params, build = equation.params, own.build
    length, body = params["length"], params["jaxpr"]
    first, carried = parts_of_scan(equation)
    second = first + carried
    constants, begin, rows = operands[:first], operands[first:second], operands[second:]
    kept = equation.outvars[carried:]
    if kept and (length == 0 or params["reverse"]):
        raise Unsupported("a loop that records nothing, or backwards")
    if length == 0:
        return begin
    recordings = [Recording(length, np.dtype(type_of(variable).dtype)) for variable in kept]
    if any(type_of(variable).shape != (length,) or is_key(type_of(variable)) for variable in kept):
        raise Unsupported("a loop that records arrays")
    flags = own.varying_results.of_scan(body.jaxpr, [is_varying(value) for value in operands], first, second)
    scalars, index = flat(begin, build), np.dtype(np.int32)
    differs = [bool(flag) for flag, value in zip(flags, begin, strict=True) for _ in components(value, build)]
    loop = build.loop([build.constant(0, index), *scalars], [False, *differs], None)
    turn, *states = loop.states
    at = build.add("sub", build.constant(length - 1, index), turn) if params["reverse"] else turn
    slices = [arrays.row(build, table, at) for table in rows]
    results = own.run(body, [*constants, *assembled(begin, states), *slices])
    for recording, value in zip(recordings, results[carried:], strict=True):
        build.record(recording, turn, *components(value, build))
    after = build.add("add", turn, build.constant(1, index))
    again = build.add("lt", after, build.constant(length, index))
    ended = build.close(loop, [after, *flat(results[:carried], build)], again)
    return [*assembled(begin, ended[1:]), *recordings]


def cond(own: Translator, equation: JaxprEqn, operands: list[Any]) -> list[Any]:
    """One of several programs; a lane's own choice."""
    which, *rest = operands
    build, branches = own.build, equation.params["branches"]
    condition = which.operands[0] if which.operation == "convert" and which.operands[0].dtype == BOOL else None

    def chosen(number: int) -> list[Any]:
        if number == len(branches) - 1:
            return own.run(branches[number], rest)
        if condition is not None:  # a truth value that JAX has made a number
            here = build.add("xor", condition, build.constant(True, BOOL))
        else:
            here = build.add("le", which, build.constant(number, which.dtype))
        kinds: list[list[Any]] = []

        def side(results: Callable[[], list[Any]]) -> Callable[[], list[Value]]:
            def scalars() -> list[Value]:
                kinds.append(results())
                return flat(kinds[-1], build)

            return scalars

        sides = side(lambda: own.run(branches[number], rest)), side(lambda: chosen(number + 1))
        joined = build.branch(here, sides)
        return assembled(kinds[0], joined)

    return chosen(0)


LOOPS: dict[str, Callable[[Translator, JaxprEqn, list[Any]], list[Any]]] = {
    "while": while_rule,
    "scan": scan_rule,
    "cond": cond,
}
