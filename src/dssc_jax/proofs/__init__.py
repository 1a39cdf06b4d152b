"""Proofs of the sampled loop: a search for certificates, and a verifier in ball arithmetic that does not trust it."""
