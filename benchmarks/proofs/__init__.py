"""Regenerate the measured parts of docs/proofs.md and its figure: ``make proofs``."""
