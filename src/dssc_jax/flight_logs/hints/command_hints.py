"""How a logged command follows from the one that the analysed controller gives for the logged measurements.

The same measurements, with their noise, give the same command, except for the effect of the controller's first state.
So a multiple, a delay, an offset, a slower clock or another controller shows in the difference. A fit would put these
into gains, lags and disturbances.
"""

import numpy as np

from dssc_jax.core.flag_runs import flag_runs
from dssc_jax.flight_logs.hints.command_courses import course_hint
from dssc_jax.flight_logs.hints.conversions import COMMAND_ROUNDING, FEWER, conversion_text, multiple_of, rms
from dssc_jax.flight_logs.hints.lost_commands import (
    lost_commands,
    lost_commands_hint,
    replaced_commands,
    replaced_commands_hint,
)
from dssc_jax.flight_logs.hints.rounded_commands import command_rounding, rounded_hint
from dssc_jax.flight_logs.reading.held_outputs import drop_repeats, usual_hold
from dssc_jax.flight_logs.reading.interpolated_outputs import bends
from dssc_jax.flight_logs.reading.reader import Column, forward_filled
from dssc_jax.flight_logs.signal_warnings import OPEN_CAUSE, Hint

SAME_COMMAND = 0.1  # share of a command's root mean square: closer, a converted command is that of the replay
LARGE_FACTOR = 5.0  # of a command or its inverse: no other gains of one controller give it throughout a flight
LONGEST_SHIFT = 0.5  # s
LONGEST_SHARE = 0.1  # of the log
EXPLAINED = 0.1  # share of the command's deviation from its median that may be left of a command that is explained
LARGE_OFFSET = 0.005  # share of that deviation: a smaller offset is not reported
LEAST_VALUES = 20
FASTER = 0.75  # share of T_s: if the time between two changes is shorter, the controller is faster than the study's
ANOTHER = 0.1  # share of the command's deviation from its median: a larger difference is that of another controller
LEAST_STUCK = 5  # equal samples in a row of a command that sticks
STUCK = 10.0  # factor on the difference elsewhere: a larger one beside equal values is that of a command that sticks
MOST_SPIKES = 12  # largest number of spikes in a log that are reported as such
NAMED_SPIKES = 3  # spikes whose times a message names
MUCH_LARGER = 5.0  # factor on the jump of the replay: a larger one of the log is that of a spike
MOST_SPANS = 3  # largest number of spans in which a command sticks


def rate_hint(command: Column, sample_time: float) -> Hint | None:
    """The hint that a command was interpolated, or changes more often than the study's controller gives commands.

    Args:
        command: The command as logged.
        sample_time: T_s of the study [s].

    Returns:
        None if neither holds.
    """
    is_limited = np.isin(command.value, (np.nanmin(command.value), np.nanmax(command.value)))
    is_bend = bends(np.where(is_limited, np.nan, command.value))  # a line at a limit is no interpolation
    if is_bend.size:
        interval = len(is_bend) / np.count_nonzero(is_bend) * float(np.median(np.diff(command.time)))
        text = (
            f"is a straight line from one command to the next, {interval:.3g} s apart: the log was interpolated, and a "
            "controller that holds its commands gave each of them later. Log the commands alone, with the time of "
            "each, and leave other cells empty"
        )
        return Hint("interpolated-command", text)
    change_times = command.time[1:][np.diff(command.value) != 0.0]
    if len(change_times) < LEAST_VALUES:
        return None
    interval = float(np.median(np.diff(change_times)))
    if not interval < FASTER * sample_time:
        return None
    text = (
        f"changes every {interval:.3g} s, and the study's controller gives a command every {sample_time:g} s: set "
        "loop.sample_time to that of the flight's controller. A fit takes one of its commands for each sample"
    )
    return Hint("faster-controller", text)


def command_unit(logged: np.ndarray, replayed: np.ndarray, unit: str) -> str:
    """The unit or sign of a logged command that is certainly not the study's, in words; empty if none is certain.

    There are two cases. Either the logged command is, to noise, the analysed controller's in another known unit. Or it
    is throughout a multiple that no other gains give, a negative or a large one; an offset may be added, such as the
    thrust at hover.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        replayed: The command of the analysed controller, shape (samples,).
        unit: Unit of the command.
    """
    text = conversion_text(logged, replayed, SAME_COMMAND, unit)
    if text:
        return f"is the analysed controller's {text}"
    factor = multiple_of(logged, replayed)
    offset = 0.0
    if factor == 1.0:
        has_both = np.isfinite(logged) & np.isfinite(replayed)
        if np.count_nonzero(has_both) < LEAST_VALUES:
            return ""
        logged_mean = float(np.mean(logged[has_both]))
        replayed_mean = float(np.mean(replayed[has_both]))
        factor = multiple_of(logged - logged_mean, replayed - replayed_mean)
        offset = logged_mean - factor * replayed_mean
    if 1.0 / LARGE_FACTOR < factor < LARGE_FACTOR:
        return ""
    addition = f", plus {offset:.4g}" if offset else ""
    remedy = f"a scale of {1.0 / factor:.4g}" + (f" with an offset of {-offset / factor:.4g}" if offset else "")
    return (
        f"is {factor:.4g} times what the analysed controller gives for the logged measurements, at all times"
        f"{addition}: it is in another unit than the study's, {unit}, and {remedy} in the table of columns mends it"
    )


def command_hint(
    logged: np.ndarray, replayed: np.ndarray, sample_time: float, unit: str, has_reference: bool = True
) -> Hint | None:
    """The hint about how a logged command differs from the replayed one; None if it does not, or nothing is certain.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        replayed: The command of the analysed controller, shape (samples,).
        sample_time: Time between two samples [s].
        unit: Unit of the command.
        has_reference: Whether the log has a reference; if not, the replay has used that of the study.
    """
    factor = multiple_of(logged, replayed)
    if factor != 1.0:
        text = (
            f"is {factor:.4g} times what the analysed controller gives for the logged measurements: it is in another "
            "unit, or other gains flew. Estimates of gains and disturbances are off by that factor unless they did"
        )
        return Hint("another-command", text)
    has_both = np.isfinite(logged) & np.isfinite(replayed)
    if np.count_nonzero(has_both) < LEAST_VALUES:
        return None
    deviation = rms(logged - np.median(logged[has_both]))
    largest_residual = EXPLAINED * deviation
    difference = rms(logged - replayed)
    if difference <= COMMAND_ROUNDING * rms(logged):
        return None
    spikes = spike_rows(logged, replayed)
    if spikes:
        times = " and ".join(f"{row * sample_time:.4g} s" for row in spikes[:NAMED_SPIKES])
        if len(spikes) > NAMED_SPIKES:
            times += f" and {len(spikes) - NAMED_SPIKES} more times"
        largest = max(abs(float(logged[row] - replayed[row])) for row in spikes)
        text = (
            f"has single values that the analysed controller does not give, at {times} of the study, up to "
            f"{largest:.4g} {unit} beside it: spikes of the log. A fit takes them for what the vehicle got: leave them "
            "out of the log"
        )
        return Hint("command-spikes", text)
    hold = usual_hold(logged)
    spans = stuck_spans(logged, replayed) if hold == 1 else []
    if spans:
        times = " and ".join(f"from {begin * sample_time:.4g} s to {end * sample_time:.4g} s" for begin, end in spans)
        text = (
            f"repeats one value {times} of the study, where the analysed controller's changes: its topic sticks, the "
            "controller was off, or it has a lower limit. A fit takes it for what the vehicle got; if it is not, "
            "fit the part before or after"
        )
        return Hint("stuck-command", text)
    replaced = replaced_commands(logged, replayed) if hold == 1 else None
    if replaced is not None:
        return replaced_commands_hint(replaced, sample_time, unit)
    lost = lost_commands(logged, replayed) if hold == 1 else []
    if lost:
        return lost_commands_hint(lost, sample_time)
    rounding = command_rounding(logged, replayed)
    if rounding is not None and rounding.is_analysed:
        return rounded_hint(rounding, unit)
    if hold > 1 and rms(logged - held_like(logged, replayed)) <= min(largest_residual, FEWER * difference):
        text = (
            f"is what the analysed controller gives every {hold * sample_time:.3g} s, held between. If only the log is "
            "so slow, the vehicle flew other commands, and a fit takes that for a lag; if the flight was, give "
            "loop.sample_time that value"
        )
        return Hint("held-command", text)
    shift, residual = best_shift(logged, replayed, round(LONGEST_SHIFT / sample_time))
    if shift != 0 and residual <= min(largest_residual, FEWER * difference):
        side = "later" if shift > 0 else "earlier"
        text = (
            f"is {abs(shift) * sample_time:.3g} s {side} than the analysed controller gives it for the logged "
            "measurements: compare the times of its column. A fit takes that for a lag"
        )
        return Hint("shifted-command", text)
    offset = constant_offset(logged, replayed)
    if offset is not None:
        text = (
            f"lies {offset:.4g} {unit} beside what the analysed controller gives all the time: its column has an "
            "offset, or an integral began at another value. A fit takes an offset for a disturbance"
        )
        return Hint("command-offset", text)
    latter_half = slice(len(logged) // 2, None)  # what the first state does has decayed there
    if min(difference, rms((logged - replayed)[latter_half])) > ANOTHER * deviation:
        course = course_hint(logged, replayed, sample_time, deviation)
        if course is not None:
            return course
        reference = "the reference" if has_reference else "the reference (the log has no y_ref: the study's was used)"
        text = (
            f"is not what the analysed controller gives for the logged measurements: they differ by {difference:.4g} "
            f"{unit} rms, and the logged one varies by {deviation:.4g}. {OPEN_CAUSE}: other gains, limits or "
            f"another rate of the controller flew, or a measurement or {reference} is not what the controller got. "
            "Compare these, and units, offsets, times and gaps of y, y' and y_ref"
        )
        return Hint("another-command", text)
    return None if rounding is None else rounded_hint(rounding, unit)


def constant_offset(logged: np.ndarray, replayed: np.ndarray) -> float | None:
    """The constant by which a command differs from the analysed controller's [u]; None if it differs in another way.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        replayed: The command of the analysed controller, shape (samples,).
    """
    beside = logged - replayed
    has_both = np.isfinite(beside)
    if np.count_nonzero(has_both) < LEAST_VALUES:
        return None
    deviation = rms(logged - np.median(logged[has_both]))
    offset = float(np.median(beside[has_both]))
    is_constant = rms(beside - offset) <= min(EXPLAINED * deviation, FEWER * rms(beside))
    return offset if is_constant and abs(offset) > LARGE_OFFSET * deviation else None


def spike_rows(logged: np.ndarray, replayed: np.ndarray) -> list[int]:
    """The samples of a few spikes that make nearly all of the difference to the replay; none if there is another cause.

    Only the logged command has a spike. Where a controller answers a jump, the replayed command has a peak, too.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        replayed: The command of the analysed controller, shape (samples,).
    """
    differences = np.nan_to_num(np.abs(logged - replayed))
    squares = (differences / differences.max()) ** 2
    largest = np.sort(np.argsort(squares)[-MOST_SPIKES:])
    if np.sum(squares) - np.sum(squares[largest]) > EXPLAINED**2 * np.sum(squares):
        return []
    rows = []
    for row in largest[squares[largest] > EXPLAINED**2].tolist():
        if not 0 < row < len(logged) - 1:
            return []
        if not jump_at(logged, row) > MUCH_LARGER * jump_at(replayed, row):
            return []
        rows.append(row)
    return rows


def jump_at(values: np.ndarray, row: int) -> float:
    """How far the value at a row is from the mean of its two neighbours."""
    return abs(float(values[row] - 0.5 * (values[row - 1] + values[row + 1])))


def stuck_spans(logged: np.ndarray, replayed: np.ndarray) -> list[tuple[int, int]]:
    """The first and last samples of spans in which a command sticks; none if there are many, or nothing is certain.

    A command sticks where it repeats one value, the replayed one differs at most of the samples, and both agree outside
    of such spans. A command at its limits does not stick, because the replayed one rests there, too.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        replayed: The command of the analysed controller, shape (samples,).
    """
    difference = np.abs(logged - replayed)
    usual_difference = float(np.median(difference[np.isfinite(difference)]))
    least_difference = max(STUCK * usual_difference, COMMAND_ROUNDING * rms(logged))
    is_outside = np.isfinite(difference)
    spans = []
    for begin, end in zip(*flag_runs(np.diff(logged) == 0.0), strict=True):
        rows = slice(int(begin), int(end) + 1)
        is_long = end + 1 - begin >= LEAST_STUCK
        if is_long and np.mean(difference[rows] > least_difference) > 0.5 and np.ptp(replayed[rows]) > least_difference:
            spans.append((int(begin), int(end)))
            is_outside[rows] = False
    outside = rms(difference[is_outside])
    agrees = all(STUCK * outside < rms(difference[begin : end + 1]) for begin, end in spans)
    return spans if len(spans) <= MOST_SPANS and agrees else []


def held_like(logged: np.ndarray, replayed: np.ndarray) -> np.ndarray:
    """The replayed command, held from each change of the logged one to the next, shape (samples,)."""
    return forward_filled(np.where(np.isfinite(drop_repeats(logged)), replayed, np.nan))


def best_shift(logged: np.ndarray, replayed: np.ndarray, longest: int) -> tuple[int, float]:
    """The delay of the logged command that leaves the least difference, and the root mean square of that difference.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        replayed: The command of the analysed controller, shape (samples,).
        longest: The longest delay that is tried [samples].

    Returns:
        The delay [samples], negative if the logged command is earlier; and the difference [u].
    """
    samples = len(logged)
    best = 0
    smallest = rms(logged - replayed)
    for shift in range(1, min(longest, int(LONGEST_SHARE * samples)) + 1):
        delayed = rms(logged[shift:] - replayed[:-shift])
        advanced = rms(logged[:-shift] - replayed[shift:])
        if min(delayed, advanced) < smallest:
            best = shift if delayed < advanced else -shift
            smallest = min(delayed, advanced)
    return best, smallest
