"""Five costs of a sampled signal that shall follow a sinusoid: of differentiators, and of controllers under noise.

The same kinds of cost are used by M. R. Mojallizadeh, B. Brogliato, V. Acary, "Time-discretizations of differentiators:
design of implicit algorithms and comparative analysis", Int. J. Robust and Nonlinear Control 31 (2021).
"""

from typing import NamedTuple

import numpy as np

INSIDE = np.linspace(0.0, 1.0, 5)[:-1]  # points of a sample, for the error between samples


class Costs(NamedTuple):
    """Costs of an error and of the output that causes it.

    Args:
        l2: rms of the error at the samples.
        l2_between: rms of the error over continuous time.
        l_inf: Largest error at the samples.
        variation: Total variation of the output per second.
        distortion: Amplitude of all that is not the wanted sinusoid or constant in the output, relative to it.
    """

    l2: float
    l2_between: float
    l_inf: float
    variation: float
    distortion: float


def rms(values: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def held(times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times between samples, and a signal that is interpolated linearly there."""
    step = times[1] - times[0]
    inside = (times[:-1, None] + step * INSIDE).ravel()
    return inside, np.interp(inside, times, values)


def cubic(values: np.ndarray, slopes: np.ndarray, step: float) -> np.ndarray:
    """A smooth signal between samples, from its values and derivatives there (Hermite)."""
    s = INSIDE
    left, right = (1.0 + 2.0 * s) * (1.0 - s) ** 2, s**2 * (3.0 - 2.0 * s)
    rising, falling = s * (1.0 - s) ** 2 * step, s**2 * (s - 1.0) * step
    a, b, c, d = (each[:, None] for each in (values[:-1], values[1:], slopes[:-1], slopes[1:]))
    return (a * left + b * right + c * rising + d * falling).ravel()


def distortion(times: np.ndarray, output: np.ndarray, frequency: float) -> float:
    """What a constant and a sinusoid of the frequency [Hz] leave of the output, relative to the sinusoid."""
    angle = 2.0 * np.pi * frequency * times
    columns = np.stack([np.ones_like(angle), np.sin(angle), np.cos(angle)], axis=1)
    weights, *_ = np.linalg.lstsq(columns, output, rcond=None)
    wanted = columns[:, 1:] @ weights[1:]
    return rms(output - columns @ weights) / rms(wanted)


def variation(times: np.ndarray, output: np.ndarray) -> float:
    """Total variation per second."""
    return float(np.abs(np.diff(output)).sum() / (times[-1] - times[0]))
