"""Relative degree, zeros and normal form of a linear plant: whether it is of the class (5)-(8).

With G(s) = k N(s)/D(s), N and D monic and r = deg D - deg N = 2, division gives D = (s^2 + q_1 s + q_0) N + R. Then

    y'' = -q_1 y' - q_0 y - (R/N) y + k u.

R/N is split into its static gain R(0)/N(0) and a rest that is driven by y': R/N = R(0)/N(0) + s P/N. So the plant has
the form of (5)-(8) with k_p = k, a_p = q_1, the zero dynamics of N with output row P, and the stiffness
q_0 + R(0)/N(0) = D(0)/N(0), which is a part of the disturbance: d = -(stiffness/k_p) y.

References:
    A. Isidori, Nonlinear Control Systems, 3rd ed. (1995), sections 4.1 and 4.3.
"""

from typing import NamedTuple

import numpy as np

VANISHING = 1e-9
"""Relative size below which a coefficient is rounding (assumed)."""


class RealisedSystem(NamedTuple):
    """A linear system x' = A x + b u, y = c x in plain numbers.

    Args:
        a: A, row by row, shape (n, n) [1/s].
        b: Input column, shape (n,).
        c: Output row, shape (n,).
    """

    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]


class NormalForm(NamedTuple):
    """The form (5)-(8) of a linear plant, as far as the plant has it.

    Args:
        relative_degree: Order of the first derivative of the output that depends on the command.
        gain: Gain from the command to that derivative.
        zeros: Zeros of the transfer function [rad/s].
        damping: a_p [1/s]; NaN unless the relative degree is two.
        stiffness: D(0)/N(0) [1/s^2], a part of the disturbance; NaN unless the relative degree is two, or if a zero is
            at the origin.
        zero_a: Characteristic coefficients of the zero dynamics, rising powers, without the leading 1.
        zero_c: Output row of the zero dynamics, driven by y'.
    """

    relative_degree: int
    gain: float
    zeros: tuple[complex, ...]
    damping: float
    stiffness: float
    zero_a: tuple[float, ...]
    zero_c: tuple[float, ...]

    @property
    def minimum_phase(self) -> bool:
        """Whether all zeros lie in the open left half plane."""
        return all(zero.real < 0.0 for zero in self.zeros)

    @property
    def obstacle(self) -> str:
        """The reason why the plant is not of the class (5)-(8), in words; empty if the plant is of this class."""
        if self.relative_degree != 2:
            return f"the plant has relative degree {self.relative_degree}, not two as (5)-(8)"
        if not self.minimum_phase:
            worst = max(self.zeros, key=lambda zero: zero.real)
            imaginary_part = f" +- {abs(worst.imag):.4g}j" if worst.imag else ""
            place = f"{worst.real:.4g}{imaginary_part}"
            return f"the plant is not minimum phase, as (5)-(8) are: a zero at {place} rad/s"
        if self.gain > 0.0:
            return ""
        return f"the plant's high-frequency gain is {self.gain:.4g}, and k_p > 0 in (5)-(8)"


def relative_degree(system: RealisedSystem) -> int | None:
    """Return the relative degree: the order of the first derivative of the output that depends on the command.

    It is the smallest r with c A^(r-1) b not zero. A product counts as zero if it is at most :data:`VANISHING` times
    the sum of the sizes of its terms. The result is None if the command does not reach the output.
    """
    a = np.array(system.a)
    row = np.array(system.c)  # c A^(r-1)
    b = np.array(system.b)
    for degree in range(1, len(b) + 1):
        if abs(row @ b) > VANISHING * (np.abs(row) @ np.abs(b)):
            return degree
        row = row @ a
    return None


def transfer_function(system: RealisedSystem) -> tuple[np.ndarray, np.ndarray]:
    """Return the numerator and the monic denominator of a linear system, coefficients from the highest power down.

    The denominator is the characteristic polynomial chi of A. The numerator, without leading zeros, is the convolution
    of chi with the Markov parameters c A^k b. This way is more exact than the difference of two determinants, whose
    leading digits cancel.

    Raises:
        ValueError: The command does not reach the output.
    """
    degree = relative_degree(system)
    if degree is None:
        raise ValueError("the command does not reach the output")
    a = np.array(system.a, float)
    row = np.array(system.c, float)
    b = np.array(system.b, float)
    chi = np.real(np.poly(a))
    markov = []  # c A^k b for k = 0, 1, ...: exact zeros below the relative degree
    for k in range(len(b)):
        markov.append(float(row @ b) if k + 1 >= degree else 0.0)
        row = row @ a
    return np.convolve(chi, markov)[degree - 1 : len(b)], chi


def normal_form(numerator: np.ndarray, denominator: np.ndarray) -> NormalForm:
    """Return the normal form of a strictly proper transfer function, by the division at the top of this module.

    Args:
        numerator: Coefficients, highest power first, shape (m + 1,), the first not zero.
        denominator: Coefficients, highest power first, shape (n + 1,), n > m, the first not zero.
    """
    numerator = np.asarray(numerator, float)
    denominator = np.asarray(denominator, float)
    gain = float(numerator[0] / denominator[0])
    n = numerator / numerator[0]  # N and D, monic, from the highest power down
    d = denominator / denominator[0]
    degree = len(d) - len(n)
    zeros = tuple(complex(zero) for zero in np.roots(n))
    partial = NormalForm(
        relative_degree=degree, gain=gain, zeros=zeros, damping=np.nan, stiffness=np.nan, zero_a=(), zero_c=()
    )
    if degree != 2:
        return partial
    quotient, remainder = np.polydiv(d, n)  # D = (s^2 + q_1 s + q_0) N + R
    order = len(n) - 1  # m, the number of zeros
    if not order:
        return partial._replace(damping=float(d[1]), stiffness=float(d[2]))
    remainder = np.pad(remainder, (order - len(remainder), 0))  # R with m coefficients, its degree is below m
    zero_a = rising_powers(n[1:])
    if n[-1] == 0.0:  # a zero at the origin: not minimum phase, and no static gain
        return partial._replace(damping=float(quotient[1]), zero_a=zero_a)
    static_gain = remainder[-1] / n[-1]  # R(0)/N(0)
    driven_by_rate = np.concatenate([[0.0], remainder]) - static_gain * n  # s P = R - R(0)/N(0) N
    return partial._replace(
        damping=float(quotient[1]),
        stiffness=float(quotient[2] + static_gain),
        zero_a=zero_a,
        zero_c=rising_powers(driven_by_rate[:-1]),
    )


def rising_powers(coefficients: np.ndarray) -> tuple[float, ...]:
    """Return coefficients in rising powers, given coefficients that begin with the highest power."""
    return tuple(float(coefficient) for coefficient in reversed(coefficients))
