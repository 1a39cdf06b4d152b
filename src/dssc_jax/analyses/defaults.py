"""Defaults and limits of the settings of analyses and reports; the command line shows the same numbers.

This module imports nothing, so that the command line's help is fast.
"""

POINTS, BISECTIONS = 17, 14
"""Margin: values of the bracketing grid, and bisections of the cell that contains the first failure."""
MOST_POINTS, MOST_BISECTIONS = 1000, 52

CANDIDATES, TUNING_DRAWS = 64, 64
"""Comparison: gains tried for each controller, and draws on which each is tried."""
MOST_CANDIDATES = 100_000
"""Largest number of candidates, or of draws for each."""

BUDGET, LEAST_BUDGET, MOST_BUDGET = 1000, 32, 10**7
"""Simulations of a falsification: default, least and most."""

WORST_DRAWS = 3
"""Worst draws that a report simulates again."""

ROUNDS = 5
"""Largest number of rounds of a robust tuning."""

PARTICLES, MOVES, REPEATS, PLAIN = 200, 5, 20, 4096
"""Splitting: particles of each repeat, moves of a clone at each level, independent repeats, plain draws."""
LEAST_PARTICLES, LEAST_REPEATS = 10, 10

VARIATION, MOST_WEIGHTED, FEWER_PLAIN = 0.1, 20_000, 512
"""Importance sampling: coefficient of variation to reach, largest number of weighted points, plain draws."""

WIDTH, MOST_STRATIFIED = 0.02, 1_000_000
"""Failure probability: width of the interval, and largest number of draws in the strata."""

RACED, KEPT, INDIFFERENCE, MOST_RACED = 1024, 10, 0.02, 1_000_000
"""Selection: candidates, how many are chosen, difference that does not matter, largest number of simulations."""

HALVINGS = 3
"""Region: how often the cells of the coarse lattice are halved."""

SEGMENTS, CLIMBS = 100, 10
"""Worst wind: parts of the flight in each of which a wind is constant, and largest number of steps of a climb."""
LEAST_SEGMENTS, MOST_SEGMENTS, MOST_CLIMBS = 2, 400, 1000
LIMIT = 0.05
"""Laws: largest failure probability allowed."""

CELLS, MOST_CELLS, SIGMA = 10_000, 10**7, 3.0
"""Worst loop: parts of box and frequencies for each loop; standard deviations at which laws without ends are cut."""
DERIVATIVES, MOST_LINEARISED = 1_000_000, 10**8
"""Worst loop: derivatives that the default number of points takes; largest number of points."""
