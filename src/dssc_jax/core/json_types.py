"""The type of values that JSON can hold."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

Json: TypeAlias = Mapping[str, "Json"] | Sequence["Json"] | str | float | bool | None
"""An object, an array, a text, a number, true or false, or null."""

JsonObject: TypeAlias = dict[str, Any]
"""An object that was read or will be written: JSON values by name."""
