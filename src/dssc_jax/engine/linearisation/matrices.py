"""Matrices of every draw's linearised loop, and what they say of its break points."""

from typing import NamedTuple

import numpy as np

from dssc_jax.core.influences import closure


class StateMatrices(NamedTuple):
    """x+ = A x + B w, v = C x of n draws; one column of B and one row of C for each break point.

    Args:
        next_states: The state after one sample, shape (n, states).
        a: Shape (n, states, states).
        b: Shape (n, states, break points).
        c: Shape (n, break points, states).
    """

    next_states: np.ndarray
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    def returning(self, point: int) -> np.ndarray:
        """The states by which a signal that enters at a break point comes back to it, shape (n, states).

        Args:
            point: Index of the break point.
        """
        influences = self.a != 0.0
        reachable = closure(self.b[:, :, point] != 0.0, influences.swapaxes(1, 2))
        return reachable & closure(self.c[:, point] != 0.0, influences)

    def loop_states(self, point: int, draws: np.ndarray) -> np.ndarray:
        """Indices of the states by which a signal comes back to a break point in any of some draws.

        Args:
            point: Index of the break point.
            draws: Which draws, shape (n,).
        """
        return np.flatnonzero(np.any(self.returning(point)[draws], axis=0))

    def is_open(self) -> np.ndarray:
        """Whether no signal comes back to any break point, for each draw, shape (n,)."""
        returning = [self.returning(point) for point in range(self.b.shape[2])]
        return ~np.any(returning, axis=(0, 2))


class Operating(NamedTuple):
    """Matrices of all draws at one operating point.

    Args:
        matrices: Matrices of all draws.
        reached: Which draws have an operating point, shape (draws,).
        limited: Which draws lie there beyond the boundary of a part, shape (draws,).
        taken: What is taken for parts that lie at a corner there, in words.
    """

    matrices: StateMatrices
    reached: np.ndarray
    limited: np.ndarray
    taken: tuple[str, ...]

    def closed(self, point: int) -> np.ndarray:
        """Whether each draw has an operating point where no part beyond its boundary opens the loop, shape (draws,).

        Args:
            point: Index of the break point.
        """
        return self.reached & (np.any(self.matrices.returning(point), axis=1) | ~self.limited)
