"""The harmonic balance of a switching law with a linear plant."""

from collections.abc import Callable
from typing import NamedTuple


class HarmonicBalance(NamedTuple):
    """A switching law's side of the harmonic balance N(A, w) = q, from which the limit cycles of the loop follow.

    N is the law's describing function for a sigma of amplitude A and angular frequency w [rad/s]. The plant gives
    q = -1/W(i w), where W is its transfer function from the command to sigma; Re q > 0 is required.

    Args:
        amplitude: ``(q) -> A``, the amplitude of sigma at which the real parts balance.
        residual: ``(q, A, w) -> float``, the difference of the imaginary parts at w [rad/s]; 0 in balance.
    """

    amplitude: Callable[[complex], float]
    residual: Callable[[complex, float, float], float]
