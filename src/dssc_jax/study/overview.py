"""A study on one page of text, as ``print(study)`` shows it."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dssc_jax.study.actuators import section_of, tables_of
from dssc_jax.study.expressions import MARK
from dssc_jax.study.numbers import Number
from dssc_jax.study.slots import SLOTS

if TYPE_CHECKING:
    from dssc_jax.study.study import Study

MOST_ROWS = 12  # most rows of a section
MOST_NUMBERS = 6  # most numbers of a part
WIDTH = 116  # most characters of a line
ABSENT = ("none", "ideal")
"""Kinds of parts that do nothing."""


def overview(study: "Study") -> str:
    """A study in about fifty lines: clock, parts, uncertain numbers, numbers by expressions, axes and requirements.

    Sections without rows are left out.
    """
    clock = study.config.loop
    title = f"{study.name}: {study.config.description}" if study.config.description else study.name
    draws = f"{study.config.draws:,} draws ({study.config.sampling}, seed {study.config.seed})"
    time = f"{clock.duration:g} s, sampled every {clock.sample_time:g} s"
    law_rows = [number_row(study.numbers[name], law) for name, law in study.written_laws.items()]
    sections = [
        section_text("loop", part_rows(study)),
        section_text("uncertain", law_rows),
        section_text("follows from parameters", expression_rows(study)),
        section_text("swept", axis_rows(study)),
        section_text("required", [(requirement.text,) for requirement in study.requirements]),
    ]
    return "\n\n".join([f"{title}\n{draws} of {time}", *filter(None, sections)])


def section_text(title: str, rows: Sequence[tuple[str, ...]]) -> str:
    """Text of a section: its title, and the first :data:`MOST_ROWS` rows in aligned columns; empty without rows.

    Args:
        title: Title of the section.
        rows: Rows of cells, all of the same length.
    """
    if not rows:
        return ""
    visible_rows = rows[:MOST_ROWS]
    widths = [max(map(len, column)) for column in zip(*visible_rows, strict=True)]
    lines = [title]
    for row in visible_rows:
        line = "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        lines.append(f"  {line}" if len(line) <= WIDTH else f"  {line[: WIDTH - 4]} ...")
    if len(rows) > MOST_ROWS:
        lines.append(f"  ... and {len(rows) - MOST_ROWS} more")
    return "\n".join(lines)


def part_rows(study: "Study") -> list[tuple[str, ...]]:
    """One row for each part that does something: section, kinds, and the first :data:`MOST_NUMBERS` numbers."""
    rows = []
    for slot in SLOTS:
        kinds = [str(part.get("kind", "by channel")) for part in tables_of(study.config, slot)]
        if all(kind in ABSENT for kind in kinds):
            continue
        section = section_of(study.config, slot)
        names = [name for name in study.numbers if name.startswith(f"{section}.")]
        values = []
        for name in names[:MOST_NUMBERS]:
            name_in_section = name.removeprefix(f"{section}.")
            values.append(f"{name_in_section} = {content_text(study.numbers[name])}")
        if len(names) > MOST_NUMBERS:
            values.append("...")
        rows.append((section, " + ".join(kinds), ", ".join(values)))
    return rows


def content_text(number: Number) -> str:
    """Value, law or expression of a number, as text; an expression without its leading ``=``."""
    if number.expression:
        return number.expression.text.removeprefix(MARK).strip()
    return f"{number.value:.6g}" if isinstance(number.value, float) else str(number.value)


def number_row(number: Number, text: object) -> tuple[str, ...]:
    """Row of a number: its name, its values in words, its unit and its meaning.

    Args:
        number: The number.
        text: Values of the number, such as a law or the ends of an axis.
    """
    return number.name, str(text), visible_unit(number), number.quantity.meaning


def visible_unit(number: Number) -> str:
    """Unit of a number; empty for a dimensionless number, whose unit is ``1``."""
    return "" if number.quantity.unit == "1" else number.quantity.unit


def expression_rows(study: "Study") -> list[tuple[str, ...]]:
    """One row for each number that follows from parameters: its name, expression, and value or range."""
    rows = []
    for name, number in study.numbers.items():
        if number.expression:
            low, high = number.expression.support
            values = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
            rows.append((name, f"= {content_text(number)}", f"{values} {visible_unit(number)}".rstrip()))
    return rows


def axis_rows(study: "Study") -> list[tuple[str, ...]]:
    """One row for each axis: name, ends and number of values, unit and meaning of its number."""
    rows = []
    for name, values in study.axes.items():
        text = f"{min(values):g} to {max(values):g}, {len(values)} values"
        rows.append(number_row(study.numbers[name], text))
    return rows
