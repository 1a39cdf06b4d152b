"""The harmonic balance of a switching law with a linear plant."""

from collections.abc import Callable
from typing import NamedTuple


class HarmonicBalance(NamedTuple):
    """A switching law's side of the harmonic balance N(A, w) = q, from which its limit cycles follow.

    N is the law's describing function for a sigma of amplitude A and angular frequency w. The plant gives
    q = -1/W(i w), with W its transfer function from the command to sigma, and Re q > 0.

    Args:
        amplitude: ``(q) -> A``, the amplitude of sigma at which the real parts balance.
        residual: ``(q, A, w) -> float``, the difference of the imaginary parts at w [rad/s]; 0 in balance.
    """

    amplitude: Callable[[complex], float]
    residual: Callable[[complex, float, float], float]
