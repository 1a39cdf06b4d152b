"""Flights with another value of one number of the analysed controller, and the factor by which that value differs.

Each number of the controller is tried alone. With the value that flew, the controller gives the logged command for the
logged measurements exactly. So only a small difference may be left: another number that acts alike leaves more.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.channel_replay import ChannelReplay
from dssc_jax.flight_logs.hints.command_courses import bounded_minimum
from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.flight_logs.hints.references import median_values
from dssc_jax.flight_logs.signal_warnings import Hint
from dssc_jax.study import Study

LARGEST_FACTOR = 4.0  # largest factor of a number that is tried, and inverse of the least
COARSE = 17  # factors that are tried first
LEFT = 0.03  # share of what the command varies that may be left
FEWER = 0.2  # share of the difference of the commands that may be left
LEAST_DIFFERENCE = 0.02  # least difference of the factor from 1 that is reported
CLEARLY = 0.5  # share of what the next best number leaves: less, and it is that number


class OtherGain(NamedTuple):
    """A number of the controller that flew with another value.

    Args:
        name: Name of the number.
        value: Value of the number in the study.
        factor: The value that flew over that of the study.
        left: Root mean square of the difference of the commands that is left with the value that flew [u].
    """

    name: str
    value: float
    factor: float
    left: float


def numbers_of_controller(study: Study, index: int) -> dict[str, float]:
    """The numbers of a channel's controller that differ from 0 and may have any value, by name.

    Args:
        study: The study.
        index: Position of the channel.
    """
    medians = median_values(study)
    found = {}
    for name, number in study.numbers.items():
        is_controllers = any(path.startswith(f"controller.{index}.") for path in number.paths)
        value = medians.get(name, number.value)
        is_free = number.expression is None and number.quantity.law and not number.quantity.whole
        if is_controllers and is_free and isinstance(value, float | int) and value != 0.0:
            found[name] = float(value)
    return found


def other_gain(
    replay: ChannelReplay, logged: Mapping[str, np.ndarray], command: np.ndarray, most: float = math.inf
) -> OtherGain | None:
    """The number whose other value makes the controller give the logged command; None if none or several do.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, with u_total, each of shape (samples,).
        command: The controller's command with the study's numbers, shape (samples,).
        most: Largest root mean square of the difference of the commands that may be left [u].
    """
    numbers = numbers_of_controller(replay.study, replay.index)
    found = [best_factor(replay, logged, numbers, name) for name in numbers]
    found.sort(key=lambda gain: gain.left)
    if not found:
        return None
    flown = logged["u_total"]
    most = min(most, LEFT * rms(flown - np.nanmedian(flown)), FEWER * rms(flown - command))
    best = found[0]
    is_clear = len(found) == 1 or best.left < CLEARLY * found[1].left
    return best if is_clear and best.left <= most and abs(best.factor - 1.0) >= LEAST_DIFFERENCE else None


def best_factor(
    replay: ChannelReplay, logged: Mapping[str, np.ndarray], numbers: Mapping[str, float], name: str
) -> OtherGain:
    """The factor of one number with which the commands agree best.

    Args:
        replay: The channel's controller.
        logged: The channel's signals with u_total.
        numbers: Values of all numbers of the controller: with all of them as inputs, the replay is compiled once.
        name: The number that gets a factor.
    """

    def left(logarithm: float) -> float:
        """The root mean square of the difference of the commands for a factor."""
        command = replay.command(logged, {**numbers, name: numbers[name] * math.exp(logarithm)})
        return math.inf if isinstance(command, str) else rms(logged["u_total"] - command)

    widest = math.log(LARGEST_FACTOR)
    logarithm, least = bounded_minimum(left, np.linspace(-widest, widest, COARSE))
    return OtherGain(name, numbers[name], math.exp(logarithm), least)


def other_gain_hint(gain: OtherGain, unit: str) -> Hint:
    """The hint about a command that another value of one number gives.

    Args:
        gain: The number.
        unit: Unit of the command.
    """
    text = (
        f"is what the analysed controller gives for the logged measurements with {gain.factor:.4g} times its "
        f"{gain.name}, {gain.factor * gain.value:.4g} in place of {gain.value:.4g}, to {gain.left:.3g} {unit} rms: "
        "that flew, or what acts alike. Give the study that value"
    )
    return Hint("another-command", text)
