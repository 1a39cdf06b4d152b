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
    """Return state + h rate, leaf by leaf."""
    return jax.tree.map(lambda x, dx: x + h * dx, state, rate)


def rk4(derivative: VectorField, state: S, h: Scalar, velocities: tuple[str, ...]) -> S:
    """The classical Runge-Kutta method of order 4; ``velocities`` is not used."""
    del velocities
    k1 = derivative(state, 0)
    k2 = derivative(advance(state, k1, 0.5 * h), 1)
    k3 = derivative(advance(state, k2, 0.5 * h), 1)
    k4 = derivative(advance(state, k3, h), 2)
    mean = jax.tree.map(lambda a, b, c, d: (a + 2.0 * (b + c) + d) / 6.0, k1, k2, k3, k4)
    return advance(state, mean, h)


def semi_implicit_euler(derivative: VectorField, state: S, h: Scalar, velocities: tuple[str, ...]) -> S:
    """Advance velocities first, then everything else with the new velocities; order 1, symplectic on oscillators."""
    kicked = advance(state, derivative(state, 0), h)
    middle = state._replace(**{name: getattr(kicked, name) for name in velocities})  # type: ignore[attr-defined]
    drifted = advance(middle, derivative(middle, 0), h)
    return drifted._replace(**{name: getattr(middle, name) for name in velocities})


ORDERS = {Integrator.RK4: 4, Integrator.EULER: 1}
"""Order of convergence of each method."""

INTEGRATORS = {Integrator.RK4: rk4, Integrator.EULER: semi_implicit_euler}
