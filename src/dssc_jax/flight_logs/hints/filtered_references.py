"""A logged reference that the controller did not get: it got the study's, and the log has it filtered or held."""

from collections.abc import Mapping

import numpy as np

from dssc_jax.flight_logs.channel_replay import ChannelReplay
from dssc_jax.flight_logs.hints.command_courses import best_lag
from dssc_jax.flight_logs.hints.conversions import FEWER, SAME_REFERENCE, rms
from dssc_jax.flight_logs.hints.replayed_columns import DESCRIBED, command_share
from dssc_jax.flight_logs.reading.held_outputs import drop_repeats, usual_hold
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import Hint


def study_reference_text(replay: ChannelReplay, logged: Mapping[str, np.ndarray], command: np.ndarray) -> str:
    """The evidence that the controller got the study's reference and not the logged one, in words; empty if none.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, with u_total, each of shape (samples,).
        command: The controller's command for the logged signals, shape (samples,).
    """
    by_study = replay.command({name: values for name, values in logged.items() if not name.startswith("y_ref")})
    if isinstance(by_study, str):
        return ""
    share = command_share(logged["u_total"], command)
    share_by_study = command_share(logged["u_total"], by_study)
    if not share_by_study < min(DESCRIBED, FEWER * share):
        return ""
    u = signal_name(replay.study.loop.channels[replay.index], "u_total")
    return (
        f"with the study's reference the analysed controller gives the logged {u} to {100 * share_by_study:.2g} % of "
        f"what it varies, and with the logged one to {100 * share:.2g} %"
    )


def study_reference_hint(replay: ChannelReplay, logged: Mapping[str, np.ndarray], command: np.ndarray) -> Hint | None:
    """The hint about a reference that the controller did not get, with the reason if one is known; None without one.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, with u_total and y_ref, each of shape (samples,).
        command: The controller's command for the logged signals, shape (samples,).
    """
    text = study_reference_text(replay, logged, command)
    if not text:
        return None
    reason = filtered_text(logged["y_ref"], replay.reference[0], replay.study.loop.sample_time)
    reason = reason or "it is another topic's, such as a filtered or a rarer one"
    message = (
        f"is not what the controller got, which is the study's: {text}. In the log {reason}. Log the reference that "
        "the controller gets; a fit of logged commands uses none"
    )
    return Hint("another-reference", message)


def filtered_text(logged: np.ndarray, reference: np.ndarray, sample_time: float) -> str:
    """How a logged reference follows from the study's: held, or behind a lag; empty if it is neither.

    Args:
        logged: The logged reference, NaN where missing, shape (samples,).
        reference: The study's reference, shape (samples,).
        sample_time: Time between two samples [s].
    """
    tolerance = SAME_REFERENCE * rms(reference - np.mean(reference))
    hold = usual_hold(logged)
    if hold > 1 and rms(drop_repeats(logged) - reference) <= tolerance:
        return f"it is held for {hold * sample_time:.3g} s at a time"
    start = logged[np.isfinite(logged)][0] - reference[0]
    lag, left = best_lag(logged - start, reference)
    return f"it is behind a first-order lag of {lag * sample_time:.3g} s" if left <= tolerance else ""
