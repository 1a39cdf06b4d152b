"""Figures as SVG elements in the colours of the page, for light mode, dark mode and paper."""

import io
import re
from collections.abc import Callable
from typing import Any

from markupsafe import Markup, escape
from matplotlib import rc_context
from matplotlib.figure import Figure

from dssc_jax.plotting import BLUE, GREEN, GREY, ORANGE, RED, STYLE

INK = "#010203"
"""Placeholder for the colour of the page's text."""
SVG_COLOURS: dict[str, str] = {
    INK: "currentColor",
    BLUE: "var(--blue)",
    ORANGE: "var(--orange)",
    GREEN: "var(--green)",
    RED: "var(--red)",
    GREY: "var(--grey)",
}
"""Colour of the page in place of each colour of a figure."""
TEXT_COLOURS = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")
"""Matplotlib's settings of colours that are those of the page's text."""
BACKGROUNDS = ("figure.facecolor", "axes.facecolor", "savefig.facecolor")
"""Matplotlib's settings of backgrounds, which are transparent on the page."""
MANY_DIGITS = re.compile(r"(\.\d\d)\d+")
"""Digits of a coordinate below a hundredth of a point, which no screen or printer shows."""


def inline_svg(draw: Callable[[], Figure], text: str, prefix: str) -> Markup:
    """Draw a figure as an ``<svg>`` element.

    Args:
        draw: Makes the figure.
        text: Alternative text that describes the figure.
        prefix: Prefix of the identifiers in the element, unique on the page.
    """
    settings: dict[Any, Any] = {**STYLE, "svg.hashsalt": prefix}
    settings |= dict.fromkeys(TEXT_COLOURS, INK)
    settings |= dict.fromkeys(BACKGROUNDS, "none")
    buffer = io.StringIO()
    with rc_context(settings):
        draw().savefig(buffer, format="svg")
    source = buffer.getvalue()
    box_match = re.search(r'viewBox="([\d. -]+)"', source)
    box = box_match[1] if box_match else "0 0 1 1"
    end_of_opening = source.index(">", source.index("<svg"))
    content = page_content(source[end_of_opening + 1 :], prefix)
    opening = '<svg class="plot" role="img" aria-label="{}" viewBox="{}" xmlns:xlink="http://www.w3.org/1999/xlink">'
    return Markup(opening).format(escape(text), box) + Markup(content)


def page_content(content: str, prefix: str) -> str:
    """The part of a figure's SVG after its opening tag, made fit for the page.

    Metadata and needless digits are removed, and the figure's colours are replaced by those of the page. Identifiers
    get a prefix, so that no two figures on a page share an identifier.

    Args:
        content: The SVG after its opening tag.
        prefix: The prefix.
    """
    content = re.sub(r"<metadata>.*?</metadata>", "", content, flags=re.DOTALL)
    content = re.sub(r' d="[^"]*"', lambda path: MANY_DIGITS.sub(r"\1", path[0]), content)
    content = re.sub(r'( id="|url\(#|href="#)', rf"\1{prefix}-", content)
    for colour, name in SVG_COLOURS.items():
        content = re.sub(colour, name, content, flags=re.IGNORECASE)
    return content
