"""Lags 1/(mu s + 1)^order in series with the plant input (the examples of Section V-A2).

The command is constant between samples, so the lag is advanced by its exact solution: a small mu needs no small step.
"""

from enum import IntEnum
from typing import Annotated, NamedTuple

from dssc_jax.core.adapters import linear_unmodelled
from dssc_jax.core.contracts import Unmodelled
from dssc_jax.core.numerics import at_least
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry
from dssc_jax.core.sampled_linear import FASTEST, LinearSystem
from dssc_jax.core.signals import Scalar


class Order(IntEnum):
    """Number of first-order lags in series."""

    ONE = 1
    TWO = 2


class LagParams(NamedTuple):
    """The time constant of a lag, which all its first-order lags share."""

    mu: Annotated[Scalar, Quantity("s", "time constant mu of the unmodelled dynamics", above=0.0)]


def system(params: LagParams, order: Order) -> LinearSystem:
    """The lag as a linear system: mu z1' = u - z1, mu z2' = z1 - z2, ...; its output is the last state.

    A mu below ``FASTEST`` counts as ``FASTEST``, so that the rate 1/mu stays finite.

    Args:
        params: The time constant mu.
        order: Number of first-order lags in series.
    """
    rate = 1.0 / at_least(params.mu, FASTEST)
    zeros = (0.0,) * (order - 1)
    rows = []
    for i in range(order):
        row: list[Scalar] = [0.0] * order
        row[i] = -rate
        if i > 0:
            row[i - 1] = rate
        rows.append(tuple(row))
    return LinearSystem(a=tuple(rows), b=(rate, *zeros), c=(*zeros, 1.0), d=0.0)


def lag(order: Order) -> Unmodelled:
    """Make the actuator 1/(mu s + 1)^order, which is at rest at t = 0."""
    return linear_unmodelled(
        LagParams, lambda params: (0.0,) * order, lambda params: system(params, order), time_constant="mu"
    )


LAG = Entry(
    {order: lag(order) for order in Order},
    "1/(mu s + 1)^order, order 1 or 2",
    "order",
    Order.ONE,
    example={"order": 2, "mu": 0.03},
)
