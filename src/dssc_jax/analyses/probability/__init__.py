"""Failure probabilities by strata along a predicted border of failure."""

from dssc_jax.analyses.probability.probability import FailureProbability, probability

__all__ = ["FailureProbability", "probability"]
