"""Any stable proper transfer function G(mu s) with G(0) = 1 in series with the plant input (Section V-A2).

The command is constant between samples, so G is advanced by its exact solution. A small mu therefore does not limit the
step, and poles may be complex, repeated or far apart. The states are z = (v, s' v, ..., s'^(n-1) v) with s' = mu s and
v = u/denominator. They obey

    mu z' = A z + B u,  y = C z + D u,    z(t + h) = z_oo + exp(A h/mu) (z(t) - z_oo),  z_oo = (u, 0, ..., 0)/a_0.
"""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np

from dssc_jax.core.adapters import linear_unmodelled
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import at_least
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.sampled_linear import FASTEST, LinearSystem, one_entry
from dssc_jax.core.signals import Scalar
from dssc_jax.core.zero_dynamics import companion

MOST_ORDER = 6
SLOWEST = 1e-6  # a slower decay, relative to the poles' geometric mean, cannot be told from no decay
Matrix = tuple[tuple[float, ...], ...]
NUMERATOR = Quantity("1", "numerator of G, rising powers of mu s", law=False)
DENOMINATOR = Quantity("1", "denominator of G, rising powers of mu s", law=False)


class TransferFunctionParams(NamedTuple):
    """Time constant and shape of G(mu s); 1/(mu s + 1)^2 has the numerator (1,) and the denominator (1, 2, 1)."""

    mu: Annotated[Scalar, Quantity("s", "time constant mu of the unmodelled dynamics", above=0.0)]
    numerator: Annotated[tuple[float, ...], NUMERATOR]
    denominator: Annotated[tuple[float, ...], DENOMINATOR]


class Realisation(NamedTuple):
    """G in controllable canonical form with B = (0, ..., 0, 1), in a unit of time in which the poles' mean size is 1.

    Args:
        unit: The unit of time over mu: the geometric mean of the poles' time constants.
        a: A, the companion matrix of the denominator with a_0 = a_n = 1, shape (n, n).
        c: Output row, shape (n,).
        d: Direct feedthrough.
    """

    unit: float
    a: Matrix
    c: tuple[float, ...]
    d: float


def scale_time(denominator: Sequence[float]) -> tuple[float, np.ndarray]:
    """Choose the unit of time in which the denominator's first and last coefficients are both 1.

    Args:
        denominator: Coefficients in rising powers of mu s, length n + 1.

    Returns:
        The unit over mu, and the coefficients in this unit, shape (n + 1,), in rising powers too.
    """
    ratios = np.asarray(denominator, dtype=float) / denominator[0]
    unit = ratios[-1] ** (1.0 / (len(ratios) - 1))
    return float(unit), ratios / unit ** np.arange(len(ratios))


def slowest_decay(denominator: Sequence[float]) -> float:
    """Decay rate of the slowest pole over the geometric mean of all poles' sizes; negative if a pole is unstable.

    The coefficients are taken in the unit of time of :func:`scale_time`, in which that mean is 1. The result is NaN if
    one of them is not finite there.

    Args:
        denominator: Coefficients in rising powers of mu s.
    """
    with np.errstate(all="ignore"):
        _, coefficients = scale_time(denominator)
        if not np.all(np.isfinite(coefficients)):
            return np.nan
        poles = np.linalg.eigvals(companion(tuple(coefficients[:-1])))
        return -float(np.max(poles.real))


def as_rows(matrix: np.ndarray) -> Matrix:
    """A matrix as a tuple of rows."""
    return tuple(map(tuple, matrix.tolist()))


def realise(numerator: tuple[float, ...], denominator: tuple[float, ...]) -> Realisation:
    """The controllable canonical form of G(mu s).

    In the unit of time of :func:`scale_time` the denominator is monic, so that the direct feedthrough is the last
    coefficient of the numerator.

    Args:
        numerator: Coefficients in rising powers of mu s.
        denominator: Coefficients in rising powers of mu s.
    """
    unit, scaled_denominator = scale_time(denominator)
    # the numerator over the denominator's first coefficient, in rising powers of s' = unit mu s
    scaled_numerator = np.zeros(len(scaled_denominator))
    scaled_numerator[: len(numerator)] = np.asarray(numerator) / denominator[0] / unit ** np.arange(len(numerator))
    feedthrough = scaled_numerator[-1]
    c = scaled_numerator - feedthrough * scaled_denominator
    a = as_rows(companion(tuple(scaled_denominator[:-1])))
    return Realisation(unit, a, tuple(c[:-1].tolist()), float(feedthrough))


def shown(coefficients: Sequence[float]) -> list[float]:
    """The coefficients rounded to six digits, for messages."""
    return [float(f"{value:g}") for value in coefficients]


def prepare(params: TransferFunctionParams) -> TransferFunctionParams:
    """The parameters themselves, if they are admissible.

    G must be proper, of order 1 to 6 and stable, with G(0) = 1. No pole may be slower than ``SLOWEST``. The numerator
    must also be finite in the unit of time of :func:`scale_time`.

    Raises:
        ConfigError: A condition does not hold.
    """
    numerator = params.numerator
    denominator = params.denominator
    if not 2 <= len(denominator) <= MOST_ORDER + 1:
        raise ConfigError("denominator", f"must have 2 to {MOST_ORDER + 1} coefficients, got {len(denominator)}")
    if not 1 <= len(numerator) <= len(denominator):
        rule = f"must have 1 to {len(denominator)} coefficients, no more than the denominator (G must be proper)"
        raise ConfigError("numerator", f"{rule}, got {len(numerator)}")
    if numerator[0] != denominator[0] or denominator[0] == 0.0:
        rule = "must begin with the denominator's first coefficient, and that not be 0, so that G(0) = 1"
        raise ConfigError("numerator", f"{rule}, got {numerator[0]:g} and {denominator[0]:g}")
    if not slowest_decay(denominator) > SLOWEST:
        rule = f"must be Hurwitz, and no pole slower than {SLOWEST:g} of their geometric mean"
        raise ConfigError("denominator", f"{rule}, got {shown(denominator)} in rising powers")
    with np.errstate(all="ignore"):
        g = realise(numerator, denominator)
    if not np.all(np.isfinite((*g.c, g.d))):
        raise ConfigError("numerator", f"must be in proportion to the denominator, got {shown(numerator)}")
    return params


def init(params: TransferFunctionParams) -> tuple[Scalar, ...]:
    """The state at rest: commands before t = 0 are zero."""
    return (0.0,) * (len(params.denominator) - 1)


def linear_system(params: TransferFunctionParams) -> LinearSystem:
    """G as a linear system in seconds: the canonical form of :func:`realise`, whose rates are divided by its unit.

    The time constant mu may be traced; numerator and denominator are plain numbers.
    """
    g = realise(params.numerator, params.denominator)
    rate = 1.0 / at_least(params.mu * g.unit, FASTEST)
    rows = []
    for row in g.a:
        rows.append(tuple(0.0 if entry == 0.0 else rate * entry for entry in row))
    return LinearSystem(tuple(rows), one_entry(rate, len(g.c) - 1, len(g.c)), g.c, g.d)


TRANSFER_FUNCTION = linear_unmodelled(TransferFunctionParams, init, linear_system, prepare, time_constant="mu")
