"""Falsification: the draws on which the loop misses its requirements most, hunted instead of drawn."""
