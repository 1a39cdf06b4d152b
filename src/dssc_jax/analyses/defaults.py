"""Defaults and limits of the settings of analyses and reports; the command line shows the same numbers.

This module imports nothing, so that the command line's help is fast.
"""

# margin
POINTS = 17  # values of the bracketing grid
MOST_POINTS = 1000
BISECTIONS = 14  # bisections of the cell that contains the first failure
MOST_BISECTIONS = 52

# comparison
CANDIDATES = 64  # gains tried for each controller
TUNING_DRAWS = 64  # draws on which each is tried
MOST_CANDIDATES = 100_000  # largest number of candidates, or of draws for each

# falsification
BUDGET = 1000  # simulations
LEAST_BUDGET = 32
MOST_BUDGET = 10**7
WORST_DRAWS = 3  # worst draws that a report simulates again

# robust tuning
ROUNDS = 5  # largest number of rounds

# rare failures by splitting
PARTICLES = 200  # particles of each repeat
LEAST_PARTICLES = 10
MOVES = 5  # moves of a clone at each level
REPEATS = 20  # independent repeats
LEAST_REPEATS = 10
PLAIN = 4096  # plain draws

# rare failures by importance sampling
VARIATION = 0.1  # coefficient of variation to reach
MOST_WEIGHTED = 20_000  # largest number of weighted points
FEWER_PLAIN = 512  # plain draws

# failure probability
WIDTH = 0.02  # width of the interval
MOST_STRATIFIED = 1_000_000  # largest number of draws in the strata

# selection
RACED = 1024  # candidates
KEPT = 10  # how many are chosen
INDIFFERENCE = 0.02  # difference that does not matter
MOST_RACED = 1_000_000  # largest number of simulations

# region
HALVINGS = 3  # how often the cells of the coarse lattice are halved

# worst wind
SEGMENTS = 100  # parts of the flight, in each of which a wind is constant
LEAST_SEGMENTS = 2
MOST_SEGMENTS = 400
CLIMBS = 10  # largest number of steps of a climb
MOST_CLIMBS = 1000

# laws
LIMIT = 0.05  # largest failure probability allowed

# worst loop
CELLS = 10_000  # parts of box and frequencies for each loop
MOST_CELLS = 10**7
SIGMA = 3.0  # standard deviations at which laws without ends are cut
DERIVATIVES = 1_000_000  # derivatives that the default number of points takes
MOST_LINEARISED = 10**8  # largest number of points
