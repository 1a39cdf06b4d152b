"""The candidates among many that fail least often."""

from dssc_jax.analyses.selection.selection import Selection, select

__all__ = ["Selection", "select"]
