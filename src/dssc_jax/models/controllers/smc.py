"""First-order sliding mode u = -K sgn(sigma).

In units, u stands for the unit of the command.
"""

import math
from typing import Annotated, NamedTuple

from dssc_jax.core.contracts import Controller
from dssc_jax.core.harmonic_balance import HarmonicBalance
from dssc_jax.core.numerics import saturate, sign
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Discretisation, Entry
from dssc_jax.core.signals import Command, Measurement, ReferencePoint, Scalar, tracking_error
from dssc_jax.core.smoothness import SWITCHES, not_smooth
from dssc_jax.models.controllers.dssc_forms import DsscGains, nominal_input_gain, switching_gain
from dssc_jax.models.controllers.nominal import L0, NominalGains, nominal_control
from dssc_jax.models.controllers.sta import K_N


class SmcGains(NamedTuple):
    """Gains of first-order sliding mode, and the nominal plant of its nominal control; None: there is none."""

    l0: Annotated[Scalar, L0]
    gain: Annotated[Scalar, Quantity("u", "switching gain K", above=0.0)]
    k_n: Annotated[Scalar, K_N] = 1.0
    nominal: NominalGains | None = None


class SmcInfo(NamedTuple):
    """The margin K - |u_eq| [u] of the sliding condition, which holds if the margin is not negative.

    The equivalent control u_eq is the u that brings sigma to 0 within one sample, by the nominal input gain k_n.
    """

    sliding_margin: Annotated[Scalar, Quantity("u", "K - |u_eq|")]


class NoInfo(NamedTuple):
    """The report of the explicit relay: nothing, because it never slides within a sample and has no margin."""


def init(gains: SmcGains, measurement: Measurement, reference: ReferencePoint) -> tuple[()]:
    """The state: none.

    The controller does not use the first measurement and reference.
    """
    return ()


def relay_balance(gains: SmcGains) -> HarmonicBalance:
    """The relay's side of the harmonic balance N(A) = q, with its real describing function N = 4 K/(pi A).

    ``amplitude`` is the A [y/s] with N(A) = Re q. The describing function is real, so that the imaginary part of q is
    the residual, which must be 0 at an oscillation.
    """
    gain = float(gains.gain)
    return HarmonicBalance(
        amplitude=lambda q: 4.0 * gain / (math.pi * q.real),
        residual=lambda q, amplitude, w: q.imag,
    )


def relay_of_dssc(gains: DsscGains) -> dict[str, float]:
    """The table of the relay that corresponds to DSSC: u_0 = rho sgn without predictor and averaging filter."""
    return {"gain": switching_gain(gains), "k_n": nominal_input_gain(gains)}


def smc(implicit: bool) -> Controller:
    """Make the relay, in one of two sampled forms.

    Args:
        implicit: Whether the relay is in its implicit form, u = -clip(sigma/(T_s k_n), -K, K), or switched by the sign
            of the sample, u = -K sgn(sigma).
    """

    def step(
        gains: SmcGains, state: tuple[()], measurement: Measurement, reference: ReferencePoint, dt: Scalar
    ) -> tuple[tuple[()], Command, SmcInfo | NoInfo]:
        # one sample
        error = tracking_error(measurement, reference, gains.l0)
        u_nominal = nominal_control(gains.nominal, gains.l0, error, reference, predictor_pole=0.0)
        u_eq = -error.sigma / (dt * gains.k_n)
        if implicit:
            return state, Command(saturate(u_eq, gains.gain), u_nominal), SmcInfo(gains.gain - abs(u_eq))
        return state, Command(-gains.gain * sign(error.sigma), u_nominal), NoInfo()

    return Controller(
        SmcGains,
        init,
        step,
        smooth=not_smooth(SWITCHES),
        describing=relay_balance,
        tunable=("gain",),
        from_dssc=relay_of_dssc,
        info=SmcInfo if implicit else NoInfo,
    )


SMC = Entry(
    {Discretisation.IMPLICIT: smc(implicit=True), Discretisation.EXPLICIT: smc(implicit=False)},
    "first-order sliding mode",
    "discretisation",
    Discretisation.IMPLICIT,
    example={"l0": 0.5, "gain": 1.0},
)
