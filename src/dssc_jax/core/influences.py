"""Which states influence which others, directly or not."""

import numpy as np


def closure(states: np.ndarray, influences: np.ndarray) -> np.ndarray:
    """Extend sets of states by all states that influence them, directly or not.

    Args:
        states: Masks of states, shape (..., states).
        influences: Whether the state of each row depends on that of each column, shape (..., states, states).
    """
    influencing = states
    while True:
        extended = influencing | np.any(influencing[..., :, None] & influences, axis=-2)
        if np.array_equal(extended, influencing):
            return influencing
        influencing = extended
