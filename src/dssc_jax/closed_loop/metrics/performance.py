"""Metrics that are computed only if a study lists them, because each costs time at every sample."""

import math
from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp

from dssc_jax.closed_loop.metrics.instants import Instant, Sample
from dssc_jax.closed_loop.metrics.streaming import (
    RISES,
    SAMPLING,
    Course,
    Metric,
    Scope,
    Span,
    Window,
    final_value,
    largest_absolute,
    total,
)
from dssc_jax.core.numerics import at_least, root_abs, sign
from dssc_jax.core.signals import Scalar

SHARE_OF_SAMPLING = 0.05  # chattering frequency over the sampling frequency, a tenth of Nyquist's (assumed)


def integral(acc: Scalar, window: Window, span: Span) -> Scalar:
    """Integral of a signal, from the sum of its samples."""
    return acc * span.sample_time


def magnitude_of_mean(acc: Scalar, window: Window, span: Span) -> Scalar:
    """Absolute value of the mean over the window, from the sum of the samples."""
    return jnp.abs(acc) / span.sample_count


def update_timed_error(acc: Scalar, sample: Sample, window: Window) -> Scalar:
    """Add |e| times the time since the window's start."""
    return acc + (sample.k * sample.dt - window.after) * jnp.abs(sample.e)


class ErrorBeyondZero(NamedTuple):
    """Sign of the window's first error other than zero, and the largest error of the opposite sign."""

    side: Scalar = 0.0
    largest: Scalar = 0.0


def update_overshoot(acc: ErrorBeyondZero, sample: Sample, window: Window) -> ErrorBeyondZero:
    """Note the sign of the first error, and an error of the opposite sign that is larger than all before."""
    side = jnp.where(acc.side == 0.0, sign(sample.e), acc.side)
    return ErrorBeyondZero(side, jnp.maximum(acc.largest, -side * sample.e))


class CommandBands(NamedTuple):
    """The robust command split by a low-pass filter into a slow and a fast part.

    Args:
        samples: Number of samples so far.
        slow: Slow part of the last command.
        total: Sum of the slow part.
        squares: Sum of squares of the slow part.
        fast: Sum of squares of the fast part.
    """

    samples: Scalar = 0.0
    slow: Scalar = 0.0
    total: Scalar = 0.0
    squares: Scalar = 0.0
    fast: Scalar = 0.0


def update_bands(acc: CommandBands, sample: Sample, window: Window) -> CommandBands:
    """Split the sample's command by a first-order low-pass filter that starts at the window's first command."""
    frequency = window.chattering or SHARE_OF_SAMPLING / sample.dt
    share = -jnp.expm1(-2.0 * math.pi * frequency * sample.dt)
    slow = jnp.where(acc.samples == 0.0, sample.u, acc.slow + share * (sample.u - acc.slow))
    fast = sample.u - slow
    return CommandBands(acc.samples + 1.0, slow, acc.total + slow, acc.squares + slow * slow, acc.fast + fast * fast)


def fast_share(acc: CommandBands, window: Window, span: Span) -> Scalar:
    """Energy of the fast part over that of both parts, the slow one about its mean; 0 for a constant command."""
    about_mean = jnp.maximum(acc.squares - acc.total * acc.total / span.sample_count, 0.0)
    energy = acc.fast + about_mean
    return jnp.where(energy > 0.0, acc.fast / jnp.where(energy > 0.0, energy, 1.0), 0.0)


class CommandAndNoise(NamedTuple):
    """The command's two parts, and the sum of squares of the measurement error of sigma [(m/s)^2]."""

    command: CommandBands = CommandBands()
    noise: Scalar = 0.0


def update_amplification(acc: CommandAndNoise, sample: Sample, window: Window) -> CommandAndNoise:
    """Add the command and the measurement error of sigma."""
    command = update_bands(acc.command, sample, window)
    return CommandAndNoise(command, acc.noise + jnp.square(sample.sigma_measured - sample.sigma))


def amplification(acc: CommandAndNoise, window: Window, span: Span) -> Scalar:
    """rms of the command's fast part over rms of the measurement error; 0 for an exact measurement."""
    noisy = acc.noise > 0.0
    return root_abs(jnp.where(noisy, acc.command.fast / jnp.where(noisy, acc.noise, 1.0), 0.0))


class DriftSum(NamedTuple):
    """Number of samples, the last measurement error of sigma [m/s], and the sum of the gain times its changes [m/s]."""

    samples: Scalar = 0.0
    previous: Scalar = 0.0
    total: Scalar = 0.0


def update_drift(acc: DriftSum, sample: Sample, window: Window) -> DriftSum:
    """Add g(sigma_k) (n_k - n_(k-1)) for the measurement error n of sigma; the first sample has none.

    The gain is g = 1/(k_o tau_av) at the measured sigma, that is, the info's ``integral_gain`` times ``tau_m``.
    """
    noise = sample.sigma_measured - sample.sigma
    step = (noise - acc.previous) * sample.info.integral_gain * sample.info.tau_m
    return DriftSum(acc.samples + 1.0, noise, acc.total + jnp.where(acc.samples == 0.0, 0.0, step))


def drift_rate(acc: DriftSum, window: Window, span: Span) -> Scalar:
    """Absolute value of the sum over the length of the window [s]."""
    return jnp.abs(acc.total) / (span.sample_count * span.sample_time)


class CommandPath(NamedTuple):
    """Number of samples, the last total command u + u_n, and its total variation so far."""

    samples: Scalar = 0.0
    previous: Scalar = 0.0
    length: Scalar = 0.0


def update_path(acc: CommandPath, sample: Sample, window: Window) -> CommandPath:
    """Add the size of the change to this sample's u + u_n; the window's first sample has none."""
    step = jnp.where(acc.samples == 0.0, 0.0, jnp.abs(sample.u_total - acc.previous))
    return CommandPath(acc.samples + 1.0, sample.u_total, acc.length + step)


class LogTrend(NamedTuple):
    """Sums of ln |sigma| and of k ln |sigma| over samples k."""

    total: Scalar = 0.0
    moment: Scalar = 0.0


def update_trend(acc: LogTrend, sample: Sample, window: Window) -> LogTrend:
    """Add ln |sigma|, where sigma is at least the smallest normal number."""
    level = jnp.log(jnp.maximum(jnp.abs(sample.sigma), jnp.finfo(jnp.result_type(float)).tiny))
    return LogTrend(acc.total + level, acc.moment + sample.k * level)


def growth_rate(acc: LogTrend, window: Window, span: Span) -> Scalar:
    """Least-squares slope of ln |sigma| over time [1/s]."""
    n = 1.0 * span.sample_count  # a count of samples that the draw decides may be traced
    centre = span.steps - n + 0.5 * (n - 1.0)
    spread = at_least(n * (n**2 - 1.0) / 12.0, 1.0)
    return (acc.moment - centre * acc.total) / (spread * span.sample_time)


def update_largest_thrust(acc: Scalar, instant: Instant, window: Window) -> Scalar:
    """The larger of the accumulator and the thrusts of all rotors [N]."""
    return reduce(jnp.maximum, instant.plant.rotor, acc)


def update_smallest_thrust(acc: Scalar, instant: Instant, window: Window) -> Scalar:
    """The smaller of the accumulator and the thrusts of all rotors [N]."""
    return reduce(jnp.minimum, instant.plant.rotor, acc)


PERFORMANCE: dict[str, Metric] = {
    "error_rate_max": largest_absolute("y/s", "largest |e'|", lambda s: s.e_dot),
    "iae": Metric("y s", "integral of |e|", total(lambda s: jnp.abs(s.e)), integral, course=RISES, least=0.0),
    "itae": Metric(
        "y s^2",
        "integral of time, from the window's start, times |e|",
        update_timed_error,
        integral,
        course=RISES,
        least=0.0,
    ),
    "overshoot": Metric(
        "y",
        "largest error on the other side of zero",
        update_overshoot,
        lambda acc, *_: acc.largest,
        start=ErrorBeyondZero(),
        course=RISES,
    ),
    "steady_state_error": Metric(
        "y", "|mean of e| over the window", total(lambda s: s.e), magnitude_of_mean, least=0.0
    ),
    "command_energy": Metric(
        "u^2 s",
        "integral of the robust command's square",
        total(lambda s: s.u * s.u),
        integral,
        course=RISES,
        least=0.0,
    ),
    "chattering_index": Metric(
        "1",
        "share of the robust command above the chattering frequency",
        update_bands,
        fast_share,
        start=CommandBands(),
        least=0.0,
    ),
    "noise_amplification": Metric(
        "1",
        "rms of the command above the chattering frequency per rms of measurement error",
        update_amplification,
        amplification,
        start=CommandAndNoise(),
        least=0.0,
    ),
    "noise_drift": Metric(
        "u/s",
        "rate at which measurement noise drives the implicit form's command",
        update_drift,
        drift_rate,
        SAMPLING,
        start=DriftSum(),
    ),
    "total_command_tv": Metric(
        "u",
        "total variation of u + u_n",
        update_path,
        lambda acc, *_: acc.length,
        start=CommandPath(),
        course=RISES,
        least=0.0,
    ),
    "roll_max": largest_absolute("rad", "largest |roll|", lambda i: i.plant.phi, ("phi",), Scope.VEHICLE),
    "pitch_max": largest_absolute("rad", "largest |pitch|", lambda i: i.plant.theta, ("theta",), Scope.VEHICLE),
    "rotor_thrust_max": Metric(
        "N",
        "largest commanded thrust of a rotor",
        update_largest_thrust,
        final_value,
        needs=("rotor_1",),
        scope=Scope.VEHICLE,
        course=RISES,
    ),
    "rotor_thrust_min": Metric(
        "N",
        "smallest commanded thrust of a rotor",
        update_smallest_thrust,
        final_value,
        needs=("rotor_1",),
        scope=Scope.VEHICLE,
        start=math.inf,
        course=Course.FALLS,
    ),
    "growth_rate": Metric(
        "1/s", "rate at which |sigma| grows, fitted over the window", update_trend, growth_rate, start=LogTrend()
    ),
}
