"""Hints about the signals of a channel, by themselves and by the analysed controller's command for them.

A hint that explains others replaces them. A hint about a wrong column, for example, replaces those about units and
times of the channel's signals.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dssc_jax.core.units import ChannelUnits
from dssc_jax.flight_logs.channel_replay import ChannelReplay, has_enough_outputs
from dssc_jax.flight_logs.hints.command_hints import command_hint, command_unit, rate_hint
from dssc_jax.flight_logs.hints.conversions import followed_conversion, rms
from dssc_jax.flight_logs.hints.filtered_references import study_reference_hint
from dssc_jax.flight_logs.hints.limited_commands import limited_hint
from dssc_jax.flight_logs.hints.log_hints import LogHints
from dssc_jax.flight_logs.hints.measured_rates import mended_rate
from dssc_jax.flight_logs.hints.moved_signals import moved_output, moved_reference
from dssc_jax.flight_logs.hints.other_gains import CLEARLY, other_gain, other_gain_hint
from dssc_jax.flight_logs.hints.output_scales import has_wrong_reference, scaled_output
from dssc_jax.flight_logs.hints.output_steps import is_reference
from dssc_jax.flight_logs.hints.replayed_clocks import replayed_clock
from dssc_jax.flight_logs.hints.replayed_columns import column_hints
from dssc_jax.flight_logs.hints.rounded_outputs import rounded_output_hint
from dssc_jax.flight_logs.hints.slower_controllers import slower_controller
from dssc_jax.flight_logs.reading.reader import FlightLog, signal_name
from dssc_jax.flight_logs.signal_warnings import OPEN_CAUSE, Hint
from dssc_jax.study import Study


@dataclass(frozen=True)
class LoggedChannel:
    """A channel of a log.

    Args:
        index: Position of the channel in the loop.
        name: Name of the channel.
        units: Units of the channel's signals.
        signals: Logged signals by their names without the channel, NaN where missing, shape (samples,) each.
        reference: The study's reference and its derivatives, shape (3, samples).
    """

    index: int
    name: str
    units: ChannelUnits
    signals: Mapping[str, np.ndarray]
    reference: np.ndarray

    def signal(self, label: str) -> str:
        """Name in the log of the channel's signal with a label such as ``y``."""
        return signal_name(self.name, label)


def add_output_hints(hints: LogHints, study: Study, channel: LoggedChannel) -> None:
    """Add the hints that a channel's output gives without its command.

    Args:
        hints: The hints so far.
        study: The study.
        channel: The channel.
    """
    if "y" not in channel.signals:
        return
    output = channel.signals["y"]
    y, y_ref = channel.signal("y"), channel.signal("y_ref")
    followed_text = followed_conversion(output, channel.reference[0], channel.units.output)
    if followed_text and not follows_logged_reference(hints, channel):
        hints.conversions.setdefault(y, Hint("another-unit", followed_text))
    rounded = rounded_output_hint(study, channel.index, output)
    if rounded is not None:
        hints.factors.setdefault(y, rounded)
    if y_ref in hints.others and is_reference(output, channel.reference[0]):
        text = f"looks exchanged with {y_ref}: it is the study's reference"
        hints.conversions[y] = Hint("exchanged-columns", text)
        del hints.others[y_ref]


def follows_logged_reference(hints: LogHints, channel: LoggedChannel) -> bool:
    """Whether the logged reference is in the study's unit, and the output follows no multiple of that reference.

    Args:
        hints: The hints so far.
        channel: The channel, with an output.
    """
    if "y_ref" not in channel.signals or channel.signal("y_ref") in hints.conversions:
        return False
    return not followed_conversion(channel.signals["y"], channel.signals["y_ref"], channel.units.output)


def add_replay_hints(
    hints: LogHints, log: FlightLog, channel: LoggedChannel, replay: ChannelReplay, command: np.ndarray | str
) -> None:
    """Add the hints that the analysed controller's command for a channel's signals gives.

    Args:
        hints: The hints so far.
        log: The log.
        channel: The channel.
        replay: The channel's controller.
        command: The controller's command, shape (samples,), or why there is none.
    """
    if "u_total" not in channel.signals or not has_enough_outputs(channel.signals):
        return
    columns = wrong_columns(replay, channel.signals, command, hints.conversions)
    if columns:
        hints.replace_columns(channel.name, columns)
    elif not isinstance(command, str):
        add_command_hints(hints, log, channel, replay, command)


def wrong_columns(
    replay: ChannelReplay,
    signals: Mapping[str, np.ndarray],
    command: np.ndarray | str,
    conversions: Mapping[str, Hint],
) -> dict[str, Hint]:
    """The hints about a channel's wrong columns, by signal, from its controller's command; empty: none is wrong.

    Args:
        replay: The channel's controller.
        signals: The channel's signals by their names without it, NaN where missing, each of shape (samples,).
        command: The controller's command for these signals, shape (samples,), or why there is none.
        conversions: Hints from the signals alone; if one is about the same columns, it is kept.
    """
    hints = column_hints(replay, signals, command)
    for name, hint in hints.items():
        columns = hint.text.partition(":")[0]
        if name in conversions and conversions[name].text.startswith(columns):
            hints[name] = conversions[name]
    return hints


def add_command_hints(
    hints: LogHints, log: FlightLog, channel: LoggedChannel, replay: ChannelReplay, command: np.ndarray
) -> None:
    """Add the hint about a logged command that is not the analysed controller's.

    After a cause is found, the controller's command with that cause mended serves to find the next cause.

    Args:
        hints: The hints so far.
        log: The log.
        channel: The channel, with a logged command.
        replay: The channel's controller.
        command: The controller's command, shape (samples,).
    """
    signals = channel.signals
    logged = signals["u_total"]
    name, y, y_ref = (channel.signal(label) for label in ("u_total", "y", "y_ref"))
    slower = slower_controller(replay, signals, command)
    if slower is not None:
        hints.factors[name] = slower
        return
    unit_text = command_unit(logged, command, channel.units.of("u"))
    if unit_text:
        hints.conversions.setdefault(name, Hint("another-unit", unit_text))
        return
    rate = None if y in hints.conversions else mended_rate(replay, signals, command)
    if rate is not None:
        hints.factors[channel.signal("y_dot")] = rate.hint
        if y in hints.factors and hints.factors[y].code in ("integral-factor", "integral-drift"):
            del hints.factors[y]
        command = rate.command
    hint = rate_hint(log.columns[name], replay.sample_time)
    limited = None if hint is not None else limited_hint(replay, signals, command, channel.units.of("u"))
    if limited is not None:
        hints.factors[name] = limited
        return
    has_wrong_output = y in hints.conversions
    scaled = None if has_wrong_output else scaled_output(replay, signals, command)
    gain = None
    if scaled is not None:
        gain = other_gain(replay, signals, command, CLEARLY * rms(logged - scaled.command))
    if gain is not None:
        hint = other_gain_hint(gain, channel.units.of("u"))
    elif scaled is not None:
        hints.factors[y] = scaled.hint
        command = scaled.command
    elif not has_wrong_output:
        is_reference_told = y_ref in hints.shifts or y_ref in hints.others
        reference = None if is_reference_told else moved_reference(replay, signals, command)
        output = moved_output(replay, signals, command) if reference is None else None
        if reference is not None:
            hints.shifts[y_ref] = reference.hint
            command = reference.command
        elif output is not None:
            hints.factors[y] = output.hint
            command = output.command
    has_study_reference = not has_wrong_output and has_wrong_reference(replay, signals, command)
    is_told = any(y_ref in found for found in (hints.shifts, hints.others, hints.conversions))
    if has_study_reference and "y_ref" in signals and not is_told:
        reference_hint = study_reference_hint(replay, signals, command)
        if reference_hint is not None:
            hints.others[y_ref] = reference_hint
    if hint is None and not has_wrong_output and not has_study_reference:
        hint = command_hint(logged, command, replay.sample_time, channel.units.of("u"), "y_ref" in signals)
        if hint is not None and OPEN_CAUSE in hint.text:
            gain = other_gain(replay, signals, command)
            hint = hint if gain is None else other_gain_hint(gain, channel.units.of("u"))
            clock = None if gain is not None else replayed_clock(replay, signals, command)
            if clock is not None:
                hints.shifts[y_ref] = clock
                hint = None
    slope = hints.slopes.get(channel.signal("y_ref_dot"))
    is_explained = slope is not None and slope.code == "wrong-scale"
    if hint is not None and not (is_explained and hint.code == "another-command"):
        hints.factors[name] = hint
