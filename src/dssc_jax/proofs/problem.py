"""The problem of a proof: one loop with intervals, in plain numbers, read from a study and stored in a certificate."""

import math
from dataclasses import asdict, dataclass
from typing import NamedTuple

from dssc_jax.core.json_types import JsonObject

Interval = tuple[float, float]
"""Lower and upper end."""
Box = dict[str, Interval]
"""Intervals of ``k_p`` [1/s], ``a_p`` [1/s] and, with a transfer function G(mu s), of ``rate``, 1/mu [1/s]."""


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
        a: a_n, the believed damping of the plant [1/s].
        k: k_n, the believed high-frequency gain of the plant [1/s].
        predictor_term: Whether the gain of sigma in u_n contains the term 1/(k_n tau_m).
    """

    a: float
    k: float
    predictor_term: bool


@dataclass(frozen=True)
class ProofProblem:
    """A sampled loop of the class (5)-(8) with intervals for its uncertain numbers.

    The units are those of a loop whose output is a length [m] and whose command is a velocity [m/s].

    Args:
        sample_time: T_s [s].
        l0: Error pole [1/s].
        form: Sampled form of DSSC, ``implicit`` or ``conservative``.
        functions: Kind of the state-dependent functions, in the entry ``kind``, and their constants by name.
        rho: Bound of the switched control [m/s]; None: the command has no bound (PI).
        nominal: The nominal control; None: there is none.
        k_p: Interval of the high-frequency gain [1/s].
        a_p: Interval of the damping [1/s].
        zero_a: Characteristic coefficients of the zero dynamics, ascending; empty for order two.
        zero_c: Output row of the zero dynamics.
        numerator: Numerator of G(mu s), the unmodelled dynamics, in rising powers of mu s; empty for none.
        denominator: Denominator of G(mu s) in rising powers of mu s. Its first coefficient equals the numerator's first
            one, so that G(0) = 1.
        mu: Interval of the time constant mu [s]; (0, 0) for none.
        delay: Delay of the command, in samples; not together with G.
        sensor_lag: Time constant [s] of the lag through which y and y' are measured; 0 for none.
        level: Bound of |d| [m/s] for the part of the disturbance that does not depend on the state.
        slope: Bound of |d'| [m/s^2] for the same part.
        reference: Bounds of the reference's first three derivatives [m/s, m/s^2, m/s^3].
        initial: Interval of each component of the initial state (e, e', eta).
        start: Where the predictor starts: ``zero``, ``matched`` (at sigma) or ``midpoint`` (half a sample earlier).
        by_state: k_d1 to k_d5 of (30), by which the disturbance grows with the state.
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
        """Hash the main numbers only, for caches keyed by a problem: the table ``functions`` cannot be hashed.

        Problems that differ in the other fields share a hash, and a cache then compares them.
        """
        return hash((self.sample_time, self.l0, self.k_p, self.a_p, self.mu, self.delay))

    def to_dict(self) -> JsonObject:
        """The problem as a table of JSON's types, as a certificate holds it."""
        return asdict(self)

    @property
    def box(self) -> Box:
        """The box over which the loop is to be proved: intervals of k_p, a_p and, with G(mu s), of 1/mu, all [1/s]."""
        box: Box = {"k_p": self.k_p, "a_p": self.a_p}
        if self.denominator:
            smallest_mu, largest_mu = self.mu
            box["rate"] = (1.0 / largest_mu, 1.0 / smallest_mu)
        return box

    @property
    def delay_weights(self) -> tuple[float, ...]:
        """Weights of the commands of ages 0, 1, ... samples in the command that acts on the plant."""
        return delay_weights(self.delay)


def delay_weights(delay: float) -> tuple[float, ...]:
    """Weights of the commands of ages 0, 1, ... samples in the command that acts on the plant; their sum is 1.

    With a fractional delay the acting command changes once within a sample. A weighted mean of the two commands, held
    over the whole sample, stands for it.

    Args:
        delay: Delay of the command, in samples.
    """
    samples = math.floor(delay)
    fraction = delay - samples
    weights = (0.0,) * samples + (1.0 - fraction,)
    return (*weights, fraction) if fraction > 0.0 else weights
