"""Theoretical analyses of the simulated loops: linearisation at the origin, and describing functions.

A local margin is about small deviations; a simulated margin is about requirements. They answer different questions and
are kept apart: each result names its criterion.
"""

from dssc_jax.analyses.theory.assessment import Assessment, assess
from dssc_jax.analyses.theory.chattering import chattering
from dssc_jax.analyses.theory.describing import LimitCycle, limit_cycle
from dssc_jax.analyses.theory.linearised import Linearised, at_rest, open_loop
from dssc_jax.analyses.theory.local import Time, local_margin, spectrum

__all__ = [
    "Assessment",
    "LimitCycle",
    "Linearised",
    "Time",
    "assess",
    "at_rest",
    "chattering",
    "limit_cycle",
    "local_margin",
    "open_loop",
    "spectrum",
]
