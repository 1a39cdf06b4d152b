"""The modulation function rho: constant, or the norm bound (33)-(34) with its norm observer.

Each is a NamedTuple of its constants with ``init()`` and ``at(state, signals, dt) -> (state, rho)``.

In units, y stands for the unit of the plant's output, and u for the unit of its command.
"""

import math
from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Registry, single
from dssc_jax.core.signals import Scalar
from dssc_jax.core.zero_dynamics import ZeroDynamics, norm_observer


class ModulationSignals(NamedTuple):
    """The signals in the norm bound (34), at one sample.

    Args:
        u_av: Averaged control [u].
        u_nominal: Nominal control u_n [u].
        y: Output [y].
        y_dot: Derivative of the output [y/s].
        sigma: Sliding variable [y/s].
        sigma_m_dot: y_m'' + l_0 y_m', the derivative of the reference's part of sigma [y/s^2].
        k_o: Predictor gain [y/(s^2 u)].
        tau_m: Predictor time constant [s].
        l0: Error pole l_0 [1/s].
    """

    u_av: Scalar
    u_nominal: Scalar
    y: Scalar
    y_dot: Scalar
    sigma: Scalar
    sigma_m_dot: Scalar
    k_o: Scalar
    tau_m: Scalar
    l0: Scalar


class ConstantModulation(NamedTuple):
    """A constant rho, as in all of the article's runs."""

    rho: Annotated[Scalar, Quantity("u", "modulation rho", above=0.0)]

    def init(self) -> tuple[()]:
        """The state: none."""
        return ()

    def at(self, state: tuple[()], signals: ModulationSignals, dt: Scalar) -> tuple[tuple[()], Scalar]:
        """The state and the constant rho [u], whatever the signals.

        ``dt`` is not used: a constant needs no observer.
        """
        return state, self.rho


class NormBound(NamedTuple):
    """The constants of the modulation rho of (33)-(34), a bound of |d_0|/k_o with which the loop slides.

    The norm observer eta_bar' = -lambda eta_bar + c |y'| bounds |C_eta eta|, the part of d_0 from the zero dynamics, by
    its state eta_bar, up to an initial transient. The bound of the disturbance (A0.b) is
    alpha_d + alpha_y |y| + alpha_y_dot |y'|. ``zero_dynamics`` is the controller's model of (A_eta, C_eta). Unless rate
    lambda and gain c of the observer are given, they follow from this model before tracing.
    """

    k_p_max: Annotated[Scalar, Quantity("y/(s^2 u)", "upper bound of k_p", above=0.0)]
    a_p_max: Annotated[Scalar, Quantity("1/s", "bound of |a_p|", at_least=0.0)]
    delta_rho: Annotated[Scalar, Quantity("y/s^2", "margin delta_rho", above=0.0)]
    alpha_d: Annotated[Scalar, Quantity("u", "bound of |d|, constant part", at_least=0.0)] = 0.0
    alpha_y: Annotated[Scalar, Quantity("u/y", "bound of |d|, part growing with |y|", at_least=0.0)] = 0.0
    alpha_y_dot: Annotated[Scalar, Quantity("u s/y", "bound of |d|, part growing with |y'|", at_least=0.0)] = 0.0
    zero_dynamics: ZeroDynamics | None = None
    eta_bar_initial: Annotated[Scalar, Quantity("y/s^2", "initial value of eta_bar", at_least=0.0)] = 0.0
    observer_rate: Annotated[Scalar | None, Quantity("1/s", "lambda of the norm observer", above=0.0)] = None
    observer_gain: Annotated[Scalar | None, Quantity("1/s", "c of the norm observer", at_least=0.0)] = None

    def prepare(self) -> "NormBound":
        """Derive the observer's rate and gain from the zero dynamics, unless both are given; raises ConfigError.

        Without zero dynamics the gain is 0, so that the observer adds nothing once its initial value has decayed.
        """
        if (self.observer_rate is None) != (self.observer_gain is None):
            raise ConfigError("observer_rate", "observer_rate and observer_gain go together; got one of them")
        if self.observer_rate is not None:
            return self
        if self.zero_dynamics is None:
            return self._replace(observer_rate=1.0, observer_gain=0.0)
        if not all(isinstance(value, int | float) for part in self.zero_dynamics for value in part):
            raise ConfigError("zero_dynamics", "the norm observer is designed from plain numbers, not from laws")
        rate, gain = norm_observer(self.zero_dynamics)
        if not math.isfinite(gain):
            raise ConfigError("zero_dynamics", f"the norm observer's gain must be finite, got {gain}")
        return self._replace(observer_rate=rate, observer_gain=gain)

    def init(self) -> Scalar:
        """The observer's state eta_bar at t = 0 [m/s^2].

        Its unit is y/s^2, with the unit y of the plant's output.
        """
        return self.eta_bar_initial

    def at(self, state: Scalar, signals: ModulationSignals, dt: Scalar) -> tuple[Scalar, Scalar]:
        """(33) and (34); the observer by implicit Euler, which keeps eta_bar >= 0 at every step size.

        Between samples |C_eta eta| may exceed eta_bar by O(T_s), which delta_rho must cover.

        Args:
            state: eta_bar before the sample [y/s^2].
            signals: The signals in the bound.
            dt: T_s [s].

        Returns:
            The next eta_bar [y/s^2], and rho [u].
        """
        assert self.observer_rate is not None  # held by prepare
        assert self.observer_gain is not None
        speed = jnp.abs(signals.y_dot)
        eta_bar = (state + dt * self.observer_gain * speed) / (1.0 + dt * self.observer_rate)
        alpha = self.alpha_d + self.alpha_y * jnp.abs(signals.y) + self.alpha_y_dot * speed
        known = (
            self.k_p_max * jnp.abs(signals.u_nominal)
            + (self.a_p_max + signals.l0) * speed
            + self.k_p_max * alpha
            + jnp.abs(signals.sigma_m_dot)
            + jnp.abs(signals.sigma) / signals.tau_m
            + eta_bar
        )
        rho = ((signals.k_o + self.k_p_max) * jnp.abs(signals.u_av) + known + self.delta_rho) / signals.k_o
        return eta_bar, rho


MODULATIONS: Registry = {
    "constant": single(ConstantModulation, "constant rho", rho=2.0),
    "norm_bound": single(
        NormBound,
        "norm bound (33)-(34) with a norm observer of the zero dynamics",
        k_p_max=1.2,
        a_p_max=1.0,
        delta_rho=0.1,
    ),
}
