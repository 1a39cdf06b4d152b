"""Probabilities of rare failures, by multilevel splitting."""
