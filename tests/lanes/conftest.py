"""The tests of lanes need 64 bits, as those of the whole package do, and verify each program after each pass."""

import os

import jax

os.environ["DSSC_JAX_VERIFY"] = "1"
jax.config.update("jax_enable_x64", True)
