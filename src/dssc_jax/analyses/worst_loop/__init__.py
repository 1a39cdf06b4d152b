"""Worst case of the linearised loop over the box of its laws: the worst values found, and bounds for all of it."""

from dssc_jax.analyses.worst_loop.result import WorstLoop
from dssc_jax.analyses.worst_loop.worst_loop import worst_loop

__all__ = ["WorstLoop", "worst_loop"]
