"""Verifier of certificates, in ball arithmetic. It imports nothing of the search."""
