"""The start of an inner loop's integrals: the study's numbers alone, or added to the equilibrium of the draw."""

from enum import StrEnum

import jax


@jax.tree_util.register_static
class Start(StrEnum):
    """The choice of the integrals at the start.

    The study's start values are added to zeros, or to the values that the integrals have in the equilibrium.
    """

    ZERO = "zero"
    SETTLED = "settled"
