"""Translation of JAX's trace of one lane into a :class:`~dssc_jax.lanes.program.Program`.

Only this module and the tables of rules that it imports know JAX's primitives. Calls are inlined. A small array within
a lane becomes scalars; a constant array stays a table. A random key is a pair of words.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, JaxprEqn, Literal, Var

from dssc_jax.lanes.builder import Builder
from dssc_jax.lanes.functions.elementary import ELEMENTARY, RareRule
from dssc_jax.lanes.interface import AXIS
from dssc_jax.lanes.program import Program, Recording, Subroutine, Value
from dssc_jax.lanes.tracing import indexing, random_bits
from dssc_jax.lanes.tracing.arrays import ARRAY_RULES, elementwise
from dssc_jax.lanes.tracing.foreign_calls import FOREIGN_RULES
from dssc_jax.lanes.tracing.loops import LOOPS
from dssc_jax.lanes.tracing.primitives import ELEMENT_RULES
from dssc_jax.lanes.tracing.random_bits import Key
from dssc_jax.lanes.tracing.specification import (
    SCALARS,
    WHOLE,
    TranslationRule,
    any_value,
    array_type,
    no_value,
    require_type,
    rule,
)
from dssc_jax.lanes.tracing.states import refuse_recordings
from dssc_jax.lanes.tracing.varying import VaryingResults, is_key
from dssc_jax.lanes.unsupported import Unsupported


def translate(lane: Callable[..., Any], *arguments: Any, fast: bool = False) -> tuple[Program, Any]:
    """Trace the program of one lane and translate it.

    Args:
        lane: A function of scalars; its results may be reduced over the other lanes by ``pmax`` along
            :data:`~dssc_jax.lanes.interface.AXIS`.
        arguments: Trees of ``jax.ShapeDtypeStruct`` with shape ().
        fast: Whether products and quotients may be regrouped; see :class:`~dssc_jax.lanes.builder.Builder`.

    Returns:
        The program, with one input for each leaf of the arguments, and the tree of results, with shapes and types.

    Raises:
        Unsupported: An operation has no rule.
    """
    return traced_program(Translator(Builder(fast)), lane, *arguments)


def traced_program(translator: "Translator", lane: Callable[..., Any], *arguments: Any) -> tuple[Program, Any]:
    """Trace the program of one lane, and translate it by a given translator.

    Args:
        translator: The translator, with a builder that is empty so far.
        lane: A function of scalars.
        arguments: Trees of ``jax.ShapeDtypeStruct`` with shape ().

    Returns:
        The program, and the tree of results, with shapes and types.

    Raises:
        Unsupported: An operation has no rule.
    """
    traced, result_shapes = jax.make_jaxpr(lane, axis_env=[(AXIS, 1)], return_shape=True)(*arguments)
    for aval in (*traced.in_avals, *traced.out_avals):
        require_type(aval, SCALARS)
    build = translator.build
    types = [np.dtype(aval.dtype) for aval in traced.in_avals]
    inputs = [build.input(position, dtype) for position, dtype in enumerate(types)]
    outputs = [require_output(value) for value in translator.run(traced, inputs)]
    return Program(types, build.here, outputs), result_shapes


def require_output(value: Any) -> Value | Recording:
    """Require that a value is a scalar or a recording, as a result of a lane must be; return the value.

    Raises:
        Unsupported: The value is an array of another kind, or a random key.
    """
    if not isinstance(value, Value | Recording):
        raise Unsupported("an array as a result")
    return value


class Translator:
    """Translates the equations of a trace, in order, into operations of a program.

    ``has_memory`` tells whether loops may carry arrays in memory; if not, their elements are scalars.

    Args:
        build: The builder of the program.
    """

    has_memory = True

    def __init__(self, build: Builder) -> None:
        """Begin without traces of functions and without subroutines."""
        self.build = build
        self.varying_results = VaryingResults()
        self._traces: dict[Any, ClosedJaxpr] = {}
        self._subroutines: dict[Any, Subroutine] = {}

    def run(self, program: ClosedJaxpr, operands: Sequence[Any]) -> list[Any]:
        """Translate a traced program for some operands, and return its results.

        Raises:
            Unsupported: An equation has no translation; the error tells its place in the model.
        """
        jaxpr = program.jaxpr
        constants = [self.constant(number) for number in program.consts]
        scope: dict[Var, Any] = dict(zip(jaxpr.constvars, constants, strict=True))
        scope.update(zip(jaxpr.invars, operands, strict=True))

        def read(atom: Any) -> Any:
            """Return the value of an operand or result, which is a literal of the trace or a variable."""
            return self.constant(atom.val, array_type(atom).dtype) if isinstance(atom, Literal) else scope[atom]

        for equation in jaxpr.eqns:
            try:
                results = self.equation(equation, [read(atom) for atom in equation.invars])
            except Unsupported as problem:
                raise problem.locate(equation) from None
            scope.update(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def constant(self, number: Any, dtype: Any = None) -> Any:
        """Return a constant of a trace in the form in which the translator keeps it.

        A number becomes a value of the program, an array stays an array of numbers, and a random key becomes a
        :class:`Key`.

        Args:
            number: The constant.
            dtype: Dtype of the result; None: the constant's own dtype.

        Raises:
            Unsupported: The constant is an array of keys, or a key of a generator other than Threefry.
        """
        if is_key(jax.typeof(number)):
            random_bits.require_threefry(number.dtype)
            words = np.asarray(jax.random.key_data(number))
            if words.shape != (2,):
                raise Unsupported(f"a constant array of random keys of shape {words.shape}")
            return Key(*(self.build.constant(word, words.dtype) for word in words))
        array = np.asarray(number, dtype or np.asarray(number).dtype)
        return array if array.shape else self.build.constant(array, array.dtype)

    def equation(self, equation: JaxprEqn, operands: list[Any]) -> Sequence[Any]:
        """Translate one equation, and return its results.

        Args:
            equation: The equation.
            operands: The operands, as values of the trace.

        Raises:
            Unsupported: The equation's primitive has no rule, or the rule does not translate the equation exactly.
        """
        name = equation.primitive.name
        for rules, apply in self.families:
            if name in rules:
                rules[name].specification.require(equation)
                return apply(rules[name], equation, operands)
        raise Unsupported("no rule for it")

    @property
    def families(
        self,
    ) -> Sequence[tuple[Mapping[str, TranslationRule], Callable[[Any, JaxprEqn, list[Any]], Sequence[Any]]]]:
        """The tables of rules by primitive, each with the method that applies the rules of the table."""
        return (
            (INLINED, self.apply_to_program),
            (LOOPS, self.apply_to_program),
            (OVER_LANES, self.apply_to_program),
            (random_bits.RANDOM_RULES, self.apply_to_arrays),
            (ELEMENT_RULES, self.apply_to_elements),
            (ELEMENTARY, self.apply_traced_function),
            (ARRAY_RULES, self.apply_to_arrays),
            (indexing.INDEXING_RULES, self.apply_to_arrays),
            (FOREIGN_RULES, self.apply_to_arrays),
        )

    def apply_to_program(self, translation: TranslationRule, equation: JaxprEqn, operands: list[Any]) -> Sequence[Any]:
        """Apply a rule whose translation needs this translator itself, because it translates inner programs.

        Rules of reductions over the lanes are called in the same way.
        """
        return translation.translate(self, equation, operands)

    def apply_to_elements(self, translation: TranslationRule, equation: JaxprEqn, operands: list[Any]) -> Sequence[Any]:
        """Apply a rule of an elementwise operation to each element."""
        refuse_recordings(operands)
        dtype = np.dtype(array_type(equation.outvars[0]).dtype)

        def translate_element(*scalars: Value) -> Value:
            """Return the operation's result for one element of each operand."""
            return translation.translate(self.build, scalars, equation.params, dtype)

        return [elementwise(translate_element, self.build, operands)]

    def apply_traced_function(
        self, translation: TranslationRule, equation: JaxprEqn, operands: list[Any]
    ) -> Sequence[Any]:
        """Apply a rule of an elementary function to each element.

        The function consists of JAX's arithmetic. It is traced, and its trace is translated for each element. A
        :class:`RareRule` adds a subroutine for rare arguments.
        """
        refuse_recordings(operands)
        types = [np.dtype(array_type(atom).dtype) for atom in equation.invars]
        function = self.trace_of(translation.translate, types)

        def usual_result(*scalars: Value) -> Value:
            """Return the function's result for one element of each operand."""
            return self.run(function, scalars)[0]

        if not isinstance(translation, RareRule):
            return [elementwise(usual_result, self.build, operands)]
        condition = self.trace_of(translation.is_rare, types)
        subroutine = self.subroutine(translation.rarely, types)

        def usual_or_rare_result(*scalars: Value) -> Value:
            """Return the function's result or, for rare arguments, the result of the subroutine."""
            usual = usual_result(*scalars)
            is_rare = self.run(condition, scalars)[0]
            return self.build.add("rarely", is_rare, usual, *scalars, dtype=usual.dtype, detail=subroutine)

        return [elementwise(usual_or_rare_result, self.build, operands)]

    def apply_to_arrays(self, translation: TranslationRule, equation: JaxprEqn, operands: list[Any]) -> Sequence[Any]:
        """Apply a rule whose translation takes whole arrays: it moves, combines or draws elements, or calls C."""
        if translation not in MEMORY_RULES:
            refuse_recordings(operands)
        results = translation.translate(self.build, operands, equation.params, equation)
        return results if equation.primitive.multiple_results else [results]

    def trace_of(self, function: Callable[..., Any], types: Sequence[np.dtype]) -> ClosedJaxpr:
        """Return the trace of an elementary function of scalars, which is made once for each combination of dtypes.

        JAX's 64 bits are enabled for the trace, because a function may compute in float64 whatever its arguments are.
        """
        key = function, *types
        if key not in self._traces:
            scalars = [jax.ShapeDtypeStruct((), dtype) for dtype in types]
            with jax.enable_x64(True):
                self._traces[key] = jax.make_jaxpr(function)(*scalars)
        return self._traces[key]

    def subroutine(self, function: Callable[..., Any], types: Sequence[np.dtype]) -> Subroutine:
        """Return the subroutine of a function of scalars, which is translated once for each combination of dtypes."""
        key = function, *types
        if key not in self._subroutines:
            translator = Translator(Builder(self.build.fast))
            inputs = [translator.build.input(position, dtype) for position, dtype in enumerate(types)]
            outputs = translator.run(self.trace_of(function, types), inputs)
            bits = [str(8 * dtype.itemsize) for dtype in types]
            name = "_".join((function.__name__, *bits))  # such as "far_sin_64"
            self._subroutines[key] = Subroutine(name, Program(list(types), translator.build.here, outputs))
        return self._subroutines[key]


def inline_call(translator: Translator, equation: JaxprEqn, operands: list[Any]) -> list[Any]:
    """Translate the program of a call in place of the call; return the results of the program."""
    inner: Any = equation.params.get("jaxpr", equation.params.get("call_jaxpr"))
    program = inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())  # (): it has no constants
    return translator.run(program, operands)


def inline_whole_operation(translator: Translator, equation: JaxprEqn, operands: list[Any]) -> list[Any]:
    """Translate the program of an operation that JAX, since 0.12, keeps whole in a trace, such as ``searchsorted``."""
    shapes = [array_type(atom) for atom in equation.invars]
    program = jax.make_jaxpr(equation.params["_prim"].expand)(*shapes)
    return translator.run(program, operands)


def largest_over_lanes(translator: Translator, equation: JaxprEqn, operands: list[Any]) -> list[Any]:
    """``lax.pmax`` over the lanes of whole numbers that are 0 or 1: 1 if any lane has a 1, else 0.

    Raises:
        Unsupported: An operand is an array.
    """
    build = translator.build
    results = []
    for operand in operands:
        if not isinstance(operand, Value):
            raise Unsupported("a maximum over the lanes of arrays")
        any_lane_has = build.add("any", build.add("ne", operand, build.constant(0, operand.dtype)))
        results.append(build.add("convert", any_lane_has, dtype=operand.dtype))
    return results


def is_lane_axis(axes: Any, equation: JaxprEqn) -> bool:
    """Whether a reduction runs over the lanes alone; one along an axis of the user's has no translation.

    This is the condition of a parameter; the equation is not needed.
    """
    return tuple(axes) == (AXIS,)


OVER_LANES = {"pmax": rule(largest_over_lanes, WHOLE, axes=is_lane_axis, axis_index_groups=no_value)}
"""Reductions over the lanes that run together."""

REMATERIALISED = rule(inline_call, None, jaxpr=any_value, prevent_cse=any_value, differentiated=any_value,
                      policy=any_value)  # fmt: skip
"""The rule of a call whose results JAX would compute again for a gradient, under the three names that JAX gives it."""
MEMORY_RULES = [indexing.INDEXING_RULES[name] for name in ("dynamic_slice", "dynamic_update_slice")]
"""Rules of the operations that an array in memory allows."""

INLINED = {
    "jit": rule(
        inline_call, None, jaxpr=any_value, name=any_value, in_shardings=any_value, out_shardings=any_value,
        in_layouts=any_value, out_layouts=any_value, donated_invars=any_value, ctx_mesh=any_value,
        keep_unused=any_value, inline=any_value, compiler_options_kvs=no_value,
    ),
    "closed_call": rule(inline_call, None, call_jaxpr=any_value),
    "core_call": rule(inline_call, None, call_jaxpr=any_value),
    "call_hi_primitive": rule(inline_whole_operation, None, _prim=any_value),
    "remat": REMATERIALISED,
    "remat2": REMATERIALISED,
    "checkpoint": REMATERIALISED,
    "custom_jvp_call": rule(
        inline_call, None, call_jaxpr=any_value, jvp_jaxpr_fun=any_value, num_consts=any_value,
        symbolic_zeros=any_value,
    ),
    "custom_vjp_call": rule(
        inline_call, None, call_jaxpr=any_value, fwd_jaxpr_thunk=any_value, bwd=any_value, num_consts=any_value,
        out_trees=any_value, symbolic_zeros=any_value,
    ),
}  # fmt: skip
"""Rules of calls, which are inlined."""
