"""Signals that a study names: words in a model's parameters, and the type of what a plant reports under these names."""

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
    """A unit or a meaning in a model's parameters: part of their structure, no number among their leaves."""

    __slots__ = ()


class NamedSignal(NamedTuple):
    """Name, unit and meaning of a signal, and whether it is an angle that begins again after a turn.

    A signal without a unit has an empty one.
    """

    name: str
    unit: str
    meaning: str
    periodic: bool = False

    @classmethod
    def of(cls, name: str, quantity: Quantity) -> "NamedSignal":
        """The signal with a name that a quantity describes."""
        return cls(name, quantity.unit, quantity.meaning, quantity.periodic)

    @property
    def quantity(self) -> Quantity:
        """What the signal is; without a meaning, its name stands for it."""
        return Quantity(self.unit, self.meaning or self.name, periodic=self.periodic)


COMPONENTS = (*Vec3._fields, *Quaternion._fields)
REPORT = "Report"
SIGNAL_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", re.ASCII)
SEPARATOR = "__"
"""Between the names of a report's fields in the name of its type; no signal has it in its name."""


def require_signal_name(name: str) -> None:
    """Require that a name can be that of a signal, and so that of a field of a report; raises ConfigError."""
    if not SIGNAL_NAME.fullmatch(name):
        raise ConfigError("", "must be named by letters and digits, with single _ between them")
    if iskeyword(name):
        raise ConfigError("", "has a name that is a word of Python; give it another one")


@cache
def report_type(names: tuple[str, ...]) -> type:
    """The NamedTuple type of a plant's report with these fields."""
    return namedtuple(SEPARATOR.join((REPORT, *names)), names, module=__name__)  # type: ignore[return-value]


def __getattr__(name: str) -> type:
    """The type of a report by its name: what was computed with it in another process is restored by that.

    Raises:
        AttributeError: it is no name of such a type.
    """
    first, *names = name.split(SEPARATOR)
    if first != REPORT or not all(names):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return report_type(tuple(names))


def signals_in(info: Info) -> dict[str, Any]:
    """The signals of an info by name: its fields, and those of a part that declares quantities in place of the part.

    A vector's components have its name with their own behind it, as ``wind_x``, and several values of a field their
    number, as ``rotor_1``. A part that is () is left out, and an info that is () has no signal.
    """
    signals = {}
    for name, value in zip(getattr(info, "_fields", ()), info, strict=True):
        if hasattr(value, "_fields") and quantities_of(type(value)):
            signals |= signals_in(value)
        else:
            signals |= components_of(name, value)
    return signals


def components_of(name: str, value: Any) -> dict[str, Any]:
    """A signal by its name, or the components of a tuple by theirs."""
    if not isinstance(value, tuple):
        return {name: value}
    ends = getattr(value, "_fields", range(1, len(value) + 1))
    components = {}
    for end, component in zip(ends, value, strict=True):
        components |= components_of(f"{name}_{end}", component)
    return components


def quantity_of(name: str, quantities: Mapping[str, Quantity]) -> Quantity | None:
    """What a signal is: as declared under its name, or under that of the vector that it is a component of.

    None if neither is declared.
    """
    if name in quantities:
        return quantities[name]
    vector, _, component = name.rpartition("_")
    if vector not in quantities or not (component in COMPONENTS or component.isdecimal()):
        return None
    quantity = quantities[vector]
    return Quantity(quantity.unit, f"{quantity.meaning} {component}", periodic=quantity.periodic)


def by_names(items: Mapping[str, Item] | None) -> list[tuple[str, Item]]:
    """Named items in the order of their names, the order of a mapping's leaves; none of None."""
    return sorted((items or {}).items())
