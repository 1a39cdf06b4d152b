"""``python -m dssc_jax`` is the command ``dssc-jax``."""

from dssc_jax.cli.main import main

main()
