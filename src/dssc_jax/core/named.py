"""Signals that a study names: their declaration, and the NamedTuple type in which a plant reports them."""

import re
from collections import namedtuple
from collections.abc import Mapping
from functools import cache
from keyword import iskeyword
from typing import Any, NamedTuple, TypeVar

import jax

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity, quantities_of
from dssc_jax.core.signals import Info
from dssc_jax.core.vectors import Quaternion, Vec3

Item = TypeVar("Item")


@jax.tree_util.register_static
class Text(str):
    """A unit or a meaning among a model's parameters; for JAX it is part of the tree's structure and not a leaf."""

    __slots__ = ()


class NamedSignal(NamedTuple):
    """A declared signal.

    Args:
        name: Name in the study and in results.
        unit: Unit; empty: none is declared.
        meaning: Meaning in words; empty: none is declared.
        periodic: Whether the signal is an angle that begins again after a turn.
    """

    name: str
    unit: str
    meaning: str
    periodic: bool = False

    @classmethod
    def of(cls, name: str, quantity: Quantity) -> "NamedSignal":
        """Return the signal with this name, and with the unit and meaning of a quantity."""
        return cls(name, quantity.unit, quantity.meaning, quantity.periodic)

    @property
    def quantity(self) -> Quantity:
        """Unit and meaning of the signal as a quantity; the name stands for the meaning if none is declared."""
        return Quantity(self.unit, self.meaning or self.name, periodic=self.periodic)


COMPONENTS = (*Vec3._fields, *Quaternion._fields)  # ends of the names of a vector's or quaternion's components
REPORT = "Report"  # beginning of the name of a report's type
SIGNAL_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", re.ASCII)
SEPARATOR = "__"
"""Separator of the fields' names in the name of a report's type; no signal's name contains it."""


def require_signal_name(name: str) -> None:
    """Require that a name is a valid field of a report: an identifier without ``__``, and no word of Python.

    Raises:
        ConfigError: The name is not valid.
    """
    if not SIGNAL_NAME.fullmatch(name):
        raise ConfigError("", "must be named by letters and digits, with single _ between them")
    if iskeyword(name):
        raise ConfigError("", "has a name that is a word of Python; give it another one")


@cache
def report_type(names: tuple[str, ...]) -> type:
    """Return the NamedTuple type of what a plant reports, with a field for each signal.

    The type's name contains the names of the fields, so that :func:`__getattr__` can make the type again in another
    process.
    """
    return namedtuple(SEPARATOR.join((REPORT, *names)), names, module=__name__)  # type: ignore[return-value]


def __getattr__(name: str) -> type:
    """Make the type of :func:`report_type` from its name, so that pickle can read reports of other processes.

    Raises:
        AttributeError: No report's type has this name.
    """
    first, *names = name.split(SEPARATOR)  # Report__speed__current
    if first != REPORT or not all(names):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return report_type(tuple(names))


def signals_in(info: Info) -> dict[str, Any]:
    """Return the scalar signals of an info by name.

    A field that is itself an info, with declared quantities, is replaced by that info's fields. A vector is replaced by
    its components, such as ``wind_x``, and a tuple by its numbered elements, such as ``rotor_1``. Empty tuples vanish.

    Args:
        info: A NamedTuple, or an empty tuple.
    """
    signals = {}
    for name, value in zip(getattr(info, "_fields", ()), info, strict=True):
        if hasattr(value, "_fields") and quantities_of(type(value)):
            signals |= signals_in(value)
        else:
            signals |= components_of(name, value)
    return signals


def components_of(name: str, value: Any) -> dict[str, Any]:
    """Return the numbers of a signal by name: a scalar, the components ``wind_x``, ... of a vector, or elements.

    Args:
        name: Name of the signal.
        value: A scalar, a NamedTuple such as ``Vec3``, or a tuple; tuples may be nested.
    """
    if not isinstance(value, tuple):
        return {name: value}
    ends = getattr(value, "_fields", range(1, len(value) + 1))
    components = {}
    for end, component in zip(ends, value, strict=True):
        components |= components_of(f"{name}_{end}", component)
    return components


def quantity_of(name: str, quantities: Mapping[str, Quantity]) -> Quantity | None:
    """Return the declared quantity of a signal, or of the vector of which it is a component; None if there is none.

    Args:
        name: Name of the signal, such as ``wind_x``.
        quantities: Declared quantities by name.
    """
    if name in quantities:
        return quantities[name]
    vector, _, component = name.rpartition("_")
    is_component = component in COMPONENTS or component.isdecimal()
    if vector not in quantities or not is_component:
        return None
    quantity = quantities[vector]
    return Quantity(quantity.unit, f"{quantity.meaning} {component}", periodic=quantity.periodic)


def by_names(items: Mapping[str, Item] | None) -> list[tuple[str, Item]]:
    """Return the pairs of name and item sorted by name, as JAX orders the leaves of a mapping; [] for None."""
    return sorted((items or {}).items())
