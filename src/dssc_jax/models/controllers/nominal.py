"""The nominal control (37), shared by all controllers.

In units, y stands for the unit of the plant's output, and u for the unit of its command.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ReferencePoint, Scalar, TrackingError

L0 = Quantity("1/s", "error pole l_0 of sigma = e' + l_0 e", above=0.0)


class NominalGains(NamedTuple):
    """The nominal plant y'' = -a_n y' + k_n u_p of (37), and whether the gain c_sigma keeps its term 1/tau_m."""

    a: Annotated[Scalar, Quantity("1/s", "nominal damping a_n")]
    k: Annotated[Scalar, Quantity("y/(s^2 u)", "nominal input gain k_n", above=0.0)]
    predictor_term: bool = True


def nominal_control(
    nominal: NominalGains | None, l0: Scalar, error: TrackingError, reference: ReferencePoint, predictor_pole: Scalar
) -> Scalar:
    """u_n of (37) [m/s]; zero without nominal gains.

    u_n = -c_e e - c_sigma sigma - c_m1 y_m' - c_m2 y_m'' with c_e = (a_n - l0) l0/k_n,
    c_sigma = (l0 - a_n + 1/tau_m)/k_n, c_m1 = -a_n/k_n and c_m2 = -1/k_n. The article prints the last two for k_n = 1
    only. If a_n and k_n are the plant's own, sigma' = k_p u + k_p d - sigma/tau_m is left for u to control. The term
    1/tau_m is a feedback that is held over the sample. Whatever the discretisation of the controller, it needs
    T_s (1/tau_m + |l0 - a_n|) < 2. The unit of u_n is that of the command [u].

    Args:
        nominal: Nominal gains; None: there is no nominal control, and u_n is 0.
        l0: Error pole l_0 [1/s].
        error: Tracking errors.
        reference: Desired trajectory.
        predictor_pole: 1/tau_m [1/s]; 0 for a controller without a predictor.
    """
    if nominal is None:
        return 0.0
    pole = jnp.where(nominal.predictor_term, predictor_pole, 0.0)
    feedback = (nominal.a - l0) * l0 * error.e + (l0 - nominal.a + pole) * error.sigma
    return (nominal.a * reference.y_dot + reference.y_ddot - feedback) / nominal.k
