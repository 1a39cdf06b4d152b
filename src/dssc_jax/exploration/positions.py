"""The positions that a slider can take, and the changes of the study that positions of its sliders describe."""

import math
from collections.abc import Mapping
from typing import TypeAlias

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.exploration.sliders import MEDIAN, WIDTH, Slider
from dssc_jax.study import Study
from dssc_jax.study.laws import LAWS, Law, RangedLaw

POSITION_COUNT = 81
"""Number of positions of a slider between its ends, before rounding."""

Positions: TypeAlias = Mapping[Slider, float]
"""Position of each slider."""
Change: TypeAlias = float | dict[str, list[float]]
"""A new value of a number, or a new law."""


def study_changes(study: Study, positions: Positions) -> dict[str, Change]:
    """Return the changes of a study that positions of its sliders describe, by dotted name of the number.

    A slider at its start changes nothing, unless its number is swept.

    Args:
        study: The study, with its sweep.
        positions: Position of each slider.

    Raises:
        ConfigError: A law cannot be moved to its position.
    """
    changes: dict[str, Change] = {}
    parts_by_name: dict[str, dict[str, float]] = {}  # positions of the sliders of laws
    for slider, position in positions.items():
        if slider.part:
            parts_by_name.setdefault(slider.name, {})[slider.part] = float(position)
        elif position != slider.start or slider.name in study.axes:
            changes[slider.name] = float(position)
    for name, parts in parts_by_name.items():
        law = study.numbers[name].value
        assert isinstance(law, Law)  # only laws have parts
        law_table = changed_law(name, law, parts)
        if law_table is not None:
            changes[name] = law_table
    return changes


def changed_law(name: str, law: Law, parts: Mapping[str, float]) -> dict[str, list[float]] | None:
    """Return the table of a law at positions of its sliders; None if all of its sliders are at their start.

    A law with ranges always gives a table, which has single arguments in place of the ranges.

    Args:
        name: Dotted name of the number, for messages.
        law: The law in the study.
        parts: Positions by part, see :attr:`Slider.part`.

    Raises:
        ConfigError: The law cannot be moved to these positions.
    """
    if isinstance(law, RangedLaw):
        names = LAWS[law.kind].argument_names
        arguments = []
        for argument_name, middle in zip(names, law.arguments, strict=False):
            arguments.append(parts.get(argument_name, middle))
        return {law.kind: arguments}
    median = parts.get(MEDIAN, law.median)
    width = parts.get(WIDTH, 1.0)
    if (median, width) == (law.median, 1.0):
        return None
    try:
        moved_law = law.moved(median, width)
    except ValueError as error:
        raise ConfigError(name, str(error)) from None
    return {moved_law.kind: list(moved_law.arguments)}


def slider_positions(slider: Slider) -> tuple[float, ...]:
    """Return the positions of a slider in increasing order.

    The ends and the start are exact, and the other positions are rounded to four significant digits. No two positions
    have the same :func:`position_text`.
    """
    if slider.steps:
        return slider.steps
    if slider.log:
        logarithms = np.linspace(math.log(slider.low), math.log(slider.high), POSITION_COUNT)
        values = [math.exp(logarithm) for logarithm in logarithms]
    else:
        values = np.linspace(slider.low, slider.high, POSITION_COUNT).tolist()
    positions_by_text = {}
    for value in values[1:-1]:
        text = position_text(value)
        positions_by_text[text] = float(text)
    for value in (slider.low, slider.high, slider.start):  # an exact position takes the place of a rounded one
        positions_by_text[position_text(value)] = value
    return tuple(sorted(value for value in positions_by_text.values() if slider.low <= value <= slider.high))


def position_text(value: float) -> str:
    """Format a position as the page shows it, with four significant digits."""
    return f"{value:.4g}"
