"""Types of the numbers that native code names, which no module defines."""

from collections import namedtuple
from collections.abc import Mapping
from typing import Annotated, Any

from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar

MODULE = "dssc_jax_library"
"""The ``__module__`` of these types."""


def named_type(name: str, quantities: Mapping[str, Quantity], defaults: Mapping[str, float | None]) -> Any:
    """A NamedTuple type of numbers; with ``defaults`` for all of them, or without any.

    A number whose default is None may be absent.
    """
    values = [defaults[field] for field in quantities] if defaults else None
    created = namedtuple(name, list(quantities), defaults=values, module=MODULE)
    hints = {}
    for field, quantity in quantities.items():
        optional = field in defaults and defaults[field] is None
        hints[field] = Annotated[Scalar | None, quantity] if optional else Annotated[Scalar, quantity]
    created.__annotations__ = hints
    return created
