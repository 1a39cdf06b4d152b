"""Whether two traces of a program are the same, and which of its equations is not."""

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
    """Trace a function twice, and compare the programs.

    Args:
        program: Gives the function anew, so that JAX has not traced it yet.

    Returns:
        The code that was running where the programs first differ, outermost call first; empty if no equation tells.
        None: they are the same.
    """
    first, second = (jax.make_jaxpr(program())() for _ in range(2))
    equation = different_equation(first, second)
    if equation is not None:
        return codes_of(equation)
    return None if text_of(first) == text_of(second) and same_values(first.consts, second.consts) else []


def different_equation(first: ClosedJaxpr, second: ClosedJaxpr) -> JaxprEqn | None:
    """The first equation of a program that differs from the other program's."""
    pairs = zip(first.jaxpr.constvars, first.consts, second.consts, strict=False)
    changed = {id(variable) for variable, value, other in pairs if not same_values([value], [other])}
    for equation, other in zip(first.jaxpr.eqns, second.jaxpr.eqns, strict=False):
        for inner, other_inner in zip(inner_programs(equation), inner_programs(other), strict=False):
            if (inner_difference := different_equation(inner, other_inner)) is not None:
                return inner_difference
        reads_changed = any(
            id(variable) in changed for variable in equation.invars if not isinstance(variable, Literal)
        )
        literals = ([x.val for x in e.invars if isinstance(x, Literal)] for e in (equation, other))
        if reads_changed or text_of(equation) != text_of(other) or not same_values(*literals):
            return equation
    return None


def inner_programs(equation: JaxprEqn) -> Iterator[ClosedJaxpr]:
    """The programs within an equation, such as the body of a loop."""
    for value in equation.params.values():
        for part in value if isinstance(value, tuple | list) else (value,):
            if isinstance(part, ClosedJaxpr):
                yield part


def same_values(first: list[Any], second: list[Any]) -> bool:
    """Whether constants are equal to the bit; values of an enclosing trace, such as parameters, count as equal."""
    return [bits_of(value) for value in first] == [bits_of(value) for value in second]


def bits_of(value: Any) -> bytes | None:
    """The bits of a constant; None: it is a value of an enclosing trace."""
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        value = jax.random.key_data(value)
    try:
        return np.asarray(value).tobytes()
    except jax.errors.TracerArrayConversionError:
        return None


def text_of(program: ClosedJaxpr | JaxprEqn) -> str:
    """The text of a program without addresses."""
    return ADDRESS.sub("", str(program))


def codes_of(equation: JaxprEqn) -> list[CodeType]:
    """The code that was running where an equation was traced, outermost call first."""
    trace = getattr(equation.source_info, "traceback", None)
    return [] if trace is None else list(reversed(trace.raw_frames()[0]))
