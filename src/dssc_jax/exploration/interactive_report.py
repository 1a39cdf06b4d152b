"""A result as one file with linked brushing: no program behind it, and nothing from the network."""

import shlex

from bokeh.embed import file_html
from bokeh.layouts import column
from bokeh.models import Div
from bokeh.resources import INLINE
from markupsafe import escape

from dssc_jax.core.errors import ConfigError
from dssc_jax.exploration.brushing import Brushing
from dssc_jax.exploration.draw_table import DrawTable
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.result import Result

INTERACTIVE = "interactive.html"
OWN_SCRIPTS_ONLY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:; "
    "font-src data:"
)
"""A page's scripts are part of it, and may load and send nothing."""


def interactive_html(result: Result | Analysis) -> str:
    """The interactive report of a result.

    Args:
        result: A loaded or new result of a run or a sweep.

    Raises:
        ConfigError: It is an analysis, which has no draws to brush.
    """
    if isinstance(result, Analysis):
        raise ConfigError(result.study.name, f"draws of a run or a sweep can be brushed, not those of '{result.kind}'")
    study = result.study
    folder = shlex.quote(str(result.path or f"results/{study.name}"))
    head = Div(
        text=f"<h1>{escape(study.name)}</h1><p>{escape(study.config.description)}</p>"
        f"<p>required: {escape('; '.join(r.text for r in study.requirements) or 'nothing')}</p>"
        "<p>drag over the points to brush; Escape ends it. Orange crosses fail, blue circles pass.</p>",
        disable_math=True,
    )
    page = column(head, Brushing(DrawTable(result), folder).layout)
    text = file_html(page, INLINE, title=f"{study.name}: draws")
    policy = f'<meta http-equiv="Content-Security-Policy" content="{OWN_SCRIPTS_ONLY}">'
    return text.replace("<head>", f"<head>\n    {policy}", 1)
