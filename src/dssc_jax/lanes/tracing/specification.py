"""Specifications of rules: types of operands and results, and values of parameters, that are translated exactly.

Everything that a specification does not list is refused by name: another type, another value, or a parameter that a
newer JAX adds. The program then runs as plain XLA. :meth:`Specification.require` is the only place of this decision.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import JaxprEqn, Literal, Var

from dssc_jax.lanes.unsupported import Unsupported

KEY = "random key"
"""Type of the elements of an array of random keys of Threefry, JAX's default generator."""
TRUTH = frozenset({np.dtype(bool)})
REAL = frozenset({np.dtype(np.float32), np.dtype(np.float64)})
SIGNED_INTEGERS = frozenset(np.dtype(f"i{size}") for size in (1, 2, 4, 8))
UNSIGNED_INTEGERS = frozenset(np.dtype(f"u{size}") for size in (1, 2, 4, 8))
WHOLE = SIGNED_INTEGERS | UNSIGNED_INTEGERS
NUMBER_TYPES = REAL | WHOLE
SCALARS = NUMBER_TYPES | TRUTH
MOVED_TYPES = SCALARS | {KEY}
"""Types of elements for rules that only move elements."""

Variable: TypeAlias = Var | Literal
ElementType: TypeAlias = np.dtype | str
"""NumPy's dtype of elements, :data:`KEY`, or the name of another type."""
Types: TypeAlias = frozenset[np.dtype] | frozenset[np.dtype | str]
Parameters: TypeAlias = Mapping[str, Any]
"""Parameters of an equation by name, whose types depend on its primitive."""
Condition = Callable[[object, JaxprEqn], bool]
"""``(value of a parameter, equation) -> whether the rule translates it exactly``."""


def any_value(value: object, equation: JaxprEqn) -> bool:
    """The condition of a parameter that may have any value: true.

    Either the rule reads the parameter, or the parameter has no effect on a lane.
    """
    return True


def no_value(value: object, equation: JaxprEqn) -> bool:
    """The condition of a parameter that must be None, an empty tuple or an empty list; the equation is not needed."""
    is_empty = isinstance(value, tuple | list) and len(value) == 0
    return value is None or is_empty


def result_type(value: Any, equation: JaxprEqn) -> bool:
    """The condition of a parameter that must be None or the common dtype of all operands and results."""
    types = {element_type(variable.aval) for variable in (*equation.invars, *equation.outvars)}
    return value is None or types == {np.dtype(value)}


def one_of(*values: object) -> Condition:
    """Return the condition of a parameter that must have one of some values.

    Args:
        values: The values; for a member of an enumeration, its name.
    """
    return lambda value, equation: getattr(value, "name", value) in values


@dataclass(frozen=True)
class Specification:
    """The types and parameters of a primitive that are translated exactly.

    Args:
        types: Types that every operand and result may have; None: any type. Calls and loops allow any type, because
            their inner equations are checked in turn.
        parameters: The condition of each parameter; a parameter that is not listed is refused.
        exact: ``(equation) -> reason`` why the equation is not translated exactly; the reason is None if it is.
    """

    types: Types | None
    parameters: Mapping[str, Condition] = field(default_factory=dict)
    exact: Callable[[JaxprEqn], str | None] = lambda equation: None

    def require(self, equation: JaxprEqn) -> None:
        """Require that an equation meets the specification.

        Raises:
            Unsupported: A type, a parameter or the value of a parameter has no exact translation.
        """
        if self.types is not None:
            for variable in (*equation.invars, *equation.outvars):
                require_type(variable.aval, self.types)
        for name, value in equation.params.items():
            if name not in self.parameters:
                raise Unsupported(f"an unknown parameter {name} = {abbreviation(value)}")
            if not self.parameters[name](value, equation):
                raise Unsupported(f"the parameter {name} = {abbreviation(value)}")
        reason = self.exact(equation)
        if reason is not None:
            raise Unsupported(reason)


@dataclass(frozen=True)
class TranslationRule:
    """The rule for one primitive of JAX.

    Args:
        translate: Builds the operations of an equation of the primitive.
        specification: The equations that ``translate`` translates exactly.
    """

    translate: Callable[..., Any]
    specification: Specification


def rule(translate: Callable[..., Any], types: Types | None, **parameters: Condition) -> TranslationRule:
    """Return a translation rule.

    Args:
        translate: Builds the operations of an equation.
        types: Types that every operand and result may have; None: any type.
        parameters: The condition of each parameter of the equation.
    """
    return TranslationRule(translate, Specification(types, parameters))


def array_type(variable: Variable) -> jax.ShapeDtypeStruct:
    """Return the shape and dtype of an operand or a result.

    Raises:
        Unsupported: The variable is no array.
    """
    shape = getattr(variable.aval, "shape", None)
    dtype = getattr(variable.aval, "dtype", None)
    if shape is None or dtype is None:
        raise Unsupported(f"elements of type {variable.aval}")
    return jax.ShapeDtypeStruct(shape, dtype)


def element_type(aval: object) -> ElementType:
    """The type of an abstract array's elements: a dtype of NumPy, :data:`KEY`, or JAX's name of another type."""
    dtype = getattr(aval, "dtype", None)
    if dtype is None:  # it is no array
        return str(aval)
    if jnp.issubdtype(dtype, jax.dtypes.prng_key):
        is_threefry = "fry" in str(dtype)  # JAX prints the type as key<fry>
        return KEY if is_threefry else str(dtype)
    return np.dtype(dtype)


def require_type(aval: object, types: Types) -> None:
    """Require that the elements of an abstract array of JAX have one of some types.

    Raises:
        Unsupported: They have another type.
    """
    actual = element_type(aval)
    if actual in types:
        return
    if isinstance(actual, str) and actual.startswith("key"):
        raise Unsupported(f"random numbers of another generator, {actual}")
    raise Unsupported(f"elements of type {actual}")


def abbreviation(value: object) -> str:
    """Return the text of a parameter's value for a message: one line of at most 60 characters."""
    printed_value = str(getattr(value, "name", value))  # the name of a member of an enumeration
    text = " ".join(printed_value.split())
    return text if len(text) <= 60 else f"{text[:57]}..."
