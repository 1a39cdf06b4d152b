"""Hint for a frequent mistake: a name in the wrong section of a study."""

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry, Registry, Slot
from dssc_jax.study.fields import field_specs
from dssc_jax.study.table_errors import UNKNOWN_NAME

TOP = "at the top of the file, above the first [section]"
MOST_SECTIONS = 3


def with_section(
    error: ConfigError,
    table: Mapping[str, object],
    fixed: Mapping[str, type[BaseModel]],
    registries: Mapping[str, Registry],
) -> ConfigError:
    """Name the right section in the error of an unknown name, if the name is valid in another section.

    Args:
        error: Any error of a study's table.
        table: Table of the study.
        fixed: Fixed tables by their section; the section of the whole file is empty.
        registries: Kinds of each slot.

    Returns:
        The new error; any other error as it is.
    """
    section, _, name = error.where.rpartition(".")
    if not error.rule.startswith(UNKNOWN_NAME):
        return error
    header = f"[{section}]"
    places = [place for place in sections_of(name, table, fixed, registries) if place != header]
    if not places:
        return error
    return ConfigError(error.where, f"{UNKNOWN_NAME} here; '{name}' belongs {' or '.join(places[:MOST_SECTIONS])}")


def sections_of(
    name: str, table: Mapping[str, object], fixed: Mapping[str, type[BaseModel]], registries: Mapping[str, Registry]
) -> list[str]:
    """Sections in which a study with these kinds may have a name, in words; without any, those of other kinds."""
    places = [f"in [{place}]" if place else TOP for place, model in fixed.items() if name in model.model_fields]
    for slot, registry in registries.items():
        part = table.get(slot)
        kind = part.get("kind") if isinstance(part, Mapping) else None
        if isinstance(kind, str) and kind in registry:
            places += [f"in [{place}]" for place, field in places_in(registry[kind], slot, part) if field == name]
    if not places:
        for slot, registry in registries.items():
            for kind, entry in registry.items():
                if has_field(params_of(entry), name):
                    places.append(f'in [{slot}] of kind "{kind}"')
    return list(dict.fromkeys(places))


def has_field(params: type, name: str) -> bool:
    """Whether a parameter type has a field with a name that a study may state."""
    spec = field_specs(params).get(name)
    if spec is None:
        return False
    return not (isinstance(spec.mark, Quantity) and spec.mark.data)  # the values of a record come from its file


def params_of(entry: Entry) -> Any:
    """Parameter type of a registry row, which is the same for all values of its option."""
    member = next(iter(entry.members.values()))
    return getattr(member, "params", member)


def places_in(entry: Entry, section: str, table: Any) -> Iterator[tuple[str, str]]:
    """Pairs of a section and a field that it may have, for a part of this kind and all parts within it."""
    yield from fields_in(params_of(entry), section, table if isinstance(table, Mapping) else {})
    if entry.option:
        yield section, entry.option


def fields_in(params: type, section: str, table: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Pairs of a section and a field that it may have, for a parameter type and all parts within it."""
    for name, spec in field_specs(params).items():
        inner = table.get(name)
        inner = {"kind": inner} if isinstance(inner, str) else inner
        inner = inner if isinstance(inner, Mapping) else {}
        if isinstance(spec.mark, Slot):
            entry = spec.mark.registry.get(inner.get("kind", spec.mark.default) or "")
            if entry is not None:
                yield from places_in(entry, f"{section}.{name}", inner)
        elif spec.is_nested or spec.item_type is not None:
            yield from fields_in(spec.item_type or spec.hint, f"{section}.{name}", inner)
        elif not spec.is_derived:
            yield section, name
