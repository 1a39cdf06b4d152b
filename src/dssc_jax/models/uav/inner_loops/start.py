"""The start of an inner loop's integrals: the study's numbers alone, or added to the equilibrium of the draw."""

from enum import StrEnum

import jax


@jax.tree_util.register_static
class Start(StrEnum):
    """The values to which the study's start values of the integrals are added: zero, or those in the equilibrium."""

    ZERO = "zero"
    SETTLED = "settled"
