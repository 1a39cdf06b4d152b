"""The requirement that a margin of the linearised loop is large enough, or a peak small enough."""

import math
import re

from dssc_jax.closed_loop.break_points import BreakPoint, place_names
from dssc_jax.closed_loop.margin_kinds import MARGIN_KINDS, LoopMargin, MarginKind
from dssc_jax.closed_loop.margin_measures import margin_measure
from dssc_jax.closed_loop.requirements import Requirement
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.study.schema import RequirementTable

QUANTITY = re.compile(r"\s*(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?P<unit>\S*)\s*")


def margin_requirement(table: RequirementTable, place: str, channels: tuple[str, ...]) -> Requirement:
    """The requirement of a margin.

    Args:
        table: The requirement, which has a margin.
        place: Its place in the study.
        channels: Names of the channels; one empty name for a plant with one channel.

    Raises:
        ConfigError: The margin, the break point or the bound is not valid.
    """
    name = str(table.margin)
    if name not in MARGIN_KINDS:
        raise ConfigError(f"{place}.margin", f"unknown margin '{name}'; {nearest(name, MARGIN_KINDS)}")
    kind = MARGIN_KINDS[name]
    known = place_names(channels)
    usual = BreakPoint.INPUT if channels == ("",) else ""
    at = table.at if table.at is not None else usual
    if at not in known:
        rule = f"names where the loop is broken, and must be one of {', '.join(known)}"
        raise ConfigError(f"{place}.at", f"{rule}; got {at!r}" if at else rule)
    measure = margin_measure(LoopMargin(kind, at), usual)
    side = "max" if table.max is not None else "min"
    stated = table.max if table.max is not None else table.min
    assert stated is not None  # held by the table
    value = bound_value(kind, stated, f"{place}.{side}")
    require_attainable(kind, value, stated, f"{place}.{side}")
    require_stable(kind, value, side, f"{place}.{side}")
    written = number_text(stated)
    if side == "max":
        return Requirement(measure, maximum=value, written=written)
    return Requirement(measure, minimum=value, written=written)


def number_text(stated: float | str) -> str:
    """A bound as text, if it was written with a unit; empty otherwise."""
    return " ".join(stated.split()) if isinstance(stated, str) else ""


def bound_value(kind: MarginKind, stated: float | str, place: str) -> float:
    """A bound in the margin's unit.

    Raises:
        ConfigError: it is no number with one of the margin's units.
    """
    if not isinstance(stated, str):
        return stated
    units = ", ".join(unit for unit in kind.units if unit != "1")
    match = QUANTITY.fullmatch(stated)
    unit = match["unit"] or kind.unit if match else ""
    if match is None or unit not in kind.units:
        rule = f"must be a number [{kind.unit}], or a text of a number and one of {units}"
        raise ConfigError(place, f"{rule}; got {stated!r}")
    return kind.units[unit](float(match["number"]))


def require_attainable(kind: MarginKind, value: float, stated: float | str, place: str) -> None:
    """Require that a loop can have the bound as its margin.

    Args:
        kind: The margin.
        value: The bound in its unit.
        stated: The bound as the study has it.
        place: Its place.

    Raises:
        ConfigError: it is not finite, negative, or beyond the largest margin; a plain number gets a unit as hint.
    """
    if not math.isfinite(value):
        raise ConfigError(place, f"must be a finite number [{kind.unit}], got {value:g}")
    written = number_text(stated) or f"{value:g}"
    if value < 0.0:
        raise ConfigError(place, f"must be >= 0 {kind.unit}, as every {kind.meaning} is; got {written}")
    if value <= kind.most:
        return
    rule = f"must be <= {kind.most:.6g} {kind.unit}, the largest {kind.meaning} there is; got {written}"
    if not isinstance(stated, str):
        for unit, converted in kind.units.items():
            if converted(stated) <= kind.most:
                rule += f'; did you mean "{stated:g} {unit}"?'
    raise ConfigError(place, rule)


def require_stable(kind: MarginKind, value: float, side: str, place: str) -> None:
    """Require that a bound excludes loops at the limit of stability.

    Raises:
        ConfigError: it does not, so that an unstable loop would meet it.
    """
    limit = f"{kind.neutral:g}, which loops at the limit of stability have; got {value:g}"
    if side == "min" and kind.good == "large" and value <= kind.neutral:
        raise ConfigError(place, f"must be > {limit}")
    if side == "max" and kind.good == "small" and value >= kind.neutral:
        raise ConfigError(place, f"must be < {limit}")
