"""Performance metrics that are computed only if a study lists them, because each costs time at every sample."""

import math
from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp

from dssc_jax.closed_loop.instants import Instant, Sample
from dssc_jax.closed_loop.metrics import (
    RISES,
    SAMPLING,
    Course,
    Metric,
    Scope,
    Span,
    Window,
    final_value,
    largest_size,
    total,
)
from dssc_jax.core.numerics import at_least, root_abs, sign
from dssc_jax.core.signals import Scalar

SHARE_OF_SAMPLING = 0.05  # share of the sampling frequency, a tenth of Nyquist's: faster is chattering (assumed)


def integral(acc: Scalar, window: Window, span: Span) -> Scalar:
    """Sum times T_s."""
    return acc * span.sample_time


def magnitude_of_mean(acc: Scalar, window: Window, span: Span) -> Scalar:
    """|mean over the window|."""
    return jnp.abs(acc) / span.sample_count


def timed_error(acc: Scalar, sample: Sample, window: Window) -> Scalar:
    """Sum of (t - after) |e|."""
    return acc + (sample.k * sample.dt - window.after) * jnp.abs(sample.e)


class Beyond(NamedTuple):
    """Sign of the window's first error that is not zero, and the largest error on the other side."""

    side: Scalar = 0.0
    largest: Scalar = 0.0


def time_beyond(acc: Beyond, sample: Sample, window: Window) -> Beyond:
    """Largest error beyond zero, relative to its sign at the start of the window."""
    side = jnp.where(acc.side == 0.0, sign(sample.e), acc.side)
    return Beyond(side, jnp.maximum(acc.largest, -side * sample.e))


class Bands(NamedTuple):
    """Samples so far, the slow part of the command, its sum and sum of squares, and the fast part's."""

    samples: Scalar = 0.0
    slow: Scalar = 0.0
    total: Scalar = 0.0
    squares: Scalar = 0.0
    fast: Scalar = 0.0


def bands(acc: Bands, sample: Sample, window: Window) -> Bands:
    """Split the command by a first-order low-pass filter that starts at the window's first command."""
    frequency = window.chattering or SHARE_OF_SAMPLING / sample.dt
    share = -jnp.expm1(-2.0 * math.pi * frequency * sample.dt)
    slow = jnp.where(acc.samples == 0.0, sample.u, acc.slow + share * (sample.u - acc.slow))
    fast = sample.u - slow
    return Bands(acc.samples + 1.0, slow, acc.total + slow, acc.squares + slow * slow, acc.fast + fast * fast)


def fast_share(acc: Bands, window: Window, span: Span) -> Scalar:
    """Energy of the fast part over that of both parts, the slow one about its mean; 0 for a constant command."""
    about_mean = jnp.maximum(acc.squares - acc.total * acc.total / span.sample_count, 0.0)
    energy = acc.fast + about_mean
    return jnp.where(energy > 0.0, acc.fast / jnp.where(energy > 0.0, energy, 1.0), 0.0)


class Amplified(NamedTuple):
    """The command's bands, and the sum of squares of the error of the measured sigma [m/s]."""

    command: Bands = Bands()
    noise: Scalar = 0.0


def amplified(acc: Amplified, sample: Sample, window: Window) -> Amplified:
    """Add the command and the error of the measured sigma."""
    return Amplified(bands(acc.command, sample, window), acc.noise + jnp.square(sample.sigma_measured - sample.sigma))


def amplification(acc: Amplified, window: Window, span: Span) -> Scalar:
    """rms of the command's fast part over rms of the measurement error; 0 for an exact measurement."""
    noisy = acc.noise > 0.0
    return root_abs(jnp.where(noisy, acc.command.fast / jnp.where(noisy, acc.noise, 1.0), 0.0))


class DriftSum(NamedTuple):
    """Samples so far, the last error of the measured sigma [m/s], and the sum of the gain times its changes [m/s]."""

    samples: Scalar = 0.0
    previous: Scalar = 0.0
    total: Scalar = 0.0


def drift_sum(acc: DriftSum, sample: Sample, window: Window) -> DriftSum:
    """Add g(sigma_k) (n_k - n_(k-1)) with g = 1/(k_o tau_av) at the measured sigma; the first sample has none."""
    noise = sample.sigma_measured - sample.sigma
    step = (noise - acc.previous) * sample.info.integral_gain * sample.info.tau_m
    return DriftSum(acc.samples + 1.0, noise, acc.total + jnp.where(acc.samples == 0.0, 0.0, step))


def drift_rate(acc: DriftSum, window: Window, span: Span) -> Scalar:
    """|sum| per time."""
    return jnp.abs(acc.total) / (span.sample_count * span.sample_time)


class Path(NamedTuple):
    """Samples so far, the last whole command, and its total variation so far [m/s]."""

    samples: Scalar = 0.0
    previous: Scalar = 0.0
    length: Scalar = 0.0


def path(acc: Path, sample: Sample, window: Window) -> Path:
    """Add the change to this sample's u + u_n; the window's first sample has none."""
    step = jnp.where(acc.samples == 0.0, 0.0, jnp.abs(sample.u_total - acc.previous))
    return Path(acc.samples + 1.0, sample.u_total, acc.length + step)


class Trend(NamedTuple):
    """Sums of ln |sigma| and of k ln |sigma|."""

    total: Scalar = 0.0
    moment: Scalar = 0.0


def trend(acc: Trend, sample: Sample, window: Window) -> Trend:
    """Add ln |sigma|, floored at the smallest normal number."""
    level = jnp.log(jnp.maximum(jnp.abs(sample.sigma), jnp.finfo(jnp.result_type(float)).tiny))
    return Trend(acc.total + level, acc.moment + sample.k * level)


def slope(acc: Trend, window: Window, span: Span) -> Scalar:
    """Least-squares slope of ln |sigma| over time."""
    n = 1.0 * span.sample_count  # a count of samples that the draw decides may be traced
    centre = span.steps - n + 0.5 * (n - 1.0)
    spread = at_least(n * (n**2 - 1.0) / 12.0, 1.0)
    return (acc.moment - centre * acc.total) / (spread * span.sample_time)


def largest_thrust(acc: Scalar, instant: Instant, window: Window) -> Scalar:
    """Largest thrust of any rotor so far."""
    return reduce(jnp.maximum, instant.plant.rotor, acc)


def smallest_thrust(acc: Scalar, instant: Instant, window: Window) -> Scalar:
    """Smallest thrust of any rotor so far."""
    return reduce(jnp.minimum, instant.plant.rotor, acc)


PERFORMANCE: dict[str, Metric] = {
    "error_rate_max": largest_size("y/s", "largest |e'|", lambda s: s.e_dot),
    "iae": Metric("y s", "integral of |e|", total(lambda s: jnp.abs(s.e)), integral, course=RISES, least=0.0),
    "itae": Metric(
        "y s^2", "integral of time, from the window's start, times |e|", timed_error, integral, course=RISES, least=0.0
    ),
    "overshoot": Metric(
        "y",
        "largest error on the other side of zero",
        time_beyond,
        lambda acc, *_: acc.largest,
        start=Beyond(),
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
        "1", "share of the robust command above the chattering frequency", bands, fast_share, start=Bands(), least=0.0
    ),
    "noise_amplification": Metric(
        "1",
        "rms of the command above the chattering frequency per rms of measurement error",
        amplified,
        amplification,
        start=Amplified(),
        least=0.0,
    ),
    "noise_drift": Metric(
        "u/s",
        "rate at which measurement noise drives the implicit form's command",
        drift_sum,
        drift_rate,
        SAMPLING,
        start=DriftSum(),
    ),
    "total_command_tv": Metric(
        "u", "total variation of u + u_n", path, lambda acc, *_: acc.length, start=Path(), course=RISES, least=0.0
    ),
    "roll_max": largest_size("rad", "largest |roll|", lambda i: i.plant.phi, ("phi",), Scope.VEHICLE),
    "pitch_max": largest_size("rad", "largest |pitch|", lambda i: i.plant.theta, ("theta",), Scope.VEHICLE),
    "rotor_thrust_max": Metric(
        "N",
        "largest commanded thrust of a rotor",
        largest_thrust,
        final_value,
        needs=("rotor_1",),
        scope=Scope.VEHICLE,
        course=RISES,
    ),
    "rotor_thrust_min": Metric(
        "N",
        "smallest commanded thrust of a rotor",
        smallest_thrust,
        final_value,
        needs=("rotor_1",),
        scope=Scope.VEHICLE,
        start=math.inf,
        course=Course.FALLS,
    ),
    "growth_rate": Metric("1/s", "rate at which |sigma| grows, fitted over the window", trend, slope, start=Trend()),
}
