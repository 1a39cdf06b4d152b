"""Formulas of signal temporal logic against rtamt."""
