"""Outputs that are logged too large or too small, found by replaying the analysed controller.

The controller answers the error y_ref - y. If the logged y is not the one that it got, its command for the log differs
from the logged command. This module seeks the factor of y with which both commands agree.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.channel_replay import ChannelReplay, is_close
from dssc_jax.flight_logs.hints.command_courses import bounded_minimum
from dssc_jax.flight_logs.hints.conversions import COMMAND_ROUNDING, rms
from dssc_jax.flight_logs.reading.reader import forward_filled, signal_name
from dssc_jax.flight_logs.signal_warnings import Hint

LARGEST = 1e100  # difference of two commands: squares of larger ones overflow
WINDOW = 0.5  # s over which differences are averaged, longer than the memory of noise of y in a derivative
LEAST_WINDOWS = 16
LEAST_DIFFERENCE = 0.01  # least difference of the factor from 1 that is reported
DEVIATIONS = 6.0  # least distance of the factor from 1, in its standard deviations
EXPLAINED = 0.3  # largest share of the averaged difference that another reference leaves
CLEARLY = 0.5  # share of what another cause leaves: less, and the factor is the better explanation
BATCHES = 8  # parts of the difference, whose sums tell the factor's deviation
FITTED = 2  # numbers of the regression: the factor and a constant
STEP = 1e-4  # relative change of a number for a derivative by it


class ScaleSearch(NamedTuple):
    """A search for the factor of an output.

    Args:
        largest: The largest factor, and the inverse of the least.
        points: Factors that are tried first.
        explained: Largest share of the averaged difference that the factor may leave.
    """

    largest: float
    points: int
    explained: float


SMALL_FACTORS = ScaleSearch(largest=1.4, points=9, explained=0.3)
LARGE_FACTORS = ScaleSearch(largest=2000.0, points=61, explained=0.1)


class Scale(NamedTuple):
    """The factor of a logged output, with its standard deviation, and what it explains.

    Args:
        factor: The logged output over the one that the controller got.
        deviation: Standard deviation of the factor.
        share: Share of the averaged difference of the commands that the factor leaves.
        differences: Root mean squares of the difference of the commands without and with the factor [u].
    """

    factor: float
    deviation: float
    share: float
    differences: tuple[float, float]


class AveragedDifference:
    """The difference of the logged command from that of the analysed controller, averaged over windows.

    The mean is subtracted, because an integral that began at another value adds a constant.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, each of shape (samples,).
    """

    def __init__(self, replay: ChannelReplay, logged: Mapping[str, np.ndarray]) -> None:
        self.replay = replay
        self.logged = logged
        samples = len(logged["u_total"])
        self.width = max(1, min(round(WINDOW / replay.study.loop.sample_time), samples // LEAST_WINDOWS))

    def command(self, factor: float, offset: float = 0.0) -> np.ndarray:
        """The controller's command for (y - offset) / factor, shape (samples,); NaN if it gives none.

        Args:
            factor: Factor of the logged output.
            offset: Offset of the logged output, in its unit.
        """
        command = self.replay.command({**self.logged, "y": (self.logged["y"] - offset) / factor})
        return np.full(len(self.logged["u_total"]), np.nan) if isinstance(command, str) else command

    def averaged(self, values: np.ndarray) -> np.ndarray:
        """Means of values over the windows with a logged command, less the mean of these means, shape (windows,)."""
        difference = np.where(np.isfinite(self.logged["u_total"]), values, np.nan)
        parts = difference[: len(difference) // self.width * self.width].reshape(-1, self.width)
        means = parts[np.isfinite(parts).any(axis=1)]
        if not means.size:
            return np.zeros(0)
        averages = np.nanmean(means, axis=1)
        return averages - averages.mean()

    def at(self, factor: float, offset: float = 0.0) -> np.ndarray:
        """The averaged difference for (y - offset) / factor, shape (windows,)."""
        return self.averaged(self.logged["u_total"] - self.command(factor, offset))


class ScaledOutput(NamedTuple):
    """The hint about an output with a wrong scale, and the controller's command for the right output."""

    hint: Hint
    command: np.ndarray


def scaled_output(replay: ChannelReplay, logged: Mapping[str, np.ndarray], command: np.ndarray) -> ScaledOutput | None:
    """Find out whether an output is logged too large or too small; None if nothing is certain.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, with y and u_total, each of shape (samples,).
        command: The controller's command for these signals, shape (samples,).
    """
    difference = rms(logged["u_total"] - command)
    if not COMMAND_ROUNDING * rms(logged["u_total"]) < difference < LARGEST or not has_study_reference(replay, logged):
        return None
    averaged = AveragedDifference(replay, logged)
    scale = fitted_scale(averaged, SMALL_FACTORS) or fitted_scale(averaged, LARGE_FACTORS)
    if scale is None:
        return None
    channel = replay.study.loop.channels[replay.index]
    u = signal_name(channel, "u_total")
    unit = replay.study.units[replay.index].of("u")
    size = "large" if scale.factor > 1.0 else "small"
    text = (
        f"is {scale.factor:.4g} ± {scale.deviation:.1g} times what the controller got, too {size}: with a scale of "
        f"{1.0 / scale.factor:.4g} for its column the analysed controller gives the logged {u} to "
        f"{scale.differences[1]:.3g} {unit} rms, without it to {scale.differences[0]:.3g}. A fit takes the factor for "
        "one of the gain"
    )
    return ScaledOutput(Hint("wrong-scale", text), averaged.command(scale.factor))


def has_wrong_reference(replay: ChannelReplay, logged: Mapping[str, np.ndarray], command: np.ndarray) -> bool:
    """Whether the controller gives the logged command far better for the study's reference than for the logged one.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, with u_total, each of shape (samples,).
        command: The controller's command for these signals, shape (samples,).
    """
    if has_study_reference(replay, logged):
        return False
    others = {name: values for name, values in logged.items() if not name.startswith("y_ref")}
    by_study = replay.command(others)
    if isinstance(by_study, str):
        return False
    return rms(logged["u_total"] - by_study) < EXPLAINED * rms(logged["u_total"] - command)


def has_study_reference(replay: ChannelReplay, logged: Mapping[str, np.ndarray]) -> bool:
    """Whether the reference is the study's, and not 0 throughout. Another reference may be wrong instead of the output.

    A log without a reference counts as one with that of the study.

    Args:
        replay: The channel's controller.
        logged: The channel's signals, NaN where missing, each of shape (samples,).
    """
    reference = replay.reference[0]
    if not np.any(reference):
        return False
    column = logged.get("y_ref")
    return column is None or not np.isfinite(column).any() or is_close(forward_filled(column), reference)


def fitted_scale(averaged: AveragedDifference, search: ScaleSearch) -> Scale | None:
    """The factor of the output with which both commands agree best; None if it is not certain, or near 1.

    Args:
        averaged: The difference of the commands.
        search: The factors to try.
    """
    before = averaged.at(1.0)
    if len(before) < LEAST_WINDOWS or not rms(before) > 0.0:
        return None

    def cost(logarithm: float) -> float:
        """The root mean square of the averaged difference for a factor."""
        return rms(averaged.at(float(np.exp(logarithm))))

    widest = float(np.log(search.largest))
    logarithm, _ = bounded_minimum(cost, np.linspace(-widest, widest, search.points))
    factor = float(np.exp(logarithm))
    after = averaged.at(factor)
    share = rms(after) / rms(before)
    if not share < search.explained or abs(logarithm) > 0.95 * widest or abs(factor - 1.0) < LEAST_DIFFERENCE:
        return None
    slope = (averaged.at(factor * (1.0 + STEP)) - after) / (STEP * factor)
    size = float(slope @ slope)
    sums = np.array([part.sum() for part in np.array_split(after * slope, BATCHES)])
    deviation = float(np.sqrt(sums @ sums * BATCHES / (BATCHES - FITTED))) / size
    if abs(factor - 1.0) < DEVIATIONS * deviation or not rms(after) < CLEARLY * least_by_others(averaged, before):
        return None
    logged = averaged.logged["u_total"]
    differences = (rms(logged - averaged.command(1.0)), rms(logged - averaged.command(factor)))
    return Scale(factor, deviation, share, differences)


def least_by_others(averaged: AveragedDifference, before: np.ndarray) -> float:
    """The root mean square of the averaged difference that other causes leave: an offset of y, or a factor of u.

    Args:
        averaged: The difference of the commands.
        before: The averaged difference without a correction, shape (windows,).
    """
    size = rms(averaged.logged["y"])
    by_offset = averaged.averaged(averaged.command(1.0, STEP * size) - averaged.command(1.0)) / (STEP * size)
    by_factor = averaged.averaged(averaged.command(1.0))
    return min(remaining(before, by_offset), remaining(before, by_factor))


def remaining(values: np.ndarray, regressor: np.ndarray) -> float:
    """The root mean square of values that a multiple of a regressor leaves; both of shape (windows,).

    Args:
        values: The values, shape (windows,).
        regressor: The regressor, shape (windows,).
    """
    square = float(regressor @ regressor)
    return rms(values - (float(values @ regressor) / square if square > 0.0 else 0.0) * regressor)
