"""A study on one page of text, as ``print(study)`` shows it."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from dssc_jax.study.actuators import section_of, tables_of
from dssc_jax.study.expressions import MARK
from dssc_jax.study.numbers import Number
from dssc_jax.study.slots import SLOTS

if TYPE_CHECKING:
    from dssc_jax.study.study import Study

MOST_ROWS = 12  # of a section
MOST_NUMBERS = 6  # of a part
WIDTH = 116
ABSENT = ("none", "ideal")
"""Kinds of parts that do nothing."""


def overview(study: "Study") -> str:
    """The study's clock, parts, uncertain numbers, axes and requirements in at most some fifty lines."""
    clock = study.config.loop
    title = f"{study.name}: {study.config.description}" if study.config.description else study.name
    draws = f"{study.config.draws:,} draws ({study.config.sampling}, seed {study.config.seed})"
    time = f"{clock.duration:g} s, sampled every {clock.sample_time:g} s"
    sections = [
        section("loop", part_rows(study)),
        section("uncertain", [number_row(study.numbers[name], law) for name, law in study.written_laws.items()]),
        section("follows from parameters", expression_rows(study)),
        section("swept", axis_rows(study)),
        section("required", [(requirement.text,) for requirement in study.requirements]),
    ]
    return "\n\n".join([f"{title}\n{draws} of {time}", *filter(None, sections)])


def section(title: str, rows: Iterable[tuple[str, ...]]) -> str:
    """Rows under a title, in columns; empty without rows."""
    visible_rows = list(rows)
    if not visible_rows:
        return ""
    hidden_count = len(visible_rows) - MOST_ROWS
    visible_rows = visible_rows[:MOST_ROWS]
    widths = [max(len(row[column]) for row in visible_rows) for column in range(len(visible_rows[0]))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in visible_rows
    ]
    lines += [f"... and {hidden_count} more"] if hidden_count > 0 else []
    return "\n".join([title, *(f"  {clipped_line(line)}" for line in lines)])


def clipped_line(line: str) -> str:
    """The beginning of a line that is too long."""
    return line if len(line) <= WIDTH else f"{line[: WIDTH - 4]} ..."


def part_rows(study: "Study") -> list[tuple[str, ...]]:
    """Kind and first numbers of each part that does something."""
    rows = []
    for slot in SLOTS:
        kinds = [str(part.get("kind", "by channel")) for part in tables_of(study.config, slot)]
        if all(kind in ABSENT for kind in kinds):
            continue
        section = section_of(study.config, slot)
        names = [name for name in study.numbers if name.startswith(f"{section}.")]
        values = [f"{name.partition('.')[2]} = {content(study.numbers[name])}" for name in names[:MOST_NUMBERS]]
        values += ["..."] if len(names) > MOST_NUMBERS else []
        rows.append((section, " + ".join(kinds), ", ".join(values)))
    return rows


def content(number: Number) -> str:
    """Value, law or expression of a number."""
    if number.expression:
        return number.expression.text.removeprefix(MARK).strip()
    return f"{number.value:.6g}" if isinstance(number.value, float) else str(number.value)


def number_row(number: Number, text: object) -> tuple[str, ...]:
    """Name, content, unit and meaning of a number."""
    unit = "" if number.quantity.unit == "1" else number.quantity.unit
    return number.name, str(text), unit, number.quantity.meaning


def expression_rows(study: "Study") -> list[tuple[str, ...]]:
    """Each number that follows from parameters: its expression, and its value or range."""
    rows = []
    for name, number in study.numbers.items():
        if number.expression:
            low, high = number.expression.support
            values = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
            unit = "" if number.quantity.unit == "1" else number.quantity.unit
            rows.append((name, f"= {content(number)}", f"{values} {unit}".rstrip()))
    return rows


def axis_rows(study: "Study") -> list[tuple[str, ...]]:
    """Name, ends and number of values of each axis."""
    rows = []
    axes: Mapping[str, tuple[float, ...]] = study.axes
    for name, values in axes.items():
        number = study.numbers[name]
        text = f"{min(values):g} to {max(values):g}, {len(values)} values"
        rows.append(number_row(number, text))
    return rows
