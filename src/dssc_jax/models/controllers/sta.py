"""The super-twisting algorithm in its explicit, implicit and proper implicit forms.

In the normalisation of Table 2 it is u = -kappa1 |sigma|^(1/2) sgn sigma + v, v' = -(kappa2/2) sgn sigma. The sampled
forms compute w = k_n u for the model x+ = x + h (w + d), with x = sigma, h = T_s, the disturbance d and the nominal
input gain k_n. Their gains are k1 = k_n kappa1 and k2 = k_n kappa2/2.

In units, y stands for the unit of the plant's output, and u for the unit of its command.

References:
    B. Brogliato, A. Polyakov, D. Efimov, "The implicit discretization of the supertwisting sliding-mode control
    algorithm", IEEE Trans. Automatic Control 65 (2020).
    R. Seeber, B. Andritsch, proper implicit discretisation of the super-twisting controller, Automatica (2025).
"""

import math
from collections.abc import Callable
from typing import Annotated, NamedTuple, TypeAlias

import jax.numpy as jnp

from dssc_jax.core.contracts import Controller
from dssc_jax.core.harmonic_balance import HarmonicBalance
from dssc_jax.core.numerics import root_abs, root_of, saturate, sign
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Discretisation, Entry
from dssc_jax.core.signals import (
    Command,
    Measurement,
    Params,
    ReferencePoint,
    Scalar,
    TrackingError,
    tracking_error,
)
from dssc_jax.core.smoothness import SWITCHES, not_smooth
from dssc_jax.models.controllers.dssc_forms import DsscGains, nominal_input_gain
from dssc_jax.models.controllers.nominal import L0, NominalGains, nominal_control
from dssc_jax.models.controllers.state_functions import KAPPA_1, KAPPA_2, super_twisting

K_N = Quantity("y/(s^2 u)", "nominal input gain k_n", above=0.0)
LIMIT = Quantity("u", "limit of |u|", above=0.0)
ROOT_FACTOR = 2.0 / math.sqrt(math.pi) * math.gamma(1.25) / math.gamma(1.75)
"""Factor c of the describing function c A^(-1/2) of |x|^(1/2) sgn x: 1.1128."""


class StaGains(NamedTuple):
    """Gains of the STA in the normalisation of Table 2; ``limit`` bounds |u|, but does not stop the integral."""

    l0: Annotated[Scalar, L0]
    kappa1: Annotated[Scalar, KAPPA_1]
    kappa2: Annotated[Scalar, KAPPA_2]
    k_n: Annotated[Scalar, K_N] = 1.0
    limit: Annotated[Scalar | None, LIMIT] = None
    nominal: NominalGains | None = None


class IntegralState(NamedTuple):
    """The integral term v of w = k_n u [y/s^2]."""

    v: Scalar


class IntegralInfo(NamedTuple):
    """The integral part of the command [u]."""

    integral: Annotated[Scalar, Quantity("u", "integral term of u")]


Update: TypeAlias = Callable[[Scalar, Scalar, Scalar, Scalar, Scalar], tuple[Scalar, Scalar]]
"""(x, v, k_1, k_2, T_s) -> w and v+ after the sample."""


def explicit_update(x: Scalar, v: Scalar, k1: Scalar, k2: Scalar, h: Scalar) -> tuple[Scalar, Scalar]:
    """Forward Euler: (w, v+).

    Args:
        x: Sliding variable sigma [y/s].
        v: Integral term before the sample [y/s^2].
        k1: k_n kappa_1.
        k2: k_n kappa_2/2.
        h: T_s [s].

    Returns:
        w = k_n u of the sample, and the integral term after it.
    """
    return -k1 * root_abs(x) * sign(x) + v, v - h * k2 * sign(x)


def implicit_update(x: Scalar, v: Scalar, k1: Scalar, k2: Scalar, h: Scalar) -> tuple[Scalar, Scalar]:
    """Backward Euler, solved exactly: never chatters, |x| = O(h) in sliding.

    Arguments and results are as for :func:`explicit_update`. Let b = x + h v, and xi in Sgn x+. Without a disturbance
    the sample leads from x to x+ = b - h k1 |x+|^(1/2) sgn x+ - h^2 k2 xi. For |b| <= h^2 k2 the solution is x+ = 0;
    else s = |x+|^(1/2) solves a quadratic.
    """
    b = x + h * v
    sliding = jnp.abs(b) <= h * h * k2
    s = root_of(jnp.abs(b) - h * h * k2, h * k1)
    v_next = jnp.where(sliding, -x / h, v - h * k2 * sign(b))
    return jnp.where(sliding, -x / h, v_next - k1 * s * sign(b)), v_next


def proper_update(x: Scalar, v: Scalar, k1: Scalar, k2: Scalar, h: Scalar) -> tuple[Scalar, Scalar]:
    """The proper implicit form: reaches |x| <= L h^2.

    Arguments and results are as for :func:`explicit_update`. L is a bound of |d'|, the slope of the disturbance. In the
    code ``xi`` is the set-valued sign of x, limited to [-1, 1], and ``s`` is the root in place of |x|^(1/2).
    """
    xi = saturate(x / (h * h * k2), 1.0)
    s = root_of(jnp.abs(x) - h * h * k2, h * k1)
    v_next = v - h * k2 * xi
    return -k1 * s * xi + 2.0 * v_next - v, v_next


Carried: TypeAlias = Callable[[Scalar, Scalar, Scalar, Scalar, Scalar], Scalar]
"""(x, w, k_1, k_2, T_s) -> the v with which the sample gives w."""


def explicit_carried(x: Scalar, w: Scalar, k1: Scalar, k2: Scalar, h: Scalar) -> Scalar:
    """The inverse of :func:`explicit_update` in v.

    The result is the integral term v [y/s^2] before a sample that gives ``w`` [y/s^2], for a bumpless start. ``x`` and
    the gains are as in :func:`explicit_update`; k2 and h do not enter the present w.
    """
    return w + k1 * root_abs(x) * sign(x)


def implicit_carried(x: Scalar, w: Scalar, k1: Scalar, k2: Scalar, h: Scalar) -> Scalar:
    """The inverse of :func:`implicit_update` in v: w leads to x+ = x + h w, where both terms are known.

    The result is the integral term v [y/s^2] before a sample that gives ``w`` [y/s^2], for a bumpless start. ``x``, the
    gains and h are as in :func:`implicit_update`.
    """
    after = x + h * w
    return w + (k1 * root_abs(after) + h * k2) * sign(after)


def proper_carried(x: Scalar, w: Scalar, k1: Scalar, k2: Scalar, h: Scalar) -> Scalar:
    """The inverse of :func:`proper_update` in v.

    The result is the integral term v [y/s^2] before a sample that gives ``w`` [y/s^2], for a bumpless start. ``x``, the
    gains and h are as in :func:`proper_update`.
    """
    xi = saturate(x / (h * h * k2), 1.0)
    s = root_of(jnp.abs(x) - h * h * k2, h * k1)
    return w + (2.0 * h * k2 + k1 * s) * xi


def sta_balance(gains: StaGains) -> HarmonicBalance:
    """The STA's side of the harmonic balance N(A, w) = q at the amplitude A of sigma and the frequency w [rad/s].

    Its describing function is N = c kappa1 A^(-1/2) + 2 kappa2/(pi A)/(i w), in the normalisation of Table 2, with
    c = ``ROOT_FACTOR``. The real part of the balance gives the amplitude A, and the imaginary part the residual.
    """
    kappa1 = float(gains.kappa1)
    kappa2 = float(gains.kappa2)
    return HarmonicBalance(
        amplitude=lambda q: (ROOT_FACTOR * kappa1 / q.real) ** 2,
        residual=lambda q, amplitude, w: q.imag + 2.0 * kappa2 / (math.pi * amplitude * w),
    )


def sta_of_dssc(gains: DsscGains) -> dict[str, float]:
    """The table of the STA that DSSC's state-dependent functions approximate (Table 2, row 2).

    Args:
        gains: Gains of DSSC.
    """
    twisting = super_twisting(gains.functions)
    return {"kappa1": float(twisting.kappa1), "kappa2": float(twisting.kappa2), "k_n": nominal_input_gain(gains)}


IntegralUpdate: TypeAlias = Callable[[Params, TrackingError, Scalar, Scalar], tuple[Scalar, Scalar]]
"""(gains, error, v, T_s) -> w and v+ after the sample."""

IntegralTransfer: TypeAlias = Callable[[Params, TrackingError, Scalar, Scalar], Scalar]
"""(gains, error, w, T_s) -> the v with which the sample gives w."""


def twisting_controller(gains_type: type, sampled: IntegralUpdate, inverse: IntegralTransfer) -> Controller:
    """Make a controller u = w/k_n + u_n, whose w has an integral term v for its state; STA and VGSTA are of this kind.

    Args:
        gains_type: Type of the gains, with ``l0``, ``k_n``, ``limit`` and ``nominal``.
        sampled: The sampled form: (gains, error, v, T_s) -> w and the next v.
        inverse: The sampled form, solved for the v before the sample: (gains, error, w, T_s) -> v.
    """

    def step(
        gains: Params, state: IntegralState, measurement: Measurement, reference: ReferencePoint, dt: Scalar
    ) -> tuple[IntegralState, Command, IntegralInfo]:
        # one sample
        error = tracking_error(measurement, reference, gains.l0)
        u_nominal = nominal_control(gains.nominal, gains.l0, error, reference, predictor_pole=0.0)
        w, v = sampled(gains, error, state.v, dt)
        u = w / gains.k_n
        if gains.limit is not None:
            u = saturate(u, gains.limit)
        return IntegralState(v), Command(u, u_nominal), IntegralInfo(v / gains.k_n)

    def transfer(
        gains: Params, measurement: Measurement, reference: ReferencePoint, command: Scalar, dt: Scalar
    ) -> IntegralState:
        """The integral term that leaves the command as it is.

        The first step from the returned state gives the command, for a bumpless start.
        """
        error = tracking_error(measurement, reference, gains.l0)
        w = gains.k_n * (command - nominal_control(gains.nominal, gains.l0, error, reference, predictor_pole=0.0))
        return IntegralState(inverse(gains, error, w, dt))

    return Controller(
        gains_type,
        init=lambda gains, measurement, reference: IntegralState(0.0),
        step=step,
        transfer=transfer,
        smooth=not_smooth(SWITCHES),
        limit="limit",
        info=IntegralInfo,
    )


def sta(update: Update, inverse_update: Carried) -> Controller:
    """Make the STA in a sampled form.

    Args:
        update: The sampled form.
        inverse_update: The sampled form, solved for the integral term before the sample.
    """

    def sampled(gains: StaGains, error: TrackingError, v: Scalar, dt: Scalar) -> tuple[Scalar, Scalar]:
        # k_1 = k_n kappa_1 and k_2 = k_n kappa_2/2, as Table 2 has it
        return update(error.sigma, v, gains.k_n * gains.kappa1, 0.5 * gains.k_n * gains.kappa2, dt)

    def inverse(gains: StaGains, error: TrackingError, w: Scalar, dt: Scalar) -> Scalar:
        # the v before the sample that gives w
        return inverse_update(error.sigma, w, gains.k_n * gains.kappa1, 0.5 * gains.k_n * gains.kappa2, dt)

    controller = twisting_controller(StaGains, sampled, inverse)
    return controller._replace(describing=sta_balance, tunable=("kappa1", "kappa2"), from_dssc=sta_of_dssc)


STA = Entry(
    {
        Discretisation.IMPLICIT: sta(implicit_update, implicit_carried),
        Discretisation.EXPLICIT: sta(explicit_update, explicit_carried),
        Discretisation.PROPER: sta(proper_update, proper_carried),
    },
    "super-twisting algorithm, three sampled forms",
    "discretisation",
    Discretisation.IMPLICIT,
    example={"l0": 0.5, "kappa1": 1.0, "kappa2": 2.0},
)
