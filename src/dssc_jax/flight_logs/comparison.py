"""A logged flight beside the analysed set: replayed through the controller, and laid over the study's draws.

The test is one of exchangeable curves (:mod:`dssc_jax.statistics.exchangeable`): its statistic is fixed in advance, the
largest standardised departure over all logged signals and times, and its p-value is exact for any time series.
"""

import warnings
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from dssc_jax import plotting
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import wrap_angle
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.flight_logs.reader import LOGGED, FlightLog, log_signals, nearest_values, samples_within
from dssc_jax.flight_logs.replay import ChannelCurves, commanded, curves_of_draws, study_references
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.analysis_folder import Stored
from dssc_jax.statistics.exchangeable import largest_departures, rank_p_value
from dssc_jax.study import Study

MOST_NUMBERS = 40_000_000  # of all draws' curves, kept in memory
ENOUGH = 0.95  # share of the samples that the controller must have for a replay
SAME_REFERENCE = 1e-3  # of a reference's size: what resolution and rounding of a log explain
DRAWN_LEVELS = {"low": 0.05, "median": 0.5, "high": 0.95}


@dataclass(eq=False)
class LogComparison(Analysis):
    """A logged flight beside a study's draws.

    The dataset has along ``signal`` and ``t``: ``logged``, ``commanded`` (what the analysed controller commands for the
    logged measurements; for commands only), ``lowest``, ``low``, ``median``, ``high`` and ``highest`` of the draws (low
    and high are quantiles of 5 and 95 %), ``departure`` of the log; and along ``curve`` the ``statistic`` of each draw,
    and of the log as the last one.

    Args:
        log: Name of the log.
        start: Time of the log at which the study begins [s].
        every: Of how many samples one was compared.
        not_replayed: Why a channel's log was not replayed, by channel.
        references: Largest difference between the logged and the study's reference, by channel; empty if not logged.
    """

    kind = "compare-log"
    title = "A logged flight beside the draws"
    table = ("signal", "t")

    log: str
    start: float
    every: int
    not_replayed: dict[str, str]
    references: dict[str, float]

    @property
    def p_value(self) -> float | None:
        """Probability of a statistic as large as the log's, or larger, if the flight were another draw.

        None if no logged signal differs between the draws, so that a rank among them means nothing.
        """
        statistics = self.dataset["statistic"].values
        return None if np.isnan(statistics[-1]) else rank_p_value(statistics)

    def without_spread(self) -> dict[str, float]:
        """Logged signals that are the same in all draws, with the log's largest distance from them."""
        largest = {}
        for name in self.dataset["signal"].values:
            own = self.dataset.sel(signal=name)
            known = np.isfinite(own["logged"].values)
            if known.any() and np.isnan(own["departure"].values[known]).all():
                distance = np.abs(own["logged"].values - own["median"].values)[known]
                largest[str(name)] = float(np.max(distance[np.isfinite(distance)], initial=0.0))
        return largest

    def decisive(self) -> tuple[str, float] | None:
        """Signal and time [s] of the log's largest departure; None without a p-value."""
        if self.p_value is None:
            return None
        departure = np.nan_to_num(self.dataset["departure"].values, nan=-1.0)
        signal, at = np.unravel_index(np.argmax(departure), departure.shape)
        return str(self.dataset["signal"].values[signal]), float(self.dataset["t"].values[at])

    @property
    def headline(self) -> str:
        """The answer in one line."""
        decisive = self.decisive()
        if decisive is None:
            largest = ", ".join(f"{name} by {x:.3g} {self.unit(name)}" for name, x in self.without_spread().items())
            return f"all draws are the same, so a rank among them means nothing; the log differs from them, {largest}"
        signal, at = decisive
        largest = self.dataset["statistic"].values[-1]
        return (
            f"p = {self.p_value:.3g} for the flight as one more draw; "
            f"its largest departure is {largest:.3g}, in {signal} at {at:.4g} s"
        )

    def figure(self) -> Figure:
        """Plot the answer."""
        return plotting.log_comparison(self)

    def content(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        statistics = self.dataset["statistic"].values
        draws = len(statistics) - 1
        signal, at = self.decisive() or (None, None)
        return {
            "log": self.log,
            "start": self.start,
            "draws": draws,
            "samples": self.dataset.sizes["t"],
            "every": self.every,
            "p_value": self.p_value,
            "least_p_value": 1.0 / (draws + 1),
            "draws_at_least_as_extreme": int(np.count_nonzero(statistics[:-1] >= statistics[-1])),
            "statistic": None if self.p_value is None else statistics[-1],
            "statistic_of_draws": {name: np.quantile(statistics[:-1], q) for name, q in DRAWN_LEVELS.items()}
            if np.isfinite(statistics[:-1]).all()
            else None,
            "without_spread": self.without_spread(),
            "decisive_signal": signal,
            "decisive_time": at,
            "signals": {str(name): self.of_signal(str(name)) for name in self.dataset["signal"].values},
            "not_replayed": self.not_replayed,
            "reference_differences": self.references,
        }

    def of_signal(self, name: str) -> dict[str, Any]:
        """How a signal lies in the draws, and how the analysed controller's command differs from it."""
        own, time = self.dataset.sel(signal=name), self.dataset["t"].values
        logged, departure = own["logged"].values, own["departure"].values
        known = np.isfinite(logged)
        slack = 1e-9 * max(np.max(np.abs(logged[known]), initial=0.0), 1e-300)
        outside = known & ((logged < own["lowest"].values - slack) | (logged > own["highest"].values + slack))
        facts: dict[str, Any] = {
            "unit": self.unit(name),
            "samples": int(known.sum()),
            "largest_departure": None if np.isnan(departure[known]).all() else np.nanmax(departure[known]),
            "outside_share": float(outside.sum() / max(known.sum(), 1)),
            "first_outside": float(time[outside][0]) if outside.any() else None,
            "outside_to_the_end_since": since_last(time[known], outside[known]),
        }
        difference = own["commanded"].values - logged
        both = np.isfinite(difference)
        if both.any():
            worst = np.argmax(np.abs(np.where(both, difference, 0.0)))
            facts |= {
                "largest_difference": float(abs(difference[worst])),
                "largest_difference_at": float(time[worst]),
                "rms_difference": root_mean_square(difference[both]),
                "rms_logged": root_mean_square(logged[both]),
            }
        return facts

    def unit(self, name: str) -> str:
        """The unit of a signal."""
        for channel, units in zip(self.study.loop.channels, self.study.units, strict=True):
            own = name.removeprefix(f"{channel}_") if channel else name
            if own in ChannelCurves._fields and name == signal_name(channel, own):
                return units.of({"y": "y", "y_dot": "y/s", "u_total": "u"}[own])
        return ""

    def settings(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        names = ("log", "start", "every", "not_replayed", "references")
        return {name: getattr(self, name) for name in names}

    @classmethod
    def restored(cls, stored: Stored) -> Self:
        """See :class:`Analysis`."""
        return cls(stored.study, stored.dataset, **stored.settings)


def root_mean_square(values: np.ndarray) -> float:
    """The root mean square of finite values, however large they are."""
    size = float(np.abs(values).max())
    return size * float(np.sqrt(np.mean((values / size) ** 2))) if size > 0.0 else 0.0


def signal_name(channel: str, name: str) -> str:
    """The name of a channel's signal."""
    return f"{channel}_{name}" if channel else name


def since_last(time: np.ndarray, outside: np.ndarray) -> float | None:
    """Since when a signal is outside without interruption until its end; None if it ends inside."""
    if not outside.size or not outside[-1]:
        return None
    inside = np.flatnonzero(~outside)
    return float(time[inside[-1] + 1 if inside.size else 0])


def forward_filled(values: np.ndarray) -> np.ndarray:
    """The last known value in place of each missing one; the first known one before it. Shape (samples,)."""
    known = np.flatnonzero(np.isfinite(values))
    return values[known[np.maximum(np.searchsorted(known, np.arange(len(values)), side="right") - 1, 0)]]


def compare_log(study: Study, log: FlightLog, *, progress: ProgressCallback | None = None) -> LogComparison:
    """Replay a logged flight through the analysed controller, and lay it over the study's draws.

    p = (1 + number of draws at least as extreme)/(n + 1), by the largest standardised departure over all logged
    signals and times. It is exact, for any law of the curves, if the flight has the law of the draws. What is missing
    in the log must be so for reasons that have nothing to do with the flight.

    Args:
        study: The study that analysed the flight: its reference, initial state and sensors are part of what is tested.
            Its sweep is ignored; draws are independent.
        log: The flight, see :func:`dssc_jax.read_log`.
        progress: Called with the draws done.

    Raises:
        ConfigError: draws are not independent, or the log has no sample within the study's duration.

    Example:
        >>> import numpy as np, dssc_jax as dj
        >>> from dssc_jax.flight_logs.reader import Column
        >>> study = dj.Study.load("motor").override({"draws": 19})
        >>> run = dj.simulate(study, 7)
        >>> columns = {name: Column(run["t"].values, run[name].values) for name in ("y", "u_total")}
        >>> dj.compare_log(study, dj.FlightLog("run", columns, 0.0)).summary()["signals"]["u_total"]["samples"]
        1000
    """
    require_independent(study, "an exact p-value")
    study = study.without_sweep()
    loop = study.loop
    samples = samples_within(log, loop.sample_time, loop.steps)
    names = [name for name in log_signals(loop.channels) if name in log.columns]
    logged = {name: nearest_values(log.columns[name], log.start, loop.sample_time, max(samples, 1)) for name in names}
    compared = [values for name, values in logged.items() if name.endswith(ChannelCurves._fields)]
    if samples < 1 or not any(np.isfinite(values).any() for values in compared):
        span = f"{loop.steps * loop.sample_time:g} s from {log.start:g} s on"
        raise ConfigError(log.name, f"has no output and no command in the study's {span}")
    references = study_references(study, samples)
    replays, reasons, differences = {}, {}, {}
    for index, channel in enumerate(loop.channels):
        own = {name: logged[signal_name(channel, name)] for name in LOGGED if signal_name(channel, name) in logged}
        if channel in loop.plant.angles and "y" in own:
            desired = references[index, 0]
            own["y"] = logged[signal_name(channel, "y")] = desired + np.asarray(wrap_angle(own["y"] - desired))
        if "y_ref" in own:
            differences[channel] = float(np.nanmax(np.abs(own["y_ref"] - references[index, 0]), initial=0.0))
        answer = replayed_channel(study, index, own, references[index])
        if isinstance(answer, str):
            reasons[channel] = answer
        else:
            replays[channel] = answer
    return laid_over(study, log, logged, replays, reasons, differences, progress)


def replayed_channel(
    study: Study, index: int, logged: dict[str, np.ndarray], reference: np.ndarray
) -> np.ndarray | str:
    """The command of the analysed controller for a channel's log, or why there is none.

    Args:
        study: The study.
        index: Position of the channel.
        logged: Its sampled signals by name.
        reference: The study's own reference with two derivatives, shape (3, samples).
    """
    if "y" not in logged:
        return "the log has no measured output y"
    share = float(np.mean(np.isfinite(logged["y"])))
    if share < ENOUGH:
        return f"the log has y at {100 * share:.3g} % of the controller's samples; a replay needs {100 * ENOUGH:g} %"
    nothing = np.full(len(logged["y"]), np.nan)
    filled = {name: forward_filled(values) for name, values in logged.items() if np.isfinite(values).any()}
    same = True
    if "y_ref" in filled:
        size = max(float(np.abs(reference[0]).max()), float(np.ptp(reference[0])), 1e-300)
        same = float(np.abs(filled["y_ref"] - reference[0]).max()) <= SAME_REFERENCE * size
    derivatives = [
        filled.get(name, reference[row] if same else nothing) for row, name in ((1, "y_ref_dot"), (2, "y_ref_ddot"))
    ]
    desired = np.array([filled.get("y_ref", reference[0]), *derivatives])
    command = commanded(study, index, np.array([filled["y"], filled.get("y_dot", nothing)]), desired)
    if np.isfinite(command).all():
        return command
    missing = [name for name in ("y_dot",) if name not in filled]
    missing += [name for name in ("y_ref_dot", "y_ref_ddot") if not same and name not in filled]
    if missing:
        return f"the controller needs {' or '.join(missing)}, which the log lacks"
    return "the controller's command is not finite for these measurements"


def laid_over(
    study: Study,
    log: FlightLog,
    logged: dict[str, np.ndarray],
    replays: dict[str, np.ndarray],
    reasons: dict[str, str],
    differences: dict[str, float],
    progress: ProgressCallback | None,
) -> LogComparison:
    """Simulate the draws, and compare the log with them; arguments as they result in :func:`compare_log`."""
    channels, draws = study.loop.channels, study.config.draws
    signals = [
        (index, own)
        for index, channel in enumerate(channels)
        for own in ChannelCurves._fields
        if signal_name(channel, own) in logged or (own == "u_total" and channel in replays)
    ]
    names = [signal_name(channels[index], own) for index, own in signals]
    samples = len(next(iter(logged.values())))
    every = -(-samples * draws * len(signals) // MOST_NUMBERS)
    nothing = np.full(samples, np.nan)
    tested = np.array([logged.get(name, nothing) for name in names])[:, ::every]
    replayed = np.array(
        [replays.get(channels[index], nothing) if own == "u_total" else nothing for index, own in signals]
    )
    curves = np.empty((draws, *tested.shape))
    for draw, curve in enumerate(curves_of_draws(study, samples, every)):
        for row, (index, own) in enumerate(signals):
            curves[draw, row] = getattr(curve[index], own)
        if progress is not None:
            progress(draw + 1, draws)
    statistics, departure = largest_departures(curves, tested)
    own_unit = {"units": "that of the signal"}
    columns = {
        "logged": (tested, "logged value"),
        "commanded": (replayed[:, ::every], "command of the analysed controller"),
    }
    columns |= {name: (column, f"{name} value of the draws") for name, column in pointwise_quantiles(curves).items()}
    data: dict[str, Any] = {
        name: (LogComparison.table, column, {"long_name": text, **own_unit}) for name, (column, text) in columns.items()
    }
    departs = {"long_name": "departure of the log from the draws' median, by their spread", "units": "1"}
    data["departure"] = (LogComparison.table, departure, departs)
    largest = {"long_name": "largest departure of each draw, and of the log as the last one", "units": "1"}
    data["statistic"] = (("curve",), statistics, largest)
    coords = {
        "signal": ("signal", names, {"long_name": "signal"}),
        "t": ("t", study.loop.sample_time * np.arange(0, samples, every), {"long_name": "time", "units": "s"}),
    }
    dataset = xr.Dataset(data, coords=coords, attrs={"title": study.name})
    return LogComparison(study, dataset, log.name, log.start, every, reasons, differences)


def pointwise_quantiles(curves: np.ndarray) -> dict[str, np.ndarray]:
    """Range and quantiles of the draws that have not ended, pointwise; curves of shape (draws, signals, times)."""
    finite = np.where(np.isfinite(curves), curves, np.nan)
    levels = {"lowest": 0.0, **DRAWN_LEVELS, "highest": 1.0}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "All-NaN slice")  # all draws have ended: nothing is shown
        values = np.nanquantile(finite, list(levels.values()), axis=0)
    return dict(zip(levels, values, strict=True))
