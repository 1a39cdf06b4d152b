"""A hint for a frequent mistake: a name in the wrong section of a study."""

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
    """The error with the section in which an unknown name is valid, if it is valid in another one.

    Args:
        error: Any error of a study's table.
        table: The study's table.
        fixed: The fixed tables by their place; the whole file's has an empty one.
        registries: The kinds of each slot.
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
    """Every place in which a study of these kinds may have the name, as the end of a sentence."""
    places = [f"in [{place}]" if place else TOP for place, model in fixed.items() if name in model.model_fields]
    for slot, registry in registries.items():
        part = table.get(slot)
        kind = part.get("kind") if isinstance(part, Mapping) else None
        entries = {kind: registry[kind]} if isinstance(kind, str) and kind in registry else {}
        for entry in entries.values():
            places += [f"in [{place}]" for place, field in places_in(entry, slot, part) if field == name]
    if not places:
        places = [
            f'in [{slot}] of kind "{kind}"'
            for slot, registry in registries.items()
            for kind, entry in registry.items()
            if has_field(params_of(entry), name)
        ]
    return list(dict.fromkeys(places))


def has_field(params: type, name: str) -> bool:
    """Whether a parameter type has a field of a name that a study writes; the values of a record come from a file."""
    spec = field_specs(params).get(name)
    return spec is not None and not (isinstance(spec.mark, Quantity) and spec.mark.data)


def params_of(entry: Entry) -> Any:
    """The parameter type of a registry row; options do not change it."""
    member = next(iter(entry.members.values()))
    return getattr(member, "params", member)


def places_in(entry: Entry, section: str, table: Any) -> Iterator[tuple[str, str]]:
    """Each section of a kind, and a field that it may have."""
    yield from fields_in(params_of(entry), section, table if isinstance(table, Mapping) else {})
    if entry.option:
        yield section, entry.option


def fields_in(params: type, section: str, table: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Each section of a parameter type, and a field that it may have."""
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
