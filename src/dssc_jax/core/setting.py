"""The loop to which a controller is fitted when a study is built: nominal plant, sample time and measured signals."""

from typing import NamedTuple

import numpy as np


class NominalPlant(NamedTuple):
    """A linear plant x' = A x + b u_p + E d of one channel, in which the median of each law stands for the law.

    Args:
        a: A, shape (n, n).
        command: b, shape (n,).
        disturbances: E: the column of the disturbance at the command, then a column for each named input, shape (n, q).
        output: Row c of the output y = c x, shape (n,).
        signals: Row of each measured signal, by which x gives the signal, shape (m, n).
        feedthrough: Direct feedthrough from the command to each measured signal, shape (m,).
        inputs: Names of the columns of ``disturbances``, length q.
    """

    a: np.ndarray
    command: np.ndarray
    disturbances: np.ndarray
    output: np.ndarray
    signals: np.ndarray
    feedthrough: np.ndarray
    inputs: tuple[str, ...]


class LoopSetting(NamedTuple):
    """The loop to which a controller is fitted when a study is built.

    Args:
        sample_time: T_s [s].
        measures: Names of the measured signals beside y and y'.
        plant: The nominal plant; None: the plant has several channels, or is not linear.
    """

    sample_time: float
    measures: tuple[str, ...]
    plant: NominalPlant | None
