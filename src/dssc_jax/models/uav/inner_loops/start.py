"""How the integrals of an inner loop start: at their numbers, or at the equilibrium of the draw."""

from enum import StrEnum

import jax


@jax.tree_util.register_static
class Start(StrEnum):
    """Where the integrals start; their numbers in the study add to it."""

    ZERO = "zero"
    SETTLED = "settled"
