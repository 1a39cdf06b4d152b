"""Analyses that combine many simulations of a study."""
