"""The zero dynamics eta' = A_eta eta + B_eta y' of (5), which the plant and the norm observer share."""

from typing import Annotated, NamedTuple

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity, extent
from dssc_jax.core.signals import Scalar


class ZeroDynamics(NamedTuple):
    """Zero dynamics of order m, with A_eta in controllable canonical form.

    Args:
        a: Coefficients (a_0, ..., a_{m-1}) of the characteristic polynomial s^m + a_{m-1} s^{m-1} + ... + a_0; the last
            row of A_eta is -a.
        c: Output row C_eta, length m.
    """

    a: Annotated[tuple[Scalar, ...], Quantity("1/s^(m-i)", "characteristic coefficients of A_eta, rising powers")]
    c: Annotated[tuple[Scalar, ...], Quantity("SI", "output row C_eta")]


def companion(a: tuple[float, ...]) -> np.ndarray:
    """Return the matrix A_eta in controllable canonical form, shape (m, m), given its characteristic coefficients.

    Args:
        a: Coefficients in rising powers, without the leading 1.
    """
    m = len(a)
    matrix = np.eye(m, k=1)
    matrix[-1] = -np.asarray(a, dtype=float)
    return matrix


def is_hurwitz(a: tuple[float, ...]) -> bool:
    """Whether all eigenvalues of A_eta have negative real parts, so that the zero dynamics are stable.

    Args:
        a: Characteristic coefficients in rising powers, without the leading 1.
    """
    return bool(np.all(np.linalg.eigvals(companion(a)).real < 0.0))


def kharitonov(low: tuple[float, ...], high: tuple[float, ...]) -> list[tuple[float, ...]]:
    """Return Kharitonov's four polynomials, without the leading 1, by their coefficients in rising powers.

    If these four are stable, so is every polynomial with coefficients between the bounds.

    Args:
        low: Lower bounds of the coefficients in rising powers, without the leading 1.
        high: Upper bounds of the same coefficients.

    Reference:
        V. L. Kharitonov, Differential Equations 14 (1979) 1483-1485.
    """
    bounds = {"l": low, "h": high}
    polynomials = []
    for pattern in ("llhh", "hhll", "lhhl", "hllh"):  # low or high bound of coefficients 0 to 3, then repeated
        polynomials.append(tuple(bounds[pattern[i % 4]][i] for i in range(len(low))))
    return polynomials


def require_hurwitz(dynamics: ZeroDynamics) -> None:
    """Require that a and c have the same length, and that A_eta is Hurwitz for all values of its coefficients' laws.

    Raises:
        ConfigError: The lengths differ or are 0, or A_eta may have an eigenvalue outside of the open left half plane.
    """
    if len(dynamics.a) != len(dynamics.c) or not dynamics.a:
        raise ConfigError(
            "zero_dynamics", f"a and c must have the same length >= 1, got {len(dynamics.a)} and {len(dynamics.c)}"
        )
    extents = [extent(value) for value in dynamics.a]
    low = tuple(least for least, _ in extents)
    high = tuple(greatest for _, greatest in extents)
    for polynomial in kharitonov(low, high):
        if not np.all(np.isfinite(polynomial)) or not is_hurwitz(polynomial):
            rounded = [float(f"{coefficient:g}") for coefficient in polynomial]
            raise ConfigError(
                "zero_dynamics.a",
                f"A_eta must be Hurwitz (minimum phase); s^{len(polynomial)} + ... with coefficients "
                f"{rounded} in rising powers is not",
            )


def norm_observer(dynamics: ZeroDynamics) -> tuple[float, float]:
    """Return rate lambda [1/s] and gain c of the norm observer eta_bar' = -lambda eta_bar + c |y'|.

    Its state eta_bar bounds |C_eta eta|, up to the transient |C_eta| (lmax/lmin)^(1/2) |eta(0)| e^(-lambda t). With the
    solution P_o of the Lyapunov equation A_eta^T P_o + P_o A_eta = -2 I and its extreme eigenvalues lmin and lmax, the
    rate is lambda = 1/lmax and the gain is c = |C_eta| |P_o B_eta| / lmin.

    Raises:
        ConfigError: A_eta is not Hurwitz, or the lengths of a and c differ; see :func:`require_hurwitz`.
    """
    require_hurwitz(dynamics)
    matrix = companion(tuple(float(value) for value in dynamics.a))
    p = solve_continuous_lyapunov(matrix.T, -2.0 * np.eye(len(matrix)))
    eigenvalues = np.linalg.eigvalsh(p)  # ascending
    input_column = p[:, -1]  # P_o B_eta: B_eta is the last unit vector
    gain = np.linalg.norm(np.asarray(dynamics.c, dtype=float)) * np.linalg.norm(input_column) / eigenvalues[0]
    return 1.0 / float(eigenvalues[-1]), float(gain)
