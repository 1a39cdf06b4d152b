"""Classical margins of the nominal loop of a design, broken at the command."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from dssc_jax.core.quantities import Quantity
from dssc_jax.design.linear_loop import ClosedLoop
from dssc_jax.engine.linearisation.response import (
    classical_margins,
    crossing_frequencies,
    margin_angles,
    response_of,
)


@dataclass(frozen=True)
class DesignedMargins:
    """Classical margins of one stable sampled loop.

    A margin that does not exist is infinite; the lower gain margin is 0 in this case.
    """

    gain_margin: Annotated[float, Quantity("1", "smallest destabilising factor of the gain above 1")]
    gain_lower_margin: Annotated[float, Quantity("1", "largest destabilising factor below 1; 0: none")]
    phase_margin: Annotated[float, Quantity("rad", "smallest destabilising phase lag")]
    phase_margin_at: Annotated[float, Quantity("rad/s", "frequency of the phase margin")]
    delay_margin: Annotated[float, Quantity("s", "smallest destabilising delay")]
    gain_crossovers: Annotated[tuple[float, ...], Quantity("rad/s", "frequencies at which the loop gain is 1")]
    phase_crossings: Annotated[
        tuple[float, ...], Quantity("rad/s", "frequencies at which the phase is -180 degrees, up to pi/T_s")
    ]


def designed_margins(loop: ClosedLoop, sample_time: float) -> DesignedMargins:
    """Compute the classical margins of a stable loop, broken at the command.

    Args:
        loop: The closed loop in sampled time.
        sample_time: T_s [s].
    """
    matrices = loop.a[None], loop.b[None], loop.c[None]  # the margin functions take a batch of loops, here of size 1
    poles = np.linalg.eigvals(loop.a)[None]
    respond = response_of(*matrices)
    angles = margin_angles(*matrices, poles)
    margins = classical_margins(respond, angles, sample_time)
    gain_crossovers, phase_crossings = crossing_frequencies(respond, angles, sample_time)
    return DesignedMargins(
        gain_margin=float(margins.gain_upper[0]),
        gain_lower_margin=float(margins.gain_lower[0]),
        phase_margin=float(margins.phase[0]),
        phase_margin_at=float(margins.crossover[0]),
        delay_margin=float(margins.delay[0]),
        gain_crossovers=tuple(gain_crossovers.tolist()),
        phase_crossings=tuple(phase_crossings.tolist()),
    )
