"""The one-degree-of-freedom class (5)-(8), of any order n >= 2, in normal form.

In units, y stands for the unit of the plant's output, and u for the unit of its command.
"""

from typing import Annotated, NamedTuple

from dssc_jax.core.adapters import linear_derivative
from dssc_jax.core.contracts import LinearDynamics, Plant
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.sampled_linear import one_entry
from dssc_jax.core.signals import Measurement, PlantInput, Scalar
from dssc_jax.core.smoothness import SMOOTH
from dssc_jax.core.units import POSITION
from dssc_jax.core.zero_dynamics import ZeroDynamics, require_hurwitz


class NormalFormParams(NamedTuple):
    """Parameters of the class (5)-(8); without ``zero_dynamics`` the order is two."""

    k_p: Annotated[Scalar, Quantity("y/(s^2 u)", "high-frequency gain k_p", above=0.0)] = 1.0
    a_p: Annotated[Scalar, Quantity("1/s", "damping a_p")] = 1.0
    zero_dynamics: ZeroDynamics | None = None
    initial: Annotated[tuple[Scalar, ...], Quantity("y, y/s, SI", "initial x1, x2, then eta")] = (0.0, 0.0)


class NormalFormState(NamedTuple):
    """Output x1 = y [y], its rate x2 [y/s] and the zero dynamics' state eta."""

    x1: Scalar
    x2: Scalar
    eta: tuple[Scalar, ...]


def init(params: NormalFormParams) -> NormalFormState:
    """The state at t = 0; components of eta that ``initial`` does not give are zero."""
    x1, x2, *eta = params.initial
    order = 0 if params.zero_dynamics is None else len(params.zero_dynamics.a)
    return NormalFormState(x1, x2, tuple(eta) + (0.0,) * (order - len(eta)))


def linear(params: NormalFormParams) -> LinearDynamics:
    """The matrices of the plant (5)-(7) for its state x = (x1, x2, eta).

    A_eta has the controllable canonical form, with B_eta = (0, ..., 0, 1). The disturbance acts as the command does.
    """
    zero_dynamics = params.zero_dynamics
    order = 0 if zero_dynamics is None else len(zero_dynamics.a)
    coupling = () if zero_dynamics is None else tuple(-c for c in zero_dynamics.c)  # -C_eta
    rows = [(0.0, 1.0, *(0.0,) * order), (0.0, -params.a_p, *coupling)]
    for i in range(order - 1):
        rows.append((0.0, 0.0, *one_entry(1.0, i + 1, order)))
    if zero_dynamics is not None:
        rows.append((0.0, 1.0, *(-a for a in zero_dynamics.a)))
    column = (0.0, params.k_p, *(0.0,) * order)
    return LinearDynamics(a=tuple(rows), command=(column,), disturbance=(column,))


def measure(params: NormalFormParams, state: NormalFormState, drive: PlantInput) -> Measurement:
    """The output y = x1 (8) and its derivative y' = x2 (6), which depend neither on the input nor on the parameters."""
    del params, drive
    return Measurement(state.x1, state.x2)


def input_gain(params: NormalFormParams) -> Scalar:
    """The high-frequency gain k_p of (7) from the command to y'' [y/(s^2 u)]."""
    return params.k_p


def prepare(params: NormalFormParams) -> NormalFormParams:
    """The parameters themselves, after a check of the zero dynamics and of the initial state's length.

    Raises:
        ConfigError: The zero dynamics are not stable, their coefficients differ in number, or the initial state has too
            few or too many values.
    """
    order = 0
    if params.zero_dynamics is not None:
        require_hurwitz(params.zero_dynamics)
        order = len(params.zero_dynamics.a)
    if not 2 <= len(params.initial) <= 2 + order:
        raise ConfigError(
            "initial", f"needs x1, x2 and at most {order} values of eta, got {len(params.initial)} values"
        )
    return params


NORMAL_FORM = Plant(
    params=NormalFormParams,
    init=init,
    derivative=linear_derivative(linear),
    measure=measure,
    input_gain=input_gain,
    velocities=("x2",),
    prepare=prepare,
    units=(POSITION,),
    linear=linear,
    smooth=SMOOTH,
)
