"""A logged command at limits that the analysed controller does not have.

Such a command repeats its extreme values. There are two cases. If the controller's integral went on at the limit, as
before an actuator with limits, the logged command is the analysed controller's, clipped. If the flown controller had
limits of its own, which hold back the integral, the logged command is that of the analysed controller with such limits.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.channel_replay import ChannelReplay
from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.flight_logs.reading.held_outputs import usual_hold
from dssc_jax.flight_logs.signal_warnings import Hint
from dssc_jax.models.actuators.saturation import SATURATION
from dssc_jax.study import Study
from dssc_jax.study.actuators import acting_elements

LEAST_AT_LIMIT = 5  # commands with an extreme value that is a limit
LEFT = 0.03  # share of what the command varies that may be left
FEWER = 0.2  # share of the difference of the commands that may be left


class Limits(NamedTuple):
    """Limits of a command [u]; None: there is none on this side."""

    low: float | None
    high: float | None

    def text(self, unit: str) -> str:
        """The limits in words."""
        if self.low is None or self.high is None:
            return f"at most {self.high:.4g} {unit}" if self.low is None else f"at least {self.low:.4g} {unit}"
        return f"from {self.low:.4g} to {self.high:.4g} {unit}"


def repeated_limits(logged: np.ndarray, replayed: np.ndarray) -> Limits:
    """The extreme values that a logged command repeats while the analysed controller's command is beyond them.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        replayed: The command of the analysed controller, shape (samples,).
    """
    required = LEAST_AT_LIMIT * usual_hold(logged)
    low, high = float(np.nanmin(logged)), float(np.nanmax(logged))
    is_low = np.count_nonzero((logged == low) & (replayed < low)) >= required
    is_high = np.count_nonzero((logged == high) & (replayed > high)) >= required
    return Limits(low if is_low else None, high if is_high else None)


def limited_command(replay: ChannelReplay, logged: Mapping[str, np.ndarray], limits: Limits) -> np.ndarray | None:
    """The command that the analysed controller would give with these limits; None if it has no fields for limits.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, each of shape (samples,).
        limits: The limits.
    """
    channel = replay.study.loop.channels[replay.index]
    table = f"controller.{channel}" if channel else "controller"
    fields = {f"{table}.{side}": value for side, value in limits._asdict().items() if value is not None}
    try:
        limited = replay.study.override(fields)
    except ConfigError:
        return None
    command = ChannelReplay(limited, replay.index, replay.reference, replay.sample_time).command(logged)
    return None if isinstance(command, str) else command


def has_saturation(study: Study) -> bool:
    """Whether the study limits the command itself, behind its controllers."""
    return any(element.model is SATURATION for element, _ in acting_elements(study.table, study.config))


def limited_hint(
    replay: ChannelReplay, logged: Mapping[str, np.ndarray], command: np.ndarray, unit: str
) -> Hint | None:
    """The hint that a logged command is the analysed controller's within limits that the study's controller lacks.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, with u_total, each of shape (samples,).
        command: The controller's command for these signals, shape (samples,).
        unit: Unit of the command.

    Returns:
        None if that is not certain.
    """
    flown = logged["u_total"]
    limits = repeated_limits(flown, command)
    if limits == Limits(None, None) or has_saturation(replay.study):
        return None
    largest_difference = min(LEFT * rms(flown - np.nanmedian(flown)), FEWER * rms(flown - command))
    clipped_difference = rms(flown - np.clip(command, limits.low, limits.high))
    limited = limited_command(replay, logged, limits)
    limited_difference = np.inf if limited is None else rms(flown - limited)
    if not min(clipped_difference, limited_difference) <= largest_difference:
        return None
    if limited_difference < clipped_difference:
        fields = ", ".join(f"{side} = {value:.4g}" for side, value in limits._asdict().items() if value is not None)
        remedy = f"Give the controller {fields}"
    else:
        remedy = (
            "Its integral goes on at a limit, as behind an actuator with one: if the vehicle got this command, a fit "
            "takes the right one, and the study needs that limit for what it predicts ([unmodelled] "
            'kind = "saturation"). '
            "If only the log has the limit, leave its column out, and a fit takes the analysed controller's"
        )
    text = (
        f"is {limits.text(unit)}, and within these limits it is what the analysed controller gives, to "
        f"{min(clipped_difference, limited_difference):.2g} {unit} rms; the study's has no such limits. {remedy}"
    )
    return Hint("limited-command", text)
