"""Columns that seem to be wrong, because the analysed controller gives the logged command with other columns only.

Each hypothesis is the same log with exchanged columns, or with the output in place of an error. A hint names it if the
controller then gives the logged command, and does not with the given columns.
"""

import itertools
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.channel_replay import ChannelReplay
from dssc_jax.flight_logs.hints.conversions import FEWER, rms
from dssc_jax.flight_logs.hints.integrals import (
    DEVIATIONS,
    INTEGRAL,
    SAME_CHANGE,
    integral_factor,
    likeness_to_integral,
)
from dssc_jax.flight_logs.reading.reader import Column, forward_filled, signal_name
from dssc_jax.flight_logs.signal_warnings import Hint

DESCRIBED = 0.1  # largest difference of the commands with the right columns, as a share of the command's deviation
ERROR = "seems to hold the error"
SIGNS = ("u_total", "y")
CLEARLY = 0.1  # share of what a sign leaves: less, and other columns are the better explanation
EXCHANGED = ("y", "y_dot", "y_ref", "u_total")
EXCHANGED_RATES = (("y_dot", "y_ref_dot"), ("y_ref", "y_ref_dot"))
LEAST_VALUES = 20


class OtherColumns(NamedTuple):
    """A channel's log in which signals come from other columns.

    Args:
        signal: A signal whose column is wrong, without the channel.
        text: What is wrong with that signal, in words that follow its name.
        signals: All signals of the channel by the hypothesis, each of shape (samples,).
    """

    signal: str
    text: str
    signals: Mapping[str, np.ndarray]


def column_hints(replay: ChannelReplay, logged: Mapping[str, np.ndarray], command: np.ndarray | str) -> dict[str, Hint]:
    """The hint about a channel's wrong columns, by signal; empty if no others explain the command far better.

    Args:
        replay: The channel's controller.
        logged: The channel's signals by their names without it, NaN where missing, each of shape (samples,).
        command: The controller's command for the columns that were given, shape (samples,), or why there is none.
    """
    largest_share = DESCRIBED
    largest_difference = np.inf
    if not isinstance(command, str):
        present_share = command_share(logged["u_total"], command)
        if present_share <= DESCRIBED:
            return {}
        largest_share = min(DESCRIBED, FEWER * present_share)
        largest_difference = FEWER * command_difference(logged["u_total"], command)
    channel = replay.study.loop.channels[replay.index]
    sign, sign_share = best_columns(replay, opposite_signs(replay, logged), largest_share, largest_difference)
    if sign is not None:
        largest_share = CLEARLY * sign_share
    exchanges = (*errors_as_outputs(replay, logged), *exchanged_columns(replay, logged))
    best, least_share = best_columns(replay, exchanges, largest_share, largest_difference)
    if best is None:
        best, least_share = sign, sign_share
    if best is None:
        return {}
    if best.text.startswith(ERROR):
        as_reference = replay.command({**best.signals, "y": reference_of(replay, logged)})
        reference_share = np.inf if isinstance(as_reference, str) else command_share(logged["u_total"], as_reference)
        if least_share > FEWER * reference_share:
            return {signal_name(channel, "y"): another_output(replay, logged, best, least_share, reference_share)}
    u = signal_name(channel, "u_total")
    reason = f"with that, the analysed controller gives the logged {u} to {100 * least_share:.2g} % of what it varies"
    code = "another-unit" if best is sign else "exchanged-columns"
    return {signal_name(channel, best.signal): Hint(code, f"{best.text}: {reason}")}


def best_columns(
    replay: ChannelReplay, candidates: Iterable[OtherColumns], largest_share: float, largest_difference: float
) -> tuple[OtherColumns | None, float]:
    """The columns with which the controller best gives the logged command, and the share by :func:`command_share`.

    The share alone does not decide. With u = y_ref - y, for example, an exchange of output and command leaves the
    difference of the commands as it is. The share falls if the new command varies more, but that proves nothing.

    Args:
        replay: The channel's controller.
        candidates: The columns to try.
        largest_share: Share below which columns count.
        largest_difference: Difference of the commands by :func:`command_difference` below which columns count.

    Returns:
        None in place of the columns, and ``largest_share``, if no columns count.
    """
    best = None
    least_share = largest_share
    for candidate in candidates:
        command = replay.command(candidate.signals)
        if isinstance(command, str):
            continue
        share = command_share(candidate.signals["u_total"], command)
        difference = command_difference(candidate.signals["u_total"], command)
        if share < least_share and difference < largest_difference:
            least_share = share
            best = candidate
    return best, least_share


def opposite_signs(replay: ChannelReplay, logged: Mapping[str, np.ndarray]) -> Iterator[OtherColumns]:
    """The hypotheses that a command, an output, or an output and its derivative have the opposite sign."""
    channel = replay.study.loop.channels[replay.index]
    for name in SIGNS:
        if name in logged:
            text = "has the opposite sign"
            if name == "u_total" and not np.any(reference_of(replay, logged)):
                text += f", or {signal_name(channel, 'y')} has"  # a controller of y alone does not tell which
            yield OtherColumns(name, text, {**logged, name: -logged[name]})
    if "y" in logged and "y_dot" in logged:
        text = f"has the opposite sign, as has {signal_name(channel, 'y_dot')}"
        yield OtherColumns("y", text, {**logged, "y": -logged["y"], "y_dot": -logged["y_dot"]})


def reference_of(replay: ChannelReplay, logged: Mapping[str, np.ndarray]) -> np.ndarray:
    """The logged reference, or that of the study if the log has none, shape (samples,).

    Args:
        replay: The channel's controller.
        logged: The channel's signals by name, NaN where missing.
    """
    return logged.get("y_ref", replay.reference[0])


def another_output(
    replay: ChannelReplay,
    logged: Mapping[str, np.ndarray],
    as_error: OtherColumns,
    error_share: float,
    reference_share: float,
) -> Hint:
    """The hint that an output is not what the controller got, if its reference in its place gives the command as well.

    The column of the output may hold the error, or any small signal, such as the output of another channel.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, each of shape (samples,).
        as_error: The hypothesis that the column holds the error.
        error_share: The share by :func:`command_share` with that hypothesis.
        reference_share: The share by :func:`command_share` with the reference in place of the output.
    """
    channel = replay.study.loop.channels[replay.index]
    u = signal_name(channel, "u_total")
    text = "is not what the controller got"
    if "y_dot" in logged and not moves_by_rate(logged, replay.study.loop.sample_time):
        text = f"does not change as {signal_name(channel, 'y_dot')} tells"
    error = as_error.text.removeprefix(f"{ERROR} ")
    text += (
        f": it is another channel's, or holds the error {error}. With that error the analysed controller gives the "
        f"logged {u} to {100 * error_share:.2g} % of what it varies, and with an output that is its reference, too, "
        f"to {100 * reference_share:.2g} %"
    )
    return Hint("exchanged-columns", text)


def moves_by_rate(logged: Mapping[str, np.ndarray], sample_time: float) -> bool:
    """Whether a logged output resembles the integral of its derivative, and their factor may be 1.

    Args:
        logged: The channel's signals, NaN where missing, with y and y_dot, each of shape (samples,).
        sample_time: Time between two samples [s].
    """
    time = sample_time * np.arange(len(logged["y"]))
    y, y_dot = (Column(time, forward_filled(logged[name])) for name in ("y", "y_dot"))
    factor = integral_factor(y, y_dot, 0.0, float(time[-1]))
    is_other = factor is not None and abs(factor.value - 1.0) > max(SAME_CHANGE, DEVIATIONS * factor.deviation)
    return not is_other and likeness_to_integral(y, y_dot) > INTEGRAL


def command_difference(logged: np.ndarray, command: np.ndarray) -> float:
    """Root mean square of the difference of two commands less its median; infinite with too few values.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        command: The command of the analysed controller, shape (samples,).
    """
    difference = logged - command
    is_finite = np.isfinite(difference)
    if np.count_nonzero(is_finite) < LEAST_VALUES:
        return np.inf
    return rms(difference - np.median(difference[is_finite]))


def command_share(logged: np.ndarray, command: np.ndarray) -> float:
    """The difference by :func:`command_difference` over the root mean square deviation of the logged command.

    The share is infinite with too few values, or if the logged command rests.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        command: The command of the analysed controller, shape (samples,).
    """
    is_finite = np.isfinite(logged - command)
    if not is_finite.any():
        return np.inf
    deviation = rms(logged - np.median(logged[is_finite]))
    if not 0.0 < deviation < np.inf:
        return np.inf
    return command_difference(logged, command) / deviation


def errors_as_outputs(replay: ChannelReplay, logged: Mapping[str, np.ndarray]) -> Iterator[OtherColumns]:
    """The hypotheses that the column of y holds the error, of either sign, from the logged or the study's reference."""
    if "y" not in logged:
        return
    channel = replay.study.loop.channels[replay.index]
    y = signal_name(channel, "y")
    y_ref = signal_name(channel, "y_ref")
    reference = reference_of(replay, logged)
    if len(np.unique(reference[np.isfinite(reference)])) < 2:
        return  # without a reference that moves, the error is y with an offset
    for error, output in ((f"{y_ref} - {y}", reference - logged["y"]), (f"{y} - {y_ref}", reference + logged["y"])):
        yield OtherColumns("y", f"{ERROR} {error}", {**logged, "y": output})


def exchanged_columns(replay: ChannelReplay, logged: Mapping[str, np.ndarray]) -> Iterator[OtherColumns]:
    """The hypotheses that two signals of a channel have each other's column."""
    channel = replay.study.loop.channels[replay.index]
    for first, second in (*itertools.combinations(EXCHANGED, 2), *EXCHANGED_RATES):
        if first not in logged or second not in logged:
            continue
        signals = {**logged, first: logged[second], second: logged[first]}
        yield OtherColumns(first, f"looks exchanged with {signal_name(channel, second)}", signals)
