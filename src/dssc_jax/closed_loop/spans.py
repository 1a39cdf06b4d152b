"""The samples of a window."""

import math
from typing import NamedTuple

import jax.numpy as jnp

from dssc_jax.closed_loop.window import Window
from dssc_jax.core.signals import Scalar


class Span(NamedTuple):
    """Data for the final value of an accumulator: samples up to the end of the window, samples in it, and T_s [s]."""

    steps: Scalar
    sample_count: Scalar
    sample_time: float


def periods_lasting(duration: float, sample_time: float) -> int:
    """The least number of sample periods that last as long as a duration [s], robust to rounding of t = k T_s."""
    return math.ceil(duration / sample_time - 1e-9)


def first_sample(after: float, sample_time: float) -> int:
    """Index of the first sample at t >= after."""
    return max(0, periods_lasting(after, sample_time))


LONGEST = 2**31 - 1  # samples of a run


def samples_before_end(window: Window, sample_time: float, steps: Scalar) -> Scalar:
    """Number of samples at t <= until in a run of ``steps`` samples, robust to rounding of t = k T_s."""
    if math.isinf(window.until):
        return steps
    count = min(LONGEST, math.floor(window.until / sample_time + 1e-9) + 1)
    return min(steps, count) if isinstance(steps, int) else jnp.minimum(steps, count)


def span_of(window: Window, steps: Scalar, sample_time: float) -> Span:
    """The span of a window in a run of ``steps`` samples."""
    end = samples_before_end(window, sample_time, steps)
    return Span(end, end - first_sample(window.after, sample_time), sample_time)


def in_window(window: Window, k: Scalar, sample_time: float) -> Scalar | None:
    """Whether sample k lies in the window; None where all samples do."""
    start = first_sample(window.after, sample_time)
    if math.isinf(window.until):
        return None if start == 0 else k >= start
    return (k >= start) & (k < samples_before_end(window, sample_time, LONGEST))
