"""The chain of actuators ``[[actuator]]`` between command and plant, and the kinds of parts in words.

A chain fills the slot ``unmodelled`` of the loop, in place of the section ``[unmodelled]`` with a single actuator.
"""

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
"""Section of the study file with the elements of a chain."""
SLOT = "unmodelled"
"""Slot of the loop that a chain fills."""
MOST_ELEMENTS = 12
ABSENT_ACTUATOR: TomlTable = {"kind": "none"}
"""Table of a channel without an actuator: the command reaches the plant unchanged."""


class ActuatorTable(BaseModel):
    """``[[actuator]]``: an element of a chain; its kind adds the same fields as in ``[unmodelled]``."""

    model_config = STRICT
    name: str | None = Field(
        default=None,
        pattern=r"^[A-Za-z_][A-Za-z0-9_-]{0,39}$",
        description="name in `actuator.NAME.FIELD`; absent: its index",
    )
    channel: str | None = Field(default=None, description="channel of a vehicle in which it acts; absent: every one")


ELEMENT_FIELDS = tuple(ActuatorTable.model_fields)
"""Fields that an element of any kind may have, ``name`` and ``channel``."""


def kind_fields(table: Mapping[str, object]) -> TomlTable:
    """Table of an element without its name and channel, as it would stand in ``[unmodelled]``."""
    return {name: value for name, value in table.items() if name not in ELEMENT_FIELDS}


def element_labels(tables: list[TomlTable]) -> list[str]:
    """Label of each element of a chain: its name, or its index if it has no name.

    The dotted names of an element's numbers contain the label, such as ``actuator.servo.tau``.

    Raises:
        ConfigError: A name or a channel is not valid, or a name occurs twice.
    """
    labels: list[str] = []
    for index, table in enumerate(tables):
        place = f"{ACTUATOR}.{index}"
        element_table = {field: table[field] for field in ELEMENT_FIELDS if field in table}
        with errors_under(place):
            try:
                name = ActuatorTable.model_validate(element_table).name
            except ValidationError as error:
                raise first_error(error, ELEMENT_FIELDS) from None
        if name in labels:
            raise ConfigError(f"{place}.name", f"'{name}' names two elements")
        labels.append(name or str(index))
    return labels


def in_channel(table: Mapping[str, object], channel: str) -> bool:
    """Whether an element acts in a channel: in its ``channel``, or in every channel if its table states none."""
    return "channel" not in table or table["channel"] == channel


def require_channel(table: Mapping[str, object], path: str, channels: tuple[str, ...]) -> None:
    """Require that the ``channel`` of an element, if its table states one, is a channel of the plant.

    Args:
        table: Table of the element.
        path: Dotted path of the table, for messages.
        channels: Names of the channels; one empty name for a plant with one channel.

    Raises:
        ConfigError: The plant has no channel of this name.
    """
    channel = table.get("channel", "")
    if not channel or channel in channels:
        return
    hint = "the plant has one channel without a name" if channels == ("",) else nearest(str(channel), channels)
    raise ConfigError(f"{path}.channel", f"must be a channel of the plant, got {channel!r}; {hint}")


def parse_chain(tables: list[TomlTable], channels: tuple[str, ...]) -> list[Component]:
    """Parse the tables ``[[actuator]]`` into one component for each channel: the chain of the channel's elements.

    An element without ``channel`` acts in every channel. The channels then share the numbers of the element, and so
    each draw of them.

    Args:
        tables: Tables of the elements, from the command to the plant.
        channels: Names of the channels; one empty name for a plant with one channel.

    Raises:
        ConfigError: There are too many elements, or an element is not valid or cannot act at its position.
    """
    if len(tables) > MOST_ELEMENTS:
        raise ConfigError(ACTUATOR, f"has at most {MOST_ELEMENTS} elements, got {len(tables)}")
    elements = []
    for label, table in zip(element_labels(tables), tables, strict=True):
        path = f"{ACTUATOR}.{label}"
        require_channel(table, path, channels)
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
    """The actuators of a study with one channel, each with its parameters, from the command to the plant.

    The parameters may contain laws and expressions. An actuator of kind ``none`` is left out.

    Args:
        table: Table of the study.
        config: Fixed tables of the study.
    """
    parameters = ParameterTable.from_toml(as_table(table.get(PARAMETERS, {}), PARAMETERS))
    elements = []
    for element_table in parameters.resolved(tables_of(config, SLOT), SLOT):
        part = parse_component(kind_fields(element_table), UNMODELLED, SLOT)
        if part.kind != "none":
            elements.append((Element(part.kind, part.model), part.params))
    return elements


def series_component(elements: list[tuple[str, Component]], place: str) -> Component:
    """Combine the elements of one channel into one component, in which they act one after the other.

    Args:
        elements: Path in the study and component of each element, from the command to the plant.
        place: Path of the chain in the loop's parameters.

    Returns:
        The element itself if there is only one, and the kind ``none`` if there is none.

    Raises:
        ConfigError: An element cannot act at its position.
    """
    if not elements:
        return parse_component(ABSENT_ACTUATOR, UNMODELLED, ACTUATOR)
    if len(elements) == 1:
        path, part = elements[0]
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
        index, _, field = error.where.partition(".")  # such as "1.delay", for the second element
        path_of_element, _ = elements[int(index)]
        raise ConfigError(f"{path_of_element}.{field}", error.rule) from None
    return Component(kind=kind, model=model, params=params, numbers=tuple(numbers), elements=series)


def require_one_form(config: StudyTable) -> None:
    """Require that a study does not state both a chain ``[[actuator]]`` and the single actuator ``[unmodelled]``.

    Raises:
        ConfigError: The study states both.
    """
    if config.actuator and config.unmodelled != ABSENT_ACTUATOR:
        raise ConfigError(SLOT, "is the chain of one element; beside [[actuator]], make it one of its elements")


def tables_of(config: StudyTable, slot: str, channel: str = "") -> list[TomlTable]:
    """Tables of the parts in a slot: one for each element of a chain or each summand of a sum, otherwise one table.

    Elements of kind ``none`` are left out of a chain.

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
    if isinstance(override, Mapping):
        return [table | override]
    return [table]


def kind_in(config: StudyTable, slot: str, channel: str = "") -> str:
    """Kind of the part in a slot, in words, such as ``dssc``.

    The kinds of a chain or a sum are joined, such as ``delay + lag``; an empty slot gives ``none``. If only the tables
    of the channels state a kind, the common table gives ``by channel``.

    Args:
        config: Tables of the study.
        slot: Slot of the loop.
        channel: Name of a channel; empty for the common table.
    """
    usual = usual_kind(config, slot) or "by channel"
    kinds = [str(table.get("kind", usual)) for table in tables_of(config, slot, channel)]
    return " + ".join(kinds) if kinds else "none"


def usual_kind(config: StudyTable, slot: str) -> str | None:
    """Kind of the part in a slot whose table states no kind; None for a slot without a default."""
    if slot == "sensor" and MEASURES in config.sensor:
        return USUAL_SENSOR
    if slot == "reference":
        return "zero"
    return None


def section_of(config: StudyTable, slot: str) -> str:
    """Section of the study file that fills a slot: ``actuator`` for the slot of a chain, otherwise the slot's name."""
    return ACTUATOR if slot == SLOT and config.actuator else slot
