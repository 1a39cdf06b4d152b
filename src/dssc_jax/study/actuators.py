"""The chain of actuators ``[[actuator]]``: its tables, its elements in each channel, and its kind in words."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import chain as joined

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
"""The slot of the loop that a chain fills."""
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
"""Fields of an element beside those of its kind."""


def labels_of(tables: list[TomlTable]) -> list[str]:
    """The name of each element, or its index if it has none.

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
    """Parse the chain of each channel; a chain of one element is that element.

    An element without ``channel`` acts in every channel, and its numbers are one number for all.

    Raises:
        ConfigError: An element is not valid, or stands where it cannot act.
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
        kind_table = {name: value for name, value in table.items() if name not in ELEMENT_FIELDS}
        elements.append((path, table, parse_component(kind_table, UNMODELLED, path)))
    components = []
    for index, channel in enumerate(channels):
        elements_of_channel = [
            (path, part) for path, table, part in elements if in_channel(table, channel) and part.kind != "none"
        ]
        components.append(series_component(elements_of_channel, f"{SLOT}.{index}"))
    return components


def acting_elements(table: Mapping[str, object], config: StudyTable) -> list[tuple[Element, Params]]:
    """The actuators of a study of one channel in their order, with their parameters.

    Args:
        table: The study's table.
        config: Its fixed tables.
    """
    parameters = ParameterTable.of(as_table(table.get(PARAMETERS, {}), PARAMETERS))
    elements = []
    for element_table in parameters.resolved(tables_of(config, SLOT), SLOT):
        kind_table = {name: value for name, value in element_table.items() if name not in ELEMENT_FIELDS}
        element = parse_component(kind_table, UNMODELLED, SLOT)
        if element.kind != "none":
            elements.append((Element(element.kind, element.model), element.params))
    return elements


def series_component(elements: list[tuple[str, Component]], place: str) -> Component:
    """The elements of one channel as one component; ``place`` is its path in the loop's parameters."""
    if not elements:
        return parse_component({"kind": "none"}, UNMODELLED, ACTUATOR)
    if len(elements) == 1:
        ((path, part),) = elements
        return replace(part, numbers=tuple(number.under(place, path) for number in part.numbers))
    numbers: list[tuple[Number, ...]] = []
    for index, (path, part) in enumerate(elements):
        numbers.append(tuple(number.under(f"{place}.{index}", path) for number in part.numbers))
    kind = " + ".join(part.kind for _, part in elements)
    params = tuple(part.params for _, part in elements)
    series = tuple(Element(part.kind, part.model) for _, part in elements)
    try:
        model = chain(series)
    except ConfigError as error:
        index, _, field = error.where.partition(".")
        raise ConfigError(f"{elements[int(index)][0]}.{field}", error.rule) from None
    return Component(kind, model, params, tuple(joined(*numbers)), series)


def require_one_form(config: StudyTable) -> None:
    """Require that a study gives a chain or ``[unmodelled]``, not both.

    Raises:
        ConfigError: It gives both.
    """
    if config.actuator and config.unmodelled != {"kind": "none"}:
        raise ConfigError(SLOT, "is the chain of one element; beside [[actuator]], make it one of its elements")


def tables_of(config: StudyTable, slot: str, channel: str = "") -> list[TomlTable]:
    """The tables of the parts in a slot: one for each element of a chain or of a sum, else a single one.

    Args:
        config: The study's tables.
        slot: A slot of the loop.
        channel: Name of a channel, whose own table overrides the common one; empty: the common ones.
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
    """The kind of the part in a slot, the kinds of a chain or a sum of winds, or that each channel has a part."""
    usual = usual_kind(config, slot) or "by channel"
    return " + ".join(str(table.get("kind", usual)) for table in tables_of(config, slot, channel)) or "none"


def usual_kind(config: StudyTable, slot: str) -> str | None:
    """The kind of a slot whose table gives none; None: the table of each channel gives one."""
    if slot == "sensor" and MEASURES in config.sensor:
        return USUAL_SENSOR
    return "zero" if slot == "reference" else None


def section_of(config: StudyTable, slot: str) -> str:
    """The section of the study file that fills a slot."""
    return ACTUATOR if slot == SLOT and config.actuator else slot
