"""Table 1: parameters from bounds, and its design inequalities with their slacks.

k_p is uncertain: every inequality must hold for all k_p in [k_min, k_max]. With
f(k_p) = 4 eps k_p (gamma k_p - 4 eps^2) > 1 at k_min, f rises and the bounds of kappa_c and kappa_d fall with k_p,
so all hold on the interval if and only if they hold at k_min.
"""

from collections.abc import Iterator
from enum import StrEnum
from typing import Annotated, NamedTuple

from dssc_jax.design.bounds import Bounds, Constants, derive, positive, require_plain
from dssc_jax.errors import ConfigError

ROUNDING = 1e-12  # relative; slacks below it are equality
ULPS = 16.0 * 2.0**-52  # a few roundings of the terms that cancel in f


class Recipe(StrEnum):
    """How parameters follow from the bounds.

    ``strict`` meets every inequality over the whole interval of k_p with a chosen slack. ``printed`` is Table 1's
    own column of parameters at k_min, which meets those of kappa_c and kappa_d with equality only.
    """

    STRICT = "strict"
    PRINTED = "printed"


class Free(NamedTuple):
    """The free parameters of Table 1, and the relative slack of the strict recipe."""

    l0: Annotated[float, positive("1/s", "error pole l_0")]
    phi_a: Annotated[float, positive("(m/s)^(1/2)", "square-root part phi_a")]
    eps: Annotated[float, positive("SI", "eps")]
    delta: Annotated[float, positive("(m/s)^(1/2)", "smoothing delta")]
    eps_1: Annotated[float, positive("1", "eps_1, so that f(k_min) = 1 + eps_1")]
    eps_2: Annotated[float, positive("SI", "eps_2, added to kappa_a and kappa_b")]
    eps_3: Annotated[float, positive("1", "eps_3, added to phi_b")]
    slack: Annotated[float, positive("1", "relative slack of kappa_c and kappa_d")] = 0.01


class Parameters(NamedTuple):
    """The parameters of Table 1 that the inequalities speak of, and delta."""

    l0: Annotated[float, positive("1/s", "error pole l_0")]
    phi_a: Annotated[float, positive("(m/s)^(1/2)", "square-root part phi_a")]
    phi_b: Annotated[float, positive("1", "linear part phi_b")]
    delta: Annotated[float, positive("(m/s)^(1/2)", "smoothing delta")]
    eps: Annotated[float, positive("SI", "eps")]
    gamma: Annotated[float, positive("SI", "gamma")]
    kappa_a: Annotated[float, positive("SI", "kappa_a")]
    kappa_b: Annotated[float, positive("SI", "kappa_b")]
    kappa_c: Annotated[float, positive("SI", "kappa_c")]
    kappa_d: Annotated[float, positive("SI", "kappa_d")]


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
        bound: Right side as derived; None where it has no meaning.
        printed_bound: Right side as printed.
        rounding: Relative rounding error of the bound.
    """

    name: str
    equation: str
    value: float
    bound: float | None
    printed_bound: float | None
    rounding: float = ROUNDING

    @property
    def slack(self) -> float | None:
        """Value less the derived bound."""
        return None if self.bound is None else self.value - self.bound

    @property
    def printed_slack(self) -> float | None:
        """Value less the printed bound."""
        return None if self.printed_bound is None else self.value - self.printed_bound

    @property
    def state(self) -> State:
        """Violated, boundary and satisfied told apart at rounding."""
        if self.bound is None or self.slack is None:
            return State.NOT_EVALUABLE
        if abs(self.slack) <= self.rounding * max(abs(self.value), abs(self.bound)):
            return State.BOUNDARY
        return State.SATISFIED if self.slack > 0.0 else State.VIOLATED


class Certificate(NamedTuple):
    """Every inequality, and whether all hold strictly."""

    inequalities: tuple[Inequality, ...]
    constants: Constants

    @property
    def certified(self) -> bool:
        """Whether every inequality is strictly satisfied."""
        return all(inequality.state is State.SATISFIED for inequality in self.inequalities)

    def to_dict(self) -> dict:
        """For JSON."""
        rows = [
            {
                "name": i.name,
                "equation": i.equation,
                "value": i.value,
                "bound": i.bound,
                "slack": i.slack,
                "state": i.state.value,
                "printed_slack": i.printed_slack,
            }
            for i in self.inequalities
        ]
        return {"inequalities": rows, "certified": self.certified, "constants": self.constants._asdict()}


def f(k_p: float, eps: float, gamma: float) -> float:
    """f(k_p) = 4 eps k_p (gamma k_p - 4 eps^2), the first design inequality's left side."""
    return 4.0 * eps * k_p * (gamma * k_p - 4.0 * eps**2)


def f_rounding(k_p: float, eps: float, gamma: float) -> float:
    """Absolute rounding error of f: its two terms cancel."""
    return ULPS * 4.0 * eps * k_p * (gamma * k_p + 4.0 * eps**2)


def kappa_c_bound(k_p: float, eps: float, gamma: float) -> float | None:
    """(8 eps^2 + 2 gamma k_p)/(f - 1); None where f <= 1, where it would turn negative and pass unseen."""
    excess = f(k_p, eps, gamma) - 1.0
    return (8.0 * eps**2 + 2.0 * gamma * k_p) / excess if excess > f_rounding(k_p, eps, gamma) else None


def kappa_d_bound(k_p: float, eps: float, gamma: float) -> float | None:
    """(8 eps^2 gamma k_p + 4 eps^2)/f; None where f <= 0."""
    value = f(k_p, eps, gamma)
    return (8.0 * eps**2 * gamma * k_p + 4.0 * eps**2) / value if value > f_rounding(k_p, eps, gamma) else None


def over_phi_b(first: float, second: float, factor: float, phi_b: float) -> float:
    """(first m phi_b + second)/phi_b^2, the form of the bounds of kappa_a, kappa_b and of kappa_c's second branch.

    The factor m is 2 eps as derived, since rho = 2 eps rho_1 + rho_2; the article prints 1, enough for
    eps <= 1/2 only.
    """
    return (first * factor * phi_b + second) / phi_b**2


def check(parameters: Parameters, bounds: Bounds) -> Certificate:
    """Table 1's design inequalities over the whole interval of k_p.

    Args:
        parameters: The parameters in question.
        bounds: What is known of plant, disturbance, nominal control and reference.

    Returns:
        Each inequality with its slack, as derived and as printed.

    Raises:
        ConfigError: the bounds contradict themselves.
    """
    require_plain(parameters)
    return Certificate(tuple(inequalities(parameters, bounds.prepare())), derive(bounds, parameters.l0))


def inequalities(p: Parameters, bounds: Bounds) -> Iterator[Inequality]:
    """The rows of Table 1, left column below, at k_min."""
    constants = derive(bounds, p.l0)
    k_p, k_max = bounds.k_min, bounds.k_max
    at = (k_p, p.eps, p.gamma)
    table = "Table 1"
    value, error = f(*at), ROUNDING + f_rounding(*at)
    yield Inequality("f", f"{table}: 4 eps k_p (gamma k_p - 4 eps^2) > 1", value, 1.0, 1.0, error)
    yield Inequality("phi_b", f"{table}: phi_b > l0/eps", p.phi_b, p.l0 / p.eps, p.l0 / p.eps)
    lyapunov, drift = kappa_c_bound(*at), kappa_d_bound(*at)
    yield Inequality(
        "kappa_c (Lyapunov)", f"{table}, (75)", p.kappa_c, lyapunov, lyapunov, error / abs(value - 1.0 or 1.0)
    )
    branches = (
        ("kappa_c (disturbance)", p.kappa_c, constants.kd3_bar, constants.k_sigma),
        ("kappa_b", p.kappa_b, constants.kd1_bar, k_max * bounds.c_ie),
        ("kappa_a (disturbance)", p.kappa_a, constants.kd2_bar, k_max * bounds.c_isigma),
    )
    for name, left, first, second in branches:
        derived = over_phi_b(first, second, 2.0 * p.eps, p.phi_b)
        yield Inequality(name, f"{table}, Appendix F", left, derived, over_phi_b(first, second, 1.0, p.phi_b))
    yield Inequality(
        "kappa_a (kappa_b/l0)", f"{table}: kappa_a > kappa_b/l0", p.kappa_a, p.kappa_b / p.l0, p.kappa_b / p.l0
    )
    yield Inequality("kappa_d", f"{table}, (75)", p.kappa_d, drift, drift, error / abs(value or 1.0))


def synthesise(bounds: Bounds, free: Free, recipe: Recipe = Recipe.STRICT) -> Parameters:
    """Parameters of Table 1 from bounds and free parameters.

    gamma makes f(k_min) = 1 + eps_1. The strict recipe takes max(1, 2 eps) for the factor m, which meets the
    derived and the printed inequalities, and leaves the relative slack on kappa_c and kappa_d.

    Args:
        bounds: What is known.
        free: l0, phi_a, eps, delta, eps_1, eps_2, eps_3 > 0 and the slack.
        recipe: See :class:`Recipe`.

    Raises:
        ConfigError: the bounds contradict themselves, or a free parameter is not positive.
    """
    bounds = bounds.prepare()
    try:
        require_plain(free)
    except ConfigError as error:
        raise error.within_path("free") from None
    recipe = Recipe(recipe)
    k_p, k_max, eps = bounds.k_min, bounds.k_max, free.eps
    factor, grow = (max(1.0, 2.0 * eps), 1.0 + free.slack) if recipe is Recipe.STRICT else (1.0, 1.0)
    constants = derive(bounds, free.l0)
    gamma = (1.0 + free.eps_1) / (4.0 * eps * k_p**2) + 4.0 * eps**2 / k_p
    phi_b = free.l0 / eps + free.eps_3
    # f - 1 = eps_1 by construction: the printed form of the bounds, without the difference's rounding
    lyapunov = (8.0 * eps**2 + 2.0 * gamma * k_p) / free.eps_1
    drift = (8.0 * eps**2 * gamma * k_p + 4.0 * eps**2) / (1.0 + free.eps_1)
    kappa_b = over_phi_b(constants.kd1_bar, k_max * bounds.c_ie, factor, phi_b) + free.eps_2
    kappa_a = over_phi_b(constants.kd2_bar, k_max * bounds.c_isigma, factor, phi_b)
    return Parameters(
        l0=free.l0,
        phi_a=free.phi_a,
        phi_b=phi_b,
        delta=free.delta,
        eps=eps,
        gamma=gamma,
        kappa_a=max(kappa_a, kappa_b / free.l0) + free.eps_2,
        kappa_b=kappa_b,
        kappa_c=grow * max(lyapunov, over_phi_b(constants.kd3_bar, constants.k_sigma, factor, phi_b)),
        kappa_d=grow * drift,
    )
