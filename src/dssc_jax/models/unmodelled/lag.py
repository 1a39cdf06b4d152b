"""Lags 1/(mu s + 1)^order in series with the plant input (the examples of Section V-A2), or no dynamics.

The command is held between samples and the lag is advanced by its exact solution, so a small mu does not limit the
step.
"""

from enum import IntEnum
from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import NoParams, Unmodelled
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import SMOOTH


class Order(IntEnum):
    """Order of the lag."""

    ONE = 1
    TWO = 2


class LagParams(NamedTuple):
    """Time constant of the lag."""

    mu: Annotated[Scalar, Quantity("s", "time constant mu of the unmodelled dynamics", above=0.0)]


def first_order(params: LagParams, state: tuple[Scalar], command: Scalar, dt: Scalar) -> tuple[Scalar]:
    """Exact solution of mu z' = u - z over dt."""
    (z,) = state
    return (command + (z - command) * jnp.exp(-dt / params.mu),)


def second_order(params: LagParams, state: tuple[Scalar, Scalar], command: Scalar, dt: Scalar) -> tuple[Scalar, Scalar]:
    """Exact solution of mu z1' = u - z1, mu z2' = z1 - z2 over dt."""
    z1, z2 = state
    steps = dt / params.mu
    decay = jnp.exp(-steps)
    gap = z1 - command
    return command + gap * decay, command + (z2 - command + gap * steps) * decay


def lag(order: Order) -> Unmodelled:
    """1/(mu s + 1)^order, at rest at t = 0."""
    return Unmodelled(
        LagParams,
        init=lambda params: (0.0,) * order,
        step=first_order if order == Order.ONE else second_order,
        output=lambda params, state, command: state[-1],
        smooth=SMOOTH,
        continuous=True,
    )


NO_DYNAMICS = Unmodelled(
    NoParams,
    init=lambda params: (),
    step=lambda params, state, command, dt: state,
    output=lambda params, state, command: command,
    smooth=SMOOTH,
    continuous=True,
)
LAG = Entry({order: lag(order) for order in Order}, "1/(mu s + 1)^order, order 1 or 2", "order", Order.ONE)
