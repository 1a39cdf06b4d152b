"""What analyses do unless told otherwise, and how much they may be asked for; the command line shows the same numbers.

Nothing is imported here: help is to be instant.
"""

POINTS, BISECTIONS = 17, 14
"""Of a margin: values of the bracketing grid, halvings of the cell that holds the first failure."""
MOST_POINTS, MOST_BISECTIONS = 1000, 52

CANDIDATES, TUNING_DRAWS = 64, 64
"""Of a comparison: gains tried for each controller, and draws on which each is tried."""
MOST_CANDIDATES = 100_000
"""Candidates, or draws of each."""

BUDGET, LEAST_BUDGET, MOST_BUDGET = 1000, 32, 10**7
"""Simulations of a falsification."""

ROUNDS = 5
"""Of a robust tuning, at most."""

PARTICLES, MOVES, REPEATS, PLAIN = 200, 5, 20, 4096
"""Of a splitting: particles of each repeat, steps of a clone at each level, independent repeats, plain draws."""
LEAST_PARTICLES, LEAST_REPEATS = 10, 10
