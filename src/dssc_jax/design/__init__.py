"""Table 1 of the article: synthesis and check of the DSSC's parameters from bounds."""

from dssc_jax.design.bounds import Bounds, Constants, derive
from dssc_jax.design.table1 import (
    Certificate,
    Free,
    Inequality,
    Parameters,
    Recipe,
    State,
    check,
    synthesise,
)

__all__ = [
    "Bounds",
    "Certificate",
    "Constants",
    "Free",
    "Inequality",
    "Parameters",
    "Recipe",
    "State",
    "check",
    "derive",
    "synthesise",
]
