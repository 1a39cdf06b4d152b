"""The sampled forms of DSSC's filter and predictor (14)-(18).

The conservative form is backward Euler in the coordinate phi_1(sigma_hat) of the predictor. Its sums telescope, so that
measurement noise causes no drift; it is the default wherever phi_1 has a finite slope. The implicit form is backward
Euler in sigma_hat. Both forms have closed-form solutions. The explicit form is forward Euler; it chatters at every step
size and is unstable for T_s > 2 tau_m or T_s > 2 tau_av.

Let a = T_s/tau_av, b = T_s/tau_m and c = T_s k_o/((1+a)(1+b)). A clip solves the set-valued u_0 in rho
Sgn(sigma_tilde+) exactly. While the clip is inactive, sigma_hat+ = sigma to rounding, and the command obeys the
synthesised law (22) in backward-Euler form.

In units, y stands for the unit of the plant's output, and u for the unit of its command.
"""

from collections.abc import Callable
from enum import StrEnum
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import clip, newton, sign
from dssc_jax.core.quantities import Quantity, nominal
from dssc_jax.core.registry import Slot
from dssc_jax.core.signals import Scalar, State, TrackingError
from dssc_jax.models.controllers.gain_functions import GAIN_FUNCTIONS
from dssc_jax.models.controllers.modulation import MODULATIONS, ConstantModulation
from dssc_jax.models.controllers.nominal import L0, NominalGains
from dssc_jax.models.controllers.state_functions import StateFunctions

NEWTON_STEPS = 12  # of Newton's method for sigma_hat from phi_1(sigma_hat)


@jax.tree_util.register_static
class PredictorStart(StrEnum):
    """The choice of the predicted sigma, sigma_hat, at the start.

    With ``zero`` it is 0 at the first sample. With ``matched`` it is sigma there, so that the loop slides from the
    start, as in Appendix D. With ``midpoint`` it is sigma half a sample earlier.

    The sum of T_s phi_2 in the command approximates the integral of phi_2 by the midpoint rule. With ``matched`` this
    integral starts half a sample before the first sample, and with ``midpoint`` at the first sample.
    """

    ZERO = "zero"
    MATCHED = "matched"
    MIDPOINT = "midpoint"


class DsscGains(NamedTuple):
    """Gains of DSSC.

    Args:
        l0: Error pole l_0 of sigma [1/s].
        functions: State-dependent functions k_o, tau_av, tau_m.
        rho: Modulation rho, the bound of u_0.
        nominal: Gains of the nominal control; None: there is none.
        predictor_start: Choice of sigma_hat at the start.
        sign_width: Width w of x/(|x| + w), which replaces sgn(x) for smooth derivatives; None or 0: sgn(x).
    """

    l0: Annotated[Scalar, L0]
    functions: Annotated[State, Slot(GAIN_FUNCTIONS)]
    rho: Annotated[State, Slot(MODULATIONS, number="constant")]
    nominal: NominalGains | None = None
    predictor_start: PredictorStart = PredictorStart.MIDPOINT
    sign_width: Annotated[Scalar | None, Quantity("y/s", "width of the smoothed sign", at_least=0.0)] = None


def switching_gain(gains: DsscGains) -> float:
    """The constant modulation rho [u], or the median of its law; raises ConfigError if rho is the norm bound."""
    if not isinstance(gains.rho, ConstantModulation):
        raise ConfigError("", "rho is no constant")  # "": the caller adds the place in the study
    return nominal(gains.rho.rho)


def nominal_input_gain(gains: DsscGains) -> float:
    """The input gain k_n of the nominal plant [y/(s^2 u)]; 1 if there is no nominal control."""
    return nominal(gains.nominal.k) if gains.nominal else 1.0


class DsscState(NamedTuple):
    """What DSSC remembers from one sample to the next.

    Args:
        u_av: Averaged control [u].
        predictor: sigma_hat [y/s]; in the conservative form, phi_1(sigma_hat) [u].
        sigma: sigma at the sample before [y/s].
        modulation: State of the modulation.
        earlier: Share of a sample by which ``predictor`` is younger than one sample: with the start ``midpoint`` 0.5 at
            the first sample, then 0; () with another start.
    """

    u_av: Scalar
    predictor: Scalar
    sigma: Scalar
    modulation: State
    earlier: State = ()


class Sampled(NamedTuple):
    """Filter and predictor after one sample.

    Args:
        u_0: Switched control [u].
        u_av: Averaged control [u].
        predictor: State of the predictor, as in :class:`DsscState`.
        sigma_hat: Predicted sigma [y/s].
        u_eq: Equivalent control [u]: the u_0 with which the new sigma_hat equals sigma.
    """

    u_0: Scalar
    u_av: Scalar
    predictor: Scalar
    sigma_hat: Scalar
    u_eq: Scalar


class SampleRatios(NamedTuple):
    """Numbers that filter and predictor need at one sample, computed from the values of the functions and T_s.

    Args:
        pole: 1/tau_m [1/s].
        decay: 1/(1 + T_s/tau_m).
        c: T_s k_o/((1 + T_s/tau_av)(1 + T_s/tau_m)) [y/(s u)]. A sample decreases sigma_tilde by c times an increase of
            u_0.
        inverse_c: 1/c.
        integral_gain: K_I = 1/(k_o tau_av tau_m) of (22) [u/y].
    """

    pole: Scalar
    decay: Scalar
    c: Scalar
    inverse_c: Scalar
    integral_gain: Scalar


class ControlSample(NamedTuple):
    """What filter and predictor get at one sample.

    Args:
        error: Tracking error e and sigma.
        at: Values of the state-dependent functions.
        ratios: Ratios of these values and T_s.
        rho: Bound of u_0 [u].
    """

    error: TrackingError
    at: StateFunctions
    ratios: SampleRatios
    rho: Scalar


class SampledForm(NamedTuple):
    """A sampled form of filter and predictor.

    Args:
        predictor: (gains, error) -> the predictor's state where sigma_hat = sigma.
        rate: (gains, sample) -> the rate [1/s] at which the predictor's state decays.
        update: (gains, state, sample, T_s) -> filter and predictor after the sample.
        resting: (gains, u_av+, sample, T_s) -> u_av and the predictor's state before the sample. From these the sample
            leads to the averaged control u_av+, and the loop slides.
    """

    predictor: Callable[[DsscGains, TrackingError], Scalar]
    rate: Callable[[DsscGains, ControlSample], Scalar]
    update: Callable[[DsscGains, DsscState, ControlSample, Scalar], Sampled]
    resting: Callable[[DsscGains, Scalar, ControlSample, Scalar], tuple[Scalar, Scalar]]


def smoothed_remainder(free: Scalar, c: Scalar, rho: Scalar, width: Scalar) -> Scalar:
    """The remainder of ``free`` after u_0: the solution x of x + c rho x/(|x| + width) = free, in closed form.

    x is the sigma_tilde after a sample with a smoothed sign [y/s]: the sample takes away c u_0, where u_0 is rho times
    the smoothed sign of x. For width > 0, x is a smooth function of ``free``. For width 0 it is
    free - clip(free, -c rho, c rho).

    Args:
        free: The sigma_tilde after the sample with u_0 = 0 [y/s].
        c: Decrease of sigma_tilde by an increase of u_0 [y/(s u)].
        rho: Bound of u_0 [u].
        width: Width of the smoothed sign [y/s].
    """
    size = jnp.abs(free)
    b = width + c * rho - size
    square = b * b + 4.0 * width * size
    root = jnp.sqrt(jnp.where(square > 0.0, square, 1.0)) * (square > 0.0)  # its slope at 0 is infinite
    inside = b > 0.0
    within = free * 2.0 * width / jnp.where(inside, b + root, 1.0)  # the larger root of a quadratic, without difference
    return jnp.where(inside, within, jnp.sign(free) * 0.5 * (root - b))


def limit_change(unlimited: Scalar, u_av: Scalar, rho: Scalar, c: Scalar, width: Scalar | None) -> Scalar:
    """The change u_0 - u_av, limited so that u_0 is in rho Sgn(sigma_tilde+), sigma_tilde+ = c (unlimited - change).

    The function clips the change and not u_0, because u_0 - u_av would cancel in sliding, where both are nearly equal.

    Args:
        unlimited: The change that makes sigma_tilde+ = 0, u_eq - u_av [u].
        u_av: Averaged control before the sample [u].
        rho: Bound of u_0 [u].
        c: Decrease of sigma_tilde by an increase of u_0 [y/(s u)], used with a width only.
        width: Width of the smoothed sign [y/s]; None: the sign switches.
    """
    if width is None:
        return clip(unlimited, -rho - u_av, rho - u_av)
    return unlimited - smoothed_remainder(c * (unlimited + u_av), c, rho, width) / c


def sample_ratios(at: StateFunctions, dt: Scalar) -> SampleRatios:
    """The ratios from one common division, since a division costs far more than a product; for tau_m > 0.

    In the comments a = T_s/tau_av.
    """
    share = dt / (at.tau_av + dt)  # a/(1+a)
    gain = share * at.k_o * at.tau_av  # T_s k_o/(1+a)
    product = gain * at.tau_m
    longer = at.tau_m + dt
    inverse = 1.0 / (product * longer)
    decay = product * inverse * at.tau_m  # tau_m/(tau_m + T_s)
    inverse_product = longer * inverse  # 1/(gain tau_m)
    return SampleRatios(
        pole=gain * inverse_product,
        decay=decay,
        c=gain * decay,
        inverse_c=inverse_product * longer,
        integral_gain=share * inverse_product,
    )


def implicit_update(gains: DsscGains, state: DsscState, sample: ControlSample, dt: Scalar) -> Sampled:
    """Backward Euler for (15)-(18), solved exactly.

    A sample changes sigma_hat to decay sigma_hat + c (u_0 - u_av), and u_av by a/(1+a) of u_0 - u_av, where
    a = T_s/tau_av. The equivalent control u_eq is the u_0 that makes the new sigma_hat equal to sigma; u_0 is u_eq,
    limited to rho.
    """
    u_av = state.u_av
    sigma_hat = state.predictor
    at = sample.at
    decay = sample.ratios.decay
    c = sample.ratios.c
    inverse_c = sample.ratios.inverse_c
    unlimited = (sample.error.sigma - decay * sigma_hat) * inverse_c  # u_eq - u_av
    change = limit_change(unlimited, u_av, sample.rho, c, gains.sign_width)
    after = decay * sigma_hat + c * change
    return Sampled(u_av + change, u_av + dt / (at.tau_av + dt) * change, after, after, u_av + unlimited)


def conservative_update(gains: DsscGains, state: DsscState, sample: ControlSample, dt: Scalar) -> Sampled:
    """Backward Euler for (15)-(18) in the predictor's coordinate w = phi_1(sigma_hat), solved exactly.

    (15) to (17) give w' = u_av' - phi_2(sigma_hat) with phi_2 = rate w. In sliding w = phi_1(sigma), and u_av changes
    over any number of samples by the change of phi_1 plus T_s times the sum of phi_2, also if sigma is noisy. The
    implicit form sums g(sigma_k)(sigma_k - sigma_(k-1)) instead, whose mean under noise is not zero.
    """
    u_av = state.u_av
    w = state.predictor
    at = sample.at
    e, sigma = sample.error
    law = gains.functions.law(sigma, e, at)
    share = dt / (at.tau_av + dt)
    decay = 1.0 / (1.0 + dt * law.rate)
    unlimited = (law.gain * sigma * (1.0 + dt * law.rate) - w) / share
    change = limit_change(unlimited, u_av, sample.rho, share * decay * at.k_o * at.tau_av, gains.sign_width)
    after = decay * (w + share * change)
    sigma_hat = jnp.where(change == unlimited, sigma, predicted_sigma(gains, after, e))
    return Sampled(u_av + change, u_av + share * change, after, sigma_hat, u_av + unlimited)


def phi_1_and_slope(signals: tuple[State, Scalar, Scalar], sigma: Scalar) -> tuple[Scalar, Scalar]:
    """phi_1(sigma, e) [u] of the synthesised law and its slope in sigma, 1/(k_o tau_av).

    Args:
        signals: The state-dependent functions, l_0 and e.
        sigma: Where it is evaluated [y/s].
    """
    functions, l0, e = signals
    at = functions.at(sigma, e, l0)
    return functions.law(sigma, e, at).gain * sigma, 1.0 / (at.k_o * at.tau_av)


def predicted_sigma(gains: DsscGains, w: Scalar, e: Scalar) -> Scalar:
    """sigma_hat with phi_1(sigma_hat, e) = w; only what is recorded needs it. Newton's method goes up from below.

    The method starts at w divided by the slope of phi_1 at 0. This start is below the solution if phi_1 is concave for
    sigma > 0. ``w`` is the predictor's state [u], and ``e`` the output error [y].
    """
    size = jnp.abs(w)
    signals = (gains.functions, gains.l0, e)
    start = size / phi_1_and_slope(signals, 0.0 * size)[1]  # over the slope at 0
    return sign(w) * newton(phi_1_and_slope, signals, size, start, NEWTON_STEPS)


def explicit_update(gains: DsscGains, state: DsscState, sample: ControlSample, dt: Scalar) -> Sampled:
    """Forward Euler for (15)-(18) with sgn 0 = 0, for comparison.

    The equivalent control u_eq is only reported. It follows from (20) with the difference quotient of the last two
    sigma in place of sigma'.
    """
    sigma = sample.error.sigma
    sigma_hat = state.predictor
    at = sample.at
    u_0 = sample.rho * smoothed_sign(sigma - sigma_hat, gains.sign_width)
    change = u_0 - state.u_av
    u_eq = ((sigma - state.sigma) / dt + sigma * sample.ratios.pole) / at.k_o + state.u_av
    after = sigma_hat + dt * (at.k_o * change - sigma_hat * sample.ratios.pole)
    return Sampled(u_0, state.u_av + dt / at.tau_av * change, after, after, u_eq)


def smoothed_sign(x: Scalar, width: Scalar | None) -> Scalar:
    """The smoothed sign x/(|x| + width); with a width of None or 0, the sign of x with sgn 0 = 0."""
    if width is None:
        return sign(x)
    size = jnp.abs(x) + width
    return x / jnp.where(size > 0.0, size, 1.0)


def resting_sigma_tilde(gains: DsscGains, u_av: Scalar, rho: Scalar) -> Scalar:
    """The sigma_tilde at which u_0 = u_av: 0, or what the smoothed sign needs.

    With a smoothed sign, u_0 = u_av needs sigma_tilde = width u_av/(rho - |u_av|). If |u_av| is not below rho, no
    sigma_tilde gives u_av, and the result is 0.
    """
    if gains.sign_width is None:
        return 0.0
    room = rho - jnp.abs(u_av)
    return jnp.where(room > 0.0, gains.sign_width * u_av / jnp.where(room > 0.0, room, 1.0), 0.0)


def implicit_resting(gains: DsscGains, u_av: Scalar, sample: ControlSample, dt: Scalar) -> tuple[Scalar, Scalar]:
    """The sigma_hat that decays to sigma - sigma_tilde.

    Arguments are as for :func:`explicit_resting`; ``sample`` has the decay, so that ``dt`` is not used.

    Returns:
        u_av [u] and sigma_hat [y/s] before the sample, at whose end u_av is the same and the loop slides.
    """
    sigma_tilde = resting_sigma_tilde(gains, u_av, sample.rho)
    return u_av, (sample.error.sigma - sigma_tilde) / sample.ratios.decay


def conservative_resting(gains: DsscGains, u_av: Scalar, sample: ControlSample, dt: Scalar) -> tuple[Scalar, Scalar]:
    """The w that decays to phi_1(sigma), less the part of sigma_tilde.

    Returns:
        u_av [u] and w [u] before the sample, at whose end u_av is the same and the loop slides.
    """
    e, sigma = sample.error
    at = sample.at
    law = gains.functions.law(sigma, e, at)
    longer = 1.0 + dt * law.rate
    part = resting_sigma_tilde(gains, u_av, sample.rho) * longer / (at.k_o * at.tau_av)
    return u_av, law.gain * sigma * longer - part


def explicit_resting(gains: DsscGains, u_av: Scalar, sample: ControlSample, dt: Scalar) -> tuple[Scalar, Scalar]:
    """Without a width, u_0 = 0 at sigma_tilde = 0, and u_av decays in this sample.

    The averaged control before the sample is therefore larger by the factor 1/(1 - T_s/tau_av). With a width, u_0 and
    u_av are equal, and u_av stays.

    Args:
        gains: Gains of DSSC.
        u_av: Averaged control after the sample [u].
        sample: Inputs of filter and predictor.
        dt: T_s [s].

    Returns:
        u_av [u] and sigma_hat [y/s] before the sample.
    """
    sigma_tilde = resting_sigma_tilde(gains, u_av, sample.rho)
    start = u_av / (1.0 - dt / sample.at.tau_av) if gains.sign_width is None else u_av
    return start, sample.error.sigma - sigma_tilde


def sigma_coordinate(gains: DsscGains, error: TrackingError) -> Scalar:
    """The predictor's state of the implicit and the explicit form where sigma_hat = sigma: sigma itself [y/s]."""
    return error.sigma


def sigma_rate(gains: DsscGains, sample: ControlSample) -> Scalar:
    """The rate 1/tau_m [1/s] at which the predictor's state sigma_hat of the implicit and the explicit form decays."""
    return sample.ratios.pole


def phi_1_coordinate(gains: DsscGains, error: TrackingError) -> Scalar:
    """phi_1(sigma, e).

    This value is the state w [u] of the predictor in the conservative form where sigma_hat = sigma.
    """
    at = gains.functions.at(error.sigma, error.e, gains.l0)
    return gains.functions.law(error.sigma, error.e, at).gain * error.sigma


def phi_1_rate(gains: DsscGains, sample: ControlSample) -> Scalar:
    """The rate phi_2/phi_1 [1/s] at which the predictor's state w of the conservative form decays."""
    e, sigma = sample.error
    return gains.functions.law(sigma, e, sample.at).rate
