"""Machine code beside plain XLA."""

from contextlib import contextmanager

import jax
import numpy as np

from dssc_jax.lanes.interface import AXIS
from dssc_jax.lanes.lanes import CompiledLanes

LANES = 37  # no whole number of vectors
ROUNDING = 1e-12
"""Relative; a few hundred float64 operations."""

RNG = np.random.default_rng(1)
X, Y = RNG.normal(size=LANES), RNG.normal(size=LANES)


@contextmanager
def arithmetic(precision=64):
    """JAX's precision in bits, without warnings of overflows."""
    with jax.enable_x64(precision == 64), np.errstate(all="ignore"):
        yield


def both(function, *columns, **options):
    """Machine code and plain XLA."""
    types = [jax.ShapeDtypeStruct((), column.dtype) for column in columns]
    lanes = CompiledLanes(function, *types, **options).start(columns, len(columns[0]), 2)()
    return lanes, jax.tree.map(np.asarray, jax.jit(jax.vmap(function, axis_name=AXIS))(*columns))
