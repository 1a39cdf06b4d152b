"""Fixed-step integrators for states made of scalars."""

from collections.abc import Callable
from enum import StrEnum
from typing import TypeVar

import jax

from dssc_jax.core.signals import Scalar

S = TypeVar("S")
VectorField = Callable[[S, int], S]
"""``(state, half_steps) -> state'`` at the start (0), middle (1) or end (2) of the step."""


class Integrator(StrEnum):
    """Fixed-step integration methods between two samples."""

    RK4 = "rk4"
    EULER = "euler"


def advance(state: S, rate: S, h: Scalar) -> S:
    """Return the state after a step of length h [s] with a constant rate: state + h rate, leaf by leaf."""
    return jax.tree.map(lambda x, dx: x + h * dx, state, rate)


def rk4(derivative: VectorField, state: S, h: Scalar, velocities: tuple[str, ...]) -> S:
    """Return the state after a step of length h [s] by the classical Runge-Kutta method of order 4.

    Args:
        derivative: ``(state, half_steps) -> state'``.
        state: The state at the start of the step.
        h: Length of the step [s].
        velocities: Without effect; all methods have the same arguments.
    """
    del velocities
    k1 = derivative(state, 0)
    k2 = derivative(advance(state, k1, 0.5 * h), 1)
    k3 = derivative(advance(state, k2, 0.5 * h), 1)
    k4 = derivative(advance(state, k3, h), 2)
    mean = jax.tree.map(lambda a, b, c, d: (a + 2.0 * (b + c) + d) / 6.0, k1, k2, k3, k4)
    return advance(state, mean, h)


def semi_implicit_euler(derivative: VectorField, state: S, h: Scalar, velocities: tuple[str, ...]) -> S:
    """Return the state after a step of length h [s] by the semi-implicit Euler method, of order 1.

    First the velocities advance, then all other fields, with the derivative at the new velocities. The method is
    symplectic: it keeps the energy of oscillators bounded.

    Args:
        derivative: ``(state, half_steps) -> state'``.
        state: The state at the start of the step, a NamedTuple.
        h: Length of the step [s].
        velocities: Names of the fields that advance first.
    """
    first = advance(state, derivative(state, 0), h)
    new_velocities = {name: getattr(first, name) for name in velocities}
    middle = state._replace(**new_velocities)  # type: ignore[attr-defined]
    last = advance(middle, derivative(middle, 0), h)
    return last._replace(**new_velocities)


ORDERS = {Integrator.RK4: 4, Integrator.EULER: 1}
"""Order of convergence of each method."""

INTEGRATORS = {Integrator.RK4: rk4, Integrator.EULER: semi_implicit_euler}
