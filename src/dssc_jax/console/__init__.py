"""Terminal output for people."""

from dssc_jax.console.analyses import show_comparison, show_rare, show_sensitivity
from dssc_jax.console.environment import environment, machine, show_environment
from dssc_jax.console.loops import show_loop
from dssc_jax.console.margins import show_margin_contest, show_margins, show_theory
from dssc_jax.console.regions import show_region
from dssc_jax.console.results import show_draw, show_figures, show_result, show_verification
from dssc_jax.console.searches import show_falsification, show_tuning
from dssc_jax.console.terminal import (
    announce_compiling,
    notify,
    output,
    progress_bar,
    show_files,
    show_page,
    show_table,
)
from dssc_jax.results.summary import jsonable

__all__ = [
    "announce_compiling",
    "environment",
    "jsonable",
    "machine",
    "notify",
    "output",
    "progress_bar",
    "show_comparison",
    "show_draw",
    "show_environment",
    "show_falsification",
    "show_figures",
    "show_files",
    "show_loop",
    "show_margin_contest",
    "show_margins",
    "show_page",
    "show_rare",
    "show_region",
    "show_result",
    "show_sensitivity",
    "show_table",
    "show_theory",
    "show_tuning",
    "show_verification",
]
