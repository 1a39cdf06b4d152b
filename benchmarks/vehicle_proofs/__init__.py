"""Regenerate the measured parts of docs/vehicle_proofs.md: ``make vehicle``."""
