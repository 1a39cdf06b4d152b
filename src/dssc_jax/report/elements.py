"""Elements of the page: sections, tables, figures and numbers. All text is escaped by htpy."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import htpy as h

from dssc_jax.results.schema import name_with_unit
from dssc_jax.statistics import CONFIDENCE, rounded_probability

MINUS = "\N{MINUS SIGN}"
LEVEL = f"{100 * CONFIDENCE:g} %"
"""Confidence of intervals, in words."""


class Section(NamedTuple):
    """A part of the page with a heading.

    Args:
        key: Identifier of the heading, for links.
        heading: The heading, which also stands in the contents list.
        body: Anything that htpy can render.
    """

    key: str
    heading: str
    body: h.Node


def number(value: float | None) -> str:
    """Format a number with four significant digits; None, the value of a draw that ended early, becomes infinite."""
    if value is None:
        return "∞"
    if math.isnan(value):
        return "none"
    if math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    return f"{value:.4g}".replace("-", MINUS)


def with_unit(value: float, unit: str) -> str:
    """Format a number, followed by its unit unless the unit is 1."""
    return number(value) if unit in ("", "1") else f"{number(value)} {unit}"


def number_with_meaning(name: h.Node, meaning: str, unit: str) -> list[h.Node]:
    """Show the name of a number, and below it its meaning and unit.

    Args:
        name: Name of the number.
        meaning: Meaning in words.
        unit: Unit.
    """
    return [name, h.span(".meaning")[name_with_unit(meaning, unit)]]


def probability_text(share: float, bounds: Sequence[float]) -> str:
    """Format a probability; in place of 0, the upper bound of the interval is written as "≤ BOUND".

    Args:
        share: The probability, as the share of failed draws.
        bounds: Lower and upper bound of the interval.
    """
    _, upper = bounds
    return number(share) if share else f"≤ {upper:.3g}"


def interval(bounds: Sequence[float]) -> str:
    """Format the interval of a probability, as "LOW to HIGH"."""
    low, high = bounds
    return f"{rounded_probability(low)} to {rounded_probability(high)}"


def count_text(count: int, noun: str) -> str:
    """Format a count and its noun, singular or plural."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def table(caption: str, head: Sequence[h.Node], rows: Sequence[Sequence[h.Node]], text_columns: int = 1) -> h.Element:
    """Make a table with caption and headers; the first cell of a row is the header of the row.

    Args:
        caption: The caption.
        head: Headers of the columns.
        rows: The cells, one sequence for each row.
        text_columns: Number of leading columns with text; the others contain numbers and are aligned to the right.
    """
    classes = ["words" if index < text_columns else None for index in range(len(head))]
    headers = [h.th(scope="col", class_=class_)[text] for text, class_ in zip(head, classes, strict=True)]
    body = [table_row(row, classes) for row in rows]
    return scrollable(caption, h.table[h.caption[caption], h.thead[h.tr[headers]], h.tbody[body]])


def table_row(row: Sequence[h.Node], classes: Sequence[str | None]) -> h.Element:
    """Make a row of a table, whose first cell is a header.

    Args:
        row: Content of each cell.
        classes: CSS class of each column; None: no class.
    """
    name, *values = row
    cells = [h.td(class_=class_)[value] for value, class_ in zip(values, classes[1:], strict=True)]
    return h.tr[h.th(scope="row", class_=classes[0])[name], cells]


def figure(picture: h.Node, caption: h.Node) -> h.Element:
    """Make a picture with its caption."""
    return h.figure[picture, h.figcaption[caption]]


def scrollable(name: str, content: h.Node) -> h.Element:
    """Wrap content that may be wider than a screen, so that it scrolls within the page, also by keyboard.

    Args:
        name: Name of the content, for screen readers.
        content: The content.
    """
    return h.div(".scroll", role="region", tabindex="0", aria_label=name)[content]


def facts(pairs: Sequence[tuple[str, h.Node]], class_: str = "facts") -> h.Element:
    """Make a list of names with their values."""
    return h.dl(class_=class_)[(h.div[h.dt[name], h.dd[value]] for name, value in pairs)]


def collapsible(summary: str, body: h.Node, on_paper: bool = False) -> h.Element:
    """Make content that is hidden behind its summary until a reader expands it.

    Args:
        summary: The line that is always shown.
        body: The content.
        on_paper: Whether the content is printed even while it is hidden.
    """
    return h.details(class_="printed" if on_paper else None)[h.summary[summary], body]
