"""Gains of linear-quadratic control and of the steady-state Kalman filter, for a linear plant in discrete time.

Both follow from the stabilising solution of a discrete algebraic Riccati equation.

References:
    G. F. Franklin, J. D. Powell, M. Workman, Digital Control of Dynamic Systems, 3rd ed. (1998), chapters 8 and 9.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, expm, solve_discrete_are

from dssc_jax.core.errors import ConfigError

LARGEST_CONDITION = 1e12
"""Largest condition number of the equations of rest; beyond it the plant counts as one with a zero at z = 1."""


class SampledPlant(NamedTuple):
    """The linear plant x(k+1) = A x(k) + B u(k) + E w(k), whose inputs are constant over each sample.

    Args:
        a: A, shape (n, n).
        b: B, the column of the command, shape (n,).
        disturbances: E, the columns of the disturbances, shape (n, q).
    """

    a: np.ndarray
    b: np.ndarray
    disturbances: np.ndarray


def sampled_system(a: np.ndarray, columns: np.ndarray, sample_time: float) -> SampledPlant:
    """The linear plant at its samples, with inputs that are constant between them; exact, by Van Loan's method.

    Args:
        a: A in continuous time, shape (n, n).
        columns: Columns of the command and then of the disturbances, shape (n, 1 + q).
        sample_time: T_s [s].
    """
    order = len(a)
    size = order + columns.shape[1]
    generator = np.zeros((size, size))  # of the state and the constant inputs
    generator[:order, :order] = a
    generator[:order, order:] = columns
    transition = expm(generator * sample_time)[:order]
    return SampledPlant(a=transition[:, :order], b=transition[:, order], disturbances=transition[:, order + 1 :])


def regulator_gain(a: np.ndarray, b: np.ndarray, q: np.ndarray, weight: float) -> np.ndarray:
    """The row K, shape (n,), of u = -K x that minimises the sum over the samples of x' Q x + weight u^2.

    Args:
        a: A in discrete time, shape (n, n).
        b: Column of the command, shape (n, 1).
        q: Q, shape (n, n).
        weight: Weight of the command's square.

    Raises:
        ConfigError: The command does not stabilise a mode of A, or the weights leave out one on the unit circle.
    """
    p = riccati_solution(a, b, q, weight * np.ones((1, 1)), "regulator", "the command does not stabilise it")
    rows = np.linalg.solve(weight + b.T @ p @ b, b.T @ p @ a)  # one row: the one command
    return rows[0]


def filter_gain(a: np.ndarray, rows: np.ndarray, w: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The gain L, shape (n, m), of the steady-state Kalman filter, which corrects a prediction x to x + L (s - C x).

    Args:
        a: A in discrete time, shape (n, n).
        rows: Rows of C of the measured signals, shape (m, n).
        w: Covariance of the noise that is added to the state in each sample, shape (n, n).
        v: Covariance of the signals' noise, shape (m, m).

    Raises:
        ConfigError: The measured signals do not show a mode of A.
    """
    p = riccati_solution(a.T, rows.T, w, v, "filter", "the measured signals do not show it")
    return np.linalg.solve(rows @ p @ rows.T + v, rows @ p).T


def riccati_solution(a: np.ndarray, b: np.ndarray, q: np.ndarray, r: np.ndarray, part: str, cause: str) -> np.ndarray:
    """The stabilising solution of a discrete algebraic Riccati equation.

    Args:
        a: A, shape (n, n).
        b: B, shape (n, m).
        q: Weight of the state, shape (n, n).
        r: Weight of the command, shape (m, m).
        part: The part of the controller that needs it, for the message.
        cause: A reason why there may be none, for the message.

    Raises:
        ConfigError: There is no stabilising solution.
    """
    try:
        return solve_discrete_are(a, b, q, r)
    except (LinAlgError, ValueError) as error:
        rule = f"has no {part}: the Riccati equation has no stabilising solution ({error}); a mode without weight or "
        raise ConfigError("kind", f"{rule}noise lies on the unit circle, or {cause}") from None


def gain_at_rest(plant: SampledPlant, output: np.ndarray, feedback: np.ndarray) -> float:
    """The feedforward gain N of y_m with which y = y_m at rest; 0 if the plant has a zero at z = 1 and cannot rest so.

    N = N_u + K N_x, where the plant rests at the state N_x y_m under the command N_u y_m.

    Args:
        plant: The sampled plant.
        output: Row c of y, shape (n,).
        feedback: K, shape (n,).
    """
    order = len(plant.a)
    block = np.block([[plant.a - np.eye(order), plant.b[:, None]], [output[None, :], np.zeros((1, 1))]])
    if np.linalg.cond(block) > LARGEST_CONDITION:
        return 0.0
    equilibrium = np.linalg.solve(block, np.append(np.zeros(order), 1.0))  # x+ = x and y = 1
    state = equilibrium[:order]
    command = equilibrium[order]
    return float(command + feedback @ state)
