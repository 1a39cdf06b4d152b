"""What a controller is fitted to when a study is built: the nominal plant, the sample time, the measured signals."""

from typing import NamedTuple

import numpy as np


class NominalPlant(NamedTuple):
    """A linear plant of one channel with the medians of its laws, in plain numbers.

    Args:
        a: A, shape (n, n).
        command: Column of the command, shape (n,).
        disturbances: Columns of the disturbance beside the command and of each named input, shape (n, q).
        output: Row of y, shape (n,).
        signals: Row of each measured signal, shape (m, n).
        feedthrough: Feedthrough of the command to each of them, shape (m,).
        inputs: Names of the columns of ``disturbances``.
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
        plant: The nominal plant; None: it has several channels, or no linear form.
    """

    sample_time: float
    measures: tuple[str, ...]
    plant: NominalPlant | None
