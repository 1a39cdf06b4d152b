"""Theorem 1's small-gain condition, and the guaranteed decay rate and residual sets.

With W_eta = (x_eta^T P_eta x_eta)^(1/2), x_eta = (eta, e), and W_v = (zeta^T P zeta)^(1/2), (60) and (58) are
W_eta' <= -k_eta1 W_eta + k_eta2 W_v + k_eta3 |y_m'| and W_v' <= -k_v1 W_v + k_v2 W_eta + k_v3 beta_m. The linear
comparison system is stable, and decays to the residual set, if and only if k_v1 k_eta1 > k_v2 k_eta2.

k_p enters only through P, and the worst case over [k_min, k_max] lies at an end of the interval, for two reasons.
First, stability and residual sets depend on P only through its condition number. The derivative of this number with
respect to x = gamma k_p has the sign of x - 1 - 8 eps^2, so the number falls and then rises.
Second, let lmin and lmax be the eigenvalues of P. The decay rate exceeds r if and only if r < k_eta1 and
eps phi_b lmin(P) - r det P - (k_v2 k_eta2 lmin(P)/(k_eta1 - r)) lmax(P) > 0. Here k_v2 k_eta2 lmin(P) does not depend
on k_p, lmin is concave in k_p, det P affine and lmax convex. So the left side is concave, and least at an end.
"""

from typing import NamedTuple

from dssc_jax.core.numerics import namespace
from dssc_jax.design.arrays import Numeric, greater, ratio_where
from dssc_jax.design.bounds import Bounds, Constants, derive
from dssc_jax.design.lyapunov import EigenvalueRange, eigenvalues_of_p, norm_of_pb
from dssc_jax.design.table1 import BOUNDARY_WIDTH, ULPS, Parameters

RESOLVED = 1e-9  # smallest ratio of eigenvalues of P_eta that float64 resolves to a few digits


class ErrorDynamics(NamedTuple):
    """Properties of the matrix P_eta, the solution of A_xeta^T P_eta + P_eta A_xeta = -2 I (59).

    P_eta measures the state x_eta = (eta, e) of zero dynamics and tracking error, which sigma and y_m' drive.

    Args:
        eigenvalues: Smallest and largest eigenvalue of P_eta.
        by_sigma: |P_eta B_sigma|, the size of the effect of sigma.
        by_reference: |P_eta B_m|, the size of the effect of y_m'.
    """

    eigenvalues: EigenvalueRange
    by_sigma: Numeric
    by_reference: Numeric


def error_dynamics(bounds: Bounds, l0: Numeric) -> ErrorDynamics:
    """Solve (59) for P_eta, with A_xeta = [[A_eta, -l0 B_eta], [0, -l0]], B_sigma = [B_eta; 1] and B_m = [B_eta; 0].

    For a plant of order two, P_eta is the number 1/l0. If P_eta is so ill-conditioned that float64 does not resolve its
    smallest eigenvalue, this eigenvalue is NaN, and nothing is certified.

    Args:
        bounds: Bounds of the loop, with the zero dynamics.
        l0: Error pole [1/s]; a number or an array.
    """
    if bounds.zero_dynamics is None:
        return ErrorDynamics(EigenvalueRange(1.0 / l0, 1.0 / l0), by_sigma=1.0 / l0, by_reference=0.0 * l0)
    xp = namespace(l0)
    l0 = xp.asarray(l0)
    a = bounds.zero_dynamics.a
    m = len(a)
    zero = xp.zeros_like(l0)
    unit = xp.ones_like(l0)
    rows = []  # of A_xeta; A_eta has companion form, and B_eta = (0, ..., 0, 1)
    for i in range(m - 1):
        row = [zero] * (m + 1)
        row[i + 1] = unit
        rows.append(row)
    rows.append([-x * unit for x in a] + [-l0])
    rows.append([zero] * m + [-l0])
    matrix = xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)
    p = solve_lyapunov(matrix)
    rising_eigenvalues = xp.linalg.eigvalsh(p)
    low = rising_eigenvalues[..., 0]
    high = rising_eigenvalues[..., -1]
    p_b_m = p[..., :, m - 1]  # B_m selects the last column of the zero dynamics
    p_b_sigma = p_b_m + p[..., :, m]
    return ErrorDynamics(
        eigenvalues=EigenvalueRange(xp.where(low > RESOLVED * high, low, xp.nan), high),
        by_sigma=(p_b_sigma**2).sum(axis=-1) ** 0.5,
        by_reference=(p_b_m**2).sum(axis=-1) ** 0.5,
    )


def solve_lyapunov(matrix: Numeric) -> Numeric:
    """Solve A^T P + P A = -2 I for the symmetric matrix P, shape (..., n, n).

    The n^2 entries of P are the unknowns of one linear system.

    Args:
        matrix: A matrix A, or a stack of them, shape (..., n, n).
    """
    xp = namespace(matrix)
    n = matrix.shape[-1]
    identity = xp.eye(n)
    transposed = xp.swapaxes(matrix, -1, -2)
    # vec(A^T P + P A) = (A^T x I + I x A^T) vec P, row by row
    left_product = transposed[..., :, None, :, None] * identity[:, None, :]
    right_product = identity[:, None, :, None] * transposed[..., None, :, None, :]
    system = (left_product + right_product).reshape(*matrix.shape[:-2], n * n, n * n)
    right_side = xp.broadcast_to(-2.0 * identity.reshape(n * n, 1), (*matrix.shape[:-2], n * n, 1))
    p = xp.linalg.solve(system, right_side).reshape(matrix.shape)
    return 0.5 * (p + xp.swapaxes(p, -1, -2))  # rounding makes P slightly asymmetric


def worst_condition(p: Parameters, bounds: Bounds) -> Numeric:
    """Compute the largest condition number of P over the interval of k_p, which is attained at one of its ends."""
    at_k_min = eigenvalues_of_p(bounds.k_min, p.eps, p.gamma)
    at_k_max = eigenvalues_of_p(bounds.k_max, p.eps, p.gamma)
    return greater(at_k_min.condition, at_k_max.condition)


class SmallGain(NamedTuple):
    """The smallest phi_b that satisfies the small-gain condition, by three formulas.

    Args:
        derived: From (58) and (60): the linear comparison system is stable for every larger phi_b. The certificate uses
            this bound.
        theorem: From 4 gamma_1 gamma_2 <= phi_b^2 of Appendix G with the derived gains; twice ``derived``.
        printed: The last bound of Appendix D as printed, with 1/4 instead of 4 and mixed powers of eigenvalues.
    """

    derived: Numeric
    theorem: Numeric
    printed: Numeric


def small_gain(p: Parameters, bounds: Bounds) -> SmallGain:
    """Compute the smallest phi_b for which the interconnection of tracking error and sliding motion is stable.

    The condition is phi_b^2 > |P_eta B_sigma| |P B| (kappa_e + |C_eta A_eta|) cond(P) cond(P_eta)/eps. Its right side
    does not depend on phi_b, so a sufficiently large phi_b always satisfies it.

    Args:
        p: Parameters of Table 1; phi_b is not used.
        bounds: Bounds of plant, disturbance, nominal control and reference.
    """
    c = derive(bounds, p.l0)
    eta = error_dynamics(bounds, p.l0)
    common = eta.by_sigma * norm_of_pb(p.eps) * eta.eigenvalues.condition / p.eps
    derived = (common * (c.kappa_e + c.c_eta_a_eta) * worst_condition(p, bounds)) ** 0.5
    at_k_min = eigenvalues_of_p(bounds.k_min, p.eps, p.gamma)
    at_k_max = eigenvalues_of_p(bounds.k_max, p.eps, p.gamma)
    mixed_ratio = greater(at_k_min.high / at_k_min.low**0.5, at_k_max.high / at_k_max.low**0.5)
    printed = 0.25 * common * (c.kappa_e_printed + c.c_eta_a_eta) * mixed_ratio / eta.eigenvalues.low**0.5
    return SmallGain(derived, theorem=2.0 * derived, printed=printed**0.5)


def small_gain_holds(p: Parameters, bounds: Bounds) -> Numeric:
    """Whether phi_b exceeds the derived small-gain bound by more than the bound's rounding error.

    Most of the rounding error comes from the determinant of P, whose two terms cancel.
    """
    bound = small_gain(p, bounds).derived
    determinant = p.gamma * bounds.k_min - 4.0 * p.eps**2  # of P at k_min
    cancellation_error = ratio_where(determinant > 0.0, ULPS * (p.gamma * bounds.k_min + 4.0 * p.eps**2), determinant)
    return p.phi_b > bound * (1.0 + BOUNDARY_WIDTH + cancellation_error)


class Gains(NamedTuple):
    """Coefficients of the comparison system (61), (62) at one k_p.

    W_eta' <= -k_eta1 W_eta + k_eta2 W_v + k_eta3 |y_m'| and W_v' <= -k_v1 W_v + k_v2 W_eta + k_v3 beta_m.
    """

    k_eta1: Numeric
    k_eta2: Numeric
    k_eta3: Numeric
    k_v1: Numeric
    k_v2: Numeric
    k_v3: Numeric


def comparison_gains(p: Parameters, c: Constants, eta: ErrorDynamics, eigenvalues: EigenvalueRange) -> Gains:
    """Compute the coefficients of the comparison system, with corrected powers of the eigenvalues.

    Args:
        p: Parameters of Table 1.
        c: The constants of :func:`dssc_jax.design.bounds.derive`.
        eta: Properties of P_eta.
        eigenvalues: Smallest and largest eigenvalue of P at this k_p.
    """
    pb = norm_of_pb(p.eps)
    return Gains(
        k_eta1=1.0 / eta.eigenvalues.high,
        k_eta2=eta.by_sigma / (p.phi_b * (eta.eigenvalues.low * eigenvalues.low) ** 0.5),
        k_eta3=eta.by_reference / eta.eigenvalues.low**0.5,
        k_v1=p.eps * p.phi_b / eigenvalues.high,
        k_v2=pb * (c.kappa_e + c.c_eta_a_eta) / (eigenvalues.low * eta.eigenvalues.low) ** 0.5,
        k_v3=pb / eigenvalues.low**0.5,
    )


class Guarantee(NamedTuple):
    """The guarantee of Theorem 1: a decay rate and ultimate bounds.

    The rate is 0 and the bounds are infinite if the small-gain condition does not hold.

    Args:
        decay_rate: Rate at which W_eta and W_v decay to the residual set [1/s].
        sigma: Ultimate bound of |sigma| [m/s].
        e: Ultimate bound of |e| [m].
        zeta: Ultimate bound of |phi_1| and |z| [SI].
        x_eta: Ultimate bound of |(eta, e)| [SI].
        order: The ultimate bound ``e`` times phi_b^2, the constant of the order O(1/phi_b^2) of |e| [m].
    """

    decay_rate: Numeric
    sigma: Numeric
    e: Numeric
    zeta: Numeric
    x_eta: Numeric
    order: Numeric


NOTHING = Guarantee(
    decay_rate=0.0, sigma=float("inf"), e=float("inf"), zeta=float("inf"), x_eta=float("inf"), order=float("inf")
)
"""The guarantee if the theorem does not apply."""


def guarantee(p: Parameters, bounds: Bounds) -> Guarantee:
    """Residual sets and decay rate of Theorem 1 in the worst case over the interval of k_p.

    Args:
        p: The parameters; the numbers are meaningful only if Table 1 holds.
        bounds: The bounds. The reference needs a bounded third derivative and u_m a bounded first derivative, neither
            of which the article assumes.

    Example:
        >>> from dssc_jax.design.synthesis import Free, synthesise
        >>> bounds = Bounds(k_min=0.9, k_max=1.1, a_max=1.0, alpha_d3=0.1)
        >>> gains = synthesise(bounds, Free(l0=0.5, phi_a=0.1, eps=0.3, delta=0.5, eps_1=2.0, eps_2=0.1, eps_3=6.0))
        >>> round(float(guarantee(gains, bounds).e), 4)
        0.0844
    """
    c = derive(bounds, p.l0)
    eta = error_dynamics(bounds, p.l0)
    at_k_min = guarantee_at(p, bounds, c, eta, bounds.k_min)
    at_k_max = guarantee_at(p, bounds, c, eta, bounds.k_max)
    return Guarantee(
        decay_rate=-greater(-at_k_min.decay_rate, -at_k_max.decay_rate),  # the smaller rate
        sigma=greater(at_k_min.sigma, at_k_max.sigma),
        e=greater(at_k_min.e, at_k_max.e),
        zeta=greater(at_k_min.zeta, at_k_max.zeta),
        x_eta=greater(at_k_min.x_eta, at_k_max.x_eta),
        order=greater(at_k_min.order, at_k_max.order),
    )


def guarantee_at(p: Parameters, bounds: Bounds, c: Constants, eta: ErrorDynamics, k_p: Numeric) -> Guarantee:
    """Decay rate and residual sets that Theorem 1 guarantees at one k_p.

    Where the small-gain condition does not hold, the rate is 0 and the sets are infinite.

    Args:
        p: Parameters of Table 1.
        bounds: Bounds of plant, disturbance, nominal control and reference.
        c: The constants that follow from the bounds.
        eta: Properties of P_eta.
        k_p: High-frequency gain [1/s].
    """
    eigenvalues = eigenvalues_of_p(k_p, p.eps, p.gamma)
    k = comparison_gains(p, c, eta, eigenvalues)
    margin = k.k_v1 - k.k_v2 * k.k_eta2 / k.k_eta1
    holds = margin > 0.0  # the small-gain condition k_v1 k_eta1 > k_v2 k_eta2
    xp = namespace(margin)
    # the residual set of the comparison system: W_v' = W_eta' = 0, where the drives of W_v equal margin W_v
    drive = k.k_v3 * c.beta_m + k.k_v2 * k.k_eta3 * bounds.y_m_dot / k.k_eta1
    w_v = xp.where(holds, drive / xp.where(holds, margin, 1.0), xp.inf)
    w_eta = (k.k_eta2 * w_v + k.k_eta3 * bounds.y_m_dot) / k.k_eta1
    # the decay rate r: the smaller root of (k_eta1 - r)(k_v1 - r) = k_v2 k_eta2, without cancellation
    mean = 0.5 * (k.k_eta1 + k.k_v1)
    root = (0.25 * (k.k_eta1 - k.k_v1) ** 2 + k.k_v2 * k.k_eta2) ** 0.5
    rate = xp.where(holds, margin * k.k_eta1 / (mean + root), 0.0)
    zeta = w_v / eigenvalues.low**0.5
    sigma = zeta / p.phi_b  # since |phi_1| >= phi_b |sigma|
    e = sigma / p.l0  # since e' = -l0 e + sigma
    return Guarantee(
        decay_rate=rate,
        sigma=sigma,
        e=e,
        zeta=zeta,
        x_eta=w_eta / eta.eigenvalues.low**0.5,
        order=e * p.phi_b**2,
    )
