"""Commands that a log lacks for a few samples, while the analysed controller's command goes on.

In such spans the log repeats the last command, or has one value, such as 0, in place of all commands.
"""

from typing import NamedTuple

import numpy as np

from dssc_jax.core.flag_runs import flag_runs
from dssc_jax.flight_logs.hints.conversions import COMMAND_ROUNDING, rms
from dssc_jax.flight_logs.signal_warnings import Hint

LEAST_REPEATS = 2  # samples of a span: one repeated value may be that of rounding
LONGEST = 25  # samples that repeat a command in one span: more are a controller that rests
MOST_REPEATED = 0.3  # share of the samples in such spans: with more, the controller itself is slow
BESIDE = 10.0  # factor on the difference elsewhere: a larger one beside repeated values is that of a lost command
NAMED = 3  # spans that a message names
LEAST_REPLACED = 3  # spans of one value in place of others: fewer are a command that rests
ONE_VALUE = 0.9  # least share of the differing samples that have that value


class LostCommands(NamedTuple):
    """A span of samples that repeat the command before them.

    Args:
        begin: Index of the first sample in the span.
        end: Index of the last sample in the span.
        difference: Largest difference from the analysed controller's command in the span [u].
    """

    begin: int
    end: int
    difference: float


def lost_commands(logged: np.ndarray, replayed: np.ndarray) -> list[LostCommands]:
    """Find the spans in which a log lacks commands; none if a slow controller or limits may explain the repeats.

    Both commands have to agree outside of the spans.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        replayed: The command of the analysed controller, shape (samples,).
    """
    difference = np.abs(logged - replayed)
    is_outside = np.isfinite(difference)
    if not is_outside.any():
        return []
    usual_difference = float(np.median(difference[is_outside]))
    least_difference = max(BESIDE * usual_difference, COMMAND_ROUNDING * rms(logged))
    limits = (np.nanmin(logged), np.nanmax(logged))
    spans = []
    for begin, end in zip(*flag_runs(np.diff(logged, prepend=np.nan) == 0.0), strict=True):
        rows = slice(int(begin), int(end))
        largest = float(np.max(difference[rows]))
        is_short = LEAST_REPEATS <= end - begin <= LONGEST
        if is_short and largest > least_difference and logged[begin] not in limits:
            spans.append(LostCommands(int(begin), int(end) - 1, largest))
            is_outside[rows] = False
    in_spans = np.isfinite(difference) & ~is_outside
    is_few = np.count_nonzero(in_spans) <= MOST_REPEATED * len(logged)
    agrees = BESIDE * rms(difference[is_outside]) < rms(difference[in_spans])
    return spans if spans and is_few and agrees else []


def lost_commands_hint(spans: list[LostCommands], sample_time: float) -> Hint:
    """The hint that a log lacks commands, with the times of the spans that differ most, and the remedy.

    Args:
        spans: The spans in which the log lacks commands.
        sample_time: Time between two samples [s].
    """
    largest = sorted(spans, key=lambda span: -span.difference)[:NAMED]
    times = []
    for span in sorted(largest):
        times.append(f"from {span.begin * sample_time:.4g} s to {span.end * sample_time:.4g} s")
    further = f" and at {len(spans) - NAMED} more times" if len(spans) > NAMED else ""
    text = (
        f"repeats its last value {', '.join(times)}{further} of the study, where the analysed controller's command "
        "goes on: the log lacks commands there, and a fit takes the repeated ones for what the vehicle got. Log every "
        "command, or fit a part without such a span"
    )
    return Hint("command-dropouts", text)


class ReplacedCommands(NamedTuple):
    """Samples at which a log has one value in place of the commands.

    Args:
        value: The value [u].
        begins: Index of the first sample of each span, shape (spans,).
        samples: Number of such samples in all spans.
    """

    value: float
    begins: np.ndarray
    samples: int


def replaced_commands(logged: np.ndarray, replayed: np.ndarray) -> ReplacedCommands | None:
    """Find one value in place of the commands at a few samples; None where a limit or a dead zone may explain it.

    Both commands have to agree elsewhere. A limit gives one value to all commands beyond it, and a dead zone to all
    small commands. So most of the commands that are as near to the value have to be in the log.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        replayed: The command of the analysed controller, shape (samples,).
    """
    difference = np.abs(logged - replayed)
    is_compared = np.isfinite(difference)
    if not is_compared.any():
        return None
    usual_difference = float(np.median(difference[is_compared]))
    is_different = difference > max(BESIDE * usual_difference, COMMAND_ROUNDING * rms(logged))
    if not is_different.any():
        return None
    values, counts = np.unique(logged[is_different], return_counts=True)
    value = float(values[np.argmax(counts)])
    is_replaced = is_different & (logged == value)
    begins, ends = flag_runs(is_replaced)
    count = int(np.count_nonzero(is_replaced))
    if len(begins) < LEAST_REPLACED or np.max(ends - begins) > LONGEST:
        return None
    if count < ONE_VALUE * np.count_nonzero(is_different):
        return None
    is_near = np.abs(replayed - value) <= difference[is_replaced].max()
    for is_side in (replayed > value, replayed < value):
        if np.count_nonzero(is_replaced & is_side) > MOST_REPEATED * np.count_nonzero(is_near & is_side):
            return None
    agrees = BESIDE * rms(difference[is_compared & ~is_replaced]) < rms(difference[is_replaced])
    return ReplacedCommands(value, begins, count) if agrees else None


def replaced_commands_hint(replaced: ReplacedCommands, sample_time: float, unit: str) -> Hint:
    """The hint that a log has one value in place of commands, with the first times, and the remedy.

    Args:
        replaced: The value, and the samples that have it.
        sample_time: Time between two samples [s].
        unit: Unit of the command.
    """
    times = [f"{begin * sample_time:.4g} s" for begin in replaced.begins[:NAMED]]
    further = f" and {len(replaced.begins) - NAMED} more times" if len(replaced.begins) > NAMED else ""
    text = (
        f"is {replaced.value:.4g} {unit} at {replaced.samples} samples (at {', '.join(times)}{further} of the study), "
        "where the analysed controller's command is not, and agrees elsewhere: the log has that value in place of "
        "commands, or the controller was off. A fit takes it for what the vehicle got; if it is not, leave these cells "
        "empty"
    )
    return Hint("command-dropouts", text)
