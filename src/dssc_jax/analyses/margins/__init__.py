"""Robustness margins: how far a number of the loop can change before a draw fails, for every draw.

The number moves from the first bound, the safe end, to the second. A draw's critical value is the last passing value
found before the first failure. It is bracketed on a grid and refined by bisection, for all draws at once. A draw that
passes everywhere, or fails at the start, is censored: statistics count it as beyond the end or before the start.
"""

from dssc_jax.analyses.margins.joined import join_margins, margin_parts, split_margins
from dssc_jax.analyses.margins.result import Margins
from dssc_jax.analyses.margins.search import search_critical
from dssc_jax.analyses.margins.simulated import margin

__all__ = [
    "Margins",
    "join_margins",
    "margin",
    "margin_parts",
    "search_critical",
    "split_margins",
]
