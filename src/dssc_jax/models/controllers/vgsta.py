"""The variable-gain super-twisting algorithm u = -kappa_1 phi_1 - int kappa_2 phi_1 phi_1' dt.

Here phi_1 = phi_a sigma/(r + delta) + phi_b sigma (26) with r = |sigma|^(1/2), and the gains kappa_1 and kappa_2 are
those of Table 1. delta = 0 gives the exact VGSTA, with kappa_3 = phi_b when phi_a = 1.

The implicit form evaluates the gains, and the factors of (26) that depend on delta, at the sampled (sigma, e), as
DSSC does. With s = |x+|^(1/2), where x+ is sigma after the sample, backward Euler is then a quadratic in s. For
constant gains, phi_b = 0 and delta = 0 it equals the implicit STA.

In units, y stands for the unit of the plant's output.
"""

from collections.abc import Callable
from typing import Annotated, NamedTuple, TypeAlias

import jax.numpy as jnp

from dssc_jax.core.contracts import Controller
from dssc_jax.core.numerics import root_abs, root_of, sign
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Discretisation, Entry
from dssc_jax.core.signals import Scalar, TrackingError
from dssc_jax.models.controllers.dssc_forms import DsscGains, nominal_input_gain
from dssc_jax.models.controllers.gain_functions import (
    KAPPA_ABC,
    TABLE_1_EXAMPLE,
    VariableGains,
    Vgsta,
    variable_gains,
)
from dssc_jax.models.controllers.nominal import L0, NominalGains
from dssc_jax.models.controllers.sta import K_N, LIMIT, twisting_controller
from dssc_jax.models.controllers.state_functions import ROOT_FLOOR, super_twisting


class VgstaGains(NamedTuple):
    """Gains of the VGSTA, as in Table 1; ``limit`` bounds |u|, but does not stop the integral."""

    l0: Annotated[Scalar, L0]
    phi_a: Annotated[Scalar, Quantity("(y/s)^(1/2)", "square-root part phi_a", at_least=0.0)]
    phi_b: Annotated[Scalar, Quantity("1", "linear part phi_b", at_least=0.0)]
    kappa_a: Annotated[Scalar, Quantity("SI", f"{KAPPA_ABC} of |sigma|, kappa_a", at_least=0.0)]
    kappa_b: Annotated[Scalar, Quantity("SI", f"{KAPPA_ABC} of |e|, kappa_b", at_least=0.0)]
    kappa_c: Annotated[Scalar, Quantity("SI", f"{KAPPA_ABC} kappa_c", at_least=0.0)]
    kappa_d: Annotated[Scalar, Quantity("SI", f"{KAPPA_ABC} kappa_d", at_least=0.0)]
    epsilon: Annotated[Scalar, Quantity("SI", "integral gain's share eps", at_least=0.0)]
    gamma: Annotated[Scalar, Quantity("SI", "integral gain's offset gamma", at_least=0.0)]
    delta: Annotated[Scalar, Quantity("(y/s)^(1/2)", "smoothing delta", at_least=0.0)] = 0.0
    k_n: Annotated[Scalar, K_N] = 1.0
    limit: Annotated[Scalar | None, LIMIT] = None
    nominal: NominalGains | None = None


class Shape(NamedTuple):
    """Factors of phi_1 and of its slope near the sampled sigma, where s = |x|^(1/2).

    phi_1(x) is a s sgn x + b x, and its slope is a_slope/(2 s) + b.
    """

    a: Scalar
    a_slope: Scalar
    b: Scalar


def shape_at(gains: VgstaGains, sigma: Scalar) -> Shape:
    """The factors of (26) at the sample; without delta they are phi_a, phi_a and phi_b exactly.

    With delta, a and a_slope vary with |x|; their values at the sampled sigma hold for the sample.

    Args:
        gains: Gains of the VGSTA.
        sigma: Sliding variable at the sample [y/s].
    """
    r = root_abs(sigma, ROOT_FLOOR)
    rd = r + gains.delta  # r + delta
    return Shape(gains.phi_a * r / rd, gains.phi_a * r * (rd + gains.delta) / (rd * rd), gains.phi_b)


Update: TypeAlias = Callable[[Scalar, Scalar, Shape, VariableGains, Scalar, Scalar], tuple[Scalar, Scalar]]
"""(x, v, factors of phi_1, gains, k_n, T_s) -> w and v+ after the sample."""


class Phi(NamedTuple):
    """Values at one x: ``first`` is phi_1(x), and ``second`` is phi_2 = phi_1 phi_1'."""

    first: Scalar
    second: Scalar


def phi_at(x: Scalar, shape: Shape) -> Phi:
    """phi_1 and phi_2. Apart from its sign, phi_1 phi_1' is even in s = |x|^(1/2), hence bounded at 0.

    Args:
        x: Where both are evaluated [y/s].
        shape: Factors of phi_1 and its slope.
    """
    s = root_abs(x)
    first = (shape.a + shape.b * s) * s * sign(x)
    second = (shape.a + shape.b * s) * (0.5 * shape.a_slope + shape.b * s) * sign(x)
    return Phi(first, second)


def explicit_update(
    x: Scalar, v: Scalar, shape: Shape, at: VariableGains, k_n: Scalar, h: Scalar
) -> tuple[Scalar, Scalar]:
    """Forward Euler: (w, v+).

    Args:
        x: Sliding variable sigma [y/s].
        v: Integral term before the sample [y/s^2].
        shape: Factors of phi_1.
        at: Variable gains kappa_1 and kappa_2 at the sample.
        k_n: Nominal input gain.
        h: T_s [s].

    Returns:
        w = k_n u of the sample, and the integral term after it.
    """
    phi_1, phi_2 = phi_at(x, shape)
    return -k_n * at.kappa1 * phi_1 + v, v - h * k_n * at.kappa2 * phi_2


def implicit_update(
    x: Scalar, v: Scalar, shape: Shape, at: VariableGains, k_n: Scalar, h: Scalar
) -> tuple[Scalar, Scalar]:
    """Backward Euler with the gains of the sample: A s^2 + B s = |x + h v| - h^2 kappa_2 a a_slope/2.

    Arguments and results are as for :func:`explicit_update`; s = |x+|^(1/2). In the code A is ``quadratic``, B is
    ``linear``, and ``dead_zone`` is the last term: where |x + h v| does not exceed it, x+ = 0.
    """
    a, a_slope, b = shape
    hk1 = h * k_n * at.kappa1
    h2k2 = h * h * k_n * at.kappa2
    start = x + h * v
    quadratic = 1.0 + hk1 * b + h2k2 * b * b
    linear = hk1 * a + h2k2 * b * (a + 0.5 * a_slope)
    dead_zone = 0.5 * h2k2 * a * a_slope
    sliding = jnp.abs(start) <= dead_zone
    s = root_of((jnp.abs(start) - dead_zone) / quadratic, linear / quadratic)
    phi_1 = (a + b * s) * s * sign(start)
    phi_2 = (a + b * s) * (0.5 * a_slope + b * s) * sign(start)
    v_next = jnp.where(sliding, -x / h, v - h * k_n * at.kappa2 * phi_2)
    return jnp.where(sliding, -x / h, v_next - k_n * at.kappa1 * phi_1), v_next


Carried: TypeAlias = Callable[[Scalar, Scalar, Shape, VariableGains, Scalar, Scalar], Scalar]
"""(x, w, factors of phi_1, gains, k_n, T_s) -> the v with which the sample gives w."""


def explicit_carried(x: Scalar, w: Scalar, shape: Shape, at: VariableGains, k_n: Scalar, h: Scalar) -> Scalar:
    """The inverse of :func:`explicit_update` in v.

    The result is the integral term v [y/s^2] before a sample that gives ``w`` [y/s^2], for a bumpless start. The other
    arguments are as in :func:`explicit_update`; h does not enter the present w.
    """
    return w + k_n * at.kappa1 * phi_at(x, shape).first


def implicit_carried(x: Scalar, w: Scalar, shape: Shape, at: VariableGains, k_n: Scalar, h: Scalar) -> Scalar:
    """The inverse of :func:`implicit_update` in v: w leads to x+ = x + h w, where both terms are known.

    The result is the integral term v [y/s^2] before a sample that gives ``w`` [y/s^2], for a bumpless start. The other
    arguments are as in :func:`implicit_update`.
    """
    phi_1, phi_2 = phi_at(x + h * w, shape)
    return w + k_n * (at.kappa1 * phi_1 + h * at.kappa2 * phi_2)


def gains_of_sample(gains: VgstaGains, error: TrackingError) -> VariableGains:
    """The variable gains kappa_1 and kappa_2 at the sampled (sigma, e).

    Args:
        gains: Gains of the VGSTA.
        error: Tracking errors sigma [y/s] and e [y].
    """
    coefficients = (gains.kappa_a, gains.kappa_b, gains.kappa_c, gains.kappa_d)
    return variable_gains(error.sigma, error.e, coefficients, gains.epsilon, gains.gamma)


def vgsta_of_dssc(gains: DsscGains) -> dict[str, float]:
    """The table of the VGSTA that corresponds to DSSC.

    If DSSC's functions are those of Table 1, the VGSTA has their numbers. Otherwise it is the STA that the functions
    approximate, written as a VGSTA: phi_a = 1, phi_b = 0, constant gains and the smoothing delta.
    """
    if isinstance(gains.functions, Vgsta):
        numbers = {name: getattr(gains.functions, name) for name in TABLE_1_EXAMPLE}
    else:
        twisting = super_twisting(gains.functions)
        numbers = dict.fromkeys(TABLE_1_EXAMPLE, 0.0)
        numbers |= {"phi_a": 1.0, "kappa_d": twisting.kappa1, "gamma": twisting.kappa2, "delta": twisting.delta}
    table = {name: float(value) for name, value in numbers.items()}
    table["k_n"] = nominal_input_gain(gains)
    return table


def vgsta(update: Update, inverse_update: Carried) -> Controller:
    """Make the VGSTA in a sampled form.

    Args:
        update: The sampled form.
        inverse_update: The sampled form, solved for the integral term before the sample.
    """

    def sampled(gains: VgstaGains, error: TrackingError, v: Scalar, dt: Scalar) -> tuple[Scalar, Scalar]:
        shape = shape_at(gains, error.sigma)
        return update(error.sigma, v, shape, gains_of_sample(gains, error), gains.k_n, dt)

    def inverse(gains: VgstaGains, error: TrackingError, w: Scalar, dt: Scalar) -> Scalar:
        # the v before the sample that gives w
        shape = shape_at(gains, error.sigma)
        return inverse_update(error.sigma, w, shape, gains_of_sample(gains, error), gains.k_n, dt)

    controller = twisting_controller(VgstaGains, sampled, inverse)
    return controller._replace(tunable=("kappa_d", "gamma"), from_dssc=vgsta_of_dssc)


VGSTA = Entry(
    {
        Discretisation.IMPLICIT: vgsta(implicit_update, implicit_carried),
        Discretisation.EXPLICIT: vgsta(explicit_update, explicit_carried),
    },
    "variable-gain super-twisting algorithm with the gains of Table 1",
    "discretisation",
    Discretisation.IMPLICIT,
    example={"l0": 0.5, **TABLE_1_EXAMPLE},
)
