"""Parsing of a study file's tables into models and parameters.

The parameter types of the models are the schema: their annotations give each field's quantity or slot and its default.
"""

import inspect
import types
import typing
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, create_model

from dssc_jax.core.chains import Element
from dssc_jax.core.contracts import Plant, Preset
from dssc_jax.core.default_functions import unchanged_params
from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.core.named import Text, require_signal_name
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry, Registry, Slot, single
from dssc_jax.core.toml import TomlTable
from dssc_jax.study.importing import imported
from dssc_jax.study.laws import is_law, is_number
from dssc_jax.study.numbers import Number, flattened, leaves_of, parse_number, parse_numbers
from dssc_jax.study.parameters import Expression
from dssc_jax.study.table_errors import explain
from dssc_jax.study.tables import merged, with_default


@dataclass(frozen=True)
class Component:
    """A chosen model, its parameters with numbers and laws as leaves, a record of each, and a chain's elements."""

    kind: str
    model: Any
    params: Any
    numbers: tuple[Number, ...]
    elements: tuple[Element, ...] = ()


@dataclass(frozen=True)
class FieldSpec:
    """The content of one field of a parameter type."""

    mark: Quantity | Slot | None
    core: Any
    optional: bool

    @property
    def depth(self) -> int:
        """0 for a number, 1 for a list of numbers, 2 for a list of rows."""
        depth = 0
        core = self.core
        while typing.get_origin(core) is tuple:
            depth += 1
            core = typing.get_args(core)[0]
        return depth

    @property
    def nested(self) -> bool:
        """Whether the field is another parameter type of fixed kind."""
        return self.mark is None and hasattr(self.core, "_fields")

    @property
    def listed(self) -> Any:
        """The parameter type of the items of a list of tables; None if the field is none."""
        items = typing.get_args(self.core) if typing.get_origin(self.core) is tuple else ()
        return items[0] if self.mark is None and items and hasattr(items[0], "_fields") else None

    @property
    def named(self) -> Any:
        """The type of a table's items if the study names them; None otherwise."""
        return typing.get_args(self.core)[1] if typing.get_origin(self.core) is dict else None

    @property
    def text(self) -> bool:
        """Whether the field is a unit or a meaning, in words."""
        return self.core is Text

    @property
    def part(self) -> bool:
        """Whether the field is a separate table, of a kind chosen by the study or of a fixed kind."""
        return isinstance(self.mark, Slot) or self.nested or self.named is not None or self.listed is not None

    @property
    def enum(self) -> type[Enum] | None:
        """The choices of an option, if it is one."""
        return self.core if isinstance(self.core, type) and issubclass(self.core, Enum) else None

    @property
    def derived(self) -> bool:
        """Whether the model's ``prepare`` fills the field, which is then not allowed in tables."""
        return not (self.mark or self.part or self.text or self.enum or self.core is bool)


@cache
def field_specs(params: type) -> dict[str, FieldSpec]:
    """The fields of a parameter type."""
    specs = {}
    for name, hint in typing.get_type_hints(params, include_extras=True).items():
        marks = getattr(hint, "__metadata__", ())
        mark = next((m for m in marks if isinstance(m, Quantity | Slot)), None)
        core = typing.get_args(hint)[0] if marks else hint
        optional = False
        if typing.get_origin(core) in (typing.Union, types.UnionType):
            members = typing.get_args(core)
            optional = type(None) in members
            if mark is None or optional:
                inner = [m for m in members if m is not type(None)]
                core = inner[0] if len(inner) == 1 else core
        specs[name] = FieldSpec(mark, core, optional)
    return specs


def number_type(quantity: Quantity, depth: int, optional: bool) -> Any:
    """The pydantic type for one number (``depth`` 0), a list of numbers (1), or a list of rows (2)."""

    def check(value: object) -> Any:
        return None if value is None and optional else parse_numbers(value, quantity, depth)

    return Annotated[Any, BeforeValidator(check)]


@cache
def table_model(params: type) -> type[BaseModel]:
    """The pydantic model of a table's plain fields; slots and nested tables are parsed separately."""
    fields: dict[str, Any] = {}
    for name, spec in field_specs(params).items():
        if spec.part or spec.derived:
            continue
        kind = number_type(spec.mark, spec.depth, spec.optional) if isinstance(spec.mark, Quantity) else spec.core
        if spec.text:
            kind = str
        if spec.enum:
            kind = Literal[tuple(member.value for member in spec.enum)]  # type: ignore[valid-type]
        fields[name] = (kind, ...)
    return create_model(params.__name__, __config__=ConfigDict(extra="forbid", strict=True), **fields)


def lookup(kind: object, registry: Registry) -> Entry:
    """The registry row of a kind, or a row made for a user's model, which is named ``package.module:object``.

    Args:
        kind: The ``kind`` of a table.
        registry: The rows of the package's kinds.

    Raises:
        ConfigError: The kind is unknown, the user's object cannot be imported, or it is no model for this slot.
    """
    if not isinstance(kind, str):
        raise ConfigError("kind", f"must be a name, got {kind!r}")
    if kind in registry:
        return registry[kind]
    if ":" not in kind:
        raise ConfigError("kind", f"unknown kind '{kind}'; {nearest(kind, registry)}")
    model = imported(kind, "kind")
    if is_record(model) and not isinstance(model, type) and not hasattr(model, "params"):
        model = Preset(type(model), model)
    if isinstance(model, Entry):
        return model
    require_contract(kind, model, contract_of(registry))
    if isinstance(model, Plant):
        require_measure(kind, model)
    return single(model, "a user's own")


def is_record(model: object) -> bool:
    """Whether an object is a NamedTuple, or a type of NamedTuples."""
    return hasattr(model, "_fields")


def contract_of(registry: Registry) -> type:
    """The type that all models of a registry have; ``type`` if they are types of NamedTuples."""
    first_row = next(iter(registry.values()))
    first_model = next(iter(first_row.members.values()))
    return type(first_model)


def require_contract(kind: str, model: object, contract: type) -> None:
    """Require that a user's model has the type that its slot expects."""
    expected = f"a {contract.__name__}"
    is_of_contract = isinstance(model, contract)
    if contract is type:
        expected = "a NamedTuple type"
        is_of_contract = is_of_contract and is_record(model)
    if not is_of_contract:
        raise ConfigError("kind", f"'{kind}' must be {expected}, got {type(model).__name__}")


def require_measure(kind: str, plant: Plant) -> None:
    """Require that a plant measures with its input.

    Raises:
        ConfigError: ``measure`` does not take parameters, state and input.
    """
    try:
        inspect.signature(plant.measure).bind(None, None, None)
    except TypeError:
        rule = f"'{kind}': measure must take three arguments, (params, state, input); see docs/extending.md"
        raise ConfigError("kind", rule) from None


def member_of(entry: Entry, table: TomlTable) -> Any:
    """The member of an entry that the table's option selects, or the model of the file that the table names."""
    if entry.loaded is not None:
        return entry.loaded(table)
    if entry.option is None:
        return entry.members[None]
    default = entry.default if entry.default_of is None else entry.default_of(table)
    choice = table.get(entry.option, default)
    for key, member in entry.members.items():
        if choice == key and not isinstance(choice, bool):
            return member
    valid = [key.value for key in entry.members]
    hint = nearest(choice, valid) if isinstance(choice, str) else f"valid are {', '.join(map(str, valid))}"
    raise ConfigError(entry.option, f"must be one of {', '.join(map(str, valid))}, got {choice!r}; {hint}")


def as_table(value: object, path: str = "") -> TomlTable:
    """A copy of a table.

    Raises:
        ConfigError: it is something else.
    """
    if not isinstance(value, dict):
        raise ConfigError(path, f"must be a table, got {value!r}")
    return dict(value)


def parse_component(value: object, registry: Registry, path: str = "", default: str | None = None) -> Component:
    """Parse a table into a model with its parameters.

    Args:
        value: The table.
        registry: The admissible kinds.
        path: Path of the table, for messages.
        default: The kind if the table gives none.

    Raises:
        ConfigError: With the path, the rule and the value of the first error.
    """
    with errors_under(path):
        table = as_table(value)
        kind = table.get("kind", default)
        if kind is None:
            raise ConfigError("kind", f"is required and missing; valid names are {', '.join(sorted(registry))}")
        entry = lookup(kind, registry)
        table = merged(entry.base, table)
        model = member_of(entry, table)
        choices = ("kind", *entry.keys, *([entry.option] if entry.option else []))
        params, numbers = parse_params(
            {name: item for name, item in table.items() if name not in choices},
            getattr(model, "params", model),
            getattr(model, "defaults", None),
            choices,
        )
        return Component(kind, model, getattr(model, "prepare", unchanged_params)(params), numbers)


def parse_params(
    table: TomlTable, params: Any, preset: Any = None, choices: tuple[str, ...] = ()
) -> tuple[Any, tuple[Number, ...]]:
    """An instance of a parameter type from its table, and its numbers in the order of its fields.

    Args:
        table: The table.
        params: The parameter type.
        preset: An instance with the values that the table does not give.
        choices: Valid names in addition to the fields, for messages.

    Raises:
        ConfigError: With the path within the table, the rule and the value of the first error.
    """
    specs = field_specs(params)
    defaults = getattr(params, "_field_defaults", {}) if preset is None else preset._asdict()
    fields = {name: defaults[name] for name, spec in specs.items() if spec.derived}
    numbers: dict[str, tuple[Number, ...]] = {}
    for name, spec in specs.items():
        if spec.part:
            with errors_under(name):
                fields[name], numbers_of_part = parse_part(name, spec, table, defaults)
            numbers[name] = tuple(number.under(name, name) for number in numbers_of_part)
    plain_table = {name: item for name, item in table.items() if name not in numbers}
    for name, value in parse_plain(plain_table, params, defaults, choices).items():
        fields[name] = leaves_of(value)
        mark = specs[name].mark
        if isinstance(mark, Quantity) and value is not None and not mark.data:
            numbers[name] = tuple(Number.of(path, mark, item, path) for path, item in flattened(name, value).items())
    return params(**fields), tuple(number for name in specs for number in numbers.get(name, ()))


def parse_part(name: str, spec: FieldSpec, table: TomlTable, defaults: TomlTable) -> tuple[Any, tuple[Number, ...]]:
    """The parameters and numbers of the part in a field; None if neither table nor defaults give it.

    Raises:
        ConfigError: As in :func:`parse_params`, with the path within the part.
    """
    slot = spec.mark if isinstance(spec.mark, Slot) else None
    preset = defaults.get(name)
    value = table.get(name, {})
    if spec.listed is not None:
        return parse_list(spec.listed, table.get(name), preset or ())
    if slot is not None and isinstance(value, str):
        value = {"kind": value}
    if name not in table and (slot is None or slot.default is None):
        if name not in defaults:
            raise ConfigError("", "is required and missing")
        if preset is None:
            return None, ()
    if spec.named is not None:
        return parse_named(spec, as_table(value))
    if slot is None:
        return parse_params(as_table(value), spec.core, preset)
    if slot.number is None or not (is_number(value) or is_law(value) or isinstance(value, Expression)):
        component = parse_component(value, slot.registry, default=slot.default)
        return component.params, component.numbers
    first_field = next(iter(field_specs(slot.registry[slot.number].members[None])))
    component = parse_component({"kind": slot.number, first_field: value}, slot.registry)
    return component.params, tuple(
        replace(number, name="") if number.name == first_field else number for number in component.numbers
    )


def parse_list(item: Any, value: object, preset: tuple[Any, ...]) -> tuple[tuple[Any, ...], tuple[Number, ...]]:
    """The items of a list of tables, or those of a preset with the numbers that a table gives by index.

    Raises:
        ConfigError: As in :func:`parse_params`, with the index of the item.
    """
    if isinstance(value, list | tuple):
        tables = {index: as_table(table, str(index)) for index, table in enumerate(value)}
        presets: tuple[Any, ...] = (None,) * len(tables)
    else:
        tables_by_index = as_table({} if value is None else value)
        valid_indices = [str(index) for index in range(len(preset))]
        unknown = next((key for key in tables_by_index if key not in valid_indices), None)
        if unknown is not None:
            hint = f"valid are 0 to {len(preset) - 1}" if preset else "there is none; write a list of tables"
            raise ConfigError(unknown, f"is no index of an item; {hint}")
        tables = {index: as_table(tables_by_index.get(str(index), {}), str(index)) for index in range(len(preset))}
        presets = preset
    items = []
    numbers: list[Number] = []
    for index, table in tables.items():
        with errors_under(str(index)):
            part, numbers_of_item = parse_params(table, item, presets[index])
        items.append(part)
        numbers += [number.under(str(index), str(index)) for number in numbers_of_item]
    return tuple(items), tuple(numbers)


def parse_named(spec: FieldSpec, table: TomlTable) -> tuple[dict[str, Any], tuple[Number, ...]]:
    """The items of a table whose names are the study's: numbers, or parameters of one type.

    Raises:
        ConfigError: As in :func:`parse_params`; or an item's name is no name of a signal.
    """
    items: dict[str, Any] = {}
    numbers: list[Number] = []
    for name, value in table.items():
        with errors_under(name):
            require_signal_name(name)
            if isinstance(spec.mark, Quantity):
                try:
                    content = parse_number(value, spec.mark)
                except ValueError as error:
                    raise ConfigError("", str(error)) from None
                items[name] = leaves_of(content)
                numbers.append(Number.of(name, spec.mark, content, name))
            else:
                items[name], numbers_of_item = parse_params(as_table(value), spec.named)
                numbers += [number.under(name, name) for number in numbers_of_item]
    return items, tuple(numbers)


def parse_plain(table: TomlTable, params: Any, defaults: TomlTable, choices: tuple[str, ...]) -> TomlTable:
    """The fields of a parameter type that are numbers, lists of numbers, or choices.

    Raises:
        ConfigError: As in :func:`parse_params`; names that are not fields are unknown.
    """
    specs = field_specs(params)
    model = table_model(params)
    default_values = {name: defaults[name] for name in model.model_fields if name in defaults}
    values = {name: value.value if isinstance(value, Enum) else value for name, value in default_values.items()}
    for name, value in table.items():
        with errors_under(name):
            values[name] = with_default(value, values.get(name))
    try:
        validated = model.model_validate(values)
    except ValidationError as error:
        raise explain(error, [*specs, *choices], [name for name in specs if specs[name].derived]) from None
    parsed_values = {name: getattr(validated, name) for name in model.model_fields}
    for name, value in parsed_values.items():
        enum = Text if specs[name].text else specs[name].enum
        parsed_values[name] = value if enum is None else enum(value)
    return parsed_values
