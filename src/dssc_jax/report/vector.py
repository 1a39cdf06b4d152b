"""Figures as SVG inside the page, in the page's own colours, so that they suit light mode, dark mode and paper."""

import io
import re
from collections.abc import Callable

from markupsafe import Markup, escape
from matplotlib import rc_context
from matplotlib.figure import Figure

from dssc_jax.plotting import BLUE, GREEN, GREY, ORANGE, RED, STYLE

INK = "#010203"  # placeholder for the text's colour until the page sets it
SVG_COLOURS = {
    INK: "currentColor",
    BLUE: "var(--blue)",
    ORANGE: "var(--orange)",
    GREEN: "var(--green)",
    RED: "var(--red)",
    GREY: "var(--grey)",
}
INKED = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")
CLEAR = ("figure.facecolor", "axes.facecolor", "savefig.facecolor")
DIGITS = re.compile(r"(\.\d\d)\d+")  # a hundredth of a point is less than a screen or a printer shows


def inline(draw: Callable[[], Figure], text: str, prefix: str) -> Markup:
    """A figure as an ``<svg>`` element.

    Args:
        draw: Makes the figure.
        text: Alternative text that describes the figure.
        prefix: Prefix of its identifiers, unique on the page.
    """
    look = {**STYLE, **dict.fromkeys(INKED, INK), **dict.fromkeys(CLEAR, "none")}
    buffer = io.StringIO()
    with rc_context({**look, "svg.hashsalt": prefix}):
        draw().savefig(buffer, format="svg")
    source = buffer.getvalue()
    box = re.search(r'viewBox="([\d. -]+)"', source)
    inside = source[source.index(">", source.index("<svg")) + 1 :]
    inside = re.sub(r"<metadata>.*?</metadata>", "", inside, flags=re.DOTALL)
    inside = re.sub(r' d="[^"]*"', lambda path: DIGITS.sub(r"\1", path[0]), inside)
    inside = re.sub(r'( id="|url\(#|href="#)', rf"\1{prefix}-", inside)
    for colour, name in SVG_COLOURS.items():
        inside = re.sub(colour, name, inside, flags=re.IGNORECASE)
    opening = '<svg class="plot" role="img" aria-label="{}" viewBox="{}" xmlns:xlink="http://www.w3.org/1999/xlink">'
    return Markup(opening).format(escape(text), box[1] if box else "0 0 1 1") + Markup(inside)
