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
    sum_update,
)
from dssc_jax.core.numerics import at_least, root_abs, sign
from dssc_jax.core.signals import Scalar

SHARE_OF_SAMPLING = 0.05  # chattering frequency over the sampling frequency, a tenth of Nyquist's (assumed)


def integral(acc: Scalar, window: Window, span: Span) -> Scalar:
    """Integral of a signal over the window: the accumulated sum of its samples times T_s.

    The sum contains the window's samples only, so ``window`` is not read.
    """
    return acc * span.sample_time


def magnitude_of_mean(acc: Scalar, window: Window, span: Span) -> Scalar:
    """Absolute value of the mean over the window, from the accumulated sum; the contract's ``window`` is not read."""
    return jnp.abs(acc) / span.sample_count


def update_timed_error(acc: Scalar, sample: Sample, window: Window) -> Scalar:
    """Add |e| times the time since the window's start.

    Args:
        acc: Sum so far.
        sample: The sample.
        window: The window, which starts at ``window.after`` [s].
    """
    return acc + (sample.k * sample.dt - window.after) * jnp.abs(sample.e)


class ErrorBeyondZero(NamedTuple):
    """The overshoot of the error over zero.

    Args:
        side: Sign of the window's first error other than 0; 0: there was none yet.
        largest: Size of the largest error of the opposite sign.
    """

    side: Scalar = 0.0
    largest: Scalar = 0.0


def update_overshoot(acc: ErrorBeyondZero, sample: Sample, window: Window) -> ErrorBeyondZero:
    """Note the sign of the first error, and the size of the largest error of the opposite sign.

    A side of 0 means that all errors so far were 0. The contract's ``window`` is not read.
    """
    side = jnp.where(acc.side == 0.0, sign(sample.e), acc.side)
    return ErrorBeyondZero(side, jnp.maximum(acc.largest, -side * sample.e))


def largest_error_beyond_zero(acc: ErrorBeyondZero, window: Window, span: Span) -> Scalar:
    """Size of the largest error whose sign is opposite to that of the first error.

    The accumulator holds it; the contract's ``window`` and ``span`` are not read.
    """
    return acc.largest


class CommandBands(NamedTuple):
    """Energies of the robust command below and above the chattering frequency; a low-pass filter splits the command.

    Args:
        samples: Number of samples so far.
        slow: Slow part of the last command, the filter's output.
        total: Sum of the slow part over the samples.
        squares: Sum of squares of the slow part.
        fast: Sum of squares of the fast part, command minus slow part.
    """

    samples: Scalar = 0.0
    slow: Scalar = 0.0
    total: Scalar = 0.0
    squares: Scalar = 0.0
    fast: Scalar = 0.0


def update_bands(acc: CommandBands, sample: Sample, window: Window) -> CommandBands:
    """Split the sample's command by a first-order low-pass filter, and add the energies of both parts.

    The filter starts at the window's first command. Its corner is the window's chattering frequency [Hz]; 0 selects a
    fixed share of the sampling frequency.
    """
    frequency = window.chattering or SHARE_OF_SAMPLING / sample.dt  # [Hz]; 0 in the window: its default
    share = -jnp.expm1(-2.0 * math.pi * frequency * sample.dt)  # of the way to the command in one sample
    slow = jnp.where(acc.samples == 0.0, sample.u, acc.slow + share * (sample.u - acc.slow))
    fast = sample.u - slow
    return CommandBands(acc.samples + 1.0, slow, acc.total + slow, acc.squares + slow * slow, acc.fast + fast * fast)


def fast_share(acc: CommandBands, window: Window, span: Span) -> Scalar:
    """Share of the command's energy that lies above the chattering frequency; 0 for a constant command.

    The energy of the slow part is counted about its mean, so that a constant command has none. The contract's
    ``window`` is not read.
    """
    slow_energy = jnp.maximum(acc.squares - acc.total * acc.total / span.sample_count, 0.0)
    energy = acc.fast + slow_energy
    return jnp.where(energy > 0.0, acc.fast / jnp.where(energy > 0.0, energy, 1.0), 0.0)


class CommandAndNoise(NamedTuple):
    """Energies of the robust command and of the measurement noise.

    Args:
        command: Energies of the command below and above the chattering frequency.
        noise: Sum of squares of the measurement error of sigma [(m/s)^2].
    """

    command: CommandBands = CommandBands()
    noise: Scalar = 0.0


def update_amplification(acc: CommandAndNoise, sample: Sample, window: Window) -> CommandAndNoise:
    """Add the energies of a sample's command and of its measurement error of sigma.

    ``window`` gives the chattering frequency, which splits the command.
    """
    command = update_bands(acc.command, sample, window)
    return CommandAndNoise(command, acc.noise + jnp.square(sample.sigma_measured - sample.sigma))


def amplification(acc: CommandAndNoise, window: Window, span: Span) -> Scalar:
    """rms of the command above the chattering frequency over the rms of the measurement error of sigma.

    The value is 0 if the measurement is exact. The number of samples cancels, so ``span`` is not read.
    """
    is_noisy = acc.noise > 0.0
    return root_abs(jnp.where(is_noisy, acc.command.fast / jnp.where(is_noisy, acc.noise, 1.0), 0.0))


class DriftSum(NamedTuple):
    """The drift of the command of the implicit form of DSSC by measurement noise.

    Args:
        samples: Number of samples so far.
        previous: Measurement error of sigma at the last sample [m/s].
        total: Sum over the samples of the controller's gain times the change of this error.
    """

    samples: Scalar = 0.0
    previous: Scalar = 0.0
    total: Scalar = 0.0


def update_drift(acc: DriftSum, sample: Sample, window: Window) -> DriftSum:
    """Add g(sigma_k) (n_k - n_(k-1)), the move of the command by the change of the measurement error n of sigma.

    g = 1/(k_o tau_av) is the controller's gain at the measured sigma. The window's first sample has no previous one,
    and adds nothing. The contract's ``window`` is not read.
    """
    noise = sample.sigma_measured - sample.sigma  # n_k
    step = (noise - acc.previous) * sample.info.integral_gain * sample.info.tau_m  # their product is g
    return DriftSum(acc.samples + 1.0, noise, acc.total + jnp.where(acc.samples == 0.0, 0.0, step))


def drift_rate(acc: DriftSum, window: Window, span: Span) -> Scalar:
    """Mean rate at which measurement noise drives the command: |sum of the moves| over the window's duration.

    The contract's ``window`` is not read: ``span`` has the duration.
    """
    return jnp.abs(acc.total) / (span.sample_count * span.sample_time)


class CommandPath(NamedTuple):
    """The total variation of the command u + u_n.

    Args:
        samples: Number of samples so far.
        previous: Command at the last sample.
        length: Sum of the sizes of the command's changes.
    """

    samples: Scalar = 0.0
    previous: Scalar = 0.0
    length: Scalar = 0.0


def update_path(acc: CommandPath, sample: Sample, window: Window) -> CommandPath:
    """Add the size of the command's change since the previous sample; the window's first sample adds nothing.

    The contract's ``window`` is not read.
    """
    step = jnp.where(acc.samples == 0.0, 0.0, jnp.abs(sample.u_total - acc.previous))
    return CommandPath(acc.samples + 1.0, sample.u_total, acc.length + step)


def path_length(acc: CommandPath, window: Window, span: Span) -> Scalar:
    """The total variation of the command u + u_n over the window.

    The accumulator holds it; the contract's ``window`` and ``span`` are not read.
    """
    return acc.length


class LogTrend(NamedTuple):
    """Sums over samples k, from which the slope of a line through ln |sigma| follows.

    Args:
        total: Sum of ln |sigma|.
        moment: Sum of k ln |sigma|.
    """

    total: Scalar = 0.0
    moment: Scalar = 0.0


def update_trend(acc: LogTrend, sample: Sample, window: Window) -> LogTrend:
    """Add a sample's ln |sigma|; a sigma of 0 counts as the smallest normal number, to keep the logarithm finite.

    The contract's ``window`` is not read.
    """
    level = jnp.log(jnp.maximum(jnp.abs(sample.sigma), jnp.finfo(jnp.result_type(float)).tiny))
    return LogTrend(acc.total + level, acc.moment + sample.k * level)


def growth_rate(acc: LogTrend, window: Window, span: Span) -> Scalar:
    """Least-squares slope of ln |sigma| over time [1/s]: positive if the oscillation grows.

    ``span`` gives the number of samples and their indices; the contract's ``window`` is not read.
    """
    n = 1.0 * span.sample_count  # a real number, also if the draw decides the count and it is traced
    centre = span.steps - n + 0.5 * (n - 1.0)  # mean of the indices k
    spread = at_least(n * (n**2 - 1.0) / 12.0, 1.0)  # sum of (k - centre)^2; 1 for a single sample
    return (acc.moment - centre * acc.total) / (spread * span.sample_time)


def update_largest_thrust(acc: Scalar, instant: Instant, window: Window) -> Scalar:
    """The largest thrust of any rotor up to this sample [N]; the contract's ``window`` is not read."""
    return reduce(jnp.maximum, instant.plant.rotor, acc)


def update_smallest_thrust(acc: Scalar, instant: Instant, window: Window) -> Scalar:
    """The smallest thrust of any rotor up to this sample [N]; the contract's ``window`` is not read."""
    return reduce(jnp.minimum, instant.plant.rotor, acc)


PERFORMANCE: dict[str, Metric] = {
    "error_rate_max": largest_absolute("y/s", "largest |e'|", lambda s: s.e_dot),
    "iae": Metric("y s", "integral of |e|", sum_update(lambda s: jnp.abs(s.e)), integral, course=RISES, least=0.0),
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
        largest_error_beyond_zero,
        start=ErrorBeyondZero(),
        course=RISES,
    ),
    "steady_state_error": Metric(
        "y", "|mean of e| over the window", sum_update(lambda s: s.e), magnitude_of_mean, least=0.0
    ),
    "command_energy": Metric(
        "u^2 s",
        "integral of the robust command's square",
        sum_update(lambda s: s.u * s.u),
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
        path_length,
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
