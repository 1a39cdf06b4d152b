"""A wrong scale or offset of y', found by comparison with y, and confirmed by the analysed controller's command."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.channel_replay import ChannelReplay
from dssc_jax.flight_logs.hints.conversions import FEWER, rms
from dssc_jax.flight_logs.hints.replayed_columns import DESCRIBED
from dssc_jax.flight_logs.reading.reader import forward_filled, signal_name
from dssc_jax.flight_logs.signal_warnings import Hint

LEAST_SCALE = 0.01  # least difference of a scale from 1 that is reported
LEAST_OFFSET = 0.02  # least offset that is reported, as a share of the rate's root mean square


class MendedRate(NamedTuple):
    """The hint about a wrong scale or offset of y', and the controller's command for the right y', shape (samples,)."""

    hint: Hint
    command: np.ndarray


def mended_rate(replay: ChannelReplay, logged: Mapping[str, np.ndarray], command: np.ndarray) -> MendedRate | None:
    """The scale or offset by which y' differs from what the controller got; None if neither explains the command.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, with u_total, each of shape (samples,).
        command: The controller's command for these signals, shape (samples,).
    """
    if not all(name in logged and np.isfinite(logged[name]).any() for name in ("y", "y_dot")):
        return None
    u_total = logged["u_total"]
    difference = rms(u_total - command)
    tolerance = min(DESCRIBED * rms(u_total - np.nanmedian(u_total)), FEWER * difference)
    rate = forward_filled(logged["y_dot"])
    sample_time = replay.study.loop.sample_time
    scale, offset = rate_correction(forward_filled(logged["y"]), rate, sample_time)
    corrections = []
    if abs(scale - 1.0) > LEAST_SCALE:
        corrections.append((scale, 0.0))
    if abs(offset) > LEAST_OFFSET * rms(rate):
        corrections.append((1.0, offset))
    if len(corrections) == 2:
        corrections.append((scale, offset))
    channel = replay.study.loop.channels[replay.index]
    units = replay.study.units[replay.index]
    for factor, constant in corrections:
        mended = replay.command({**logged, "y_dot": factor * rate + constant})
        if isinstance(mended, str) or rms(u_total - mended) > tolerance:
            continue
        text = (
            f"is not what the controller got, nor the slope of {signal_name(channel, 'y')}: with "
            f"{correction_text(factor, constant, units.of('y/s'))} for its column the analysed controller gives the "
            f"logged {signal_name(channel, 'u_total')} to {rms(u_total - mended):.3g} {units.of('u')} rms, without to "
            f"{difference:.3g}. Fits of logged commands do not use it"
        )
        return MendedRate(Hint("wrong-scale", text), mended)
    return None


def correction_text(scale: float, offset: float, unit: str) -> str:
    """A scale and an offset of a column, in words; a scale of 1 and an offset of 0 are left out.

    Args:
        scale: The scale.
        offset: The offset, in the unit.
        unit: Unit of the column.
    """
    texts = []
    if scale != 1.0:
        texts.append(f"a scale of {scale:.4g}")
    if offset != 0.0:
        texts.append(f"an offset of {offset:.3g} {unit}")
    return " and ".join(texts)


def rate_correction(y: np.ndarray, rate: np.ndarray, sample_time: float) -> tuple[float, float]:
    """The scale and the offset of a rate with which its integral is nearest to an output, by least squares.

    Args:
        y: The output, shape (samples,).
        rate: The rate, shape (samples,).
        sample_time: Time between two samples [s].
    """
    time = sample_time * np.arange(len(y))
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])) * sample_time])
    columns = np.column_stack([integral, time, np.ones(len(y))])
    scale, offset, _ = np.linalg.lstsq(columns, y, rcond=None)[0]
    return float(scale), float(offset)
