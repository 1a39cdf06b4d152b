"""The tests of lanes need 64 bits, as those of the whole package do."""

import jax

jax.config.update("jax_enable_x64", True)
