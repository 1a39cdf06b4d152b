"""Elements of the page: sections, tables, figures and numbers. All text is escaped by htpy."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import htpy as h

from dssc_jax.statistics import CONFIDENCE, rounded_probability

MINUS = "\N{MINUS SIGN}"
LEVEL = f"{100 * CONFIDENCE:g} %"


class Section(NamedTuple):
    """A part of the page with a heading.

    Args:
        key: Its anchor.
        heading: The heading, also used in the contents list.
        body: Anything that htpy can render.
    """

    key: str
    heading: str
    body: h.Node


def number(value: float | None) -> str:
    """Format with four significant digits; a value missing from a draw is infinite."""
    if value is None or math.isinf(value):
        return "∞" if value is None or value > 0 else f"{MINUS}∞"
    return "none" if math.isnan(value) else f"{value:.4g}".replace("-", MINUS)


def with_unit(value: float, unit: str) -> str:
    """A number with its unit, if it has one."""
    return number(value) if unit in ("", "1") else f"{number(value)} {unit}"


def probability_text(share: float, bounds: Sequence[float]) -> str:
    """A probability as text for a cell: its upper bound if no draw failed, never 0."""
    return number(share) if share else f"≤ {bounds[1]:.3g}"


def interval(bounds: Sequence[float]) -> str:
    """The interval of a probability as text."""
    low, high = map(rounded_probability, bounds)
    return f"{low} to {high}"


def count_text(count: int, noun: str) -> str:
    """A count and its noun, singular or plural."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def table(caption: str, head: Sequence[h.Node], rows: Sequence[Sequence[h.Node]], words: int = 1) -> h.Element:
    """A table with its caption and headers; the first cell of a row is the row's header.

    Args:
        caption: The caption.
        head: The columns' headers.
        rows: The cells.
        words: Number of leading columns with words; the others contain numbers and are aligned to the right.
    """
    look = ["words" if i < words else None for i in range(len(head))]
    grid = h.table[
        h.caption[caption],
        h.thead[h.tr[(h.th(scope="col", class_=c)[text] for text, c in zip(head, look, strict=True))]],
        h.tbody[(row_of(row, look) for row in rows)],
    ]
    return scrolled(caption, grid)


def row_of(row: Sequence[h.Node], look: Sequence[str | None]) -> h.Element:
    """One row, with its header."""
    name, *values = row
    return h.tr[
        h.th(scope="row", class_=look[0])[name],
        (h.td(class_=c)[cell] for cell, c in zip(values, look[1:], strict=True)),
    ]


def figure(picture: h.Node, caption: h.Node) -> h.Element:
    """A picture with its caption."""
    return h.figure[picture, h.figcaption[caption]]


def scrolled(name: str, wide: h.Node) -> h.Element:
    """Wrap content that may be wider than a screen: it scrolls separately, also by keyboard."""
    return h.div(".scroll", role="region", tabindex="0", aria_label=name)[wide]


def facts(pairs: Sequence[tuple[str, h.Node]], class_: str = "facts") -> h.Element:
    """A list of names with their values."""
    return h.dl(class_=class_)[(h.div[h.dt[name], h.dd[value]] for name, value in pairs)]


def folded(summary: str, body: h.Node, on_paper: bool = False) -> h.Element:
    """Content that can be expanded; on paper it is open or omitted."""
    return h.details(class_="printed" if on_paper else None)[h.summary[summary], body]
