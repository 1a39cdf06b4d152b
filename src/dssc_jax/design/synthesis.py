"""Synthesis of a certified design from bounds and free parameters."""

from enum import StrEnum
from typing import Annotated, NamedTuple

from dssc_jax.core.errors import ConfigError
from dssc_jax.design.arrays import Numeric, greater
from dssc_jax.design.bounds import Bounds, derive, positive, require_plain
from dssc_jax.design.small_gain import small_gain
from dssc_jax.design.table1 import Parameters, over_phi_b


class Recipe(StrEnum):
    """Rules by which the parameters of Table 1 follow from bounds and free parameters.

    ``strict`` meets every inequality over the whole interval of k_p, and the small-gain condition, with a chosen slack.
    ``printed`` takes the parameters that Table 1 prints, at k_min. These satisfy the inequalities of kappa_c and
    kappa_d only with equality, and do not ensure the small-gain condition.
    """

    STRICT = "strict"
    PRINTED = "printed"


class Free(NamedTuple):
    """The numbers of Table 1 that a designer chooses, and the relative slack of the strict recipe.

    ``eps`` and ``gamma`` determine the matrix P of the Lyapunov function (53); ``gamma`` follows from ``eps_1``.
    """

    l0: Annotated[Numeric, positive("1/s", "error pole l_0")]
    phi_a: Annotated[Numeric, positive("(m/s)^(1/2)", "square-root part phi_a")]
    eps: Annotated[Numeric, positive("SI", "eps")]
    delta: Annotated[Numeric, positive("(m/s)^(1/2)", "smoothing delta")]
    eps_1: Annotated[Numeric, positive("1", "eps_1, so that f(k_min) = 1 + eps_1")]
    eps_2: Annotated[Numeric, positive("SI", "eps_2, added to kappa_a and kappa_b")]
    eps_3: Annotated[Numeric, positive("1", "eps_3, the least excess of phi_b over l0/eps")]
    slack: Annotated[Numeric, positive("1", "relative slack of kappa_c, kappa_d and phi_b's small-gain bound")] = 0.01


def synthesise(bounds: Bounds, free: Free, recipe: Recipe = Recipe.STRICT) -> Parameters:
    """Compute parameters of Table 1 from bounds and free parameters, after checks of both.

    gamma is chosen so that f(k_min) = 1 + eps_1. The strict recipe takes max(1, 2 eps) for the factor m of
    :func:`dssc_jax.design.table1.over_phi_b`, which satisfies the derived and the printed inequalities. It adds the
    relative slack to the bounds of kappa_c and kappa_d. phi_b is l0/eps + eps_3, or larger if the small-gain condition
    requires it.

    Args:
        bounds: Bounds of plant, disturbance, nominal control and reference.
        free: The free parameters, plain positive numbers.
        recipe: See :class:`Recipe`.

    Raises:
        ConfigError: The bounds contradict themselves, a free parameter is not positive, or a resulting parameter is
            too large or too small to compute with.

    Example:
        >>> bounds = Bounds(k_min=0.9, k_max=1.1, a_max=1.0, alpha_d3=0.1)
        >>> gains = synthesise(bounds, Free(l0=0.5, phi_a=0.1, eps=0.3, delta=0.5, eps_1=2.0, eps_2=0.1, eps_3=6.0))
        >>> round(gains.phi_b, 4), round(gains.gamma, 4)
        (7.6667, 3.4864)
    """
    bounds = bounds.prepare()
    try:
        require_plain(free)
    except ConfigError as error:
        raise error.within_path("free") from None
    parameters = Parameters(*map(float, design(bounds, free, Recipe(recipe))))
    try:
        require_plain(parameters)
    except ConfigError as error:
        raise ConfigError("free", f"makes with these bounds {error.where}, which {error.rule}") from None
    return parameters


def design(bounds: Bounds, free: Free, recipe: Recipe = Recipe.STRICT) -> Parameters:
    """Compute parameters of Table 1 by the rules of :func:`synthesise`, without checks of the arguments.

    Args:
        bounds: Bounds of plant, disturbance, nominal control and reference.
        free: The free parameters: numbers, arrays or traced values.
        recipe: See :class:`Recipe`.
    """
    is_strict = recipe is Recipe.STRICT
    k_p = bounds.k_min
    k_max = bounds.k_max
    eps = free.eps
    slack_factor = 1.0 + free.slack if is_strict else 1.0
    factor = greater(1.0, 2.0 * eps) if is_strict else 1.0  # m of over_phi_b
    c = derive(bounds, free.l0)
    gamma = (1.0 + free.eps_1) / (4.0 * eps * k_p**2) + 4.0 * eps**2 / k_p
    # the bounds of kappa_c and kappa_d with f - 1 = eps_1, which holds by construction: no difference rounds
    kappa_c_bound = (8.0 * eps**2 + 2.0 * gamma * k_p) / free.eps_1
    kappa_d_bound = (8.0 * eps**2 * gamma * k_p + 4.0 * eps**2) / (1.0 + free.eps_1)
    phi_b = free.l0 / eps + free.eps_3
    without_kappas = Parameters(  # for the small-gain condition, which does not depend on kappa_a, kappa_b and kappa_c
        l0=free.l0,
        phi_a=free.phi_a,
        phi_b=phi_b,
        delta=free.delta,
        eps=eps,
        gamma=gamma,
        kappa_a=0.0,
        kappa_b=0.0,
        kappa_c=0.0,
        kappa_d=slack_factor * kappa_d_bound,
    )
    if is_strict:
        phi_b = greater(phi_b, slack_factor * small_gain(without_kappas, bounds).derived)
    kappa_b = over_phi_b(c.kd1_bar, k_max * bounds.c_ie, factor, phi_b) + free.eps_2
    kappa_a_bound = over_phi_b(c.kd2_bar, k_max * bounds.c_isigma, factor, phi_b)
    return without_kappas._replace(
        phi_b=phi_b,
        kappa_a=greater(kappa_a_bound, kappa_b / free.l0) + free.eps_2,
        kappa_b=kappa_b,
        kappa_c=slack_factor * greater(kappa_c_bound, over_phi_b(c.kd3_bar, c.k_sigma, factor, phi_b)),
    )
