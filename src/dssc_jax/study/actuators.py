"""The chain of actuators ``[[actuator]]``: its tables and its elements in each channel; the kinds of parts in words."""

from collections.abc import Mapping

from pydantic import BaseModel, Field, ValidationError

from dssc_jax.core.chains import Element, chain
from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.core.signals import Params
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.study.components import Component, as_table, parse_component
from dssc_jax.study.measures import MEASURES, USUAL_SENSOR
from dssc_jax.study.numbers import Number
from dssc_jax.study.parameters import ParameterTable
from dssc_jax.study.schema import STRICT, StudyTable
from dssc_jax.study.table_errors import first_error
from dssc_jax.study.tables import PARAMETERS

ACTUATOR = "actuator"
SLOT = "unmodelled"
"""Slot of the loop that a chain fills."""
MOST_ELEMENTS = 12


class ActuatorTable(BaseModel):
    """``[[actuator]]``: an element of a chain; its other fields are those of its kind in ``[unmodelled]``."""

    model_config = STRICT
    name: str | None = Field(
        default=None,
        pattern=r"^[A-Za-z_][A-Za-z0-9_-]{0,39}$",
        description="name in `actuator.NAME.FIELD`; absent: its index",
    )
    channel: str | None = Field(default=None, description="channel of a vehicle in which it acts; absent: every one")


ELEMENT_FIELDS = tuple(ActuatorTable.model_fields)
"""Fields of an element besides those of its kind."""


def kind_fields(table: Mapping[str, object]) -> TomlTable:
    """The kind of an element, and the fields of that kind."""
    return {name: value for name, value in table.items() if name not in ELEMENT_FIELDS}


def labels_of(tables: list[TomlTable]) -> list[str]:
    """Name of each element of a chain, or its index if it has none.

    Raises:
        ConfigError: A name or a channel is not valid, or a name occurs twice.
    """
    labels: list[str] = []
    for index, table in enumerate(tables):
        place = f"{ACTUATOR}.{index}"
        with errors_under(place):
            try:
                label = ActuatorTable.model_validate({key: table[key] for key in ELEMENT_FIELDS if key in table}).name
            except ValidationError as error:
                raise first_error(error, ELEMENT_FIELDS) from None
        if label in labels:
            raise ConfigError(f"{place}.name", f"'{label}' names two elements")
        labels.append(label or str(index))
    return labels


def in_channel(table: Mapping[str, object], channel: str) -> bool:
    """Whether an element acts in a channel."""
    return table.get("channel", channel) == channel


def parse_chain(tables: list[TomlTable], channels: tuple[str, ...]) -> list[Component]:
    """Parse the tables ``[[actuator]]`` into the chain of each channel.

    An element without ``channel`` acts in every channel, where its numbers are shared.

    Raises:
        ConfigError: An element is not valid, or cannot act at its position.
    """
    if len(tables) > MOST_ELEMENTS:
        raise ConfigError(ACTUATOR, f"has at most {MOST_ELEMENTS} elements, got {len(tables)}")
    elements = []
    for label, table in zip(labels_of(tables), tables, strict=True):
        path = f"{ACTUATOR}.{label}"
        channel = table.get("channel", "")
        if channel and channel not in channels:
            hint = nearest(str(channel), channels) if any(channels) else "the plant has one channel without a name"
            raise ConfigError(f"{path}.channel", f"must be a channel of the plant, got {channel!r}; {hint}")
        elements.append((path, table, parse_component(kind_fields(table), UNMODELLED, path)))
    components = []
    for index, channel in enumerate(channels):
        elements_of_channel = []
        for path, table, part in elements:
            if in_channel(table, channel) and part.kind != "none":
                elements_of_channel.append((path, part))
        components.append(series_component(elements_of_channel, f"{SLOT}.{index}"))
    return components


def acting_elements(table: Mapping[str, object], config: StudyTable) -> list[tuple[Element, Params]]:
    """The actuators of a study with one channel, in their order, with their parameters.

    Args:
        table: Table of the study.
        config: Fixed tables of the study.
    """
    parameters = ParameterTable.of(as_table(table.get(PARAMETERS, {}), PARAMETERS))
    elements = []
    for element_table in parameters.resolved(tables_of(config, SLOT), SLOT):
        element = parse_component(kind_fields(element_table), UNMODELLED, SLOT)
        if element.kind != "none":
            elements.append((Element(element.kind, element.model), element.params))
    return elements


def series_component(elements: list[tuple[str, Component]], place: str) -> Component:
    """Combine the elements of one channel, in series, into one component.

    Args:
        elements: Path in the study and component of each element, in their order.
        place: Path of the chain in the loop's parameters.

    Returns:
        The element itself if there is only one, and the kind ``none`` if there is none.

    Raises:
        ConfigError: An element cannot act at its position.
    """
    if not elements:
        return parse_component({"kind": "none"}, UNMODELLED, ACTUATOR)
    if len(elements) == 1:
        ((path, part),) = elements
        return part.under(place, path)
    numbers: list[Number] = []
    for index, (path, part) in enumerate(elements):
        numbers.extend(part.under(f"{place}.{index}", path).numbers)
    kind = " + ".join(part.kind for _, part in elements)
    params = tuple(part.params for _, part in elements)
    series = tuple(Element(part.kind, part.model) for _, part in elements)
    try:
        model = chain(series)
    except ConfigError as error:
        index, _, field = error.where.partition(".")
        raise ConfigError(f"{elements[int(index)][0]}.{field}", error.rule) from None
    return Component(kind, model, params, tuple(numbers), series)


def require_one_form(config: StudyTable) -> None:
    """Require that a study states a chain ``[[actuator]]`` or ``[unmodelled]``, but not both.

    Raises:
        ConfigError: It states both.
    """
    if config.actuator and config.unmodelled != {"kind": "none"}:
        raise ConfigError(SLOT, "is the chain of one element; beside [[actuator]], make it one of its elements")


def tables_of(config: StudyTable, slot: str, channel: str = "") -> list[TomlTable]:
    """Tables of the parts in a slot: one for each element of a chain or a sum, otherwise a single one.

    Args:
        config: Tables of the study.
        slot: Slot of the loop.
        channel: Name of a channel, whose table overrides the common one; empty for the common table.
    """
    if slot == SLOT and config.actuator:
        active_tables = [table for table in config.actuator if table.get("kind") != "none"]
        return [table for table in active_tables if not channel or in_channel(table, channel)]
    table = getattr(config, slot)
    if isinstance(table, list):
        return table
    override = table.get(channel) if channel else None
    return [table | override if isinstance(override, Mapping) else table]


def kind_in(config: StudyTable, slot: str, channel: str = "") -> str:
    """Kind of the part in a slot, in words: the kinds of a chain or a sum, or that each channel has a part.

    Args:
        config: Tables of the study.
        slot: Slot of the loop.
        channel: Name of a channel; empty for the common table.
    """
    usual = usual_kind(config, slot) or "by channel"
    return " + ".join(str(table.get("kind", usual)) for table in tables_of(config, slot, channel)) or "none"


def usual_kind(config: StudyTable, slot: str) -> str | None:
    """Kind of a slot whose table states none; None if there is no default."""
    if slot == "sensor" and MEASURES in config.sensor:
        return USUAL_SENSOR
    return "zero" if slot == "reference" else None


def section_of(config: StudyTable, slot: str) -> str:
    """Name of the section of the study file that fills a slot."""
    return ACTUATOR if slot == SLOT and config.actuator else slot
