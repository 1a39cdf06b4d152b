"""A compiler for many lanes of one JAX function: its trace becomes machine code, one lane in each element of a vector.

This package imports nothing of the others. :func:`compile` is its front door.
"""

from dssc_jax.lanes.batched import compile
from dssc_jax.lanes.unsupported import Unsupported

__all__ = ["Unsupported", "compile"]
