"""The sampling period and the modulation that a design needs in practice.

The theorem assumes continuous time and a modulation that dominates the disturbance. The bounds here hold in the
guaranteed residual set, where the loop eventually stays; a start far away needs faster sampling or a larger
modulation.
"""

from typing import Annotated, NamedTuple

from dssc_jax.core.numerics import namespace
from dssc_jax.design.arrays import Numeric, ratio_where
from dssc_jax.design.bounds import DISTURBANCE_FIELDS, Bounds, derive, non_negative, positive
from dssc_jax.design.lyapunov import kappa_1
from dssc_jax.design.small_gain import Guarantee, guarantee
from dssc_jax.design.table1 import Parameters

RATIO = 0.5  # share of the sampling limit that the proposed periods use


class Practice(NamedTuple):
    """The sampling period that a design needs, and the bounds that its modulation rho must dominate.

    Values for the residual set are NaN if no residual set is guaranteed. ``u_av`` and ``drift`` are also NaN for a
    disturbance without the bound ``alpha_d``, and for a nominal control with an integral.

    Args:
        sample_time_origin: Sampling period at half the sampling limit for sigma = e = 0 and k_p = k_max [s].
        sample_time: Sampling period at half the sampling limit over the guaranteed residual set [s].
        proportional_gain: Bound of 1/(k_o tau_av), the synthesised proportional gain, over the residual set [1].
        u_av: Bound of |u_av| over the residual set [m/s].
        drift: Bound of |sigma' + sigma/tau_m| over the residual set [m/s^2]. By (20) k_o u_eq = k_o u_av + sigma' +
            sigma/tau_m in sliding, so rho > u_av + drift/k_o satisfies the sliding condition.
    """

    sample_time_origin: Numeric
    sample_time: Numeric
    proportional_gain: Numeric
    u_av: Numeric
    drift: Numeric


def practice(p: Parameters, bounds: Bounds, proved_guarantee: Guarantee | None = None) -> Practice:
    """Compute the sampling periods that a design needs, and the bounds that its rho must dominate.

    Args:
        p: Parameters of Table 1.
        bounds: Bounds of plant, disturbance, nominal control and reference.
        proved_guarantee: The guarantee, if it has been computed; None: it is computed here.
    """
    residual_set = finite_guarantee(guarantee(p, bounds) if proved_guarantee is None else proved_guarantee)
    gain = proportional_gain(p, residual_set.sigma, residual_set.e)
    command = command_bounds(p, bounds, residual_set)
    return Practice(
        sample_time_origin=sample_time(bounds.k_max, proportional_gain(p, 0.0, 0.0), predictor_pole(p)),
        sample_time=sample_time(bounds.k_max, gain, predictor_pole(p)),
        proportional_gain=gain,
        u_av=command.u_av,
        drift=command.drift,
    )


def finite_guarantee(guaranteed: Guarantee) -> Guarantee:
    """A guarantee with NaN in place of every infinite value, so that all values derived from it are NaN."""
    xp = namespace(*guaranteed)
    return Guarantee(*(xp.where(xp.isfinite(value), value, xp.nan) for value in guaranteed))


def proportional_gain(p: Parameters, sigma: Numeric, e: Numeric) -> Numeric:
    """Bound of the proportional gain 1/(k_o tau_av) = kappa_1' phi_1 + kappa_1 phi_1' (28).

    phi_1' and phi_1/sigma are largest at sigma = 0, where both are phi_a/delta + phi_b. So the bound is exact at
    sigma = e = 0.

    Args:
        p: Parameters of Table 1.
        sigma: Largest |sigma| [m/s].
        e: Largest |e| [m].
    """
    kappa = p.kappa_a * sigma + p.kappa_b * e + p.kappa_c
    return (2.0 * kappa * p.kappa_a * sigma + kappa_1(p, sigma, e)) * (p.phi_a / p.delta + p.phi_b)


def predictor_pole(p: Parameters) -> Numeric:
    """Bound of the predictor's pole 1/tau_m of (29) over all sigma and e [1/s].

    1/tau_m is the sum of two terms. The term with d kappa_1/d e is at most kappa_b/kappa_a; it has no bound if
    kappa_a = 0, and the result is then NaN. The term with kappa_2 is at most the largest phi_1/sigma times the largest
    kappa_2/kappa_1.
    """
    largest_ratio = 2.0 * p.eps + p.gamma / (p.kappa_c**2 + p.kappa_d)  # of kappa_2 to kappa_1
    return ratio_where(p.kappa_a > 0.0, p.kappa_b, p.kappa_a) + (p.phi_a / p.delta + p.phi_b) * largest_ratio


def sample_time(k_p: Numeric, gain: Numeric, pole: Numeric) -> Numeric:
    """The sampling period T_s [s] that uses the share :data:`RATIO` of the sampling limit.

    At the limit, (k_p T_s gain)(1 + T_s pole/2)/2 equals 1. The result is the positive root T_s of the quadratic
    equation in which :data:`RATIO` takes the place of 1.

    Args:
        k_p: High-frequency gain [1/s].
        gain: Proportional gain 1/(k_o tau_av).
        pole: Predictor's pole 1/tau_m [1/s].
    """
    without_pole = 2.0 * RATIO / (k_p * gain)  # T_s for a pole of 0
    return 2.0 * without_pole / (1.0 + (1.0 + 2.0 * without_pole * pole) ** 0.5)


class CommandBounds(NamedTuple):
    """Bounds of what the modulation rho must dominate in the residual set.

    Args:
        u_av: Bound of |u_av| [m/s].
        drift: Bound of |sigma' + sigma/tau_m| [m/s^2].
    """

    u_av: Numeric
    drift: Numeric


def command_bounds(p: Parameters, bounds: Bounds, residual_set: Guarantee) -> CommandBounds:
    """Bounds of the averaged control u_av and of the drift in the residual set; NaN if the loop has no such bounds.

    By (48) sigma' = -k_p kappa_1 phi_1 + beta_1 + z with |phi_1|, |z| <= zeta, and by (13) k_p u_av = d_sigma - sigma'.

    Args:
        p: Parameters of Table 1.
        bounds: Bounds of plant, disturbance, nominal control and reference.
        residual_set: The guarantee with its residual set, with NaN in place of infinity.
    """
    constants = derive(bounds, p.l0)
    sigma = residual_set.sigma
    e = residual_set.e
    xp = namespace(sigma)
    beta_1_ratio = constants.kd1_bar * e + constants.kd2_bar * sigma + constants.kd3_bar  # bound of |beta_1/sigma|
    sigma_dot = (bounds.k_max * kappa_1(p, sigma, e) + 1.0) * residual_set.zeta + beta_1_ratio * sigma
    y_dot = p.l0 * e + sigma + bounds.y_m_dot  # bound of |y'|
    sigma_m_dot = bounds.y_m_ddot + p.l0 * bounds.y_m_dot  # bound of |sigma_m'|, with sigma_m = y_m' + l0 y_m
    nominal = bounds.c_e1 * e + bounds.c_sigma * sigma + bounds.c_m  # bound of the nominal control
    zero_output = output_norm(bounds) * residual_set.x_eta  # bound of the zero dynamics' output
    d_sigma = bounds.k_max * (nominal + bounds.alpha_d) + (p.l0 + bounds.a_max) * y_dot + sigma_m_dot + zero_output
    is_known = determines_command(bounds)
    return CommandBounds(
        u_av=xp.where(is_known, (d_sigma + sigma_dot) / bounds.k_min, xp.nan),
        drift=xp.where(is_known, sigma_dot + sigma * predictor_pole(p), xp.nan),
    )


def determines_command(bounds: Bounds) -> Numeric:
    """Whether the command has a bound.

    It has one if the disturbance is 0 or has the bound ``alpha_d``, and the nominal control has no integral.
    """
    disturbance = [getattr(bounds, name) for name in DISTURBANCE_FIELDS]
    is_undisturbed = namespace(*disturbance).logical_not(sum(disturbance) > 0.0)
    has_no_integral = bounds.c_isigma + bounds.c_ie == 0.0
    return ((bounds.alpha_d > 0.0) | is_undisturbed) & has_no_integral


def output_norm(bounds: Bounds) -> float:
    """|C_eta|, the norm of the output row of the zero dynamics; 0 for a plant of order two."""
    if bounds.zero_dynamics is None:
        return 0.0
    return float(sum(x * x for x in bounds.zero_dynamics.c) ** 0.5)


class Modulation(NamedTuple):
    """The numbers of the modulation rho (33), with which the loop reaches sliding."""

    k_o: Annotated[float, positive("1/s", "constant predictor gain k_o")]
    delta_rho: Annotated[float, positive("m/s^2", "margin delta_rho of (33)")]
    sigma_tilde: Annotated[float, non_negative("m/s", "|sigma - sigma_hat| at the start")] = 0.0

    def needed_rho(self, practice: Practice) -> Numeric:
        """Constant rho [m/s] that maintains sliding in the residual set with the margin delta_rho."""
        return practice.u_av + (practice.drift + self.delta_rho) / self.k_o

    @property
    def first_sliding(self) -> float:
        """Bound of the time [s] at which the loop first slides under (33); by (44) |sigma_tilde|' <= -delta_rho."""
        return self.sigma_tilde / self.delta_rho
