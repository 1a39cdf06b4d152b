"""Every kind of model and part with its fields, from the registries and the parameter types."""

from collections.abc import Iterable, Iterator, Sequence
from enum import Enum
from typing import Any, NamedTuple, TypeAlias, TypedDict

from dssc_jax.closed_loop.metrics import Metric
from dssc_jax.console.terminal import output, show_table
from dssc_jax.core.contracts import Preset
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry, Registry, Slot, single
from dssc_jax.core.units import POSITION, UNNAMED_UNITS
from dssc_jax.study.build import REGISTRIES
from dssc_jax.study.fields import FieldSpec, field_specs
from dssc_jax.study.importing import import_object
from dssc_jax.study.laws import LAWS
from dssc_jax.study.measuring import PACKAGE_METRICS
from dssc_jax.study.sections import params_of

FieldRow: TypeAlias = tuple[str, str, str, str, str]
"""A field of a kind, with the columns :data:`KIND_COLUMNS`."""

TRAJECTORY = "trajectory"
HEADS = {TRAJECTORY: "reference, of a plant of several channels"}
REQUIRED = "required"
KIND_COLUMNS = ("field", "unit", "meaning", "admissible", "default")


class KindDescription(TypedDict):
    """A kind's summary, field names, option values by name, and the description of each field by column."""

    summary: str
    fields: list[str]
    options: dict[str, list[str]]
    about: dict[str, dict[str, str]]


class MetricDescription(TypedDict):
    """Unit and meaning of a metric, and of what it is measured."""

    unit: str
    meaning: str
    of: str


def registries() -> dict[str, Registry]:
    """Every registry by the table of its kinds; registries of models first, then those of their parts."""
    by_table = dict(REGISTRIES)
    for slot, registry in REGISTRIES.items():
        for entry in registry.values():
            by_table |= parts(params_of(entry), slot)
    return by_table


def parts(params: type, place: str) -> dict[str, Registry]:
    """Registries of the slots in a parameter type."""
    by_slot = {}
    for name, spec in field_specs(params).items():
        if isinstance(spec.mark, Slot):
            by_slot[f"{place}.{name}"] = spec.mark.registry
            for entry in spec.mark.registry.values():
                by_slot |= parts(params_of(entry), f"{place}.{name}")
        elif spec.is_nested:
            by_slot |= parts(spec.hint, f"{place}.{name}")
    return by_slot


def kinds() -> dict[str, dict[str, KindDescription]]:
    """Summary, fields and options of every kind, by table."""
    by_table: dict[str, dict[str, KindDescription]] = {}
    for slot, registry in registries().items():
        by_table[slot] = {kind: description_of(entry) for kind, entry in registry.items()}
    return by_table


def description_of(entry: Entry) -> KindDescription:
    """The description of a kind."""
    return {
        "summary": entry.summary,
        "fields": [name for name, spec in field_specs(params_of(entry)).items() if not spec.is_derived],
        "options": options_of(entry),
        "about": columns_by_field(rows_of(entry)),
    }


def columns_by_field(rows: Iterable[FieldRow]) -> dict[str, dict[str, str]]:
    """Unit, meaning, admissible values and default of each field."""
    columns = {}
    for name, *values in rows:
        columns[name] = dict(zip(KIND_COLUMNS[1:], values, strict=True))
    return columns


def options_of(entry: Entry) -> dict[str, list[str]]:
    """The possible values of an entry's options, by name."""
    return {entry.option: [key.value for key in entry.members]} if entry.option else {}


def rows_of(entry: Entry) -> list[FieldRow]:
    """Every field of a kind; nested fields have dotted names."""
    params = params_of(entry)
    preset = getattr(entry.default_member, "defaults", None)
    rows: list[FieldRow] = [(name, "", meaning, "", "") for name, meaning in entry.keys.items()]
    rows += fields(params, "", preset)
    for name, values in options_of(entry).items():
        rows.append((name, "", "option", " | ".join(map(str, values)), text_of(entry.default)))
    return rows


def fields(params: type, prefix: str, preset: "NamedTuple | None") -> Iterator[FieldRow]:
    """Rows of a parameter type; ``preset`` is an instance whose values are the defaults."""
    defaults = getattr(params, "_field_defaults", {}) if preset is None else preset._asdict()
    for name, spec in field_specs(params).items():
        if spec.is_derived:
            continue
        default = defaults.get(name, REQUIRED)
        if isinstance(spec.mark, Slot):
            meaning = f"which part; a number alone is '{spec.mark.number}'" if spec.mark.number else "which part"
            yield f"{prefix}{name}.kind", "", meaning, " | ".join(spec.mark.registry), spec.mark.default or REQUIRED
        elif spec.named_type is not None:
            if isinstance(spec.mark, Quantity):
                yield f"{prefix}{name}.NAME", *field_columns(spec), "absent"
            else:
                yield f"{prefix}{name}.NAME", "", "a table for each, by its name in the study", "", "absent"
                yield from fields(spec.named_type, f"{prefix}{name}.NAME.", None)
        elif spec.item_type is not None:
            members = default if isinstance(default, tuple) and default else (None,)
            count = "none" if members == (None,) else f"{len(members)} tables"
            yield f"{prefix}{name}", "", "a list of tables, each with the entries below", "", count
            for index, member in enumerate(members):
                yield from fields(spec.item_type, f"{prefix}{name}.{index}.", member)
        elif spec.is_nested:
            inner = None if default in (None, REQUIRED) else default
            if default is None:
                yield f"{prefix}{name}", "", "a table; absent: none of it", "", "absent"
            yield from fields(spec.hint, f"{prefix}{name}.", inner)
        else:
            yield f"{prefix}{name}", *field_columns(spec), text_of(default)


def field_columns(spec: FieldSpec) -> tuple[str, str, str]:
    """Unit, meaning and admissible values of a field."""
    if isinstance(spec.mark, Quantity):
        meaning = spec.mark.meaning + ("", " (a list)", " (a list of rows)")[spec.depth]
        limits = [
            *([f"> {spec.mark.above:g}"] if spec.mark.above is not None else []),
            *([f">= {spec.mark.at_least:g}"] if spec.mark.at_least is not None else []),
            *([f"< {spec.mark.below:g}"] if spec.mark.below is not None else []),
            *([f"<= {spec.mark.at_most:g}"] if spec.mark.at_most is not None else []),
            *([] if spec.mark.law else ["no law"]),
        ]
        return spec.mark.unit, meaning, ", ".join(limits)
    if spec.is_text:
        return "", "text", ""
    if isinstance(spec.hint, type) and issubclass(spec.hint, Enum):
        return "", "option", " | ".join(member.value for member in spec.hint)
    return "", "option", "true | false"


def text_of(default: object) -> str:
    """A default value as text."""
    if isinstance(default, Enum):
        return str(default.value)
    if isinstance(default, tuple):
        return f"[{', '.join(map(text_of, default))}]"
    if isinstance(default, bool):
        return str(default).lower()
    if default in (None, ""):
        return "absent"
    if isinstance(default, int | float):
        return f"{default:g}"
    return str(default)


def entry_of(model: Any, name: str) -> Entry:
    """A registry row of a user's own model, preset of parameters, or family of models.

    Raises:
        ConfigError: the object is none of these.
    """
    if isinstance(model, Entry):
        return model
    if hasattr(model, "params") and hasattr(model.params, "_fields"):
        return single(model, f"a {type(model).__name__.lower()} of your own")
    if hasattr(model, "_fields"):
        preset = Preset(model, None) if isinstance(model, type) else Preset(type(model), model)
        return single(preset, "parameters of your own")
    raise ConfigError(name, f"must be a model or its parameters, got {type(model).__name__}")


def entries_named(name: str) -> dict[str, Entry]:
    """The kinds of a name by table, or a user's own model.

    Args:
        name: Its name, or that of a user's own model, ``module:OBJECT``, which is imported.

    Raises:
        ConfigError: there is none, and neither a law, a metric nor a field.
    """
    if ":" in name:
        return {"your own": entry_of(import_object(name, name), name)}
    by_table = registries()
    entries = {slot: registry[name] for slot, registry in by_table.items() if name in registry}
    if not entries and name not in LAWS and name not in PACKAGE_METRICS and not fields_named(name):
        valid = {kind for registry in by_table.values() for kind in registry} | LAWS.keys() | PACKAGE_METRICS.keys()
        for registry in by_table.values():
            for entry in registry.values():
                valid |= {row[0] for row in rows_of(entry) if "." not in row[0]}
        raise ConfigError(name, f"is no kind and no field; {nearest(name, valid)}")
    return entries


def fields_named(name: str) -> dict[tuple[str, str], list[FieldRow]]:
    """The rows of a field, or of a table within one, of every kind that has it, by table and kind."""
    rows_by_kind: dict[tuple[str, str], list[FieldRow]] = {}
    for slot, registry in registries().items():
        for kind, entry in registry.items():
            rows = [row for row in rows_of(entry) if row[0] == name or row[0].startswith(f"{name}.")]
            if rows:
                rows_by_kind[slot, kind] = rows
    return rows_by_kind


def described_name(name: str) -> dict[str, Any]:
    """What :func:`show_kind` prints of a name, for JSON; arguments and errors as of :func:`entries_named`."""
    description: dict[str, Any] = {}
    kinds_by_table = {slot: description_of(entry) for slot, entry in entries_named(name).items()}
    if kinds_by_table:
        description["kinds"] = kinds_by_table
    fields_by_kind: dict[str, dict[str, dict[str, dict[str, str]]]] = {}
    for (slot, kind), rows in fields_named(name).items():
        fields_by_kind.setdefault(slot, {})[kind] = columns_by_field(rows)
    if fields_by_kind:
        description["fields"] = fields_by_kind
    if name in LAWS:
        description["law"] = {"arguments": LAWS[name].signature, "rule": LAWS[name].rule[0]}
    if name in PACKAGE_METRICS:
        description["metric"] = metric_description(PACKAGE_METRICS[name])
    return description


def metric_description(metric: Metric) -> MetricDescription:
    """Unit and meaning of a metric, and of what it is measured."""
    return {"unit": metric.unit, "meaning": metric.meaning, "of": metric.scope.value}


def show_kind(name: str) -> None:
    """Print all that has this name: kinds with their fields, a law, a metric, and the kinds that have such a field.

    Arguments and errors are those of :func:`entries_named`.
    """
    entries = entries_named(name)
    if name in LAWS:
        law = LAWS[name]
        output().print(f"law {name} = {law.signature}: {law.rule[0]}", markup=False)
    if name in PACKAGE_METRICS:
        metric = PACKAGE_METRICS[name]
        output().print(f"metric {name} [{metric.unit}]: {metric.meaning}, of each {metric.scope.value}", markup=False)
    for slot, entry in entries.items():
        show_rows(f'[{HEADS.get(slot, slot)}] kind = "{name}": {entry.summary}', rows_of(entry))
    for (slot, kind), rows in fields_named(name).items():
        show_rows(f'[{HEADS.get(slot, slot)}] kind = "{kind}"', rows)


def show_rows(title: str, rows: Sequence[FieldRow]) -> None:
    """Print fields under a title."""
    output().print(title, markup=False)
    show_table(KIND_COLUMNS, rows)
    if any(UNNAMED_UNITS.of(row[1]) != POSITION.of(row[1]) for row in rows):
        output().print("y and u are the units of the plant's output and of its command", markup=False)
