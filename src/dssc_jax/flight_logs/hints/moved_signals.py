"""A reference, or an output, that reached the flown controller at another time than logged.

With the logged reference, or that of the study if the log has none, the analysed controller gives another command than
the logged one. This module seeks the time by which that reference, or the measured output, has to be moved so that both
commands agree.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.channel_replay import ChannelReplay, is_close
from dssc_jax.flight_logs.hints.command_hints import best_shift
from dssc_jax.flight_logs.hints.conversions import FEWER, rms
from dssc_jax.flight_logs.hints.replayed_columns import DESCRIBED, command_share
from dssc_jax.flight_logs.reading.reader import forward_filled, signal_name
from dssc_jax.flight_logs.signal_warnings import Hint

LONGEST_SHIFT = 1.0  # s
LONGEST_SHARE = 0.1  # of the log
COARSE_SHIFTS = 40  # to either side that are tried first
REFERENCE = ("y_ref", "y_ref_dot", "y_ref_ddot")
MEASUREMENT = ("y", "y_dot")


class MovedSignal(NamedTuple):
    """The hint about a signal at another time, and the controller's command for the moved signal, shape (samples,).

    The command is NaN where the moved signal is not known.
    """

    hint: Hint
    command: np.ndarray


class Move(NamedTuple):
    """A move of signals with which the controller gives the logged command.

    Args:
        seconds: How much later the moved signals come [s]; negative: earlier.
        before: Share by :func:`command_share` without the move.
        after: Share by :func:`command_share` with the move.
        command: The controller's command for the moved signals, NaN where they are not known, shape (samples,).
    """

    seconds: float
    before: float
    after: float
    command: np.ndarray


def moved(values: np.ndarray, shift: int) -> np.ndarray:
    """Values moved to later samples, or to earlier ones for a negative shift; an end value fills the gap.

    Args:
        values: The values, shape (samples,).
        shift: How many samples later they come; negative: earlier.
    """
    rows = np.clip(np.arange(len(values)) - shift, 0, len(values) - 1)
    return values[rows]


def replayed_reference(replay: ChannelReplay, logged: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The reference and its derivatives that a replay uses, as far as they are known, each of shape (samples,).

    Logged signals count first. If the log has no y_ref, or that of the study, the study's signals fill the others.
    """
    signals = {name: forward_filled(logged[name]) for name in REFERENCE if has_values(logged, name)}
    if "y_ref" not in signals or is_close(signals["y_ref"], replay.reference[0]):
        signals = {**dict(zip(REFERENCE, replay.reference, strict=True)), **signals}
    return signals


def has_values(logged: Mapping[str, np.ndarray], name: str) -> bool:
    """Whether a log has at least one value of a signal.

    Args:
        logged: The channel's signals by name, NaN where missing.
        name: Name of the signal.
    """
    return name in logged and bool(np.isfinite(logged[name]).any())


def command_for(
    replay: ChannelReplay, logged: Mapping[str, np.ndarray], signals: Mapping[str, np.ndarray], shift: int
) -> np.ndarray:
    """The controller's command for signals moved to later samples, or to earlier ones, shape (samples,).

    The command is NaN where the moved signals are not known, and everywhere if the controller gives none.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, each of shape (samples,).
        signals: The signals to move, each of shape (samples,).
        shift: How many samples later they come; negative: earlier.
    """
    command = replay.command({**logged, **{name: moved(values, shift) for name, values in signals.items()}})
    if isinstance(command, str):
        return np.full(len(logged["u_total"]), np.nan)
    known = command.copy()
    known[len(known) + min(shift, 0) :] = np.nan
    return known


def moved_reference(replay: ChannelReplay, logged: Mapping[str, np.ndarray], command: np.ndarray) -> MovedSignal | None:
    """Find out whether the controller got its reference at another time; None if nothing is certain.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, with y and u_total, each of shape (samples,).
        command: The controller's command for these signals, shape (samples,).
    """
    reference = replayed_reference(replay, logged)
    if not np.ptp(reference["y_ref"]) > 0.0:
        return None
    move = best_move(replay, logged, reference, command)
    return (
        None if move is None else MovedSignal(Hint("shifted-reference", moved_text(replay, logged, move)), move.command)
    )


def moved_output(replay: ChannelReplay, logged: Mapping[str, np.ndarray], command: np.ndarray) -> MovedSignal | None:
    """Find out whether the controller got the measured output at another time; None if nothing is certain.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, with y and u_total, each of shape (samples,).
        command: The controller's command for these signals, shape (samples,).
    """
    measurement = {name: forward_filled(logged[name]) for name in MEASUREMENT if has_values(logged, name)}
    move = best_move(replay, logged, measurement, command)
    if move is None:
        return None
    text = (
        f"is not what the controller got at that time: {reason_of(replay, move)}. If it is late, log the time of the "
        "measurement, not that of its arrival (`timestamp_sample` of PX4), and compare clocks"
    )
    return MovedSignal(Hint("shifted-output", text), move.command)


def best_move(
    replay: ChannelReplay, logged: Mapping[str, np.ndarray], signals: Mapping[str, np.ndarray], command: np.ndarray
) -> Move | None:
    """Find the move of signals for which the controller gives the logged command; None if nothing is certain.

    The move has to explain more than a move of the command alone does.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, with y and u_total, each of shape (samples,).
        signals: The signals to move, without gaps, each of shape (samples,).
        command: The controller's command for the log, shape (samples,).
    """
    u = logged["u_total"]
    share = command_share(u, command)
    if not DESCRIBED < share < np.inf:
        return None
    sample_time = replay.study.loop.sample_time
    longest = int(min(LONGEST_SHIFT / sample_time, LONGEST_SHARE * len(u)))
    shares = {0: share}

    def try_shifts(middle: int, step: int, count: int) -> int:
        """Try shifts at a step on either side of a middle one, and return the best of all shifts so far."""
        for shift in range(middle - count * step, middle + count * step + 1, step):
            if shift not in shares and abs(shift) <= longest:
                shares[shift] = command_share(u, command_for(replay, logged, signals, shift))
        return min(shares, key=lambda shift: shares[shift])

    step = max(1, -(-longest // COARSE_SHIFTS))
    best = try_shifts(0, step, COARSE_SHIFTS)
    while step > 1:
        step = -(-step // 2)
        best = try_shifts(best, step, 1)
    deviation = rms(u - np.median(u[np.isfinite(u)]))
    command_shift_share = best_shift(u, command, longest)[1] / deviation
    if best == 0 or not shares[best] < min(DESCRIBED, FEWER * share, FEWER * command_shift_share):
        return None
    return Move(best * sample_time, share, shares[best], command_for(replay, logged, signals, best))


def reason_of(replay: ChannelReplay, move: Move) -> str:
    """The evidence for a move, in words: how well the controller gives the logged command with and without the move.

    Args:
        replay: The channel's controller.
        move: The move.
    """
    channel = replay.study.loop.channels[replay.index]
    side = "later" if move.seconds > 0.0 else "earlier"
    return (
        f"with one {abs(move.seconds):.3g} s {side} the analysed controller gives the logged "
        f"{signal_name(channel, 'u_total')} to {100.0 * move.after:.2g} % of what it varies, and without that to "
        f"{100.0 * move.before:.2g} %"
    )


def moved_text(replay: ChannelReplay, logged: Mapping[str, np.ndarray], move: Move) -> str:
    """The words that the controller got its reference at another time, with the remedy.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, each of shape (samples,).
        move: The move of the reference.
    """
    reason = reason_of(replay, move)
    if has_values(logged, "y_ref"):
        return (
            f"is not what the controller got: {reason}. Compare the times of its column, or give the study that "
            f"{'delay' if move.seconds > 0.0 else 'lead'}; a fit of logged commands does not use it"
        )
    return (
        f"is not in the log, and the study's was used: {reason}. Log the reference, or give the study the one that "
        "flew; a fit of logged commands does not use it"
    )
