"""Requirements that a margin of the linearised loop is large enough, or one of its peaks small enough."""

import math
import re

from dssc_jax.closed_loop.break_points import BreakPoint, place_names
from dssc_jax.closed_loop.metrics.margin_kinds import MARGIN_KINDS, LoopMargin, MarginKind
from dssc_jax.closed_loop.metrics.margin_measures import margin_measure
from dssc_jax.closed_loop.metrics.requirements import Requirement
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.study.schema import RequirementTable

QUANTITY = re.compile(r"\s*(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?P<unit>\S*)\s*")
"""A number with or without a unit, such as ``6 dB``."""


def margin_requirement(table: RequirementTable, place: str, channels: tuple[str, ...]) -> Requirement:
    """Parse the requirement that bounds a margin of the linearised loop from above or below.

    Args:
        table: Table of the requirement, which has a margin.
        place: Dotted path of the table, such as ``requirement.0``.
        channels: Names of the channels; one empty name for a plant with one channel.

    Raises:
        ConfigError: The margin, the break point or the bound is not valid.
    """
    name = str(table.margin)
    if name not in MARGIN_KINDS:
        raise ConfigError(f"{place}.margin", f"unknown margin '{name}'; {nearest(name, MARGIN_KINDS)}")
    kind = MARGIN_KINDS[name]
    valid_places = place_names(channels)
    default_place = BreakPoint.INPUT if channels == ("",) else ""  # empty: several channels have no default
    place_of_break = table.at if table.at is not None else default_place
    if place_of_break not in valid_places:
        rule = f"names where the loop is broken, and must be one of {', '.join(valid_places)}"
        raise ConfigError(f"{place}.at", f"{rule}; got {place_of_break!r}" if place_of_break else rule)
    measure = margin_measure(LoopMargin(kind, place_of_break), default_place)
    side = "min" if table.max is None else "max"
    bound = table.min if table.max is None else table.max
    assert bound is not None  # RequirementTable has one of them
    place_of_bound = f"{place}.{side}"
    value = bound_value(kind, bound, place_of_bound)
    require_attainable(kind, value, bound, place_of_bound)
    require_stable(kind, value, side, place_of_bound)
    bound_text = text_with_unit(bound)
    if side == "max":
        return Requirement(measure, maximum=value, written=bound_text)
    return Requirement(measure, minimum=value, written=bound_text)


def text_with_unit(bound: float | str) -> str:
    """Text of a bound that the study states with a unit, such as ``6 dB``; empty for a plain number."""
    return " ".join(bound.split()) if isinstance(bound, str) else ""


def bound_value(kind: MarginKind, bound: float | str, place: str) -> float:
    """Value of a bound in the unit of its margin, such as 1.995 for ``6 dB`` of a gain margin.

    Args:
        kind: Kind of the margin.
        bound: Bound in the study, a plain number or a text with a unit.
        place: Place of the bound in the study, for messages.

    Raises:
        ConfigError: The bound is a text other than a number with one of the margin's units.
    """
    if not isinstance(bound, str):
        return bound
    match = QUANTITY.fullmatch(bound)
    if match is not None:
        unit = match["unit"] or kind.unit
        if unit in kind.units:
            to_kind_unit = kind.units[unit]
            return to_kind_unit(float(match["number"]))
    units = ", ".join(unit for unit in kind.units if unit != "1")
    rule = f"must be a number [{kind.unit}], or a text of a number and one of {units}"
    raise ConfigError(place, f"{rule}; got {bound!r}")


def require_attainable(kind: MarginKind, value: float, bound: float | str, place: str) -> None:
    """Require that a bound lies among the values that a margin of this kind can have.

    Args:
        kind: Kind of the margin.
        value: Bound in the unit of the margin.
        bound: Bound as the study states it, a plain number or a text with a unit, for messages.
        place: Place of the bound in the study, for messages.

    Raises:
        ConfigError: The bound is not finite, negative, or larger than the largest margin. If a plain number would be
            valid in another unit, the message proposes it.
    """
    if not math.isfinite(value):
        raise ConfigError(place, f"must be a finite number [{kind.unit}], got {value:g}")
    bound_text = text_with_unit(bound) or f"{value:g}"
    if value < 0.0:
        raise ConfigError(place, f"must be >= 0 {kind.unit}, as every {kind.meaning} is; got {bound_text}")
    if value <= kind.most:
        return
    rule = f"must be <= {kind.most:.6g} {kind.unit}, the largest {kind.meaning} there is; got {bound_text}"
    if not isinstance(bound, str):
        for unit, to_kind_unit in kind.units.items():
            if to_kind_unit(bound) <= kind.most:
                rule += f'; did you mean "{bound:g} {unit}"?'
    raise ConfigError(place, rule)


def require_stable(kind: MarginKind, value: float, side: str, place: str) -> None:
    """Require that loops at the limit of stability do not meet a bound, so that it requires more than stability.

    Args:
        kind: Kind of the margin.
        value: Bound in the unit of the margin.
        side: ``min`` or ``max``.
        place: Place of the bound in the study.

    Raises:
        ConfigError: Loops at the limit of stability would meet the bound.
    """
    limit = f"{kind.neutral:g}, which loops at the limit of stability have; got {value:g}"
    if side == "min" and kind.good == "large" and value <= kind.neutral:
        raise ConfigError(place, f"must be > {limit}")
    if side == "max" and kind.good == "small" and value >= kind.neutral:
        raise ConfigError(place, f"must be < {limit}")
