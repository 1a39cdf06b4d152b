"""``python -m dssc_jax.cli``."""

from dssc_jax.cli import main

main()
