"""Table 1: parameters from bounds, and its design inequalities with their slacks.

k_p is uncertain: every inequality must hold for all k_p in [k_min, k_max]. With
f(k_p) = 4 eps k_p (gamma k_p - 4 eps^2) > 1 at k_min, f rises and the bounds of kappa_c and kappa_d fall with k_p,
so all hold on the interval if and only if they hold at k_min.
"""

from enum import StrEnum
from typing import Annotated, NamedTuple

from dssc_jax.design.arrays import Number, greater, ratio_where
from dssc_jax.design.bounds import Bounds, derive, positive

ROUNDING = 1e-12  # relative; slacks below it are equality
ULPS = 16.0 * 2.0**-52  # a few roundings of the terms that cancel in f


class Parameters(NamedTuple):
    """The parameters of Table 1 that the inequalities speak of, and delta."""

    l0: Annotated[Number, positive("1/s", "error pole l_0")]
    phi_a: Annotated[Number, positive("(m/s)^(1/2)", "square-root part phi_a")]
    phi_b: Annotated[Number, positive("1", "linear part phi_b")]
    delta: Annotated[Number, positive("(m/s)^(1/2)", "smoothing delta")]
    eps: Annotated[Number, positive("SI", "eps")]
    gamma: Annotated[Number, positive("SI", "gamma")]
    kappa_a: Annotated[Number, positive("SI", "kappa_a")]
    kappa_b: Annotated[Number, positive("SI", "kappa_b")]
    kappa_c: Annotated[Number, positive("SI", "kappa_c")]
    kappa_d: Annotated[Number, positive("SI", "kappa_d")]


class State(StrEnum):
    """What an inequality's slack says; ``not_evaluable`` where its bound has no meaning because f <= 1 or f <= 0."""

    SATISFIED = "satisfied"
    BOUNDARY = "boundary"
    VIOLATED = "violated"
    NOT_EVALUABLE = "not_evaluable"


class Inequality(NamedTuple):
    """One strict inequality ``value > bound``.

    Args:
        name: What it bounds.
        equation: Where it stands in the article.
        value: Left side.
        bound: Right side as derived; NaN where it has no meaning.
        printed_bound: Right side as printed; NaN likewise.
        rounding: Relative rounding error of the bound.
    """

    name: str
    equation: str
    value: Number
    bound: Number
    printed_bound: Number
    rounding: Number = ROUNDING

    @property
    def slack(self) -> Number:
        """Value less the derived bound; NaN where that has no meaning."""
        return self.value - self.bound

    @property
    def printed_slack(self) -> Number:
        """Value less the printed bound."""
        return self.value - self.printed_bound

    @property
    def tolerance(self) -> Number:
        """Slacks of at most this size are equality."""
        return self.rounding * greater(abs(self.value), abs(self.bound))

    @property
    def satisfied(self) -> Number:
        """Whether it holds strictly; False where it has no meaning. For arrays, element by element."""
        return self.slack > self.tolerance

    @property
    def state(self) -> State:
        """Violated, boundary and satisfied told apart at rounding; for plain numbers."""
        if self.bound != self.bound:
            return State.NOT_EVALUABLE
        if abs(self.slack) <= self.tolerance:
            return State.BOUNDARY
        return State.SATISFIED if self.slack > 0.0 else State.VIOLATED


def f(k_p: Number, eps: Number, gamma: Number) -> Number:
    """f(k_p) = 4 eps k_p (gamma k_p - 4 eps^2), the first design inequality's left side."""
    return 4.0 * eps * k_p * (gamma * k_p - 4.0 * eps**2)


def f_rounding(k_p: Number, eps: Number, gamma: Number) -> Number:
    """Absolute rounding error of f: its two terms cancel."""
    return ULPS * 4.0 * eps * k_p * (gamma * k_p + 4.0 * eps**2)


def kappa_c_bound(k_p: Number, eps: Number, gamma: Number) -> Number:
    """(8 eps^2 + 2 gamma k_p)/(f - 1); NaN where f <= 1, where it would turn negative and pass unseen."""
    excess = f(k_p, eps, gamma) - 1.0
    return ratio_where(excess > f_rounding(k_p, eps, gamma), 8.0 * eps**2 + 2.0 * gamma * k_p, excess)


def kappa_d_bound(k_p: Number, eps: Number, gamma: Number) -> Number:
    """(8 eps^2 gamma k_p + 4 eps^2)/f; NaN where f <= 0."""
    value = f(k_p, eps, gamma)
    return ratio_where(value > f_rounding(k_p, eps, gamma), 8.0 * eps**2 * gamma * k_p + 4.0 * eps**2, value)


def over_phi_b(first: Number, second: Number, factor: Number, phi_b: Number) -> Number:
    """(first m phi_b + second)/phi_b^2, the form of the bounds of kappa_a, kappa_b and of kappa_c's second branch.

    The factor m is 2 eps as derived, since rho = 2 eps rho_1 + rho_2; the article prints 1, enough for
    eps <= 1/2 only.
    """
    return (first * factor * phi_b + second) / phi_b**2


def inequalities(p: Parameters, bounds: Bounds) -> tuple[Inequality, ...]:
    """The design inequalities of Table 1 at k_min, hence over the whole interval of k_p.

    Args:
        p: The parameters; numbers or arrays of shapes that broadcast.
        bounds: What is known of plant, disturbance, nominal control and reference.
    """
    constants = derive(bounds, p.l0)
    k_p, k_max = bounds.k_min, bounds.k_max
    at = (k_p, p.eps, p.gamma)
    table = "Table 1"
    value = f(*at)
    error = ROUNDING + f_rounding(*at)
    lyapunov, drift = kappa_c_bound(*at), kappa_d_bound(*at)

    def disturbed(name: str, left: Number, first: Number, second: Number) -> Inequality:
        derived = over_phi_b(first, second, 2.0 * p.eps, p.phi_b)
        return Inequality(name, f"{table}, Appendix F", left, derived, over_phi_b(first, second, 1.0, p.phi_b))

    near_one = abs(value - 1.0)
    return (
        Inequality(
            "f",
            f"{table}: 4 eps k_p (gamma k_p - 4 eps^2) > 1",
            value,
            1.0,
            1.0,
            ROUNDING + f_rounding(*at) / greater(abs(value), 1.0),
        ),
        Inequality("phi_b", f"{table}: phi_b > l0/eps", p.phi_b, p.l0 / p.eps, p.l0 / p.eps),
        Inequality(
            "kappa_c (Lyapunov)",
            f"{table}, (77)",
            p.kappa_c,
            lyapunov,
            lyapunov,
            error / greater(near_one, error),
        ),
        disturbed("kappa_c (disturbance)", p.kappa_c, constants.kd3_bar, constants.k_sigma),
        disturbed("kappa_b", p.kappa_b, constants.kd1_bar, k_max * bounds.c_ie),
        disturbed("kappa_a (disturbance)", p.kappa_a, constants.kd2_bar, k_max * bounds.c_isigma),
        Inequality(
            "kappa_a (kappa_b/l0)", f"{table}: kappa_a > kappa_b/l0", p.kappa_a, p.kappa_b / p.l0, p.kappa_b / p.l0
        ),
        Inequality("kappa_d", f"{table}, (77)", p.kappa_d, drift, drift, error / greater(abs(value), error)),
    )
