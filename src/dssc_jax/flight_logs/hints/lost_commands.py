"""Commands that a log lacks for a few samples, and repeats the last one, where the analysed controller's changes."""

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


class LostCommands(NamedTuple):
    """Samples that repeat the command before them.

    Args:
        begin: The first of them.
        end: The last one.
        difference: Largest difference from the analysed controller's command.
    """

    begin: int
    end: int
    difference: float


def lost_commands(logged: np.ndarray, replayed: np.ndarray) -> list[LostCommands]:
    """Find the spans in which a log lacks commands; none where a slow controller or limits may explain them.

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
    """That a log lacks commands, with the times of those that differ most, and the remedy.

    Args:
        spans: The spans in which it does.
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
