"""A logged command that is the analysed controller's behind a lag, or by another clock."""

from collections.abc import Callable

import numpy as np
from scipy import optimize, signal

from dssc_jax.flight_logs.hints.conversions import FEWER, rms
from dssc_jax.flight_logs.signal_warnings import Hint

EXPLAINED = 0.1  # share of the command's deviation that may be left
LAGS = (1.0, 50.0)  # samples: the range of time constants that are tried
LARGEST_RATE = 0.1  # largest relative difference of two clocks that is tried
LEAST_SHIFT = 2.0  # samples at the end of the log, by which another clock is reported


def course_hint(logged: np.ndarray, replayed: np.ndarray, sample_time: float, deviation: float) -> Hint | None:
    """The hint about a command that is the replayed one behind a lag, or by another clock; None if it is neither.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        replayed: The command of the analysed controller, shape (samples,).
        sample_time: Time between two samples [s].
        deviation: Root mean square deviation of the logged command from its median.
    """
    tolerance = min(EXPLAINED * deviation, FEWER * rms(logged - replayed))
    lag, left = best_lag(logged, replayed)
    if left <= tolerance:
        text = (
            f"is what the analysed controller gives, behind a first-order lag of {lag * sample_time:.3g} s: the log "
            "has a filtered command, or what an actuator made of it. A fit takes it for what the study's actuator "
            "gets. Log the command that the controller gives"
        )
        return Hint("filtered-command", text)
    rate, left = best_rate(logged, replayed)
    if left <= tolerance and abs(rate - 1.0) * len(logged) >= LEAST_SHIFT:
        text = (
            f"is what the analysed controller gives at {rate:.4g} times the logged times: its clock drifts from that "
            "of the measurements. Compare the clocks of the log. A fit takes that for a delay that grows"
        )
        return Hint("clock-rate", text)
    return None


def best_lag(logged: np.ndarray, original: np.ndarray) -> tuple[float, float]:
    """The first-order lag behind which a signal is nearest to a logged one.

    Args:
        logged: The logged signal, NaN where missing, shape (samples,).
        original: The signal without the lag, shape (samples,).

    Returns:
        The time constant [samples], and the root mean square of the remaining difference.
    """

    def left(logarithm: float) -> float:
        """The root mean square of the difference."""
        share = -np.expm1(-np.exp(-logarithm))
        lagged, _ = signal.lfilter([share], [1.0, share - 1.0], original - original[0], zi=[0.0])
        return rms(logged - original[0] - lagged)

    logarithm, least = bounded_minimum(left, np.linspace(np.log(LAGS[0]), np.log(LAGS[1]), 16))
    return float(np.exp(logarithm)), least


def best_rate(logged: np.ndarray, original: np.ndarray) -> tuple[float, float]:
    """The rate of the clock with which a signal is nearest to a logged one.

    Args:
        logged: The logged signal, NaN where missing, shape (samples,).
        original: The signal by the right clock, shape (samples,).

    Returns:
        The rate, and the root mean square of the remaining difference.
    """
    rows = np.arange(len(original), dtype=float)

    def left(rate: float) -> float:
        """The root mean square of the difference."""
        return rms(logged - np.interp(rate * rows, rows, original, right=np.nan))

    count = round(2.0 * LARGEST_RATE * len(rows)) | 1
    return bounded_minimum(left, np.linspace(1.0 - LARGEST_RATE, 1.0 + LARGEST_RATE, max(count, 3)))


def bounded_minimum(left: Callable[[float], float], grid: np.ndarray) -> tuple[float, float]:
    """Minimise a function near the best of some points; return the place of the minimum, and the value there."""
    place = int(np.clip(np.argmin([left(point) for point in grid.tolist()]), 1, len(grid) - 2))
    found = optimize.minimize_scalar(left, bounds=(grid[place - 1], grid[place + 1]), method="bounded")
    return float(found.x), left(float(found.x))
