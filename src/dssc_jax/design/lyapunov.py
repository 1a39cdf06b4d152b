"""The Lyapunov function V = zeta^T P zeta of (53), and Q - 2 eps I > 0 over all admissible disturbances (54).

P = [[gamma k_p, -2 eps], [-2 eps, 1]]. With kappa_2 = 2 eps kappa_1 + gamma, the symmetric matrix is
Q - 2 eps I = [[k_q, 2 eps alpha_1 - alpha_2], [., 2 eps]], where the dot stands for the same entry and
k_q = 2 (gamma k_p - 4 eps^2) k_p kappa_1 - 4 eps gamma k_p - 2 gamma k_p alpha_1 + 4 eps alpha_2 - 2 eps
(the article prints its second term with the wrong sign).
"""

from itertools import product
from typing import NamedTuple

import numpy as np

from dssc_jax.core.numerics import namespace
from dssc_jax.design.arrays import Numeric, ratio_where
from dssc_jax.design.bounds import Bounds, Constants, derive
from dssc_jax.design.table1 import Parameters, f

POINTS = 49
"""Number of values of |sigma|, and of |e|, in the search for a negative eigenvalue."""
GAIN_POINTS = 5
"""Number of values of k_p in the search for a negative eigenvalue."""


class EigenvalueRange(NamedTuple):
    """Smallest (``low``) and largest (``high``) eigenvalue of a positive definite matrix."""

    low: Numeric
    high: Numeric

    @property
    def condition(self) -> Numeric:
        """Condition number of the matrix, the ratio of the largest eigenvalue to the smallest."""
        return self.high / self.low


def eigenvalues_of_p(k_p: Numeric, eps: Numeric, gamma: Numeric) -> EigenvalueRange:
    """Smallest and largest eigenvalue of P; the smallest is NaN unless P > 0, that is gamma k_p > 4 eps^2.

    The smallest one is computed as the determinant divided by the largest one. The formula with a difference would lose
    digits by cancellation.

    Args:
        k_p: High-frequency gain [1/s].
        eps: Parameter eps of P.
        gamma: Parameter gamma of P.
    """
    p_11 = gamma * k_p
    root = ((p_11 - 1.0) ** 2 + 16.0 * eps**2) ** 0.5
    high = 0.5 * (p_11 + 1.0 + root)
    determinant = p_11 - 4.0 * eps**2
    return EigenvalueRange(ratio_where(determinant > 0.0, determinant, high), high)


def norm_of_pb(eps: Numeric) -> Numeric:
    """The norm |P B| = (1 + 4 eps^2)^(1/2) with B = [0, 1]^T, which does not depend on k_p."""
    return (1.0 + 4.0 * eps**2) ** 0.5


class AlphaBounds(NamedTuple):
    """Bounds rho_1 and rho_2 of |alpha_1| and |alpha_2|, by which disturbances enter Q (Appendix E)."""

    rho_1: Numeric
    rho_2: Numeric


def alpha_bounds(p: Parameters, bounds: Bounds, constants: Constants, sigma: Numeric, e: Numeric) -> AlphaBounds:
    """The bounds rho_1 of |alpha_1| and rho_2 of |alpha_2| at (sigma, e), for every k_p up to k_max.

    The article omits the factor k_p on the integral terms of rho_2; here it is k_max.

    Args:
        p: Parameters of Table 1.
        bounds: Bounds of plant, disturbance, nominal control and reference.
        constants: The constants that follow from the bounds.
        sigma: Values of sigma [m/s].
        e: Values of e [m].
    """
    beta_1_over_sigma = constants.kd1_bar * abs(e) + constants.kd2_bar * abs(sigma) + constants.kd3_bar
    beta_2_over_sigma = constants.k_sigma + bounds.k_max * (bounds.c_isigma * abs(sigma) + bounds.c_ie * abs(e))
    return AlphaBounds(beta_1_over_sigma / p.phi_b, beta_2_over_sigma / p.phi_b**2)


def kappa_1(p: Parameters, sigma: Numeric, e: Numeric) -> Numeric:
    """The gain function kappa_1 = (kappa_a |sigma| + kappa_b |e| + kappa_c)^2 + kappa_d (78)."""
    return (p.kappa_a * abs(sigma) + p.kappa_b * abs(e) + p.kappa_c) ** 2 + p.kappa_d


def smallest_of_q(p: Parameters, k_p: Numeric, gain: Numeric, alpha_1: Numeric, alpha_2: Numeric) -> Numeric:
    """Smallest eigenvalue of the symmetric matrix Q - 2 eps I, whose entries the docstring of the module gives.

    Args:
        p: Parameters of Table 1.
        k_p: High-frequency gain [1/s].
        gain: Value of the gain function kappa_1.
        alpha_1: Ratio beta_1/phi_1, by which the disturbance term beta_1 enters Q.
        alpha_2: Ratio beta_2/phi_2, by which the disturbance term beta_2 enters Q.
    """
    eps = p.eps
    p_11 = p.gamma * k_p
    k_q = (
        2.0 * (p_11 - 4.0 * eps**2) * k_p * gain
        - 4.0 * eps * p_11
        - 2.0 * p_11 * alpha_1
        + 4.0 * eps * alpha_2
        - 2.0 * eps
    )
    q_12 = 2.0 * eps * alpha_1 - alpha_2
    mean = 0.5 * k_q + eps
    half_difference = 0.5 * k_q - eps
    root = (half_difference**2 + q_12**2) ** 0.5
    largest = mean + root
    determinant = 2.0 * eps * k_q - q_12**2
    positive = largest > 0.0
    xp = namespace(largest)
    divisor = xp.where(positive, largest, 1.0)
    return xp.where(positive, determinant / divisor, mean - root)  # the quotient cancels no digits, the difference does


def worst_of_q(p: Parameters, bounds: Bounds, k_p: Numeric, sigma: Numeric, e: Numeric) -> Numeric:
    """Smallest eigenvalue of Q - 2 eps I over all |alpha_1| <= rho_1 and |alpha_2| <= rho_2, at k_p, sigma and e.

    The matrix is affine in (alpha_1, alpha_2). So its smallest eigenvalue is concave, and its minimum over the
    rectangle of admissible values lies at one of the four vertices.

    Args:
        p: Parameters of Table 1.
        bounds: Bounds of plant, disturbance, nominal control and reference.
        k_p: High-frequency gain [1/s].
        sigma: Values of sigma [m/s].
        e: Values of e [m]; the shapes of k_p, sigma and e broadcast.
    """
    limit = alpha_bounds(p, bounds, derive(bounds, p.l0), sigma, e)
    gain = kappa_1(p, sigma, e)
    eigenvalues = [
        smallest_of_q(p, k_p, gain, sign_1 * limit.rho_1, sign_2 * limit.rho_2)
        for sign_1, sign_2 in product((-1.0, 1.0), repeat=2)
    ]
    xp = namespace(*eigenvalues)
    return xp.stack(xp.broadcast_arrays(*eigenvalues)).min(axis=0)


def smallest_q_on_grid(p: Parameters, bounds: Bounds) -> float:
    """Smallest eigenvalue of Q - 2 eps I on a grid of sigma, e and k_p, for parameters and bounds in plain numbers.

    The search tests the proof independently: a negative value would refute it. |sigma| and |e| range from 0 to 10^6
    times the value at which their term in kappa_1 equals kappa_c.
    """
    multiples = np.concatenate([[0.0], np.logspace(-3, 6, POINTS - 1)])
    sigma = multiples[:, None, None] * p.kappa_c / p.kappa_a
    e = multiples[None, :, None] * p.kappa_c / p.kappa_b
    k_p = np.linspace(bounds.k_min, bounds.k_max, GAIN_POINTS)
    return float(np.min(worst_of_q(p, bounds, k_p, sigma, e)))


class LinearBound(NamedTuple):
    """A bound ``by_sigma`` |sigma| + ``by_e`` |e| + ``constant``."""

    by_sigma: Numeric
    by_e: Numeric
    constant: Numeric


def weighted_sum(first_weight: Numeric, first: LinearBound, second_weight: Numeric, second: LinearBound) -> LinearBound:
    """The weighted sum of two linear bounds, term by term."""
    return LinearBound(*(first_weight * x + second_weight * y for x, y in zip(first, second, strict=True)))


def q_coefficients(p: Parameters, bounds: Bounds) -> tuple[Numeric, ...]:
    """Coefficients of a polynomial in |sigma| and |e| that is positive if and only if Q - 2 eps I > 0.

    If all coefficients are positive, the polynomial is positive, and so Q - 2 eps I > 0 for every sigma and e.

    The matrix is positive definite if 2 eps k_q > (2 eps alpha_1 - alpha_2)^2. The worst case of every term is
    alpha_1 = rho_1 and alpha_2 = -rho_2. The condition then reads

        f kappa_1 - rho^2 - 4 eps gamma k_p rho_1 - 8 eps^2 rho_2 - 8 eps^2 gamma k_p - 4 eps^2 > 0

    with rho = 2 eps rho_1 + rho_2. The left side is a polynomial of second degree, since rho_1, rho_2 and the root of
    kappa_1 - kappa_d are linear in |sigma| and |e|. Divided by f, every subtracted term falls as k_p rises, so the
    condition at k_min suffices. Table 1 requires more: it bounds rho_1 and rho_2 by rho.

    Returns:
        The coefficients of sigma^2, |sigma e|, e^2, |sigma|, |e| and 1, at k_min.
    """
    c = derive(bounds, p.l0)
    eps = p.eps
    k_p = bounds.k_min
    gain = f(k_p, eps, p.gamma)
    p_11 = p.gamma * k_p
    rho_1 = LinearBound(
        by_sigma=c.kd2_bar / p.phi_b,
        by_e=c.kd1_bar / p.phi_b,
        constant=c.kd3_bar / p.phi_b,
    )
    rho_2 = LinearBound(
        by_sigma=bounds.k_max * bounds.c_isigma / p.phi_b**2,
        by_e=bounds.k_max * bounds.c_ie / p.phi_b**2,
        constant=c.k_sigma / p.phi_b**2,
    )
    rho = weighted_sum(2.0 * eps, rho_1, 1.0, rho_2)
    linear = weighted_sum(4.0 * eps * p_11, rho_1, 8.0 * eps**2, rho_2)  # the subtracted terms with rho_1 and rho_2
    return (
        gain * p.kappa_a**2 - rho.by_sigma**2,
        2.0 * (gain * p.kappa_a * p.kappa_b - rho.by_sigma * rho.by_e),
        gain * p.kappa_b**2 - rho.by_e**2,
        2.0 * (gain * p.kappa_a * p.kappa_c - rho.by_sigma * rho.constant) - linear.by_sigma,
        2.0 * (gain * p.kappa_b * p.kappa_c - rho.by_e * rho.constant) - linear.by_e,
        gain * (p.kappa_c**2 + p.kappa_d) - rho.constant**2 - linear.constant - 8.0 * eps**2 * p_11 - 4.0 * eps**2,
    )


def q_is_positive(p: Parameters, bounds: Bounds) -> Numeric:
    """Whether Q - 2 eps I > 0 is proved for all sigma, e, alpha_1, alpha_2 and k_p: f > 0 and positive coefficients."""
    holds = p.gamma * bounds.k_min > 4.0 * p.eps**2
    for coefficient in q_coefficients(p, bounds):
        holds = holds & (coefficient > 0.0)
    return holds


def functions_are_positive(p: Parameters) -> Numeric:
    """Whether k_o tau_av > 0 and tau_m > 0 are proved for all sigma, e.

    In (28), which gives k_o tau_av, every term is positive. For a positive tau_m in (29), the inequality
    eps kappa phi_b > kappa_b (l0 |e| + |sigma|) suffices. Comparing the coefficients of |e| and |sigma|, this holds if
    phi_b >= l0/eps and kappa_a >= kappa_b/(eps phi_b); the positive kappa_c, kappa_d and gamma make it strict. The
    second condition is weaker than kappa_a > kappa_b/l0 of Table 1.
    """
    return (p.eps * p.phi_b >= p.l0) & (p.kappa_a * p.eps * p.phi_b >= p.kappa_b)
