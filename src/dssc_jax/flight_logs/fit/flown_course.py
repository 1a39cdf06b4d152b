"""The course of a flight at a minimum of its fit: commands, and speeds of the output."""

import math
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.refusals import noise_between_neighbours
from dssc_jax.flight_logs.hints.conversions import rms

SPEED_ERROR = 0.05  # of the speed's root mean square: the noise of a slope of the residual that counts as speed


class Flight(NamedTuple):
    """The course of a flight at the samples.

    Args:
        commands: Commands [u], shape (n,).
        speed: Mean speeds of the output over each sample, shape (n,).
        sample_time: Time between two samples [s].
    """

    commands: np.ndarray
    speed: np.ndarray
    sample_time: float


def flown(problem: FitProblem, minimum: Minimum) -> Flight:
    """The flight at a minimum of a problem of one channel."""
    return flown_with(problem, minimum.x, problem.log.commands)


def flown_with(problem: FitProblem, x: np.ndarray, commands: np.ndarray, forces: np.ndarray | None = None) -> Flight:
    """The flight in a problem of one channel: the log's commands, and the speed for given commands and forces.

    The speed is that of the predicted output plus the smoothed slope of the residual, because gusts that the study
    declares move the vehicle, too.

    Args:
        problem: The problem.
        x: The coordinates, shape (p,).
        commands: The commands for which the speed is predicted, shape (1, samples).
        forces: Forces beside the study's disturbance, shape (samples,) [u]; None: there are none.
    """
    sample_time = problem.study.loop.sample_time
    (readings,) = problem.readings
    predicted, _ = problem.predict(problem.values(x), commands, forces)
    output = predicted[readings.channel]
    speed = np.gradient(output, sample_time)
    residual = readings.values - readings.interpolate(output)
    noise = noise_between_neighbours(readings.times, residual)
    times = sample_time * np.arange(len(output))
    spacing = max(len(output) / len(readings.times), 1.0)  # samples from one reading to the next
    half_width = slope_half_width(noise, sample_time * spacing, SPEED_ERROR * rms(speed))
    sampled = np.interp(times, readings.times, residual)
    speed = speed + slopes(sampled, round(half_width * spacing)) / sample_time
    means = np.append(0.5 * (speed[1:] + speed[:-1]), speed[-1])  # a force is held over a sample, as commands are
    return Flight(problem.log.commands[readings.channel], means, sample_time)


def slope_half_width(noise: float, gap: float, error: float) -> int:
    """The number h of readings on either side, such that a line through all has a slope with a small enough error.

    The slope of a line through 2 h + 1 readings at equal gaps d has the variance 3 s^2/(h (h + 1) (2 h + 1) d^2).

    Args:
        noise: Standard deviation s of white noise of the readings.
        gap: Time d from one reading to the next [s].
        error: The largest standard deviation of the slope.
    """
    ratio = min(noise / (gap * max(error, TINY)), 1e6)
    # A sufficient h: 3/(h (h + 1) (2 h + 1)) is below 1.5/h^3.
    return max(1, math.ceil((1.5 * ratio**2) ** (1.0 / 3.0)))


def slopes(series: np.ndarray, half_width: int) -> np.ndarray:
    """Slope of the line through each sample and its neighbours on either side, per sample; shape (n,).

    Args:
        series: The samples, shape (n,).
        half_width: Number of neighbours on either side; fewer in a short series. Beyond its ends, the end values count.
    """
    half_width = min(half_width, max(1, len(series) // 2))
    positions = np.arange(-half_width, half_width + 1)
    extended = np.pad(series, half_width, mode="edge")
    return np.correlate(extended, positions.astype(float), mode="valid") / float(np.sum(positions**2))
