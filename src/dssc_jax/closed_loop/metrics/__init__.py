"""Metrics of a draw in streaming form, their windows, the requirements on them, and formulas of temporal logic."""
