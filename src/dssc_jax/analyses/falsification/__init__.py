"""Falsification: search for the draw on which the loop misses its requirements most."""
