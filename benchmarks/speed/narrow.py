"""Vectors of 256 bits on a processor that has wider ones, to learn what others will see."""

import os

from dssc_jax.lanes.llvm import machine

VARIABLE = "DSSC_JAX_BENCHMARK_NARROW"
WANTED = VARIABLE in os.environ
FLAGS = ("-mno-avx512f",) if WANTED else ()
"""GCC's options for it."""


def narrow() -> None:
    """Let this process compile lanes as if the processor had no AVX-512."""
    features = machine.features()
    features.update({name: False for name in features if name.startswith(("avx512", "evex512"))})
