"""How a logged command follows from the one that the analysed controller gives for the logged measurements.

The same measurements with their noise lead to the same command, but for the controller's first state. So a multiple, a
delay, an offset or a slower clock shows, which a fit would put into gains, lags and disturbances; so does another
controller.
"""

import numpy as np

from dssc_jax.flight_logs.conversions import FEWER, multiple_of, rms
from dssc_jax.flight_logs.held_outputs import drop_repeats, usual_hold
from dssc_jax.flight_logs.reader import forward_filled

LONGEST_SHIFT = 0.5  # s
LONGEST_SHARE = 0.1  # of the log
EXPLAINED = 0.1  # share of the command's deviation from its median that may be left of a command that is explained
LARGE_OFFSET = 0.1  # share of that deviation: a smaller offset is not told
LEAST_VALUES = 20
ANOTHER = 0.1  # share of the command's deviation from its median: a larger difference is that of another controller
ROUNDING = 1e-3  # share of a command's root mean square: no smaller difference says anything


def command_hint(logged: np.ndarray, replayed: np.ndarray, sample_time: float, unit: str) -> str:
    """How the logged command follows from the replayed one, in words; empty if both are the same or nothing is certain.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        replayed: The command of the analysed controller, shape (samples,).
        sample_time: Time between two samples [s].
        unit: Unit of the command.
    """
    factor = multiple_of(logged, replayed)
    if factor != 1.0:
        return (
            f"is {factor:.4g} times what the analysed controller gives for the logged measurements: it is in another "
            "unit, or other gains flew. Estimates of gains and disturbances are off by that factor unless they did"
        )
    has_both = np.isfinite(logged) & np.isfinite(replayed)
    if np.count_nonzero(has_both) < LEAST_VALUES:
        return ""
    deviation = rms(logged - np.median(logged[has_both]))
    largest_residual = EXPLAINED * deviation
    difference = rms(logged - replayed)
    if difference <= ROUNDING * rms(logged):
        return ""
    hold = usual_hold(logged)
    if hold > 1 and rms(logged - held_like(logged, replayed)) <= min(largest_residual, FEWER * difference):
        return (
            f"is what the analysed controller gives every {hold * sample_time:.3g} s, held between. If only the log is "
            "so slow, the vehicle flew other commands, and a fit takes that for a lag; if the flight was, give "
            "loop.sample_time that value"
        )
    shift, residual = best_shift(logged, replayed, round(LONGEST_SHIFT / sample_time))
    if shift != 0 and residual <= min(largest_residual, FEWER * difference):
        side = "later" if shift > 0 else "earlier"
        return (
            f"is {abs(shift) * sample_time:.3g} s {side} than the analysed controller gives it for the logged "
            "measurements: compare the times of its column. A fit takes that for a lag"
        )
    offset = float(np.median((logged - replayed)[has_both]))
    residual = rms(logged - replayed - offset)
    if abs(offset) > LARGE_OFFSET * deviation and residual <= min(largest_residual, FEWER * difference):
        return (
            f"lies {offset:.4g} {unit} beside what the analysed controller gives all the time: its column has an "
            "offset, or an integral began at another value. A fit takes an offset for a disturbance"
        )
    latter_half = slice(len(logged) // 2, None)  # what the first state does has decayed there
    if min(difference, rms((logged - replayed)[latter_half])) > ANOTHER * deviation:
        return (
            f"is not what the analysed controller gives for the logged measurements: they differ by {difference:.4g} "
            f"{unit} rms, and the logged one varies by {deviation:.4g}. Other gains or limits flew, or a measurement "
            "is not what the controller got: compare units, offsets, times and gaps of y and y'"
        )
    return ""


def held_like(logged: np.ndarray, replayed: np.ndarray) -> np.ndarray:
    """The replayed command, held from each change of the logged one to the next, shape (samples,)."""
    return forward_filled(np.where(np.isfinite(drop_repeats(logged)), replayed, np.nan))


def best_shift(logged: np.ndarray, replayed: np.ndarray, longest: int) -> tuple[int, float]:
    """The delay of the logged command that leaves the least difference [samples], and the rms of that difference."""
    samples = len(logged)
    best = 0
    smallest = rms(logged - replayed)
    for shift in range(1, min(longest, int(LONGEST_SHARE * samples)) + 1):
        later = rms(logged[shift:] - replayed[:-shift])
        earlier = rms(logged[:-shift] - replayed[shift:])
        if min(later, earlier) < smallest:
            best = shift if later < earlier else -shift
            smallest = min(later, earlier)
    return best, smallest
