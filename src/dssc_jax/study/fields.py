"""Fields of a model's parameter type, as the schema of its table in a study."""

import types
import typing
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, create_model

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.named import Text
from dssc_jax.core.quantities import Quantity, extent
from dssc_jax.core.registry import Slot
from dssc_jax.study.numbers import parse_numbers


def is_record(model: object) -> bool:
    """Whether an object is a NamedTuple, or a type of NamedTuples."""
    return hasattr(model, "_fields")


@dataclass(frozen=True)
class FieldSpec:
    """Form of one field of a parameter type in a study's table: a number, a part, a text, an option or a flag.

    The form follows from the annotation of the field.

    Args:
        mark: Quantity of a number, or slot of a part with a ``kind``; None for any other field.
        hint: Type of the field, without annotations and without ``None``.
        is_optional: Whether the field may be ``None``.
    """

    mark: Quantity | Slot | None
    hint: Any
    is_optional: bool

    @property
    def depth(self) -> int:
        """Number of lists around a number: 0 for a number alone, 1 for a list of numbers, 2 for a list of rows."""
        depth = 0
        inner = self.hint
        while typing.get_origin(inner) is tuple:
            depth += 1
            inner = typing.get_args(inner)[0]
        return depth

    @property
    def is_nested(self) -> bool:
        """Whether the field is a table of one fixed parameter type, without a ``kind``."""
        return self.mark is None and is_record(self.hint)

    @property
    def item_type(self) -> Any:
        """Parameter type of the items of a list of tables; None if the field is no such list."""
        if self.mark is not None or typing.get_origin(self.hint) is not tuple:
            return None
        item_types = typing.get_args(self.hint)
        return item_types[0] if item_types and is_record(item_types[0]) else None

    @property
    def named_type(self) -> Any:
        """Type of the items of a table whose keys are names that the study chooses; None for any other field."""
        if typing.get_origin(self.hint) is not dict:
            return None
        _, item_type = typing.get_args(self.hint)
        return item_type

    @property
    def is_text(self) -> bool:
        """Whether the field is a text, such as a unit or a meaning."""
        return self.hint is Text

    @property
    def is_part(self) -> bool:
        """Whether the content of the field is a table, or several tables, rather than a plain value."""
        has_several_tables = self.named_type is not None or self.item_type is not None
        return isinstance(self.mark, Slot) or self.is_nested or has_several_tables

    @property
    def enum(self) -> type[Enum] | None:
        """Enumeration of the values of an option; None if the field is no option."""
        return self.hint if isinstance(self.hint, type) and issubclass(self.hint, Enum) else None

    @property
    def is_derived(self) -> bool:
        """Whether the model's ``prepare`` computes the field, so that a study must not set it.

        These are all fields other than numbers, parts, texts, options and flags.
        """
        return not (self.mark or self.is_part or self.is_text or self.enum or self.hint is bool)


@cache
def field_specs(params: type) -> dict[str, FieldSpec]:
    """Form of each field of a parameter type in a study's table, by the field's name."""
    specs = {}
    for name, hint in typing.get_type_hints(params, include_extras=True).items():
        annotations = getattr(hint, "__metadata__", ())
        marks = [annotation for annotation in annotations if isinstance(annotation, Quantity | Slot)]
        mark = marks[0] if marks else None
        field_type = typing.get_args(hint)[0] if annotations else hint
        is_optional = False
        if typing.get_origin(field_type) in (typing.Union, types.UnionType):
            members = typing.get_args(field_type)
            present_members = [member for member in members if member is not type(None)]
            is_optional = len(present_members) < len(members)
            field_type = present_members[0] if len(present_members) == 1 else field_type
        specs[name] = FieldSpec(mark, field_type, is_optional)
    return specs


def in_order(part: Any) -> Any:
    """Return a part after a check of the order of its numbers, which their quantities state by ``less_than``.

    A number must be below the number that its ``less_than`` names, for all values of both laws.

    Args:
        part: A NamedTuple of parameters, with numbers or laws. Numbers that are None are not compared.

    Raises:
        ConfigError: A number may reach or exceed the number that should be larger, or the part has no such field.
    """
    for name, spec in field_specs(type(part)).items():
        larger_name = spec.mark.less_than if isinstance(spec.mark, Quantity) else None
        if larger_name is not None and larger_name not in part._fields:
            raise ConfigError(name, f"its quantity has less_than = '{larger_name}', but the part has no such number")
        if larger_name is None or getattr(part, name) is None or getattr(part, larger_name) is None:
            continue
        _, highest = extent(getattr(part, name))
        lowest_larger, _ = extent(getattr(part, larger_name))
        if not highest < lowest_larger:
            raise ConfigError(name, f"must be below {larger_name} = {lowest_larger:g}, got up to {highest:g}")
    return part


def number_type(quantity: Quantity, depth: int, optional: bool) -> Any:
    """Type with which pydantic parses a field: a number, or nested lists of numbers.

    Args:
        quantity: Unit, meaning and admissible interval of each number.
        depth: Number of lists around a number, as in :attr:`FieldSpec.depth`.
        optional: Whether the value may be None.
    """

    def check(value: object) -> Any:
        """Parse the value of the field."""
        if value is None and optional:
            return None
        return parse_numbers(value, quantity, depth)

    return Annotated[Any, BeforeValidator(check)]


@cache
def table_model(params: type) -> type[BaseModel]:
    """Pydantic's model of the plain fields of a parameter type: numbers, lists of numbers, texts, options and flags.

    The model requires every field: :func:`dssc_jax.study.components.parse_plain` fills in the defaults beforehand.
    """
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
        fields[name] = (field_type, ...)  # pydantic's sign of a required field
    return create_model(params.__name__, __config__=ConfigDict(extra="forbid", strict=True), **fields)
