"""Classical margins of every draw's linearised loop: gain, phase, delay, disk, peak sensitivities, bandwidth."""

from dssc_jax.analyses.loop_margins.loop_margins import loop_margins
from dssc_jax.analyses.loop_margins.result import LoopMargins, Status
from dssc_jax.engine.linearisation.response import (
    ClassicalMargins,
    classical_margins,
    common_grid,
    grid_with_poles,
    response_of,
)

__all__ = [
    "ClassicalMargins",
    "LoopMargins",
    "Status",
    "classical_margins",
    "common_grid",
    "grid_with_poles",
    "loop_margins",
    "response_of",
]
