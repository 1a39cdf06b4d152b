"""Table 1: its parameters, and its design inequalities with their slacks.

k_p is uncertain, so every inequality must hold for all k_p in [k_min, k_max]. If
f(k_p) = 4 eps k_p (gamma k_p - 4 eps^2) exceeds 1 at k_min, then f rises with k_p, and the bounds of kappa_c and
kappa_d fall. So the inequalities hold on the whole interval if and only if they hold at k_min.
"""

from enum import StrEnum
from typing import Annotated, NamedTuple

from dssc_jax.design.arrays import Numeric, greater, ratio_where
from dssc_jax.design.bounds import Bounds, derive, positive

BOUNDARY_WIDTH = 1e-12  # relative; slacks below it are equality
ULPS = 16.0 * 2.0**-52  # a few roundings of the terms that cancel in f


class Parameters(NamedTuple):
    """The parameters of a design: those in the inequalities of Table 1, and the smoothing delta.

    ``eps`` and ``gamma`` make the matrix P of the Lyapunov function (53), and ``kappa_a`` to ``kappa_d`` the gain
    function kappa_1 = (kappa_a |sigma| + kappa_b |e| + kappa_c)^2 + kappa_d (78).
    """

    l0: Annotated[Numeric, positive("1/s", "error pole l_0")]
    phi_a: Annotated[Numeric, positive("(m/s)^(1/2)", "square-root part phi_a")]
    phi_b: Annotated[Numeric, positive("1", "linear part phi_b")]
    delta: Annotated[Numeric, positive("(m/s)^(1/2)", "smoothing delta")]
    eps: Annotated[Numeric, positive("SI", "eps")]
    gamma: Annotated[Numeric, positive("SI", "gamma")]
    kappa_a: Annotated[Numeric, positive("SI", "kappa_a")]
    kappa_b: Annotated[Numeric, positive("SI", "kappa_b")]
    kappa_c: Annotated[Numeric, positive("SI", "kappa_c")]
    kappa_d: Annotated[Numeric, positive("SI", "kappa_d")]


class InequalityState(StrEnum):
    """State of an inequality.

    ``boundary`` is an equality up to rounding. ``not_evaluable`` means that the bound has no meaning, because f <= 1 or
    f <= 0.
    """

    SATISFIED = "satisfied"
    BOUNDARY = "boundary"
    VIOLATED = "violated"
    NOT_EVALUABLE = "not_evaluable"


class Inequality(NamedTuple):
    """One strict inequality ``value > bound``.

    Args:
        name: The bounded quantity.
        equation: Location of the inequality in the article.
        value: Left side.
        bound: Right side as derived in this package; NaN if it has no meaning.
        printed_bound: Right side as the article prints it; NaN if it has no meaning.
        rounding: Relative rounding error of the bound.
    """

    name: str
    equation: str
    value: Numeric
    bound: Numeric
    printed_bound: Numeric
    rounding: Numeric = BOUNDARY_WIDTH

    @classmethod
    def as_printed(
        cls, name: str, equation: str, value: Numeric, bound: Numeric, rounding: Numeric = BOUNDARY_WIDTH
    ) -> "Inequality":
        """Make an inequality whose derived bound is also the printed one; the arguments are fields of the class."""
        return cls(name=name, equation=equation, value=value, bound=bound, printed_bound=bound, rounding=rounding)

    @property
    def slack(self) -> Numeric:
        """Value minus the derived bound; NaN if the bound has no meaning."""
        return self.value - self.bound

    @property
    def printed_slack(self) -> Numeric:
        """Value minus the printed bound; NaN if the bound has no meaning."""
        return self.value - self.printed_bound

    @property
    def tolerance(self) -> Numeric:
        """The largest |slack| that counts as equality, from the relative rounding error of the bound."""
        return self.rounding * greater(abs(self.value), abs(self.bound))

    @property
    def satisfied(self) -> Numeric:
        """Whether the inequality holds strictly; False if its bound has no meaning. For arrays, element by element."""
        return self.slack > self.tolerance

    @property
    def state(self) -> InequalityState:
        """Whether the inequality is satisfied, violated, an equality up to rounding, or without meaning.

        For plain numbers.
        """
        is_nan = self.bound != self.bound
        if is_nan:
            return InequalityState.NOT_EVALUABLE
        if abs(self.slack) <= self.tolerance:
            return InequalityState.BOUNDARY
        return InequalityState.SATISFIED if self.slack > 0.0 else InequalityState.VIOLATED


def f(k_p: Numeric, eps: Numeric, gamma: Numeric) -> Numeric:
    """The function f(k_p) = 4 eps k_p (gamma k_p - 4 eps^2), which the first design inequality requires to exceed 1.

    Args:
        k_p: High-frequency gain [1/s].
        eps: Parameter eps of the Lyapunov matrix P.
        gamma: Parameter gamma of P.
    """
    return 4.0 * eps * k_p * (gamma * k_p - 4.0 * eps**2)


def f_rounding(k_p: Numeric, eps: Numeric, gamma: Numeric) -> Numeric:
    """Bound of the absolute rounding error of f, whose two terms may cancel; the arguments are those of :func:`f`."""
    return ULPS * 4.0 * eps * k_p * (gamma * k_p + 4.0 * eps**2)


def kappa_c_bound(k_p: Numeric, eps: Numeric, gamma: Numeric) -> Numeric:
    """The bound (8 eps^2 + 2 gamma k_p)/(f - 1) of kappa_c that the Lyapunov function requires.

    The result is NaN if f <= 1: the formula would then give a negative bound, which every kappa_c satisfies. The
    arguments are those of :func:`f`.
    """
    excess = f(k_p, eps, gamma) - 1.0
    return ratio_where(excess > f_rounding(k_p, eps, gamma), 8.0 * eps**2 + 2.0 * gamma * k_p, excess)


def kappa_d_bound(k_p: Numeric, eps: Numeric, gamma: Numeric) -> Numeric:
    """The bound (8 eps^2 gamma k_p + 4 eps^2)/f of kappa_d; NaN if f <= 0. The arguments are those of :func:`f`."""
    value = f(k_p, eps, gamma)
    return ratio_where(value > f_rounding(k_p, eps, gamma), 8.0 * eps**2 * gamma * k_p + 4.0 * eps**2, value)


def over_phi_b(first: Numeric, second: Numeric, factor: Numeric, phi_b: Numeric) -> Numeric:
    """The bound (first m phi_b + second)/phi_b^2 of kappa_a, kappa_b or kappa_c that the disturbance requires.

    Args:
        first: phi_b times the coefficient in the bound rho_1 of |alpha_1|.
        second: phi_b^2 times the coefficient in the bound rho_2 of |alpha_2|.
        factor: The factor m. The derivation gives m = 2 eps, since rho = 2 eps rho_1 + rho_2. The article prints m = 1,
            which suffices only for eps <= 1/2.
        phi_b: Linear part phi_b.
    """
    return (first * factor * phi_b + second) / phi_b**2


def inequalities(p: Parameters, bounds: Bounds) -> tuple[Inequality, ...]:
    """The design inequalities of Table 1, row by row, at k_min and hence over the whole interval of k_p.

    Args:
        p: The parameters; numbers or arrays of shapes that broadcast.
        bounds: Bounds of plant, disturbance, nominal control and reference.
    """
    constants = derive(bounds, p.l0)
    k_p = bounds.k_min
    k_max = bounds.k_max
    table = "Table 1"
    f_value = f(k_p, p.eps, p.gamma)
    f_error = f_rounding(k_p, p.eps, p.gamma)
    error = BOUNDARY_WIDTH + f_error  # absolute, of f and of a boundary

    def disturbance_row(name: str, left: Numeric, first: Numeric, second: Numeric) -> Inequality:
        """Row with a bound that the disturbance requires, as derived and as printed.

        Args:
            name: The bounded quantity.
            left: Value of this quantity, the left side of the inequality.
            first: As for :func:`over_phi_b`.
            second: As for :func:`over_phi_b`.
        """
        derived = over_phi_b(first, second, 2.0 * p.eps, p.phi_b)
        printed = over_phi_b(first, second, 1.0, p.phi_b)
        return Inequality(name, f"{table}, Appendix F", left, bound=derived, printed_bound=printed)

    distance_from_one = abs(f_value - 1.0)  # |f - 1|, the divisor in the Lyapunov bound of kappa_c
    return (
        Inequality.as_printed(
            name="f",
            equation=f"{table}: 4 eps k_p (gamma k_p - 4 eps^2) > 1",
            value=f_value,
            bound=1.0,
            rounding=BOUNDARY_WIDTH + f_error / greater(abs(f_value), 1.0),
        ),
        Inequality.as_printed(
            name="phi_b",
            equation=f"{table}: phi_b > l0/eps",
            value=p.phi_b,
            bound=p.l0 / p.eps,
        ),
        Inequality.as_printed(
            name="kappa_c (Lyapunov)",
            equation=f"{table}, (77)",
            value=p.kappa_c,
            bound=kappa_c_bound(k_p, p.eps, p.gamma),
            rounding=error / greater(distance_from_one, error),
        ),
        disturbance_row("kappa_c (disturbance)", p.kappa_c, constants.kd3_bar, constants.k_sigma),
        disturbance_row("kappa_b", p.kappa_b, constants.kd1_bar, k_max * bounds.c_ie),
        disturbance_row("kappa_a (disturbance)", p.kappa_a, constants.kd2_bar, k_max * bounds.c_isigma),
        Inequality.as_printed(
            name="kappa_a (kappa_b/l0)",
            equation=f"{table}: kappa_a > kappa_b/l0",
            value=p.kappa_a,
            bound=p.kappa_b / p.l0,
        ),
        Inequality.as_printed(
            name="kappa_d",
            equation=f"{table}, (77)",
            value=p.kappa_d,
            bound=kappa_d_bound(k_p, p.eps, p.gamma),
            rounding=error / greater(abs(f_value), error),
        ),
    )
