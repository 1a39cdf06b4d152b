"""Probabilities of rare failures, by importance sampling or multilevel splitting."""
