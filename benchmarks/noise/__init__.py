"""Regenerate docs/noise.md and its figures: ``make noise``."""
