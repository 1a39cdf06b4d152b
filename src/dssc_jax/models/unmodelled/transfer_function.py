"""Any stable proper transfer function G(mu s) with G(0) = 1 in series with the plant input (Section V-A2).

The command is held between samples and G is advanced by its exact solution. A small mu therefore does not limit the
step, and poles may be complex, repeated or far apart. With s' = mu s and z = (v, s' v, ..., s'^(n-1) v), v =
u/denominator,

    mu z' = A z + B u,  y = C z + D u,    z(t + h) = z_oo + exp(A h/mu) (z(t) - z_oo),  z_oo = (u, 0, ..., 0)/a_0.

The coefficients are plain numbers, so exp(A q 2^k) is known before tracing. h/mu is split into an integer multiple of
a short q and a remainder. Each binary digit of the integer selects one of these matrices; the exponential of the
remainder is a Taylor polynomial. The derivative with respect to mu is that of the remainder, since all these matrices
commute.
"""

from collections.abc import Sequence
from functools import cache
from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np

from dssc_jax.core.contracts import Unmodelled
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import dot
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import SMOOTH
from dssc_jax.core.zero_dynamics import companion

MOST_ORDER = 6
SLOWEST = 1e-6  # of the poles' geometric mean: slower decay than that is not told from none
DEGREE = 14  # of the Taylor polynomial: |A rest| <= 1/2, and 0.5^15/15! = 2e-17
LOSS = 1e-6  # by rounding, nearly all in high derivatives: six poles may lie a factor of 100 apart, three 1e6
VANISHED = 1e-18  # of exp(A t): nothing is left of what the state was
Matrix = tuple[tuple[float, ...], ...]
NUMERATOR = Quantity("1", "numerator of G, rising powers of mu s", law=False)
DENOMINATOR = Quantity("1", "denominator of G, rising powers of mu s", law=False)


class TransferFunctionParams(NamedTuple):
    """Time constant and shape of G: 1/(mu s + 1)^2 has the numerator (1,) and the denominator (1, 2, 1)."""

    mu: Annotated[Scalar, Quantity("s", "time constant mu of the unmodelled dynamics", above=0.0)]
    numerator: Annotated[tuple[float, ...], NUMERATOR]
    denominator: Annotated[tuple[float, ...], DENOMINATOR]


class Realisation(NamedTuple):
    """A, C and D in the unit of time mu ``unit``, in which the poles' geometric mean is 1; there B = (0, ..., 0, 1).

    Args:
        unit: The poles' geometric mean time constant, over mu.
        a: Companion matrix of the denominator, with a_0 = a_n = 1.
        c: Output row.
        d: Direct feedthrough.
        quantum: q, a power of two with |A q| <= 1.
        doublings: exp(A q 2^k), k = 0, 1, ..., up to the first that vanishes.
    """

    unit: float
    a: Matrix
    c: tuple[float, ...]
    d: float
    quantum: float
    doublings: tuple[Matrix, ...]


def time_scaled(denominator: Sequence[float]) -> tuple[float, np.ndarray]:
    """Unit of time over mu, and the denominator's coefficients in it: the first and the last are 1, shape (n + 1,)."""
    ratios = np.asarray(denominator, dtype=float) / denominator[0]
    unit = ratios[-1] ** (1.0 / (len(ratios) - 1))
    return float(unit), ratios / unit ** np.arange(len(ratios))


def decay(denominator: Sequence[float]) -> float:
    """Rate of the slowest pole, over the poles' geometric mean; NaN if there is no finite rate."""
    with np.errstate(all="ignore"):
        _, coefficients = time_scaled(denominator)
        if not np.all(np.isfinite(coefficients)):
            return np.nan
        return -float(np.max(np.linalg.eigvals(companion(tuple(coefficients[:-1]))).real))


def as_rows(matrix: np.ndarray) -> Matrix:
    """A matrix as plain numbers."""
    return tuple(map(tuple, matrix.tolist()))


@cache
def realised(numerator: tuple[float, ...], denominator: tuple[float, ...]) -> Realisation:
    """G as matrices, with the exponentials that its step needs."""
    from scipy.linalg import expm

    unit, poles = time_scaled(denominator)
    zeros = np.zeros(len(poles))
    zeros[: len(numerator)] = np.asarray(numerator) / denominator[0] / unit ** np.arange(len(numerator))
    a = companion(tuple(poles[:-1]))
    quantum = 2.0 ** -np.ceil(np.log2(np.linalg.norm(a, 1)))
    doublings = [expm(quantum * a)]
    while np.linalg.norm(doublings[-1]) > VANISHED:
        doublings.append(expm(quantum * 2.0 ** len(doublings) * a))
    c = zeros - zeros[-1] * poles
    return Realisation(
        unit, as_rows(a), tuple(c[:-1].tolist()), float(zeros[-1]), float(quantum), tuple(map(as_rows, doublings))
    )


def of(params: TransferFunctionParams) -> Realisation:
    """The realisation of G."""
    return realised(params.numerator, params.denominator)


def loss(g: Realisation) -> float:
    """Largest rounding error of :func:`transition` applied to a first row; it grows as the poles move apart."""
    a, worst = np.array(g.a), 0.0
    for known in map(np.array, g.doublings):
        powers = [known[0]]
        for _ in a[1:]:
            powers.append(powers[-1] @ a)
        worst = max(worst, float(np.max(np.abs(known - powers))))
    return worst


def prepare(params: TransferFunctionParams) -> TransferFunctionParams:
    """Check that G is proper and stable, that G(0) = 1, and that its coefficients leave enough digits.

    Raises:
        ConfigError: A condition does not hold.
    """
    above, below = params.numerator, params.denominator
    if not 2 <= len(below) <= MOST_ORDER + 1:
        raise ConfigError("denominator", f"must have 2 to {MOST_ORDER + 1} coefficients, got {len(below)}")
    if not 1 <= len(above) <= len(below):
        rule = f"must have 1 to {len(below)} coefficients, no more than the denominator (G must be proper)"
        raise ConfigError("numerator", f"{rule}, got {len(above)}")
    if above[0] != below[0] or below[0] == 0.0:
        rule = "must begin with the denominator's first coefficient, and that not be 0, so that G(0) = 1"
        raise ConfigError("numerator", f"{rule}, got {above[0]:g} and {below[0]:g}")
    denominator, numerator = ([float(f"{value:g}") for value in side] for side in (below, above))
    if not decay(below) > SLOWEST:
        rule = f"must be Hurwitz, and no pole slower than {SLOWEST:g} of their geometric mean"
        raise ConfigError("denominator", f"{rule}, got {denominator} in rising powers")
    with np.errstate(all="ignore"):
        g = of(params)
    if not loss(g) < LOSS:
        raise ConfigError(
            "denominator", f"must not have poles so far apart at its order, got {denominator} in rising powers"
        )
    if not np.all(np.isfinite((*g.c, g.d))):
        raise ConfigError("numerator", f"must be in proportion to the denominator, got {numerator}")
    return params


def times(row: Sequence[Scalar], matrix: Matrix) -> tuple[Scalar, ...]:
    """Row times matrix."""
    return tuple(dot(column, row) for column in zip(*matrix, strict=True))


def transition(g: Realisation, steps: Scalar) -> tuple[tuple[Scalar, ...], ...]:
    """exp(A steps), row by row: A is a companion matrix, so each row is the one above times A.

    Args:
        g: A and its exponentials.
        steps: Time in the unit of A, >= 0.
    """
    steps = jnp.minimum(steps, g.quantum * 2.0 ** (len(g.doublings) - 1))
    whole = jnp.floor(steps / g.quantum + 0.5)
    rest = steps - g.quantum * whole
    row: tuple[Scalar, ...] = (1.0, *(0.0 for _ in g.c[1:]))
    for matrix in g.doublings:
        half = jnp.floor(0.5 * whole)
        row = tuple(jnp.where(whole > 2.0 * half, far, near) for far, near in zip(times(row, matrix), row, strict=True))
        whole = half
    term = row
    for k in range(1, DEGREE + 1):
        term = tuple(rest / k * rate for rate in times(term, g.a))
        row = tuple(x + dx for x, dx in zip(row, term, strict=True))
    powers: list[tuple[Scalar, ...]] = [row]
    for _ in g.c[1:]:
        powers.append(times(powers[-1], g.a))
    return tuple(powers)


def init(params: TransferFunctionParams) -> tuple[Scalar, ...]:
    """The state at rest: commands before t = 0 are zero."""
    return (0.0,) * (len(params.denominator) - 1)


def step(params: TransferFunctionParams, state: tuple[Scalar, ...], command: Scalar, dt: Scalar) -> tuple[Scalar, ...]:
    """Exact solution over dt with the command held."""
    g = of(params)
    gap = (state[0] - command, *state[1:])
    position, *others = (dot(row, gap) for row in transition(g, dt / (params.mu * g.unit)))
    return command + position, *others


def output(params: TransferFunctionParams, state: tuple[Scalar, ...], command: Scalar) -> Scalar:
    """Return y = C z + D u."""
    g = of(params)
    return dot((*g.c, g.d), (*state, command))


TRANSFER_FUNCTION = Unmodelled(TransferFunctionParams, init, step, output, prepare, smooth=SMOOTH, continuous=True)
