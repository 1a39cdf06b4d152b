"""Classical margins of every draw's linearised loop: gain, phase, delay, disk, peak sensitivities, bandwidth."""

from dssc_jax.analyses.loop_margins.loop_margins import loop_margins
from dssc_jax.analyses.loop_margins.result import LoopMargins

__all__ = ["LoopMargins", "loop_margins"]
