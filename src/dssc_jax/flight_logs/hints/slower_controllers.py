"""Controllers that computed only at every N-th sample of the study, and held their command in between.

The samples at which the logged command changes give N. Replayed at these samples alone, the analysed controller gives
the logged command. It integrates and differentiates either with the time between these samples, or with the sample time
of the study, if it believed its clock to be faster than it was.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.channel_replay import ChannelReplay
from dssc_jax.flight_logs.hints.conversions import COMMAND_ROUNDING, FEWER
from dssc_jax.flight_logs.hints.replayed_columns import DESCRIBED, command_share
from dssc_jax.flight_logs.reading.reader import forward_filled
from dssc_jax.flight_logs.signal_warnings import Hint

MOST_SAMPLES = 50  # from one command to the next
LEAST_CHANGES = 20  # of a command: fewer tell no rate
REGULAR = 0.98  # least share of the changes that lie at every N-th sample
STATED = 0.5  # least share of every N-th samples at which the command changes


class CommandClock(NamedTuple):
    """The samples at which a controller gives commands.

    Args:
        stride: Number N of samples from one command to the next.
        first: The first sample with a command.
    """

    stride: int
    first: int


def command_clock(logged: np.ndarray) -> CommandClock | None:
    """The samples at which a logged command changes; None if they are not every N-th sample for an N above 1.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
    """
    rows = np.flatnonzero(np.isfinite(logged))
    changes = rows[1:][np.diff(logged[rows]) != 0.0]
    if len(changes) < LEAST_CHANGES:
        return None
    for stride in range(min(MOST_SAMPLES, len(logged) // LEAST_CHANGES), 1, -1):
        counts = np.bincount(changes % stride, minlength=stride)
        first = int(np.argmax(counts))
        is_stated = counts[first] >= STATED * len(range(first, len(logged), stride))
        if counts[first] >= REGULAR * len(changes) and is_stated:
            return CommandClock(stride, first)
    return None


def slower_command(
    replay: ChannelReplay, logged: Mapping[str, np.ndarray], clock: CommandClock, sample_time: float
) -> np.ndarray | None:
    """The command of the analysed controller if it computes only at every N-th sample; None if it gives none.

    Between these samples, the command is held.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, each of shape (samples,).
        clock: The samples at which the controller computes.
        sample_time: The time between two computations that it believes, for integrals and derivatives [s].
    """
    rows = slice(clock.first, None, clock.stride)
    slower = ChannelReplay(replay.study, replay.index, replay.reference[:, rows], sample_time)
    signals = {}
    for name, values in logged.items():
        if name != "u_total" and np.isfinite(values).any():
            signals[name] = forward_filled(values)[rows]
    command = slower.command(signals)
    if isinstance(command, str):
        return None
    held = np.full(len(logged["u_total"]), np.nan)
    held[rows] = command
    return forward_filled(held)


def slower_controller(replay: ChannelReplay, logged: Mapping[str, np.ndarray], command: np.ndarray) -> Hint | None:
    """The hint that the flight's controller computed at every N-th sample only; None if that is not certain.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, with u_total, each of shape (samples,).
        command: The command of the analysed controller that computes at every sample, shape (samples,).
    """
    u = logged["u_total"]
    share = command_share(u, command)
    clock = command_clock(u) if COMMAND_ROUNDING < share < np.inf else None
    if clock is None:
        return None
    sampled = np.full(len(u), np.nan)
    sampled[clock.first :: clock.stride] = command[clock.first :: clock.stride]
    held_share = command_share(u, forward_filled(sampled))
    believed_time = replay.study.loop.sample_time
    time = clock.stride * believed_time
    shares = {}
    for integrated_time in (time, believed_time):
        slower = slower_command(replay, logged, clock, integrated_time)
        shares[integrated_time] = np.inf if slower is None else command_share(u, slower)
    best = min(shares, key=lambda integrated_time: shares[integrated_time])
    if not shares[best] < min(DESCRIBED, FEWER * share, FEWER * held_share):
        return None
    if best == time:
        remedy = f"set loop.sample_time = {time:.4g}"
    else:
        remedy = (
            f"and it integrates and differentiates as if these were {believed_time:.4g} s: give it the time between "
            f"two samples, or set loop.sample_time = {time:.4g} with gains that give the same command"
        )
    text = (
        f"is that of a controller that computes at every {ordinal(clock.stride)} sample of the study only, each "
        f"{time:.4g} s, and holds its command between: replayed so, the analysed controller gives it to "
        f"{100.0 * shares[best]:.2g} % of what it varies, and computed at every sample to {100.0 * share:.2g} %; "
        f"{remedy}"
    )
    return Hint("slower-controller", text)


def ordinal(number: int) -> str:
    """A number as an ordinal.

    Example:
        >>> ordinal(2), ordinal(5), ordinal(12), ordinal(23)
        ('2nd', '5th', '12th', '23rd')
    """
    endings = {1: "st", 2: "nd", 3: "rd"}
    is_teen = 10 < number % 100 < 20
    return f"{number}{'th' if is_teen else endings.get(number % 10, 'th')}"
