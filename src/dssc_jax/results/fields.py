"""The fields of an analysis as JSON, and the units and meanings of the numbers in its answer."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

from pydantic import TypeAdapter, ValidationError

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

MERGED = "merged"
"""Key of a field's metadata: in JSON, the entries of this field stand beside those of the other fields."""

STORED_APART = "stored apart"
"""Key of a field's metadata: the field has a file or an entry of its own in the folder."""


class FieldMeaning(NamedTuple):
    """Unit and meaning of a number in an answer.

    Args:
        key: Place of the number in the JSON, with dots between the levels. ``NAME`` stands for a name from the study;
            ``[]`` follows the name of a list.
        unit: Unit of the number; ``1`` for numbers without a unit, empty for text.
        meaning: Meaning in words.
    """

    key: str
    unit: str
    meaning: str


def stored_fields(analysis: "DataclassInstance") -> dict[str, object]:
    """Fields of an analysis in the types of JSON, by name, except fields that are stored apart."""
    stored = {}
    for name, field_type in field_types(type(analysis)).items():
        stored[name] = TypeAdapter(field_type).dump_python(getattr(analysis, name), mode="json")
    return stored


def restored_fields(cls: type, stored_values: Mapping[str, object]) -> dict[str, object]:
    """Rebuild the fields of an analysis, by name, from the values that :func:`stored_fields` returned.

    Args:
        cls: Class of the analysis.
        stored_values: The values by name.

    Raises:
        ConfigError: A field is missing, unknown, or has a value of another type; the message names it.
    """
    values = {}
    types = field_types(cls)
    for name in stored_values:
        if name not in types:
            raise ConfigError(name, "is no setting of this analysis")
    for name, field_type in types.items():
        if name not in stored_values:
            raise ConfigError(name, "is missing")
        try:
            values[name] = TypeAdapter(field_type).validate_python(stored_values[name])
        except ValidationError as error:
            first_error = error.errors()[0]
            raise ConfigError(name, first_error["msg"]) from None
    return values


def field_types(cls: type) -> dict[str, Any]:
    """The annotated types of a dataclass's fields by name, without fields that are stored apart."""
    hints = get_type_hints(cls, include_extras=True)
    return {field.name: hints[field.name] for field in fields(cls) if not field.metadata.get(STORED_APART)}


def field_meanings(cls: type, prefix: str = "") -> Iterator[FieldMeaning]:
    """Yield unit and meaning of each number in an answer and its parts, from the annotations of the dataclasses.

    Reports and tables show units and meanings beside the numbers.

    Args:
        cls: Dataclass of the answer, or of a part.
        prefix: Key of the part, with a final dot; empty for the answer itself.
    """
    hints = get_type_hints(cls, include_extras=True)
    for field in fields(cls):
        field_type = hints[field.name]
        key = prefix.removesuffix(".") if field.metadata.get(MERGED) else f"{prefix}{field.name}"
        if get_origin(field_type) is Annotated:
            field_type, *notes = get_args(field_type)
            for note in notes:
                if isinstance(note, Quantity):
                    yield FieldMeaning(key, note.unit, note.meaning)
        for part, place in answer_parts(field_type):
            prefix_of_part = f"{key}{place}.".removeprefix(".")  # the key of a merged field may be empty
            yield from field_meanings(part, prefix_of_part)


def answer_parts(hint: object) -> Iterator[tuple[type, str]]:
    """Yield each dataclass in a type annotation with its place: ``.NAME`` in a mapping, ``[]`` in a list.

    Example:
        The parts of ``dict[str, list[Part]]`` are ``Part`` at ``.NAME[]``.
    """
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
        for part, inner_place in answer_parts(argument):
            yield part, place + inner_place
