"""From a study file's tables to models and parameters.

The parameter types of the models are the schema: their annotations say which quantity a field is, which slot,
and what stands when it is absent. A validated table becomes the chosen model and an instance of its parameter
type, whose leaves are numbers and laws.
"""

import contextlib
import importlib
import sys
import types
import typing
from dataclasses import dataclass, field
from enum import Enum
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, create_model

from dssc_jax.errors import ConfigError, meant
from dssc_jax.study.laws import Law, is_law, is_number, parse_law
from dssc_jax.study.tables import merged
from dssc_jax.types import Entry, Preset, Quantity, Registry, Slot, nothing, single


@dataclass
class Component:
    """A chosen model with its parameters, and what each of its numbers means by dotted path.

    ``short`` maps the path of a number to the shorter one a study uses where a slot was given as a bare number.
    """

    kind: str
    model: Any
    params: Any
    quantities: dict[str, Quantity] = field(default_factory=dict)
    short: dict[str, str] = field(default_factory=dict)


def parse_number(value: Any, quantity: Quantity) -> float | Law:
    """A number or a law within the quantity's interval.

    Raises:
        ValueError: the rule that is broken, and the value found.
    """
    if isinstance(value, Law):
        parsed: float | Law = value
        low, high = value.support
    elif isinstance(value, dict):
        if not quantity.law:
            raise ValueError(f"must be a plain number here, got the law {value}")
        parsed = parse_law(value)
        low, high = parsed.support
    elif is_number(value):
        parsed = float(value)
        low = high = parsed
    else:
        law = " or a law" if quantity.law else ""
        raise ValueError(f"must be a finite number ({quantity.meaning} [{quantity.unit}]){law}, got {value!r}")
    broken = quantity.violated_by(low, high)
    if broken:
        found = f"{value!r}" if low == high else f"{parsed}, whose support is [{low:g}, {high:g}]"
        raise ValueError(f"{quantity.meaning} [{quantity.unit}] {broken}, got {found}")
    return parsed


def parse_numbers(value: Any, quantity: Quantity) -> tuple[float | Law, ...]:
    """A list of numbers or laws."""
    if not isinstance(value, list | tuple):
        raise ValueError(f"must be a list of numbers ({quantity.meaning} [{quantity.unit}]), got {value!r}")
    return tuple(parse_number(item, quantity) for item in value)


@dataclass(frozen=True)
class FieldSpec:
    """What one field of a parameter type holds."""

    mark: Quantity | Slot | None
    core: Any
    optional: bool

    @property
    def many(self) -> bool:
        """A list of numbers."""
        return typing.get_origin(self.core) is tuple

    @property
    def nested(self) -> bool:
        """Another parameter type of fixed kind."""
        return self.mark is None and hasattr(self.core, "_fields")

    @property
    def derived(self) -> bool:
        """Not for tables: the model's ``prepare`` fills it."""
        choice = isinstance(self.core, type) and (issubclass(self.core, Enum) or self.core is bool)
        return self.mark is None and not self.nested and not choice


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


def number_type(quantity: Quantity, many: bool, optional: bool) -> Any:
    """The pydantic type of one number, or of a list of them."""
    parse = parse_numbers if many else parse_number
    allow_none = optional

    def check(value: Any) -> Any:
        return None if value is None and allow_none else parse(value, quantity)

    return Annotated[Any, BeforeValidator(check)]


@cache
def table_model(params: type) -> type[BaseModel]:
    """The pydantic model of a table's plain fields; slots and nested tables are parsed on their own."""
    fields: dict[str, Any] = {}
    for name, spec in field_specs(params).items():
        if isinstance(spec.mark, Slot) or spec.nested or spec.derived:
            continue
        kind = number_type(spec.mark, spec.many, spec.optional) if isinstance(spec.mark, Quantity) else spec.core
        if isinstance(kind, type) and issubclass(kind, Enum):
            kind = Literal[tuple(member.value for member in kind)]  # type: ignore[valid-type]
        fields[name] = (kind, ...)
    return create_model(params.__name__, __config__=ConfigDict(extra="forbid", strict=True), **fields)


def explain(error: ValidationError, names: typing.Iterable[str]) -> ConfigError:
    """The first of pydantic's complaints as one line: path, rule, value, nearest name."""
    first = error.errors()[0]
    path = ".".join(str(part) for part in first["loc"])
    value = first.get("input")
    match first["type"]:
        case "extra_forbidden":
            return ConfigError(path, f"unknown name; {meant(str(first['loc'][-1]), names)}")
        case "missing":
            return ConfigError(path, "is required and missing")
        case "value_error":
            return ConfigError(path, str(first.get("ctx", {}).get("error")))
        case "literal_error":
            expected = str(first.get("ctx", {}).get("expected")).replace("'", "")
            return ConfigError(path, f"'{value}' is none of {expected}")
        case _:
            return ConfigError(path, f"{first['msg'][0].lower()}{first['msg'][1:]}, got {value!r}")


def imported(name: str, place: str) -> Any:
    """A user's own object by its dotted name ``package.module:object``.

    Raises:
        ConfigError: it cannot be imported.
    """
    module_name, _, attribute = name.partition(":")
    try:
        with contextlib.redirect_stdout(sys.stderr):
            return getattr(importlib.import_module(module_name), attribute)
    except (Exception, SystemExit) as error:  # a module's own code may raise anything
        raise ConfigError(place, f"cannot import '{name}': {type(error).__name__}: {error}") from error


def lookup(kind: Any, registry: Registry, path: str) -> Entry:
    """The registry row of a kind, or a user's own model by its dotted name ``package.module:object``."""
    if not isinstance(kind, str):
        raise ConfigError(f"{path}.kind", f"must be a name, got {kind!r}")
    if kind in registry:
        return registry[kind]
    if ":" not in kind:
        raise ConfigError(f"{path}.kind", f"unknown kind '{kind}'; {meant(kind, registry)}")
    found = imported(kind, f"{path}.kind")
    if hasattr(found, "_fields") and not isinstance(found, type) and not hasattr(found, "params"):
        found = Preset(type(found), found)
    if isinstance(found, Entry):
        return found
    contract = type(next(iter(next(iter(registry.values())).members.values())))
    if not isinstance(found, contract) or (contract is type and not hasattr(found, "_fields")):
        wanted = "a NamedTuple type" if contract is type else f"a {contract.__name__}"
        raise ConfigError(f"{path}.kind", f"'{kind}' must be {wanted}, got {type(found).__name__}")
    return single(found, "a user's own")


def member_of(entry: Entry, table: dict[str, Any], path: str) -> Any:
    """Take the entry's option out of the table and pick the member."""
    if entry.option is None:
        return entry.members[None]
    choice = table.pop(entry.option, entry.default)
    for key, member in entry.members.items():
        if choice == key and not isinstance(choice, bool):
            return member
    valid = [key.value for key in entry.members]
    hint = meant(choice, valid) if isinstance(choice, str) else f"valid are {', '.join(map(str, valid))}"
    raise ConfigError(f"{path}.{entry.option}", f"must be one of {', '.join(map(str, valid))}, got {choice!r}; {hint}")


def as_table(value: Any, path: str) -> dict[str, Any]:
    """A copy of a table.

    Raises:
        ConfigError: it is something else.
    """
    if not isinstance(value, dict):
        raise ConfigError(path, f"must be a table, got {value!r}")
    return dict(value)


def parse_component(value: Any, registry: Registry, path: str, default: str | None = None) -> Component:
    """The model that a table names, with its parameters.

    Raises:
        ConfigError: with the path, the rule and the value of the first thing that is wrong.
    """
    table = as_table(value, path)
    kind = table.pop("kind", default)
    if kind is None:
        raise ConfigError(f"{path}.kind", f"is required and missing; valid names are {', '.join(sorted(registry))}")
    entry = lookup(kind, registry, path)
    table = merged(entry.silent, table)
    model = member_of(entry, table, path)
    component = Component(kind, model, None)
    options = (entry.option,) if entry.option else ()
    also = ("kind", *options)
    params = getattr(model, "params", model)
    component.params = parse_params(table, params, path, component, also, getattr(model, "defaults", None))
    prepare = getattr(model, "prepare", nothing)
    try:
        component.params = prepare(component.params)
    except ConfigError as error:
        raise error.within_path(path) from None
    return component


def parse_params(
    table: dict[str, Any], params: Any, path: str, into: Component, also: tuple[str, ...] = (), preset: Any = None
) -> Any:
    """An instance of a parameter type from its table; the meaning of each number is noted in ``into``.

    Args:
        table: The table, which is used up.
        params: The parameter type.
        path: Where the table stands.
        into: Takes the meaning of each number.
        also: Names that stood in the table and are valid, for messages.
        preset: An instance whose values stand where the table is silent.

    Raises:
        ConfigError: with the path, the rule and the value of the first thing that is wrong.
    """
    specs = field_specs(params)
    defaults = getattr(params, "_field_defaults", {}) if preset is None else preset._asdict()
    found: dict[str, Any] = {}
    for name, spec in specs.items():
        place = f"{path}.{name}"
        if spec.derived:
            found[name] = defaults[name]
            continue
        if not isinstance(spec.mark, Slot) and not spec.nested:
            continue
        inner = defaults.get(name)
        if name not in table:
            chosen = isinstance(spec.mark, Slot) and spec.mark.default is not None
            if not chosen and name not in defaults:
                raise ConfigError(place, "is required and missing")
            if not chosen and inner is None:
                found[name] = None
                continue
        value = table.pop(name, {})
        if isinstance(spec.mark, Slot):
            if spec.mark.number is not None and (is_number(value) or is_law(value)):
                first = next(iter(field_specs(spec.mark.registry[spec.mark.number].members[None])))
                value = {"kind": spec.mark.number, first: value}
                into.short[f"{place}.{first}"] = place
            part = parse_component(value, spec.mark.registry, place, spec.mark.default)
            into.quantities.update(part.quantities)
            into.short.update(part.short)
            found[name] = part.params
        else:
            found[name] = parse_params(as_table(value, place), spec.core, place, into, (), inner)
    silent = {name: defaults[name] for name in specs if name in defaults and name not in found}
    plain = {name: value.value if isinstance(value, Enum) else value for name, value in silent.items()}
    try:
        checked = table_model(params).model_validate(plain | table)
    except ValidationError as error:
        raise explain(error, [*specs, *also]).within_path(path) from None
    for name, spec in specs.items():
        if name in found:
            continue
        value = getattr(checked, name)
        if isinstance(spec.mark, Quantity) and value is not None:
            places = [f"{path}.{name}.{i}" for i in range(len(value))] if spec.many else [f"{path}.{name}"]
            into.quantities.update(dict.fromkeys(places, spec.mark))
        if isinstance(spec.core, type) and issubclass(spec.core, Enum):
            value = spec.core(value)
        found[name] = value
    return params(**found)
