"""NamedTuple types whose fields have names from native code, made when the code is loaded."""

from collections import namedtuple
from collections.abc import Mapping
from typing import Annotated, Any

from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar

MODULE = "dssc_jax_library"
"""The ``__module__`` of these types."""


def named_type(name: str, quantities: Mapping[str, Quantity], defaults: Mapping[str, float | None]) -> Any:
    """Make a NamedTuple type of numbers.

    Args:
        name: Name of the type.
        quantities: Unit and meaning of each field.
        defaults: Default of each field, where None means that the number may be absent; empty: no field has a default.
    """
    values = [defaults[field] for field in quantities] if defaults else None
    created = namedtuple(name, list(quantities), defaults=values, module=MODULE)
    hints = {}
    for field, quantity in quantities.items():
        optional = field in defaults and defaults[field] is None
        hints[field] = Annotated[Scalar | None, quantity] if optional else Annotated[Scalar, quantity]
    created.__annotations__ = hints
    return created
