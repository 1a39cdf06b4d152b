"""The curves of a study's draws, and a logged flight laid over them."""

import warnings
from typing import NamedTuple

import numpy as np
import xarray as xr

from dssc_jax.core.signals import ProgressCallback
from dssc_jax.flight_logs.hints.conversions import likeness_text
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.replay import curves_of_draws, signal_unit
from dssc_jax.flight_logs.signal_warnings import Hint
from dssc_jax.statistics.exchangeable import extremeness, largest_departures
from dssc_jax.study import Study

DRAWN_LEVELS = {"low": 0.05, "median": 0.5, "high": 0.95}
DIMENSIONS = ("signal", "t")
LARGE_SHARE = 0.1  # share of the largest median: where the median is larger, another unit shows
MOSTLY = 0.5  # share of these samples that is beyond all draws in another unit


class Signal(NamedTuple):
    """A compared signal: the position of its channel, its field of :class:`ChannelCurves`, and its name in the log."""

    channel: int
    quantity: str
    name: str


def drawn_curves(
    study: Study, signals: list[Signal], samples: int, stride: int, progress: ProgressCallback | None
) -> np.ndarray:
    """Simulate the signals of every draw, shape (draws, signals, times).

    Args:
        study: The study.
        signals: The signals.
        samples: Number of samples of each simulation.
        stride: Samples from one time of the curves to the next.
        progress: Called with the number of draws done, and that of all draws.
    """
    draws = study.config.draws
    curves = np.empty((draws, len(signals), -(-samples // stride)))
    for draw, channels in enumerate(curves_of_draws(study, samples, stride)):
        for row, signal in enumerate(signals):
            curves[draw, row] = getattr(channels[signal.channel], signal.quantity)
        if progress is not None:
            progress(draw + 1, draws)
    return curves


def compared_dataset(
    study: Study, signals: list[Signal], stride: int, tested: np.ndarray, replayed: np.ndarray, curves: np.ndarray
) -> xr.Dataset:
    """The dataset of a comparison.

    Args:
        study: The study.
        signals: The compared signals.
        stride: Samples from one compared time to the next.
        tested: The logged signals, NaN where missing, shape (signals, times).
        replayed: The commands of the analysed controller, NaN for other signals, shape (signals, times).
        curves: The signals of the draws, shape (draws, signals, times).
    """
    columns = {
        "logged": (tested, "logged value"),
        "commanded": (replayed, "command of the analysed controller"),
    }
    for name, values in pointwise_quantiles(curves).items():
        columns[name] = (values, f"{name} value of the draws")
    dimensions = DIMENSIONS
    data = {}
    for name, (values, meaning) in columns.items():
        data[name] = (dimensions, values, {"long_name": meaning, "units": "that of the signal"})
    largest, departure = largest_departures(curves, tested)
    meaning = "departure of the log from the draws' median, by their spread"
    data["departure"] = (dimensions, departure, {"long_name": meaning, "units": "1"})
    meaning = "largest departure of each draw, and of the log as the last curve"
    data["largest_departure"] = (("curve", "signal"), largest, {"long_name": meaning, "units": "1"})
    meaning = "order of the curves by how few others depart as far in one signal; the log is the last one"
    data["statistic"] = (("curve",), extremeness(largest), {"long_name": meaning, "units": "1"})
    times = study.loop.sample_time * (stride * np.arange(tested.shape[1]))
    coords = {
        "signal": ("signal", [signal.name for signal in signals], {"long_name": "signal"}),
        "t": ("t", times, {"long_name": "time", "units": "s"}),
    }
    return xr.Dataset(data, coords=coords, attrs={"title": study.name})


def pointwise_quantiles(curves: np.ndarray) -> dict[str, np.ndarray]:
    """Range and quantiles, at each time, of the draws that have not ended, by name, shape (signals, times) each.

    Args:
        curves: The signals of the draws, not finite once a draw has ended, shape (draws, signals, times).
    """
    finite = np.where(np.isfinite(curves), curves, np.nan)
    levels = {"lowest": 0.0, **DRAWN_LEVELS, "highest": 1.0}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "All-NaN slice")  # all draws have ended: nothing is shown
        values = np.nanquantile(finite, list(levels.values()), axis=0)
    return dict(zip(levels, values, strict=True))


def output_hints(study: Study, dataset: xr.Dataset) -> dict[str, Hint]:
    """Hints about logged outputs that look like the draws' median in another unit, sign or channel, by signal.

    An output gets a hint only if it is beyond all draws at most of the times at which the draws' median is large.

    Args:
        study: The study.
        dataset: The dataset of the comparison, by :func:`compared_dataset`.
    """
    logged = {str(name) for name in dataset["signal"].values}
    names = [signal_name(channel, "y") for channel in study.loop.channels]
    names = [name for name in names if name in logged]
    expected = [dataset["median"].sel(signal=name).values for name in names]
    hints = {}
    for index, name in enumerate(names):
        signal = dataset.sel(signal=name)
        values = signal["logged"].values
        text = likeness_text(index, values, expected, names, signal_unit(study, name))
        size = np.abs(expected[index])
        is_large = np.isfinite(values) & (size > LARGE_SHARE * np.nanmax(size))
        is_outside = (values < signal["lowest"].values) | (values > signal["highest"].values)
        if text and np.count_nonzero(is_outside & is_large) > MOSTLY * np.count_nonzero(is_large):
            hints[name] = Hint("output-likeness", text)
    return hints
