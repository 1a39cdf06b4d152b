"""A wrong clock of a log without a reference: the flown controller answered the study's reference at other times.

Measurements and commands of a log agree with each other even if its clock runs too fast or too slow. The study's
reference does not agree with them. If the log lacks the reference, the analysed controller shows the clock: with the
study's reference at the times of that clock it gives the logged command.
"""

from collections.abc import Mapping

import numpy as np

from dssc_jax.flight_logs.channel_replay import ChannelReplay
from dssc_jax.flight_logs.hints.command_courses import LARGEST_RATE, LEAST_SHIFT, bounded_minimum
from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.flight_logs.hints.references import references_at
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import Hint

EXPLAINED = 0.1  # share of what the command varies that may be left
FEWER = 0.2  # share of the difference of the commands that may be left
LEAST_STRETCH = 0.003  # least difference of a stretch of the times from 1 that is reported
POINTS = 81  # stretches that are tried first


def replayed_clock(replay: ChannelReplay, logged: Mapping[str, np.ndarray], command: np.ndarray) -> Hint | None:
    """The hint about a log without a reference whose clock is not the study's; None if nothing is certain.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, with y and u_total, each of shape (samples,).
        command: The controller's command for the study's reference, shape (samples,).
    """
    if any(name.startswith("y_ref") for name in logged) or not np.ptp(replay.reference[0]) > 0.0:
        return None
    u = logged["u_total"]

    def left(stretch: float) -> float:
        """The root mean square of the difference of the commands."""
        found = replay.command({**logged, **stretched_reference(replay, len(u), stretch)})
        return np.inf if isinstance(found, str) else rms(u - found)

    stretch, least = bounded_minimum(left, np.linspace(1.0 - LARGEST_RATE, 1.0 + LARGEST_RATE, POINTS))
    before = rms(u - command)
    varies = rms(u - np.nanmedian(u))
    is_told = abs(stretch - 1.0) >= max(LEAST_STRETCH, LEAST_SHIFT / len(u))
    if not is_told or least > min(EXPLAINED * varies, FEWER * before):
        return None
    kind = "fast" if stretch > 1.0 else "slow"
    name = signal_name(replay.study.loop.channels[replay.index], "u_total")
    text = (
        f"is not in the log, and with the study's at times x {stretch:.4g} the analysed controller gives the logged "
        f"{name} to {100.0 * least / varies:.2g} % of what it varies, and without that to "
        f"{100.0 * before / varies:.2g} %: the log's clock is {max(stretch, 1.0 / stretch):.4g} times too {kind}, or "
        "the flight had another reference. Compare the log's times with those of another clock, and log the reference"
    )
    return Hint("clock-rate", text)


def stretched_reference(replay: ChannelReplay, samples: int, stretch: float) -> dict[str, np.ndarray]:
    """The study's reference and its derivatives in a log whose times are stretched, each of shape (samples,).

    Args:
        replay: The channel's controller.
        samples: Number of samples.
        stretch: Times of the log over those of the study.
    """
    times = replay.study.loop.sample_time * np.arange(samples) / stretch
    values = references_at(replay.study, times)[replay.index]
    names = ("y_ref", "y_ref_dot", "y_ref_ddot")
    return {name: row / stretch**order for order, (name, row) in enumerate(zip(names, values, strict=True))}
