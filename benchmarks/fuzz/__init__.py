"""Random programs of :mod:`jax.lax` as machine code of lanes against an independent referee, and against plain XLA."""
