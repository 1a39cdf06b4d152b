"""The matrix exponential with a hundred digits, which needs no trust in any floating-point algorithm."""

import mpmath
import numpy as np

SQUARINGS = 160


def exponential(matrix):
    """exp(matrix) rounded to float64, by repeated squaring from a matrix so small that two terms suffice."""
    n = len(matrix)
    with mpmath.workdps(100):
        small = mpmath.matrix(np.asarray(matrix, float).tolist()) / mpmath.mpf(2) ** SQUARINGS
        power = mpmath.eye(n) + small + small * small / 2
        for _ in range(SQUARINGS):
            power = power * power
        return np.array([[float(power[i, j]) for j in range(n)] for i in range(n)])
