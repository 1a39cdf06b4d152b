"""The PI controller u = -K_P sigma - K_I int sigma dt, which SSC synthesises in sliding.

In units, y stands for the unit of the plant's output, and u for the unit of its command.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Controller
from dssc_jax.core.quantities import Quantity, nominal
from dssc_jax.core.registry import Discretisation, Entry
from dssc_jax.core.signals import Command, Measurement, ReferencePoint, Scalar, tracking_error
from dssc_jax.core.smoothness import SMOOTH
from dssc_jax.models.controllers.dssc import synthesised_gains
from dssc_jax.models.controllers.dssc_forms import DsscGains
from dssc_jax.models.controllers.nominal import L0, NominalGains, nominal_control


class PiGains(NamedTuple):
    """Gains of the PI controller of sigma, and the nominal plant of its nominal control; None: there is none."""

    l0: Annotated[Scalar, L0]
    k_p: Annotated[Scalar, Quantity("u s/y", "proportional gain K_P", at_least=0.0)]
    k_i: Annotated[Scalar, Quantity("u/y", "integral gain K_I", at_least=0.0)]
    nominal: NominalGains | None = None


class PiState(NamedTuple):
    """The integral of sigma since the start [y]."""

    integral: Scalar


class PiInfo(NamedTuple):
    """The integral part -K_I int sigma dt of the command [u]."""

    integral: Annotated[Scalar, Quantity("u", "integral term of u")]


def init(gains: PiGains, measurement: Measurement, reference: ReferencePoint) -> PiState:
    """The state at the first sample: the integral is 0.

    The controller does not use the first measurement and reference.
    """
    return PiState(0.0)


def synthesised_by_dssc(gains: DsscGains) -> dict[str, float]:
    """The table of the PI control that DSSC synthesises at the origin: K_P = 1/(k_o tau_av), K_I = K_P/tau_m.

    A law of l_0 counts with its median.
    """
    proportional, integral = synthesised_gains(gains._replace(l0=nominal(gains.l0)))
    return {"k_p": float(proportional), "k_i": float(integral)}


def pi(implicit: bool) -> Controller:
    """Make the PI controller, in one of two sampled forms.

    Args:
        implicit: Whether the integral in the command includes the current sample (backward Euler) or not (forward
            Euler).
    """

    def step(
        gains: PiGains, state: PiState, measurement: Measurement, reference: ReferencePoint, dt: Scalar
    ) -> tuple[PiState, Command, PiInfo]:
        # one sample
        error = tracking_error(measurement, reference, gains.l0)
        u_nominal = nominal_control(gains.nominal, gains.l0, error, reference, predictor_pole=0.0)
        after = state.integral + dt * error.sigma
        integral = -gains.k_i * (after if implicit else state.integral)
        return PiState(after), Command(integral - gains.k_p * error.sigma, u_nominal), PiInfo(integral)

    def transfer(
        gains: PiGains, measurement: Measurement, reference: ReferencePoint, command: Scalar, dt: Scalar
    ) -> PiState:
        """The integral that leaves the command as it is; 0 without integral action.

        With integral action the first step from the returned state gives the command, for a bumpless start.
        """
        error = tracking_error(measurement, reference, gains.l0)
        robust = command - nominal_control(gains.nominal, gains.l0, error, reference, predictor_pole=0.0)
        integrates = gains.k_i > 0.0
        # with backward Euler the integral in the command includes this sample
        needed = -(robust + gains.k_p * error.sigma) / jnp.where(integrates, gains.k_i, 1.0)
        return PiState(jnp.where(integrates, needed - (dt * error.sigma if implicit else 0.0), 0.0))

    return Controller(
        PiGains,
        init,
        step,
        transfer=transfer,
        smooth=SMOOTH,
        synthesised=lambda gains: (gains.k_p, gains.k_i),
        tunable=("k_p", "k_i"),
        from_dssc=synthesised_by_dssc,
        info=PiInfo,
    )


PI = Entry(
    {Discretisation.IMPLICIT: pi(implicit=True), Discretisation.EXPLICIT: pi(implicit=False)},
    "proportional-integral control of sigma",
    "discretisation",
    Discretisation.IMPLICIT,
    example={"l0": 0.5, "k_p": 1.0, "k_i": 0.5},
)
