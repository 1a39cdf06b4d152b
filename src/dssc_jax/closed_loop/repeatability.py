"""Comparison of two traces of one function: their programs differ if the function is not pure.

JAX traces a function to a program, a list of equations. If the function reads a clock, counts its calls or draws random
numbers without JAX, the constants in the program differ from trace to trace.
"""

import re
from collections.abc import Callable, Iterator
from types import CodeType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, JaxprEqn, Literal

ADDRESS = re.compile(r"0x[0-9a-f]+")


def first_difference(program: Callable[[], Callable[[], Any]]) -> list[CodeType] | None:
    """Trace a function twice, and find the source code at which the two programs first differ.

    Args:
        program: Returns the function as a new object at each call, because JAX remembers the trace of an old one.

    Returns:
        The code objects of the calls that lead to the first different equation, outermost call first; empty if the
        programs differ, but no equation does. None: the programs are the same.
    """
    first = jax.make_jaxpr(program())()
    second = jax.make_jaxpr(program())()
    equation = different_equation(first, second)
    if equation is not None:
        return codes_of(equation)
    is_same = text_of(first) == text_of(second) and same_values(first.consts, second.consts)
    return None if is_same else []


def different_equation(first: ClosedJaxpr, second: ClosedJaxpr) -> JaxprEqn | None:
    """The first equation of a program that differs from its counterpart in the second program; None if all are equal.

    An equation also differs if it reads a constant whose value is another one in the second program. Programs within an
    equation, such as the body of a loop, are searched first, so that the innermost difference is found.
    """
    different_constants = set()
    for variable, value, second_value in zip(first.jaxpr.constvars, first.consts, second.consts, strict=False):
        if not same_values([value], [second_value]):
            different_constants.add(id(variable))
    for equation, second_equation in zip(first.jaxpr.eqns, second.jaxpr.eqns, strict=False):
        for inner, second_inner in zip(inner_programs(equation), inner_programs(second_equation), strict=False):
            inner_difference = different_equation(inner, second_inner)
            if inner_difference is not None:
                return inner_difference
        reads_difference = any(id(operand) in different_constants for operand in equation.invars)
        has_same_literals = same_values(literals_of(equation), literals_of(second_equation))
        if reads_difference or text_of(equation) != text_of(second_equation) or not has_same_literals:
            return equation
    return None


def literals_of(equation: JaxprEqn) -> list[Any]:
    """The operands of an equation that are numbers, written into the equation itself."""
    return [operand.val for operand in equation.invars if isinstance(operand, Literal)]


def inner_programs(equation: JaxprEqn) -> Iterator[ClosedJaxpr]:
    """The programs within an equation, such as the body of a loop."""
    for value in equation.params.values():
        members = value if isinstance(value, tuple | list) else (value,)
        for member in members:
            if isinstance(member, ClosedJaxpr):
                yield member


def same_values(first: list[Any], second: list[Any]) -> bool:
    """Whether two lists of constants are equal bit by bit.

    Traced values have no bits yet, and count as equal.
    """
    return [bits_of(value) for value in first] == [bits_of(value) for value in second]


def bits_of(value: Any) -> bytes | None:
    """The bits of a constant; None for a traced value, such as a parameter, which has none yet."""
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        value = jax.random.key_data(value)
    try:
        return np.asarray(value).tobytes()
    except jax.errors.TracerArrayConversionError:
        return None


def text_of(program: ClosedJaxpr | JaxprEqn) -> str:
    """The text of a program or equation without memory addresses, which change from trace to trace."""
    return ADDRESS.sub("", str(program))


def codes_of(equation: JaxprEqn) -> list[CodeType]:
    """The code objects of the calls that led to an equation, outermost call first; empty if JAX kept no traceback."""
    traceback = getattr(equation.source_info, "traceback", None)
    if traceback is None:
        return []
    codes, _ = traceback.raw_frames()  # and the place in each code; innermost call first
    return list(reversed(codes))
