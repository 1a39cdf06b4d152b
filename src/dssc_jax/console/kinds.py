"""Describe and print every kind of model and part with its fields, from the registries and the parameter types."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum
from typing import Any, NamedTuple, TypedDict, cast

from dssc_jax.closed_loop.metrics.streaming import Metric
from dssc_jax.console.terminal import show_paragraph, show_table
from dssc_jax.core.contracts import Preset
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry, Registry, Slot, single
from dssc_jax.core.units import POSITION, UNNAMED_UNITS
from dssc_jax.study.available_metrics import PACKAGE_METRICS
from dssc_jax.study.fields import FieldSpec, field_specs
from dssc_jax.study.importing import import_object
from dssc_jax.study.laws import LAWS
from dssc_jax.study.sections import params_of
from dssc_jax.study.slots import REGISTRIES

HEADS = {"trajectory": "reference, of a plant of several channels"}
"""Heads of the tables of a study that are not headed by their own name."""
REQUIRED = "required"
"""Stands in the place of a default value where a field has none."""

LIST_REMARKS = {0: "", 1: " (a list)", 2: " (a list of rows)"}
"""Remark on a field of numbers, by the number of lists around each number."""


class FieldRow(NamedTuple):
    """A field of a kind, as a row of the table of the kind's fields; an empty text is an empty cell.

    Args:
        field: Dotted name of the field.
        unit: Unit.
        meaning: Meaning.
        admissible: Admissible values.
        default: Default value.
    """

    field: str
    unit: str = ""
    meaning: str = ""
    admissible: str = ""
    default: str = ""


class KindDescription(TypedDict):
    """A kind of model or part.

    Args:
        summary: The kind in one line.
        fields: Names of the kind's fields.
        options: Possible values of each option.
        about: Unit, meaning, admissible values and default of each field, by the name of the field and of the column.
    """

    summary: str
    fields: list[str]
    options: dict[str, list[str]]
    about: dict[str, dict[str, str]]


class MetricDescription(TypedDict):
    """A metric: its unit, its meaning, and in ``of`` what it belongs to, such as a channel."""

    unit: str
    meaning: str
    of: str


def registries() -> dict[str, Registry]:
    """Return all registries, by the table of a study that chooses from each: models first, then parts of models."""
    by_table = dict(REGISTRIES)
    for slot, registry in REGISTRIES.items():
        for entry in registry.values():
            by_table |= part_registries(params_of(entry), slot)
    return by_table


def part_registries(params: type, table: str) -> dict[str, Registry]:
    """Return the registries of all slots in a parameter type, and in the parts that fill them, by dotted name.

    Args:
        params: The parameter type.
        table: Dotted name of the table of these parameters.
    """
    by_table = {}
    for name, spec in field_specs(params).items():
        if isinstance(spec.mark, Slot):
            by_table[f"{table}.{name}"] = spec.mark.registry
            for entry in spec.mark.registry.values():
                by_table |= part_registries(params_of(entry), f"{table}.{name}")
        elif spec.is_nested:
            by_table |= part_registries(spec.hint, f"{table}.{name}")
    return by_table


def kinds() -> dict[str, dict[str, KindDescription]]:
    """Describe every kind, by the table of a study that chooses it and by its name."""
    by_table: dict[str, dict[str, KindDescription]] = {}
    for slot, registry in registries().items():
        by_table[slot] = {kind: description_of(entry) for kind, entry in registry.items()}
    return by_table


def description_of(entry: Entry) -> KindDescription:
    """Describe the kind of a registry row."""
    return {
        "summary": entry.summary,
        "fields": [name for name, spec in field_specs(params_of(entry)).items() if not spec.is_derived],
        "options": options_of(entry),
        "about": columns_by_field(rows_of(entry)),
    }


def columns_by_field(rows: Iterable[FieldRow]) -> dict[str, dict[str, str]]:
    """Return the cells of each row, by the name of the field and of the column."""
    columns = {}
    for row in rows:
        cells = row._asdict()
        columns[cells.pop("field")] = cells
    return columns


def options_of(entry: Entry) -> dict[str, list[str]]:
    """Return the possible values of a registry row's option, by the option's name; empty without an option."""
    if entry.option is None:
        return {}
    return {entry.option: [key.value for key in entry.members]}


def rows_of(entry: Entry) -> list[FieldRow]:
    """Return a row for each field of a kind; nested fields have dotted names."""
    params = params_of(entry)
    preset = getattr(entry.default_member, "defaults", None)
    rows = [FieldRow(name, meaning=meaning) for name, meaning in entry.keys.items()]
    rows += parameter_rows(params, "", preset)
    for name, values in options_of(entry).items():
        admissible = " | ".join(map(str, values))
        rows.append(FieldRow(name, meaning="option", admissible=admissible, default=default_text(entry.default)))
    return rows


def parameter_rows(params: type, prefix: str, preset: "NamedTuple | None") -> Iterator[FieldRow]:
    """Yield a row for each field of a parameter type, and for each field nested in it.

    Args:
        params: The parameter type.
        prefix: Dotted name of the table of these parameters, with a final dot; empty for the outermost table.
        preset: Parameters whose values are the defaults; None: the defaults of the type.
    """
    defaults = getattr(params, "_field_defaults", {}) if preset is None else preset._asdict()
    for name, spec in field_specs(params).items():
        if not spec.is_derived:
            yield from field_rows(spec, f"{prefix}{name}", defaults.get(name, REQUIRED))


def field_rows(spec: FieldSpec, name: str, default: object) -> Iterator[FieldRow]:
    """Yield the rows of one field: several rows for a table or a list of tables, otherwise one.

    Args:
        spec: Specification of the field.
        name: Dotted name of the field.
        default: Default value; :data:`REQUIRED` if there is none.
    """
    if isinstance(spec.mark, Slot):
        meaning = f"which part; a number alone is '{spec.mark.number}'" if spec.mark.number else "which part"
        admissible = " | ".join(spec.mark.registry)
        yield FieldRow(f"{name}.kind", "", meaning, admissible, spec.mark.default or REQUIRED)
    elif spec.named_type is not None and isinstance(spec.mark, Quantity):
        yield value_row(spec, f"{name}.NAME", "absent")
    elif spec.named_type is not None:
        yield FieldRow(f"{name}.NAME", meaning="a table for each, by its name in the study", default="absent")
        yield from parameter_rows(spec.named_type, f"{name}.NAME.", None)
    elif spec.item_type is not None:
        presets = default if isinstance(default, tuple) else ()
        count = f"{len(presets)} tables" if presets else "none"
        yield FieldRow(name, meaning="a list of tables, each with the entries below", default=count)
        for index, preset in enumerate(presets or (None,)):  # without defaults, one table shows the entries
            yield from parameter_rows(spec.item_type, f"{name}.{index}.", preset)
    elif spec.is_nested:
        if default is None:
            yield FieldRow(name, meaning="a table; absent: none of it", default="absent")
        preset = None if default == REQUIRED else default
        yield from parameter_rows(spec.hint, f"{name}.", cast("NamedTuple | None", preset))
    else:
        yield value_row(spec, name, default_text(default))


def value_row(spec: FieldSpec, name: str, default: str) -> FieldRow:
    """Return the row of a field that is not a table.

    Args:
        spec: Specification of the field.
        name: Dotted name of the field.
        default: Text of the default value.
    """
    quantity = spec.mark
    if isinstance(quantity, Quantity):
        meaning = f"{quantity.meaning}{LIST_REMARKS[spec.depth]}"
        return FieldRow(name, quantity.unit, meaning, limits_text(quantity), default)
    if spec.is_text:
        return FieldRow(name, meaning="text", default=default)
    admissible = "true | false"
    if isinstance(spec.hint, type) and issubclass(spec.hint, Enum):
        admissible = " | ".join(member.value for member in spec.hint)
    return FieldRow(name, meaning="option", admissible=admissible, default=default)


def limits_text(quantity: Quantity) -> str:
    """List the bounds of a quantity's values, and whether a value may have a law; empty if everything is admissible.

    If another number of the same part is the bound, its name is given.
    """
    limits = []
    bounds = {">": quantity.above, ">=": quantity.at_least, "<": quantity.below, "<=": quantity.at_most}
    for sign, bound in bounds.items():
        if bound is not None:
            limits.append(f"{sign} {bound:g}")
    if quantity.less_than is not None:
        limits.append(f"< {quantity.less_than}")
    if not quantity.law:
        limits.append("no law")
    return ", ".join(limits)


def default_text(default: object) -> str:
    """Format a default value as it would stand in a study file; "absent" for None and an empty text."""
    if isinstance(default, Enum):
        return str(default.value)
    if isinstance(default, tuple):
        return f"[{', '.join(map(default_text, default))}]"
    if isinstance(default, bool):
        return str(default).lower()
    if default in (None, ""):
        return "absent"
    if isinstance(default, int | float):
        return f"{default:g}"
    return str(default)


def entry_of(model: Any, name: str) -> Entry:
    """Return the registry row of an object that a user imports.

    Args:
        model: The object: a registry row, a model, a type of parameters, or a preset of parameters.
        name: Name of the object, for messages.

    Raises:
        ConfigError: The object is of another type.
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
    """Return the registry rows of all kinds with a name, by table; empty if only a law, metric or field has it.

    Args:
        name: The name; or ``module:OBJECT``, a user's own model, which is imported.

    Raises:
        ConfigError: No kind, law, metric or field has the name.
    """
    if ":" in name:
        return {"your own": entry_of(import_object(name, name), name)}
    by_table = registries()
    entries = {slot: registry[name] for slot, registry in by_table.items() if name in registry}
    if not entries and name not in LAWS and name not in PACKAGE_METRICS and not fields_named(name):
        raise ConfigError(name, f"is no kind and no field; {nearest(name, all_names(by_table))}")
    return entries


def all_names(by_table: Mapping[str, Registry]) -> set[str]:
    """Collect the names of all kinds, laws, metrics, and fields that are not nested.

    Args:
        by_table: All registries, see :func:`registries`.
    """
    names = {*LAWS, *PACKAGE_METRICS}
    for registry in by_table.values():
        names.update(registry)
        for entry in registry.values():
            for row in rows_of(entry):
                if "." not in row.field:
                    names.add(row.field)
    return names


def fields_named(name: str) -> dict[tuple[str, str], list[FieldRow]]:
    """Return the rows of all fields with a name, and of the fields nested in them, by table and kind."""
    rows_by_kind: dict[tuple[str, str], list[FieldRow]] = {}
    for slot, registry in registries().items():
        for kind, entry in registry.items():
            rows = [row for row in rows_of(entry) if row.field == name or row.field.startswith(f"{name}.")]
            if rows:
                rows_by_kind[slot, kind] = rows
    return rows_by_kind


def described_name(name: str) -> dict[str, Any]:
    """Describe for JSON everything with a name: kinds, fields, a law, a metric.

    Args:
        name: The name, as for :func:`entries_named`.

    Raises:
        ConfigError: No kind, law, metric or field has the name.
    """
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
        description["law"] = {"arguments": LAWS[name].signature, "rule": LAWS[name].rule.text}
    if name in PACKAGE_METRICS:
        description["metric"] = metric_description(PACKAGE_METRICS[name])
    return description


def metric_description(metric: Metric) -> MetricDescription:
    """Describe a metric."""
    return {"unit": metric.unit, "meaning": metric.meaning, "of": metric.scope.value}


def show_kind(name: str) -> None:
    """Print everything with a name: a law, a metric, kinds with their fields, and kinds with a field of that name.

    Args:
        name: The name, as for :func:`entries_named`.

    Raises:
        ConfigError: No kind, law, metric or field has the name.
    """
    entries = entries_named(name)
    if name in LAWS:
        law = LAWS[name]
        show_paragraph(f"law {name} = {law.signature}: {law.rule.text}")
    if name in PACKAGE_METRICS:
        metric = PACKAGE_METRICS[name]
        show_paragraph(f"metric {name} [{metric.unit}]: {metric.meaning}, of each {metric.scope.value}")
    for slot, entry in entries.items():
        show_rows(f'[{HEADS.get(slot, slot)}] kind = "{name}": {entry.summary}', rows_of(entry))
    for (slot, kind), rows in fields_named(name).items():
        show_rows(f'[{HEADS.get(slot, slot)}] kind = "{kind}"', rows)


def show_rows(title: str, rows: Sequence[FieldRow]) -> None:
    """Print rows of fields under a title; a remark follows if a unit depends on the plant."""
    show_paragraph(title)
    show_table(FieldRow._fields, rows)
    if any(depends_on_plant(row.unit) for row in rows):
        show_paragraph("y and u are the units of the plant's output and of its command")


def depends_on_plant(unit: str) -> bool:
    """Whether a unit contains y or u, the units of a plant's output and command, and so differs between plants."""
    return UNNAMED_UNITS.of(unit) != POSITION.of(unit)
