"""Fields of a model's parameter type, as the schema of its table in a study."""

import types
import typing
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, create_model

from dssc_jax.core.named import Text
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Slot
from dssc_jax.study.numbers import parse_numbers


def is_record(model: object) -> bool:
    """Whether an object is a NamedTuple, or a type of NamedTuples."""
    return hasattr(model, "_fields")


@dataclass(frozen=True)
class FieldSpec:
    """Specification of one field of a parameter type, from its annotation.

    Args:
        mark: Quantity of a number, or slot of a part; None for any other field.
        hint: Type without annotations and without ``None``.
        is_optional: Whether the field may be ``None``.
    """

    mark: Quantity | Slot | None
    hint: Any
    is_optional: bool

    @property
    def depth(self) -> int:
        """Depth of lists: 0 for a number, 1 for a list of numbers, 2 for a list of rows."""
        depth = 0
        inner = self.hint
        while typing.get_origin(inner) is tuple:
            depth += 1
            inner = typing.get_args(inner)[0]
        return depth

    @property
    def is_nested(self) -> bool:
        """Whether the field is a table of one fixed parameter type."""
        return self.mark is None and is_record(self.hint)

    @property
    def item_type(self) -> Any:
        """Parameter type of the items of a list of tables; None if the field is no such list."""
        items = typing.get_args(self.hint) if typing.get_origin(self.hint) is tuple else ()
        return items[0] if self.mark is None and items and is_record(items[0]) else None

    @property
    def named_type(self) -> Any:
        """Type of the items of a table whose keys are names of the study; None if the field is no such table."""
        return typing.get_args(self.hint)[1] if typing.get_origin(self.hint) is dict else None

    @property
    def is_text(self) -> bool:
        """Whether the field is a text, such as a unit or a meaning."""
        return self.hint is Text

    @property
    def is_part(self) -> bool:
        """Whether the field has a table, or tables, of its own."""
        has_tables = self.named_type is not None or self.item_type is not None
        return isinstance(self.mark, Slot) or self.is_nested or has_tables

    @property
    def enum(self) -> type[Enum] | None:
        """Enumeration of the values of an option; None if the field is no option."""
        return self.hint if isinstance(self.hint, type) and issubclass(self.hint, Enum) else None

    @property
    def is_derived(self) -> bool:
        """Whether the model's ``prepare`` computes the field, which tables must then not set."""
        return not (self.mark or self.is_part or self.is_text or self.enum or self.hint is bool)


@cache
def field_specs(params: type) -> dict[str, FieldSpec]:
    """Specification of each field of a parameter type, by name."""
    specs = {}
    for name, hint in typing.get_type_hints(params, include_extras=True).items():
        marks = getattr(hint, "__metadata__", ())
        mark = next((m for m in marks if isinstance(m, Quantity | Slot)), None)
        field_type = typing.get_args(hint)[0] if marks else hint
        is_optional = False
        if typing.get_origin(field_type) in (typing.Union, types.UnionType):
            members = [member for member in typing.get_args(field_type) if member is not type(None)]
            is_optional = len(members) < len(typing.get_args(field_type))
            field_type = members[0] if len(members) == 1 else field_type
        specs[name] = FieldSpec(mark, field_type, is_optional)
    return specs


def number_type(quantity: Quantity, depth: int, optional: bool) -> Any:
    """Type for pydantic that parses a number (``depth`` 0), a list of numbers (1), or a list of rows (2)."""

    def check(value: object) -> Any:
        return None if value is None and optional else parse_numbers(value, quantity, depth)

    return Annotated[Any, BeforeValidator(check)]


@cache
def table_model(params: type) -> type[BaseModel]:
    """Pydantic's model of the plain fields of a parameter type: numbers, lists of numbers, texts and options."""
    fields: dict[str, Any] = {}
    for name, spec in field_specs(params).items():
        if spec.is_part or spec.is_derived:
            continue
        if isinstance(spec.mark, Quantity):
            field_type = number_type(spec.mark, spec.depth, spec.is_optional)
        elif spec.enum:
            field_type = Literal[tuple(member.value for member in spec.enum)]  # type: ignore[valid-type]
        else:
            field_type = str if spec.is_text else spec.hint
        fields[name] = (field_type, ...)
    return create_model(params.__name__, __config__=ConfigDict(extra="forbid", strict=True), **fields)
