"""Passes over a typed program, in order: negated states, liveness, signs, scheduling, observation, precomputation."""
