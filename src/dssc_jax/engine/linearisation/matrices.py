"""Matrices of the linearised loops of all draws, and the states that matter at a break point."""

from typing import NamedTuple

import numpy as np

from dssc_jax.core.influences import closure


class StateMatrices(NamedTuple):
    """The linearised loops x+ = A x + B w, v = C x of n draws, from one sample to the next.

    w are the signals that are added at the break points, and v are the signals at the break points before the addition.

    Args:
        next_states: The state after one sample from the operating point, shape (n, states).
        a: A, shape (n, states, states).
        b: B, with a column for each break point, shape (n, states, break points).
        c: C, with a row for each break point, shape (n, break points, states).
    """

    next_states: np.ndarray
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    def returning(self, point: int) -> np.ndarray:
        """Which states carry a signal from a break point around the loop and back, in each draw, shape (n, states).

        Such a state is reached by the added signal, and the signal before the sum depends on it.

        Args:
            point: Index of the break point.
        """
        influences = self.a != 0.0  # of the column's state on the row's state
        is_reached = closure(self.b[:, :, point] != 0.0, influences.swapaxes(1, 2))
        is_observed = closure(self.c[:, point] != 0.0, influences)
        return is_reached & is_observed

    def loop_states(self, point: int, draws: np.ndarray) -> np.ndarray:
        """Indices of the states that carry a signal back to a break point in at least one of the chosen draws.

        Args:
            point: Index of the break point.
            draws: Whether each draw is chosen, shape (n,).
        """
        return np.flatnonzero(np.any(self.returning(point)[draws], axis=0))

    def is_open(self) -> np.ndarray:
        """Whether the loop of each draw is open: no signal comes back to any break point, shape (n,)."""
        returning = [self.returning(point) for point in range(self.b.shape[2])]
        return ~np.any(returning, axis=(0, 2))


class Operating(NamedTuple):
    """The linearised loops of all draws at one operating point.

    Args:
        matrices: Matrices of all draws.
        reached: Which draws have the operating point, shape (draws,).
        limited: Which draws have a part beyond its boundary there, such as a command beyond its limit, shape (draws,).
        taken: Notes on the substitutes that stand for parts at a corner.
    """

    matrices: StateMatrices
    reached: np.ndarray
    limited: np.ndarray
    taken: tuple[str, ...]

    def closed(self, point: int) -> np.ndarray:
        """Whether each draw reaches its operating point, and no limit opens its loop at a break point, shape (draws,).

        A draw without parts beyond their boundary counts as closed even if no signal returns to the break point.

        Args:
            point: Index of the break point.
        """
        has_return = np.any(self.matrices.returning(point), axis=1)
        return self.reached & (has_return | ~self.limited)
