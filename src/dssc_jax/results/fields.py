"""The fields of an analysis as plain data: written to its folder by their types, and explained by their meanings."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

from pydantic import TypeAdapter, ValidationError

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

MERGED = "merged"
"""Key of a field's metadata: its entries, if it is not None, stand beside the other fields in the JSON."""

STORED_APART = "stored apart"
"""Key of a field's metadata: the field has a file or an entry of its own in the folder."""


class FieldMeaning(NamedTuple):
    """A number of an answer.

    Args:
        key: Its place in the JSON, with a dot between the levels and ``NAME`` for each name that the study gives.
        unit: Its unit; ``1`` for numbers without a unit, empty for text.
        meaning: In words.
    """

    key: str
    unit: str
    meaning: str


def stored_fields(analysis: "DataclassInstance") -> dict[str, object]:
    """The fields of a dataclass as JSON has them, by name, without those that are stored apart."""
    hints = field_types(type(analysis))
    return {name: TypeAdapter(hint).dump_python(getattr(analysis, name), mode="json") for name, hint in hints.items()}


def restored_fields(cls: type, stored_values: Mapping[str, object]) -> dict[str, object]:
    """The arguments of a dataclass that :func:`stored_fields` wrote.

    Raises:
        ConfigError: A field is missing, unknown, or has a value of another type; the message names it.
    """
    values = {}
    hints = field_types(cls)
    for name in stored_values:
        if name not in hints:
            raise ConfigError(name, "is no setting of this analysis")
    for name, hint in hints.items():
        if name not in stored_values:
            raise ConfigError(name, "is missing")
        try:
            values[name] = TypeAdapter(hint).validate_python(stored_values[name])
        except ValidationError as error:
            raise ConfigError(name, error.errors()[0]["msg"]) from None
    return values


def field_types(cls: type) -> dict[str, Any]:
    """The types of a dataclass's fields by name, without those that are stored apart."""
    hints = get_type_hints(cls, include_extras=True)
    return {field.name: hints[field.name] for field in fields(cls) if not field.metadata.get(STORED_APART)}


def field_meanings(cls: type, prefix: str = "") -> Iterator[FieldMeaning]:
    """The meaning of each number of an answer and its parts, from the annotations of its dataclass."""
    hints = get_type_hints(cls, include_extras=True)
    for field in fields(cls):
        hint = hints[field.name]
        key = prefix.removesuffix(".") if field.metadata.get(MERGED) else f"{prefix}{field.name}"
        if get_origin(hint) is Annotated:
            inner, *notes = get_args(hint)
            for note in notes:
                if isinstance(note, Quantity):
                    yield FieldMeaning(key, note.unit, note.meaning)
            hint = inner
        for part, place in answer_parts(hint):
            yield from field_meanings(part, f"{key}{place}.".removeprefix("."))


def answer_parts(hint: object) -> Iterator[tuple[type, str]]:
    """The dataclasses within a type, each with its place in it: ``.NAME`` in a mapping, ``[]`` in a list."""
    if isinstance(hint, type) and is_dataclass(hint):
        yield hint, ""
        return
    origin = get_origin(hint)
    place = ""
    if isinstance(origin, type) and issubclass(origin, Mapping):
        place = ".NAME"
    elif origin in (list, tuple):
        place = "[]"
    for argument in get_args(hint):
        for part, inner in answer_parts(argument):
            yield part, place + inner
