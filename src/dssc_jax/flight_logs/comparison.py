"""A logged flight compared with the analysed set: replayed through the controller, and laid over the study's draws.

The test is one of exchangeable curves (:mod:`dssc_jax.statistics.exchangeable`): its statistic is fixed in advance, the
rank of the largest standardised departure in each logged signal, and its p-value is exact for any time series.
"""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from matplotlib.figure import Figure

from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.flight_logs.compared_curves import (
    DIMENSIONS,
    DRAWN_LEVELS,
    Signal,
    compared_dataset,
    drawn_curves,
    output_hints,
)
from dssc_jax.flight_logs.figure import log_comparison
from dssc_jax.flight_logs.reading.coverage import require_samples
from dssc_jax.flight_logs.reading.reader import FlightLog, signal_name
from dssc_jax.flight_logs.replay import (
    ChannelCurves,
    LogReplay,
    ReplayedCommand,
    replay_log,
    replayed_command,
    signal_unit,
)
from dssc_jax.flight_logs.signal_warnings import SignalWarning, causes_first, signal_warnings
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.fields import MERGED
from dssc_jax.statistics.exchangeable import departure_ranks, rank_p_value
from dssc_jax.study import Study

MOST_NUMBERS = 40_000_000  # numbers in the curves of all draws, kept in memory
NO_SPREAD = (
    "no law of the study spreads what is compared, so every draw is the same; ranks say nothing. Give uncertain "
    "numbers, disturbances or sensors their laws"
)
RANGE_ROUNDING = 1e-9  # share of a signal's size: closer to the range of the draws, a value is within it


@dataclass(frozen=True)
class SignalAnswer:
    """The position of a logged signal in the draws."""

    unit: Annotated[str, Quantity("", "unit of the signal")]
    samples: Annotated[int, Quantity("1", "logged samples that are compared")]
    largest_departure: Annotated[float | None, Quantity("1", "largest standardised departure from the draws")]
    outside_share: Annotated[
        float | None, Quantity("1", "share of samples outside the range of the draws; None: they are all the same")
    ]
    first_outside: Annotated[float | None, Quantity("s", "first time outside")]
    outside_to_the_end_since: Annotated[float | None, Quantity("s", "time since which it stays outside")]
    replay: ReplayedCommand | None = field(metadata={MERGED: True})


@dataclass(frozen=True)
class LogAnswer:
    """The place of a logged flight among the draws of a study."""

    log: Annotated[str, Quantity("", "name of the log")]
    cut: Annotated[bool, Quantity("", "whether its file ends within a message, before the study does")]
    start: Annotated[float, Quantity("s", "time of the log at which the study begins")]
    draws: Annotated[int, Quantity("1", "number of draws")]
    samples: Annotated[int, Quantity("1", "compared samples")]
    study_samples: Annotated[int, Quantity("1", "samples that would be compared if the log covered the whole study")]
    logged_samples: Annotated[int, Quantity("1", "compared samples at which the log has a value")]
    every: Annotated[int, Quantity("1", "samples from one compared sample to the following one")]
    p_value: Annotated[float | None, Quantity("1", "p-value for the flight as one more draw")]
    least_p_value: Annotated[float, Quantity("1", "smallest p-value that this number of draws allows")]
    draws_at_least_as_extreme: Annotated[int | None, Quantity("1", "draws that depart at least as far")]
    statistic: Annotated[float | None, Quantity("1", "the log's largest standardised departure in the decisive signal")]
    statistic_of_draws: Annotated[dict[str, float] | None, Quantity("1", "quantiles of the draws' largest departures")]
    without_spread: Annotated[
        dict[str, float], Quantity("that of the signal", "largest distance from signals that are the same in all draws")
    ]
    decisive_signal: Annotated[str | None, Quantity("", "signal in which the fewest draws depart as far")]
    decisive_time: Annotated[float | None, Quantity("s", "time of the largest departure in it")]
    signals: dict[str, SignalAnswer]
    replayed_samples: Annotated[int, Quantity("1", "samples of the replay")]
    dropped_rows: Annotated[dict[str, int], Quantity("1", "rows that are left out, because their times fall")]
    held_samples: Annotated[
        dict[str, int],
        Quantity("1", "samples of the replay at which the log lacks the signal, and its last value counts"),
    ]
    not_replayed: Annotated[dict[str, str], Quantity("", "why a channel was not replayed")]
    reference_differences: Annotated[
        dict[str, float], Quantity("that of the output", "largest difference of the logged reference from the study's")
    ]
    reference_rate_differences: Annotated[
        dict[str, float],
        Quantity(
            "that of the output's derivative",
            "largest difference of the logged reference's rate from the study's",
        ),
    ]
    warned: Annotated[bool, Quantity("", "whether there is any warning")]
    warnings: tuple[SignalWarning, ...]


@dataclass(eq=False)
class LogComparison(Analysis):
    """A logged flight beside a study's draws.

    The dataset has along ``signal`` and ``t``: ``logged``, ``commanded`` (the analysed controller's command for the
    logged measurements; for commands only), ``lowest``, ``low``, ``median``, ``high`` and ``highest`` of the draws (low
    and high are quantiles of 5 and 95 %), ``departure`` of the log; and along ``curve``, which has all draws and the
    log at the end, the ``statistic`` and, along ``signal`` too, the ``largest_departure``.

    Args:
        log: Name of the log.
        start: Time of the log at which the study begins [s].
        every: Samples from one compared sample to the following one.
        replayed: Samples of the replay.
        held: Samples of the replay at which the log lacks a signal, and its last value counts; by signal.
        not_replayed: Why a channel's log was not replayed, by channel.
        references: Largest difference between the logged and the study's reference, by channel; empty if not logged.
        rates: Largest difference between their derivatives, by channel; empty if not logged.
        warnings: Signals that are the study's in another unit, sign or column or at another time, rates that are not
            the slope of its reference, and numbers at which the study starts while the flight cannot have.
        steps: Samples of the study.
        cut: Whether the log ends before the study, because its file ends within a message.
        dropped: Rows that are left out because their times fall, by signal.
    """

    kind = "compare-log"
    title = "A logged flight beside the draws"
    table = DIMENSIONS

    log: str
    start: float
    every: int
    replayed: int
    held: dict[str, int]
    not_replayed: dict[str, str]
    references: dict[str, float]
    rates: dict[str, float]
    warnings: tuple[SignalWarning, ...]
    steps: int
    cut: bool
    dropped: dict[str, int]

    @property
    def logged_samples(self) -> int:
        """Number of compared samples at which the log has a value."""
        return int(np.count_nonzero(np.isfinite(self.dataset["logged"].values).any(axis=0)))

    @property
    def p_value(self) -> float | None:
        """Probability of a statistic at least as large as the log's, if the flight were another draw.

        None if no logged signal differs between the draws, so that a rank among them means nothing.
        """
        statistics = self.dataset["statistic"].values
        return None if np.isnan(statistics[-1]) else rank_p_value(statistics)

    def without_spread(self) -> dict[str, float]:
        """The log's largest distance from each signal that is the same in all draws, by signal."""
        largest_distances = {}
        for name in self.dataset["signal"].values:
            signal = self.dataset.sel(signal=name)
            logged = signal["logged"].values
            is_finite = np.isfinite(logged)
            if is_finite.any() and np.isnan(signal["departure"].values[is_finite]).all():
                distance = np.abs(logged - signal["median"].values)[is_finite]
                largest_distances[str(name)] = float(np.max(distance[np.isfinite(distance)], initial=0.0))
        return largest_distances

    def decisive(self) -> tuple[str, float] | None:
        """The signal in which the fewest draws depart as far as the log, and the time [s] of the log's departure.

        If several signals have the fewest such draws, the one with the largest departure counts. None without a
        p-value.
        """
        if self.p_value is None:
            return None
        with_spread = self.dataset.isel(signal=np.isfinite(self.dataset["largest_departure"].values[0]))
        ranks = departure_ranks(with_spread["largest_departure"].values)[-1]
        departure = np.nan_to_num(with_spread["departure"].values, nan=-1.0)
        candidates = np.flatnonzero(ranks == ranks.min())
        signal = candidates[np.argmax(departure[candidates].max(axis=1))]
        time = self.dataset["t"].values[np.argmax(departure[signal])]
        return str(with_spread["signal"].values[signal]), float(time)

    def decisive_departures(self) -> np.ndarray | None:
        """Largest departures of all curves in the decisive signal, the log's last, shape (n + 1,); None without one."""
        decisive = self.decisive()
        return None if decisive is None else self.dataset["largest_departure"].sel(signal=decisive[0]).values

    @property
    def headline(self) -> str:
        """The answer in one line."""
        decisive = self.decisive()
        if decisive is None:
            return NO_SPREAD
        signal, time = decisive
        largest = float(self.dataset["largest_departure"].sel(signal=signal).values[-1])
        return (
            f"p = {self.p_value:.3g} for the flight as one more draw, by the {self.logged_samples} samples it has; "
            f"most in {signal}, by {largest:.3g} spreads at {time:.4g} s"
        )

    def figure(self) -> Figure:
        """Plot the answer."""
        return log_comparison(self)

    @property
    def answer(self) -> LogAnswer:
        """The numbers that summary.json holds."""
        statistics = self.dataset["statistic"].values
        draw_statistics = statistics[:-1]
        draws = len(draw_statistics)
        has_rank = self.p_value is not None
        signal, time = self.decisive() or (None, None)
        departures = self.decisive_departures()
        quantiles = None
        if departures is not None and np.isfinite(departures[:-1]).all():
            quantiles = {name: float(np.quantile(departures[:-1], level)) for name, level in DRAWN_LEVELS.items()}
        return LogAnswer(
            log=self.log,
            cut=self.cut,
            start=self.start,
            draws=draws,
            samples=self.dataset.sizes["t"],
            study_samples=-(-self.steps // self.every),
            logged_samples=self.logged_samples,
            every=self.every,
            p_value=self.p_value,
            least_p_value=1.0 / (draws + 1),
            draws_at_least_as_extreme=int(np.count_nonzero(draw_statistics >= statistics[-1])) if has_rank else None,
            statistic=None if departures is None else float(departures[-1]),
            statistic_of_draws=quantiles,
            without_spread=self.without_spread(),
            decisive_signal=signal,
            decisive_time=time,
            signals={str(name): self.signal_answer(str(name)) for name in self.dataset["signal"].values},
            replayed_samples=self.replayed,
            dropped_rows=self.dropped,
            held_samples=self.held,
            not_replayed=self.not_replayed,
            reference_differences=self.references,
            reference_rate_differences=self.rates,
            warned=bool(self.warnings),
            warnings=self.warnings,
        )

    def signal_answer(self, name: str) -> SignalAnswer:
        """Where a logged signal lies among the draws; for a command, also how far the analysed controller's differs."""
        signal = self.dataset.sel(signal=name)
        time = self.dataset["t"].values
        logged = signal["logged"].values
        is_finite = np.isfinite(logged)
        departure = signal["departure"].values[is_finite]
        has_spread = not np.isnan(departure).all()
        slack = RANGE_ROUNDING * max(np.max(np.abs(logged[is_finite]), initial=0.0), 1e-300)
        below_range = logged < signal["lowest"].values - slack
        above_range = logged > signal["highest"].values + slack
        is_outside = is_finite & (below_range | above_range) & has_spread
        return SignalAnswer(
            unit=self.unit(name),
            samples=int(is_finite.sum()),
            largest_departure=float(np.nanmax(departure)) if has_spread else None,
            outside_share=float(is_outside.sum() / is_finite.sum()) if has_spread else None,
            first_outside=float(time[is_outside][0]) if is_outside.any() else None,
            outside_to_the_end_since=start_of_last_excursion(time[is_finite], is_outside[is_finite]),
            replay=replayed_command(time, logged, signal["commanded"].values),
        )

    def unit(self, name: str) -> str:
        """The unit of the signal ``name``."""
        return signal_unit(self.study, name)


def start_of_last_excursion(time: np.ndarray, is_outside: np.ndarray) -> float | None:
    """Time from which on a signal is outside without interruption to its end [s]; None if it ends inside.

    Args:
        time: Times of the signal's values [s], shape (n,).
        is_outside: Whether each value is outside the range of the draws, shape (n,).
    """
    if not is_outside.size or not is_outside[-1]:
        return None
    inside_rows = np.flatnonzero(~is_outside)
    return float(time[inside_rows[-1] + 1 if inside_rows.size else 0])


def compare_log(study: Study, log: FlightLog, *, progress: ProgressCallback | None = None) -> LogComparison:
    """Replay a logged flight through the analysed controller, and lay it over the study's draws.

    The p-value is p = (1 + number of draws at least as extreme)/(n + 1) for n draws. A curve is extreme if few others
    depart as far from the median at any time in one of the logged signals. p is exact, for any law of the curves, if
    the flight has the law of the draws. Values may be missing in the log only for reasons that have nothing to do with
    the flight.

    Args:
        study: The study that analysed the flight: its reference, initial state and sensors are part of what is tested.
            Its sweep is ignored; draws are independent.
        log: The flight, see :func:`dssc_jax.read_log`.
        progress: Called with the number of draws done, and that of all draws.

    Raises:
        ConfigError: draws are not independent, or the log has hardly any sample within the study's duration.

    Example:
        >>> import numpy as np, dssc_jax as dj
        >>> from dssc_jax.flight_logs.reading.reader import Column
        >>> study = dj.Study.load("motor").override({"draws": 19})
        >>> run = dj.simulate(study, 7)
        >>> columns = {name: Column(run["t"].values, run[name].values) for name in ("y", "u_total")}
        >>> dj.compare_log(study, dj.FlightLog("run", columns, 0.0)).summary()["signals"]["u_total"]["samples"]
        1000
    """
    require_independent(study, "an exact p-value")
    study = study.without_sweep()
    loop = study.loop
    replay = replay_log(study, log)
    samples = replay.samples
    logged = replay.logged
    replays = replay.commands
    require_samples(study, log, compared_samples(study, replay))
    signals = [
        Signal(index, quantity, signal_name(channel, quantity))
        for index, channel in enumerate(loop.channels)
        for quantity in ChannelCurves._fields
    ]
    signals = [signal for signal in signals if signal.name in logged or signal.name in replays]
    stride = -(-samples * study.config.draws * len(signals) // MOST_NUMBERS)
    missing = np.full(samples, np.nan)
    tested = np.array([logged.get(signal.name, missing) for signal in signals])[:, ::stride]
    replayed = np.array([replays.get(signal.name, missing) for signal in signals])[:, ::stride]
    curves = drawn_curves(study, signals, samples, stride, progress)
    dataset = compared_dataset(study, signals, stride, tested, replayed, curves)
    return LogComparison(
        study=study,
        dataset=dataset,
        log=log.name,
        start=log.start,
        every=stride,
        replayed=samples,
        held=replay.held_samples,
        not_replayed=replay.not_replayed,
        references=replay.references,
        rates=replay.rates,
        warnings=causes_first(signal_warnings(output_hints(study, dataset) | replay.hints.all())),
        steps=loop.steps,
        cut=samples < loop.steps and log.is_cut(),
        dropped=dict(log.dropped),
    )


def compared_samples(study: Study, replay: LogReplay) -> np.ndarray:
    """Whether a log has any value to compare with the draws, at each sample, shape (samples,)."""
    has_value = np.zeros(replay.samples, bool)
    for channel in study.loop.channels:
        for quantity in ChannelCurves._fields:
            values = replay.logged.get(signal_name(channel, quantity))
            if values is not None:
                has_value |= np.isfinite(values[: replay.samples])
    return has_value
