"""The problem of a proof, in plain numbers: one loop with intervals, from a study and into a certificate's file."""

import math
from dataclasses import asdict, dataclass
from typing import NamedTuple

from dssc_jax.core.json_types import JsonObject

Interval = tuple[float, float]
Box = dict[str, Interval]
"""Intervals of k_p, a_p and, with a transfer function, of ``rate``, 1/mu."""


def interval_ends(interval: Interval) -> tuple[float, ...]:
    """The two ends of an interval; a single number if they are equal."""
    low, high = interval
    return (low, high) if low < high else (low,)


def middle(interval: Interval) -> float:
    """The middle of an interval."""
    low, high = interval
    return 0.5 * (low + high)


class NominalControl(NamedTuple):
    """The nominal control u_n of a loop.

    Args:
        a: a_n [1/s].
        k: k_n.
        predictor_term: Whether u_n has its term 1/tau_m.
    """

    a: float
    k: float
    predictor_term: bool


@dataclass(frozen=True)
class ProofProblem:
    """A sampled loop of the class (5)-(8) with intervals for its uncertain numbers.

    Args:
        sample_time: T_s [s].
        l0: Error pole [1/s].
        form: Sampled form of DSSC, ``implicit`` or ``conservative``.
        functions: Kind and constants of the state-dependent functions.
        rho: Bound of the switched control [m/s]; None: the command has no bound (PI).
        nominal: The nominal control; None: there is none.
        k_p: Interval of the high-frequency gain [1/s].
        a_p: Interval of the damping [1/s].
        zero_a: Characteristic coefficients of the zero dynamics, ascending; empty for order two.
        zero_c: Output row of the zero dynamics.
        numerator: Numerator of G(mu s), the unmodelled dynamics, in rising powers of mu s; empty for none.
        denominator: Denominator in rising powers; both begin with the same number, so that G(0) = 1.
        mu: Interval of the time constant mu [s]; (0, 0) for none.
        delay: Delay of the command, in samples; not together with G.
        sensor_lag: Time constant [s] of the lag through which y and y' are measured; 0 for none.
        level: Bound of |d| [m/s], of the part that does not depend on the state.
        slope: Bound of |d'| [m/s^2], of the same part.
        reference: Bounds of the reference's first three derivatives [m/s, m/s^2, m/s^3].
        initial: Interval of each component of the initial state (e, e', eta).
        start: Where the predictor starts: ``zero``, ``matched`` (at sigma) or ``midpoint`` (half a sample earlier).
        by_state: k_d1 to k_d5 as in (30), with which the disturbance depends on the state.
        reference_size: Bound of the reference itself [m]; 0 unless the disturbance depends on the state.
    """

    sample_time: float
    l0: float
    form: str
    functions: JsonObject
    rho: float | None
    nominal: NominalControl | None
    k_p: Interval
    a_p: Interval
    zero_a: tuple[float, ...]
    zero_c: tuple[float, ...]
    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    mu: Interval
    delay: float
    sensor_lag: float
    level: float
    slope: float
    reference: tuple[float, float, float]
    initial: tuple[Interval, ...]
    start: str
    by_state: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    reference_size: float = 0.0

    def __hash__(self) -> int:
        """A hash of some numbers, so that functions of a problem can be cached although ``functions`` is a table."""
        return hash((self.sample_time, self.l0, self.k_p, self.a_p, self.mu, self.delay))

    def to_dict(self) -> JsonObject:
        """The problem as JSON's types."""
        return asdict(self)

    @property
    def box(self) -> Box:
        """The intervals of k_p, a_p and, with a lag, of 1/mu."""
        box: Box = {"k_p": self.k_p, "a_p": self.a_p}
        if self.denominator:
            box["rate"] = (1.0 / self.mu[1], 1.0 / self.mu[0])
        return box

    @property
    def delay_weights(self) -> tuple[float, ...]:
        """Weights of the commands of ages 0, 1, ... samples in the command that acts on the plant."""
        return delay_weights(self.delay)


def delay_weights(delay: float) -> tuple[float, ...]:
    """Weights of the commands of ages 0, 1, ... samples in the command that acts on the plant; their sum is 1.

    A fractional delay is a change of command within a sample, which acts like a mean of two commands.

    Args:
        delay: Delay of the command, in samples.
    """
    samples = math.floor(delay)
    fraction = delay - samples
    weights = (0.0,) * samples + (1.0 - fraction,)
    return (*weights, fraction) if fraction > 0.0 else weights
