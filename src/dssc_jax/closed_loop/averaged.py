"""The output of linear unmodelled dynamics over a step of a nonlinear plant: its mean and its first moment."""

from typing import NamedTuple

import jax

from dssc_jax.core.contracts import Moments
from dssc_jax.core.sampled_linear import Forcing, HeldSystem, LinearSystem, hold, scale_column
from dssc_jax.core.signals import Scalar, State


class Averaged(NamedTuple):
    """Linear unmodelled dynamics with the integrals of their output over a step of a nonlinear plant.

    Args:
        order: Number of their states.
        held: Their exact solution over the step, with mean and double integral of the output as further states.
    """

    order: int
    held: HeldSystem

    def over(self, state: State, terms: tuple[Scalar, ...]) -> tuple[State, Moments]:
        """The state after a step with the terms of an input, and the output's moments over it."""
        leaves, structure = jax.tree.flatten(state)
        *next_leaves, mean, double = self.held.full.apply((*leaves, 0.0, 0.0), (terms,))
        return structure.unflatten(next_leaves), Moments(mean, 6.0 * mean - 12.0 * double)


def average_output(system: LinearSystem, terms: int, h: float) -> Averaged:
    """Linear unmodelled dynamics with q' = y/h and r' = q/h: after h, q is the mean and r the double integral."""
    order = len(system.a)
    rate = 1.0 / h
    rows = [(*row, 0.0, 0.0) for row in system.a]
    rows.append((*scale_column(system.c, rate), 0.0, 0.0))
    rows.append((*(0.0,) * order, rate, 0.0))
    column = (*system.b, *scale_column((system.d,), rate), 0.0)
    return Averaged(order, hold(tuple(rows), (Forcing(column, terms),), h))
