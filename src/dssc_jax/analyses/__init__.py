"""Analyses of a study that are more than one run."""
