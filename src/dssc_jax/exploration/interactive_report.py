"""Write the interactive report of a result: one HTML file with linked brushing."""

import shlex

from bokeh.embed import components
from bokeh.layouts import column
from bokeh.models import Div, LayoutDOM
from bokeh.resources import Resources
from markupsafe import escape

from dssc_jax.core.errors import ConfigError
from dssc_jax.exploration.brushing import Brushing
from dssc_jax.exploration.draw_table import DrawTable
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.result import Result

INTERACTIVE = "interactive.html"
"""Usual name of the report in the results folder."""
CONTENT_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:; "
    "font-src data:"
)
"""Content security policy of a page: its scripts are part of it, and may neither load nor send anything."""
PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta charset="utf-8">
<title>{title}</title>
<script>
{library}
</script>
</head>
<body>
{place}
{script}
</body>
</html>
"""
"""Template of a page. Bokeh's own template would load files of all imported extensions, such as Panel's."""


def interactive_html(result: Result | Analysis) -> str:
    """Return the interactive report of a result as an HTML page.

    The page needs no network, and no program behind it.

    Args:
        result: A loaded or new result of a run or a sweep.

    Raises:
        ConfigError: The result is that of an analysis, which has no draws to brush.
    """
    if isinstance(result, Analysis):
        raise ConfigError(result.study.name, f"draws of a run or a sweep can be brushed, not those of '{result.kind}'")
    study = result.study
    folder = shlex.quote(str(result.path or f"results/{study.name}"))
    required = "; ".join(requirement.text for requirement in study.requirements) or "nothing"
    head = Div(
        text=f"<h1>{escape(study.name)}</h1><p>{escape(study.config.description)}</p>"
        f"<p>required: {escape(required)}</p>"
        "<p>drag over the points or over the parallel axes to brush, with Shift to add; Escape ends it. "
        "Orange fails, blue passes; a cross or a circle is a draw.</p>",
        disable_math=True,
    )
    return standalone_page(f"{study.name}: draws", column(head, Brushing(DrawTable(result), folder).layout))


def standalone_page(title: str, page: LayoutDOM) -> str:
    """Return an HTML page that contains a layout of Bokeh and all scripts of Bokeh, and needs no network.

    Args:
        title: Title of the page, in plain text.
        page: The layout.
    """
    script, place = components(page)
    library = "\n".join(Resources(mode="inline", components=["bokeh", "bokeh-widgets"]).js_raw)
    return PAGE.format(policy=CONTENT_POLICY, title=escape(title), library=library, place=place, script=script)
