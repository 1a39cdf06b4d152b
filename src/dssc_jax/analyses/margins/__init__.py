"""Robustness margins: how far one number of the loop may go before a draw fails, for every draw.

The walk goes from the first bound, the safe end, to the second. A draw's critical value is the last value found to pass
before the first failure, bracketed on a grid and narrowed by bisection, all draws at once. A draw that passes the whole
way, or fails from the start, is censored: it stays in every statistic, beyond the end or before the start.
"""

from dssc_jax.analyses.margins.joined import join_margins, margin_settings, part_margins
from dssc_jax.analyses.margins.result import Margins
from dssc_jax.analyses.margins.search import Censoring, Critical, Walk, search_critical
from dssc_jax.analyses.margins.simulated import margin

__all__ = [
    "Censoring",
    "Critical",
    "Margins",
    "Walk",
    "join_margins",
    "margin",
    "margin_settings",
    "part_margins",
    "search_critical",
]
