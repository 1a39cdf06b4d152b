"""Proofs of the sampled loop: a search for certificates, and a verifier in ball arithmetic that does not trust it."""

BOXES = 64
"""Largest number of boxes of uncertain numbers that :func:`dssc_jax.proofs.prove.prove` tries."""
SWEEP_BOXES = 4
"""Largest number of boxes of uncertain numbers that are tried at each point of a sweep."""
