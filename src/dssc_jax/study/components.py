"""Parsing of a study's tables into models and their parameters.

The parameter type of a model is the schema of its table. The annotation of a field gives the unit and the admissible
interval of a number, or the slot of a part. The default of a field is the value of an absent entry.
"""

import inspect
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from pydantic import ValidationError

from dssc_jax.core.chains import Element
from dssc_jax.core.contracts import Plant, Preset
from dssc_jax.core.default_functions import unchanged_params
from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.core.named import Text, require_signal_name
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry, Registry, Slot, single
from dssc_jax.core.toml import TomlTable
from dssc_jax.study.fields import FieldSpec, field_specs, in_order, is_record, table_model
from dssc_jax.study.importing import import_object
from dssc_jax.study.laws import is_law, is_number
from dssc_jax.study.numbers import Number, leaves_of, numbers_of_field, parse_number
from dssc_jax.study.parameters import Expression
from dssc_jax.study.table_errors import first_error, value_errors_at
from dssc_jax.study.tables import merge_tables, with_default
from dssc_jax.study.variation_checks import require_variation


@dataclass(frozen=True)
class Component:
    """A part of the loop, parsed.

    Args:
        kind: Kind of the model in the study.
        model: The model.
        params: Parameters of the model; the leaves are numbers, laws and expressions.
        numbers: Record of each number in the parameters.
        elements: Elements of a chain of actuators; empty for any other part.
    """

    kind: str
    model: Any
    params: Any
    numbers: tuple[Number, ...]
    elements: tuple[Element, ...] = ()

    def under(self, path: str, name: str) -> "Component":
        """Make the component a part of a whole: ``path`` precedes the paths of its numbers in the whole's parameters.

        ``name`` precedes the dotted names of its numbers in the study.
        """
        return replace(self, numbers=tuple(number.under(path, name) for number in self.numbers))


def lookup(kind: object, registry: Registry) -> Entry:
    """Find the registry row of a kind; for a user's model ``package.module:object``, make a row with this model.

    Args:
        kind: Value of ``kind`` in a table.
        registry: Kinds of the package.

    Raises:
        ConfigError: The kind is unknown, the user's object cannot be imported, or the object is no model of this slot.
    """
    if not isinstance(kind, str):
        raise ConfigError("kind", f"must be a name, got {kind!r}")
    if kind in registry:
        return registry[kind]
    if ":" not in kind:
        raise ConfigError("kind", f"unknown kind '{kind}'; {nearest(kind, registry)}")
    model = import_object(kind, "kind")
    is_set_of_parameters = is_record(model) and not isinstance(model, type) and not hasattr(model, "params")
    if is_set_of_parameters:  # such as a user's vehicle: its table overrides single fields
        model = Preset(type(model), model)
    if isinstance(model, Entry):
        return model
    require_contract(kind, model, contract_of(registry))
    if isinstance(model, Plant):
        require_measure(kind, model)
    return single(model, "a user's own")


def contract_of(registry: Registry) -> type:
    """Common type of the models in a registry, such as ``Plant``; ``type`` if the models are NamedTuple types."""
    first_row = next(iter(registry.values()))
    first_model = next(iter(first_row.members.values()))
    return type(first_model)


def require_contract(kind: str, model: object, contract: type) -> None:
    """Require that a user's model has the type of the package's models in its slot.

    Args:
        kind: The model's ``package.module:object``, for messages.
        model: The model.
        contract: Type of the models in the slot, from :func:`contract_of`.

    Raises:
        ConfigError: The model has another type.
    """
    if contract is type:
        expected = "a NamedTuple type"
        is_of_contract = isinstance(model, type) and is_record(model)
    else:
        expected = f"a {contract.__name__}"
        is_of_contract = isinstance(model, contract)
    if not is_of_contract:
        raise ConfigError("kind", f"'{kind}' must be {expected}, got {type(model).__name__}")


def require_measure(kind: str, plant: Plant) -> None:
    """Require that the function ``measure`` of a user's plant takes three arguments: parameters, state and input.

    Raises:
        ConfigError: The function takes another number of arguments.
    """
    params = state = drive = None  # only the number of arguments matters
    try:
        inspect.signature(plant.measure).bind(params, state, drive)
    except TypeError:
        rule = f"'{kind}': measure must take three arguments, (params, state, input); see docs/extending.md"
        raise ConfigError("kind", rule) from None


def member_of(entry: Entry, table: TomlTable) -> Any:
    """Select the model of a registry row for a table: from the table's file, the row's only model, or by its option.

    Raises:
        ConfigError: The option does not have the stated value, or the file is not valid.
    """
    if entry.loaded is not None:
        return entry.loaded(table)
    if entry.option is None:
        return entry.members[None]  # the only member of a row without an option
    default = entry.default if entry.default_of is None else entry.default_of(table)
    choice = table.get(entry.option, default)
    for key, member in entry.members.items():
        if choice == key and not isinstance(choice, bool):  # true equals the option 1
            return member
    valid = [key.value for key in entry.members]
    valid_text = ", ".join(map(str, valid))
    hint = nearest(choice, valid) if isinstance(choice, str) else f"valid are {valid_text}"
    raise ConfigError(entry.option, f"must be one of {valid_text}, got {choice!r}; {hint}")


def as_table(value: object, path: str = "") -> TomlTable:
    """A copy of a table of a study, after a check that the value is a table.

    Args:
        value: Value of an entry of the study.
        path: Dotted path of the entry, for messages.

    Raises:
        ConfigError: The value is no table.
    """
    if not isinstance(value, dict):
        raise ConfigError(path, f"must be a table, got {value!r}")
    return dict(value)


def parse_component(value: object, registry: Registry, path: str = "", default: str | None = None) -> Component:
    """Parse a table into a model with its parameters.

    Args:
        value: Table of the part.
        registry: Admissible kinds.
        path: Dotted path of the table, for messages.
        default: Kind of a table that states none; None: the table must state a kind.

    Raises:
        ConfigError: The table is not valid; the message has the path, the rule and the value of the first error.
    """
    with errors_under(path):
        table = as_table(value)
        kind = table.get("kind", default)
        if kind is None:
            raise ConfigError("kind", f"is required and missing; valid names are {', '.join(sorted(registry))}")
        entry = lookup(kind, registry)
        table = merge_tables(entry.base, table)
        model = member_of(entry, table)
        choices = ["kind", *entry.keys]  # entries that select the model, beside the fields of its parameters
        if entry.option is not None:
            choices.append(entry.option)
        fields = {name: item for name, item in table.items() if name not in choices}
        params_type = getattr(model, "params", model)  # the model of a slot for parameters is their type itself
        params, numbers = parse_params(fields, params_type, getattr(model, "defaults", None), tuple(choices))
        prepare = getattr(model, "prepare", unchanged_params)
        prepared_params = prepare(params)
        if kind not in registry:  # a user's model
            require_variation(kind, model, prepared_params)
        return Component(kind, model, prepared_params, numbers)


def parse_params(
    table: TomlTable, params: Any, preset: Any = None, choices: tuple[str, ...] = ()
) -> tuple[Any, tuple[Number, ...]]:
    """Parse a table into an instance of a parameter type and the records of its numbers, in the order of the fields.

    Args:
        table: Table of the parameters.
        params: Parameter type.
        preset: Instance with the values that the table does not state; None for the defaults of the type.
        choices: Valid names besides the fields, for messages.

    Raises:
        ConfigError: The table is not valid; the message has the path within the table, the rule and the value.
    """
    specs = field_specs(params)
    defaults = getattr(params, "_field_defaults", {}) if preset is None else preset._asdict()
    fields = {name: defaults[name] for name, spec in specs.items() if spec.is_derived}
    numbers_by_field: dict[str, tuple[Number, ...]] = {}
    for name, spec in specs.items():
        if spec.is_part:
            with errors_under(name):
                fields[name], numbers_of_part = parse_part(name, spec, table, defaults)
            numbers_by_field[name] = tuple(number.under(name, name) for number in numbers_of_part)
    plain_table = {name: item for name, item in table.items() if name not in numbers_by_field}
    for name, value in parse_plain(plain_table, params, defaults, choices).items():
        fields[name] = leaves_of(value)
        mark = specs[name].mark
        if isinstance(mark, Quantity) and value is not None and not mark.data:
            numbers_by_field[name] = numbers_of_field(name, mark, value)
    numbers: list[Number] = []
    for name in specs:
        numbers += numbers_by_field.get(name, ())
    return in_order(params(**fields)), tuple(numbers)


def parse_part(name: str, spec: FieldSpec, table: TomlTable, defaults: TomlTable) -> tuple[Any, tuple[Number, ...]]:
    """Parse the part in a field of a table: a list of tables, a table by names, a fixed table, or a part with a kind.

    Args:
        name: Name of the field.
        spec: Form of the field.
        table: Table that may have the field.
        defaults: Default value of each field.

    Returns:
        Parameters of the part, and the records of its numbers. The parameters are None for an optional part that
        neither the table nor the defaults state.

    Raises:
        ConfigError: As in :func:`parse_params`, with the path within the part.
    """
    slot = spec.mark if isinstance(spec.mark, Slot) else None
    preset = defaults.get(name)
    value = table.get(name, {})
    if spec.item_type is not None:
        return parse_list(spec.item_type, table.get(name), preset or ())
    if slot is not None and isinstance(value, str):  # a kind without a table
        value = {"kind": value}
    has_default_kind = slot is not None and slot.default is not None
    if name not in table and not has_default_kind:
        if name not in defaults:
            raise ConfigError("", "is required and missing")
        if preset is None:
            return None, ()  # an optional part that is absent, without numbers
    if spec.named_type is not None:
        return parse_named(spec, as_table(value))
    if slot is None:
        return parse_params(as_table(value), spec.hint, preset)
    if slot.number is not None and (is_number(value) or is_law(value) or isinstance(value, Expression)):
        return parse_bare_number(value, slot.number, slot.registry)
    component = parse_component(value, slot.registry, default=slot.default)
    return component.params, component.numbers


def parse_bare_number(value: object, kind: str, registry: Registry) -> tuple[Any, tuple[Number, ...]]:
    """Parse a number, law or expression in place of a part's table, as the first field of a part of this kind.

    Returns:
        Parameters of the part, and the records of its numbers. The stated number has an empty name within the part. So
        its name in the study is the dotted name of the slot.

    Raises:
        ConfigError: As in :func:`parse_params`.
    """
    first_field = next(iter(field_specs(registry[kind].members[None])))
    component = parse_component({"kind": kind, first_field: value}, registry)
    numbers = []
    for number in component.numbers:
        numbers.append(replace(number, name="") if number.name == first_field else number)
    return component.params, tuple(numbers)


def parse_list(item: Any, value: object, preset: tuple[Any, ...]) -> tuple[tuple[Any, ...], tuple[Number, ...]]:
    """Parse a list of tables, or a table that changes some items of a preset list by their indices.

    Args:
        item: Parameter type of the items.
        value: List of tables, table of changes, or None for the unchanged preset list.
        preset: Items of the preset list.

    Returns:
        The items, and the records of their numbers.

    Raises:
        ConfigError: As in :func:`parse_params`, with the index of the item.
    """
    presets: tuple[Any, ...] = preset
    if isinstance(value, list | tuple):
        tables = [as_table(table, str(index)) for index, table in enumerate(value)]
        presets = (None,) * len(tables)  # a stated list inherits no values
    elif value is None:
        tables = [{} for _ in preset]
    else:
        tables = changes_of_items(as_table(value), len(preset))
    items = []
    numbers: list[Number] = []
    for index, (table, preset_item) in enumerate(zip(tables, presets, strict=True)):
        with errors_under(str(index)):
            part, numbers_of_item = parse_params(table, item, preset_item)
        items.append(part)
        numbers += [number.under(str(index), str(index)) for number in numbers_of_item]
    return tuple(items), tuple(numbers)


def changes_of_items(table: TomlTable, count: int) -> list[TomlTable]:
    """Split a table of changes into one table for each item of a preset list; the table is empty if the item stays.

    Args:
        table: Table of changes, such as ``{"1": {...}}``.
        count: Number of items.

    Raises:
        ConfigError: A key is no index of an item.
    """
    valid_indices = [str(index) for index in range(count)]
    for key in table:
        if key not in valid_indices:
            hint = f"valid are 0 to {count - 1}" if count else "there is none; write a list of tables"
            raise ConfigError(key, f"is no index of an item; {hint}")
    return [as_table(table.get(index, {}), index) for index in valid_indices]


def parse_named(spec: FieldSpec, table: TomlTable) -> tuple[dict[str, Any], tuple[Number, ...]]:
    """Parse a table by names that the study chooses; its items are numbers, or parameters of one type.

    Returns:
        The items by name, and the records of their numbers.

    Raises:
        ConfigError: As in :func:`parse_params`; or a key cannot be the name of a signal.
    """
    items: dict[str, Any] = {}
    numbers: list[Number] = []
    for name, value in table.items():
        with errors_under(name):
            require_signal_name(name)
            if isinstance(spec.mark, Quantity):
                with value_errors_at(""):
                    content = parse_number(value, spec.mark)
                items[name] = leaves_of(content)
                numbers.append(Number.of(name, spec.mark, content, name))
            else:
                items[name], numbers_of_item = parse_params(as_table(value), spec.named_type)
                numbers += [number.under(name, name) for number in numbers_of_item]
    return items, tuple(numbers)


def parse_plain(table: TomlTable, params: Any, defaults: TomlTable, choices: tuple[str, ...]) -> TomlTable:
    """Parse the plain fields of a parameter type: numbers, lists of numbers, texts and options.

    Args:
        table: Table of the parameters, without the tables of parts.
        params: Parameter type.
        defaults: Default value of each field.
        choices: Valid names besides the fields, for messages.

    Returns:
        Value of each plain field by name.

    Raises:
        ConfigError: As in :func:`parse_params`; a name that is no plain field is reported as unknown.
    """
    specs = field_specs(params)
    model = table_model(params)
    values = {}
    for name in model.model_fields:
        if name in defaults:
            default = defaults[name]
            values[name] = default.value if isinstance(default, Enum) else default
    for name, value in table.items():
        with errors_under(name):
            values[name] = with_default(value, values.get(name))
    try:
        validated = model.model_validate(values)
    except ValidationError as error:
        derived_names = [name for name in specs if specs[name].is_derived]
        raise first_error(error, [*specs, *choices], derived_names) from None
    parsed_values = {}
    for name in model.model_fields:
        value = getattr(validated, name)
        converter = Text if specs[name].is_text else specs[name].enum  # None for numbers and flags
        parsed_values[name] = value if converter is None else converter(value)
    return parsed_values
