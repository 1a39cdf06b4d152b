"""The parts of a loop that a linearisation differentiates, with their declared smoothness and their substitutes.

A part that does not declare where it is smooth is refused. A part that is smooth nowhere is replaced by the substitute
in its declaration, or refused without one. :mod:`dssc_jax.engine.linearisation.part_slopes` classifies a part at an
operating point; at a corner the substitute for the inner side replaces it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import IntEnum
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.core.contracts import Controller, Differentiator, Disturbance, Plant, Sensor, Unmodelled
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import is_known
from dssc_jax.core.signals import Params, Scalar
from dssc_jax.core.smoothness import SmoothExtent, Smoothness, declared_smoothness
from dssc_jax.engine.linearisation.time_dependence import require_timeless
from dssc_jax.study import Study
from dssc_jax.study.actuators import kind_in, section_of

CHANNEL_SLOTS = ("sensor", "differentiator", "controller", "unmodelled")
DISTURBANCE = "disturbance"
SIGNAL_SENSOR = "signal_sensor"
UNMODELLED = "unmodelled"
INPUTS = "inputs"
SECTIONS = {SIGNAL_SENSOR: "sensor", INPUTS: DISTURBANCE}
"""Section of the study with the parts of a slot, where their names differ."""
Part: TypeAlias = Plant | Controller | Sensor | Differentiator | Unmodelled | Disturbance
"""A model of a part that can be linearised."""

PART_FUNCTIONS: dict[type, tuple[str, ...]] = {
    Controller: ("init", "step"),
    Sensor: ("init", "step"),
    Differentiator: ("init", "step"),
    Unmodelled: ("init", "step", "output", "sample", "linear", "moments"),
}
"""The functions of a part that select its substitute where :func:`choice` makes a part of two."""


class LoopPart(NamedTuple):
    """The place of a part in the loop, with the part's declaration.

    Args:
        slot: Field of :class:`Loop`.
        channel: Index within the slot: of the channel, signal or input; 0 for the plant.
        label: Slot, channel and kind in words.
        smoothness: Where the part has derivatives, by its declaration.
        remaining: Where the part that is differentiated has derivatives: that part is the substitute if it always
            replaces the part.
        imported: Whether the model is user-defined code, ``module:object``.
    """

    slot: str
    channel: int
    label: str
    smoothness: Smoothness
    remaining: Smoothness
    imported: bool = False

    @property
    def is_examined(self) -> bool:
        """Whether the part is examined at its operating points: it has boundaries, or is user-defined code.

        The package's own parts that are smooth everywhere are not examined, because the package's tests have examined
        them.
        """
        return self.imported or self.remaining.extent != SmoothExtent.EVERYWHERE

    @property
    def is_replaced(self) -> bool:
        """Whether the substitute always replaces the part."""
        return self.smoothness.extent == SmoothExtent.NOWHERE

    def substitute(self, params: Params) -> tuple[Part, Params]:
        """The substitute that is differentiated in place of the part, and the substitute's parameters.

        Args:
            params: Parameters of the part.
        """
        assert self.smoothness.substitute is not None  # see declared_place
        return self.smoothness.substitute(params)

    def inner_side(self, params: Params) -> tuple[Part, Params]:
        """The substitute for the inner side of the part's boundaries, and the substitute's parameters.

        Call it only if :attr:`has_inner_side`.
        """
        assert self.remaining.substitute is not None
        return self.remaining.substitute(params)

    @property
    def has_inner_side(self) -> bool:
        """Whether there is a substitute for operating points on the boundaries of the part that is differentiated."""
        return self.remaining.extent == SmoothExtent.PIECEWISE and self.remaining.substitute is not None


class Finding(IntEnum):
    """Class of a part at an operating point."""

    SMOOTH = 0  # it has a derivative
    CORNER = 1  # it lies on a boundary, and a substitute for the inner side applies
    DEFECT = 2  # it has no derivative, and no substitute applies
    BEYOND = 3  # it lies beyond a boundary, where deviations do not pass


class SelectedParams(NamedTuple):
    """Parameters of a part and of its substitute, and whether the substitute replaces the part.

    Args:
        part: Parameters of the part.
        substitute: Parameters of the substitute.
        is_substituted: Whether the substitute replaces the part; may be traced, so that one program serves both cases.
    """

    part: Params
    substitute: Params
    is_substituted: Scalar

    @property
    def l0(self) -> Scalar:
        """The error pole l_0 of the part, if it is a controller [1/s]."""
        return self.part.l0


def declared_places(study: Study, moving: bool) -> tuple[LoopPart, ...]:
    """Every part that a linearisation of the study differentiates: plant, parts of the channels, sensors of signals.

    Args:
        study: The study.
        moving: Whether the loop is linearised along its flight, where disturbances matter.

    Raises:
        ConfigError: A part declares nothing, or it is smooth nowhere and has no substitute; the study has an event; or
            the plant changes with time, and the loop is not linearised along its flight.
    """
    if study.config.event:
        raise ConfigError(f"{study.source}: event", "changes the loop at a time, which a linearisation does not cover")
    if not moving:
        require_timeless(study)
    loop = study.loop
    template = study.template
    slots = (*CHANNEL_SLOTS, DISTURBANCE) if moving else CHANNEL_SLOTS
    places = [declared_place(study, "plant", 0, loop.plant, template.plant)]
    for slot in slots:
        for index in range(len(loop.channels)):
            part = getattr(loop, slot)[index]
            places.append(declared_place(study, slot, index, part, getattr(template, slot)[index]))
    for slot in (SIGNAL_SENSOR, INPUTS) if moving else (SIGNAL_SENSOR,):
        for index, part in enumerate(getattr(loop, slot)):
            places.append(declared_place(study, slot, index, part, getattr(template, slot)[index]))
    return tuple(places)


def named_kind(study: Study, slot: str, name: str) -> str:
    """The kind of a part in words, such as ``sine + step`` for two disturbances at one input.

    Args:
        study: The study.
        slot: Field of :class:`Loop`.
        name: Name of the part's channel, measured signal or input; empty for a single channel.
    """
    table = getattr(study.config, SECTIONS.get(slot, slot))
    if isinstance(table, list) or "input" in table:  # disturbances, each of which may name its input
        tables = table if isinstance(table, list) else [table]
        kinds = [str(part["kind"]) for part in tables if part.get("input", name) == name]
        return " + ".join(kinds) or "none"
    if slot == INPUTS:
        common_kind = "none"
    elif slot == SIGNAL_SENSOR:
        common_kind = "ideal"
    else:
        common_kind = table.get("kind", "ideal")
    if not name:
        return str(common_kind)
    return str(table.get(name, {}).get("kind", common_kind))


def declared_place(study: Study, slot: str, index: int, part: Part, params: Params) -> LoopPart:
    """The place of a part in the loop, with the part's declaration of where it is smooth.

    Args:
        study: The study.
        slot: Field of :class:`Loop`.
        index: Index within the slot.
        part: The model.
        params: The model's parameters, in which laws may stand for numbers.

    Raises:
        ConfigError: The part declares nothing, or it is smooth nowhere and has no substitute.
    """
    loop = study.loop
    names = {"plant": ("",), SIGNAL_SENSOR: [signal.name for signal in loop.measures], INPUTS: loop.input_names}
    channel = names.get(slot, loop.channels)[index]
    kind = kind_in(study.config, slot, channel) if slot == UNMODELLED else named_kind(study, slot, channel)
    section = SECTIONS.get(slot) or section_of(study.config, slot)
    place = f"{section}.{channel}" if channel else section
    path = f"{study.source}: {place}.kind"
    try:
        smoothness = declared_smoothness(part, params)
    except ConfigError as error:
        raise ConfigError(path, f"'{kind}' {error.rule}") from None
    if smoothness.extent == SmoothExtent.NOWHERE and smoothness.substitute is None:
        raise ConfigError(path, f"'{kind}' {smoothness.meaning}")
    label = f"{section} '{kind}'" if not channel else f"{section} '{kind}' of {channel}"
    remaining = smoothness
    if smoothness.substitute is not None and smoothness.extent == SmoothExtent.NOWHERE:
        substitute, values = smoothness.substitute(params)
        remaining = declared_smoothness(substitute, values)
    return LoopPart(
        slot=slot, channel=index, label=label, smoothness=smoothness, remaining=remaining, imported=":" in kind
    )


def substitute_notes(places: Sequence[LoopPart]) -> list[str]:
    """Notes for the reader of the results on the substitutes of the parts that are smooth nowhere; each note once."""
    notes = [f"{place.label} {place.smoothness.meaning}" for place in places if place.is_replaced]
    return list(dict.fromkeys(notes))


def part_of(loop: Loop, params: LoopParams, place: LoopPart) -> tuple[Part, Params]:
    """The model in a place of the loop, and its parameters.

    Args:
        loop: The models and the clock.
        params: The loop's parameters.
        place: The place: a slot, and an index within it.
    """
    if place.slot == "plant":
        return loop.mimo_plant, params.plant
    return getattr(loop, place.slot)[place.channel], getattr(params, place.slot)[place.channel]


def with_part(
    loop: Loop, params: LoopParams, place: LoopPart, part: Part, part_params: Params
) -> tuple[Loop, LoopParams]:
    """The loop with another part in a place, and the loop's parameters with those of this part.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        place: The place.
        part: The other part.
        part_params: Parameters of the other part.
    """
    models = list(getattr(loop, place.slot))
    values = list(getattr(params, place.slot))
    models[place.channel] = part
    values[place.channel] = part_params
    return replace(loop, **{place.slot: tuple(models)}), params._replace(**{place.slot: tuple(values)})


def substituted(loop: Loop, params: LoopParams, places: Sequence[LoopPart]) -> tuple[Loop, LoopParams]:
    """The loop and its parameters, with substitutes for all parts that are smooth nowhere.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        places: The parts of the loop.
    """
    for place in places:
        if place.is_replaced:
            _, part_params = part_of(loop, params, place)
            loop, params = with_part(loop, params, place, *place.substitute(part_params))
    return loop, params


def with_inner_sides(
    loop: Loop, params: LoopParams, places: Sequence[LoopPart], findings: jax.Array
) -> tuple[Loop, LoopParams]:
    """The loop and its parameters, with substitutes for the inner side in place of the parts at a corner.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        places: The parts.
        findings: The :class:`Finding` of each part, shape (parts,); may be traced.
    """
    for place, finding in zip(places, findings, strict=True):
        if not place.has_inner_side:
            continue
        part, part_params = part_of(loop, params, place)
        substitute, substitute_params = place.inner_side(part_params)
        is_substituted = finding == Finding.CORNER
        if substitute is part:  # the same model with other parameters, such as an infinite limit
            params_of_part = selected_params(part_params, substitute_params, is_substituted)
            loop, params = with_part(loop, params, place, part, params_of_part)
        else:
            params_of_part = SelectedParams(part_params, substitute_params, is_substituted)
            loop, params = with_part(loop, params, place, choice(part, substitute), params_of_part)
    return loop, params


def selected_params(params: Params, substitute: Params, is_substituted: Scalar) -> Params:
    """The parameters of the substitute if it replaces the part, else the parameters of the part.

    A number that is known before tracing and equal in both, such as the size of a memory, stays a plain number.

    Args:
        params: Parameters of the part.
        substitute: Parameters of the substitute, with the same fields.
        is_substituted: Whether the substitute replaces the part; may be traced.
    """

    def select(number: Scalar, substitute_number: Scalar) -> Scalar:
        """The number of the substitute if it replaces the part, else the number of the part."""
        are_known = is_known(number) and is_known(substitute_number)
        is_equal = number is substitute_number or (are_known and number == substitute_number)
        return number if is_equal else jnp.where(is_substituted, substitute_number, number)

    return jax.tree.map(select, params, substitute)


def choice(part: Part, substitute: Part) -> Part:
    """A part that runs either as the part or as its substitute.

    The parameters of the result, :class:`SelectedParams`, tell which of them runs. This may be a traced value, so both
    are computed.

    Args:
        part: The part.
        substitute: The substitute, with the same functions.
    """

    def selecting(name: str) -> Callable[..., object]:
        """Return the function of this name that runs both parts, and selects the results of one."""

        def select(params: SelectedParams, *arguments: object) -> object:
            """The results of the substitute if it replaces the part, else the results of the part."""
            inner = getattr(substitute, name)(params.substitute, *arguments)
            outer = getattr(part, name)(params.part, *arguments)
            return jax.tree.map(lambda a, b: jnp.where(params.is_substituted, a, b), inner, outer)

        return select

    names = [name for name in PART_FUNCTIONS[type(part)] if getattr(part, name) is not None]
    return part._replace(**{name: selecting(name) for name in names})


def require_smooth_at(study: Study, places: Sequence[LoopPart], findings: np.ndarray) -> dict[str, int]:
    """Require that every part of the loop has a derivative at every operating point.

    Args:
        study: The study, for messages.
        places: The parts.
        findings: The :class:`Finding` of each operating point and part, shape (n, parts).

    Returns:
        For each part that lies at or beyond a corner a note, with the number of operating points.

    Raises:
        ConfigError: A part has no derivative at an operating point: it lies on one of its boundaries, or it is not
            smooth where it declares that it is.
    """
    notes = {}
    draws = len(findings)
    for place, column in zip(places, findings.T, strict=True):
        defects = int(np.count_nonzero(column == Finding.DEFECT))
        corners = int(np.count_nonzero(column == Finding.CORNER))
        beyond = int(np.count_nonzero(column == Finding.BEYOND))
        meaning = place.remaining.meaning
        boundary = meaning.partition(";")[0]
        if defects and place.remaining.extent == SmoothExtent.PIECEWISE:
            raise ConfigError(
                study.source,
                f"{place.label} has no derivative at {defects} of {draws} operating points, which lie on {boundary}; "
                "move the operating point or the boundary",
            )
        if defects:
            raise ConfigError(
                study.source,
                f"{place.label} declares that it is smooth, but at {defects} of {draws} operating points its "
                "derivative is not the effect of small deviations, as with a switch, a clip or rounding; declare "
                "piecewise(...) or not_smooth(...) in its field smooth (docs/extending.md)",
            )
        if corners:
            notes[f"{place.label} lies on {meaning}"] = corners
        if beyond:
            notes[f"{place.label} lies beyond {boundary}, where deviations do not pass"] = beyond
    return notes
