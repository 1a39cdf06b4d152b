"""Hint for a frequent mistake: a valid name in the wrong section of a study."""

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry, Slot
from dssc_jax.study.actuators import ActuatorTable
from dssc_jax.study.fields import field_specs
from dssc_jax.study.schema import (
    EnvelopeTable,
    LoopTable,
    MetricsTable,
    PlotTable,
    RequirementTable,
    SettledTable,
    StudyTable,
    TuneTable,
    UnitsTable,
)
from dssc_jax.study.slots import REGISTRIES
from dssc_jax.study.table_errors import UNKNOWN_NAME

FIXED_TABLES: dict[str, type[BaseModel]] = {
    "loop": LoopTable,
    "loop.settled": SettledTable,
    "units": UnitsTable,
    "actuator": ActuatorTable,
    "metrics": MetricsTable,
    "requirement": RequirementTable,
    "envelope": EnvelopeTable,
    "plot": PlotTable,
    "tune": TuneTable,
}
"""Tables whose fields do not depend on a kind, by the dotted name of the section."""

TOP = "at the top of the file, above the first [section]"
MOST_SECTIONS = 3
"""Largest number of sections that a message names."""


def with_section(error: ConfigError, table: Mapping[str, object]) -> ConfigError:
    """Add the right section to the error of an unknown name, if the name is valid in another section.

    Args:
        error: Any error of a study's table.
        table: Table of the study.

    Returns:
        The new error; the same error if it does not concern an unknown name, or if no section may have the name.
    """
    section, _, name = error.where.rpartition(".")
    if not error.rule.startswith(UNKNOWN_NAME):
        return error
    places = [place for place in sections_of(name, table) if place != f"in [{section}]"]
    if not places:
        return error
    return ConfigError(error.where, f"{UNKNOWN_NAME} here; '{name}' belongs {' or '.join(places[:MOST_SECTIONS])}")


def sections_of(name: str, table: Mapping[str, object]) -> list[str]:
    """Sections in which a study may state a name, in words, each once.

    The result has the sections of the study's present kinds; if none of these has the name, those of all other kinds.

    Args:
        name: The name.
        table: Table of the study.
    """
    sections = [section for section, model in FIXED_TABLES.items() if name in model.model_fields]
    for slot, registry in REGISTRIES.items():
        part = table.get(slot)
        if not isinstance(part, Mapping):
            continue
        kind = part.get("kind")
        if isinstance(kind, str) and kind in registry:
            sections += [section for section, field in places_in(registry[kind], slot, part) if field == name]
    places = [TOP] if name in StudyTable.model_fields else []
    places += [f"in [{section}]" for section in dict.fromkeys(sections)]
    return places or sections_of_other_kinds(name)


def sections_of_other_kinds(name: str) -> list[str]:
    """All sections and kinds of the package in which a study may state a name, in words."""
    places = []
    for slot, registry in REGISTRIES.items():
        for kind, entry in registry.items():
            if has_field(params_of(entry), name):
                places.append(f'in [{slot}] of kind "{kind}"')
    return places


def has_field(params: type, name: str) -> bool:
    """Whether a parameter type has a field of this name that a study may state.

    Fields with the values of a record do not count, since these come from a file.
    """
    spec = field_specs(params).get(name)
    if spec is None:
        return False
    is_of_record = isinstance(spec.mark, Quantity) and spec.mark.data
    return not is_of_record


def params_of(entry: Entry) -> Any:
    """Parameter type of a registry row; all models of the row have the same one."""
    member = next(iter(entry.members.values()))
    return getattr(member, "params", member)


def places_in(entry: Entry, section: str, table: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Yield pairs (section, name) for all names that a study may state, in a part and in the parts within it.

    Args:
        entry: Registry row of the part's kind.
        section: Dotted name of the part's section, such as ``controller``.
        table: Table of the part, which may state the kinds of the parts within it.
    """
    yield from fields_in(params_of(entry), section, table)
    if entry.option:
        yield section, entry.option


def fields_in(params: type, section: str, table: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Yield pairs (section, field) for all fields that a study may state, of a parameter type and of its parts.

    Args:
        params: Parameter type.
        section: Dotted name of the section with the fields of the type.
        table: Table of the section, which may state the kinds of the parts within it.
    """
    for name, spec in field_specs(params).items():
        inner_section = f"{section}.{name}"
        inner_table = table_of_part(table.get(name))
        if isinstance(spec.mark, Slot):
            kind = inner_table.get("kind", spec.mark.default)
            entry = spec.mark.registry.get(kind) if isinstance(kind, str) else None
            if entry is not None:
                yield from places_in(entry, inner_section, inner_table)
        elif spec.is_nested:
            yield from fields_in(spec.hint, inner_section, inner_table)
        elif spec.item_type is not None:
            yield from fields_in(spec.item_type, inner_section, inner_table)
        elif not spec.is_derived:
            yield section, name


def table_of_part(value: object) -> Mapping[str, object]:
    """Table of a part that a study states as a table, or by its kind alone; empty for any other value."""
    if isinstance(value, str):
        return {"kind": value}
    return value if isinstance(value, Mapping) else {}
