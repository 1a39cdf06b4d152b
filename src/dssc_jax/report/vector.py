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
SVG_COLOURS = {
    INK: "currentColor",
    BLUE: "var(--blue)",
    ORANGE: "var(--orange)",
    GREEN: "var(--green)",
    RED: "var(--red)",
    GREY: "var(--grey)",
}
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
    box = re.search(r'viewBox="([\d. -]+)"', source)
    inside = source[source.index(">", source.index("<svg")) + 1 :]
    inside = re.sub(r"<metadata>.*?</metadata>", "", inside, flags=re.DOTALL)
    inside = re.sub(r' d="[^"]*"', lambda path: MANY_DIGITS.sub(r"\1", path[0]), inside)
    inside = re.sub(r'( id="|url\(#|href="#)', rf"\1{prefix}-", inside)
    for colour, name in SVG_COLOURS.items():
        inside = re.sub(colour, name, inside, flags=re.IGNORECASE)
    opening = '<svg class="plot" role="img" aria-label="{}" viewBox="{}" xmlns:xlink="http://www.w3.org/1999/xlink">'
    return Markup(opening).format(escape(text), box[1] if box else "0 0 1 1") + Markup(inside)
