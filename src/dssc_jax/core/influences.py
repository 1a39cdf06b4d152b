"""The states that influence given states, directly or through other states."""

import numpy as np


def closure(states: np.ndarray, influences: np.ndarray) -> np.ndarray:
    """Extend sets of states by all states that influence them, directly or through other states.

    Args:
        states: Masks of the sets, shape (..., n) for n states.
        influences: Entry [..., i, j] tells whether state i depends directly on state j, shape (..., n, n).

    Returns:
        Masks of the extended sets, shape (..., n).
    """
    influencing = states
    while True:
        extended = influencing | np.any(influencing[..., :, None] & influences, axis=-2)
        if np.array_equal(extended, influencing):
            return influencing
        influencing = extended
