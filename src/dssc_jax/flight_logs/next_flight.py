"""What logged flights tell about the next one and the study, assuming only that flights are exchangeable.

Half of the draws give the middle and the spread by which curves are measured, and are not used for anything else. So
the departure of a flight depends on this flight alone, and so does every metric. The statements follow from ranks of
these numbers (:mod:`dssc_jax.statistics.conformal`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.flight_logs.comparison import MOST_NUMBERS, Signal, drawn_curves
from dssc_jax.flight_logs.figure import next_flight_figure
from dssc_jax.flight_logs.flight_errors import Column, error_columns, measured_samples, number_columns
from dssc_jax.flight_logs.hints.references import study_references
from dssc_jax.flight_logs.reading.coverage import require_samples
from dssc_jax.flight_logs.reading.reader import FlightLog, channel_signals, samples_within, signal_name
from dssc_jax.flight_logs.replay import ChannelCurves, replay_log
from dssc_jax.flight_logs.signal_warnings import FlightWarning
from dssc_jax.results.analysis import Analysis
from dssc_jax.statistics import CONFIDENCE, clopper_pearson
from dssc_jax.statistics.conformal import (
    FEWEST_DRAWS,
    beyond_p_value,
    conformal_rank,
    flights_to_confirm,
    flights_to_refute,
    least_flights,
    line_rank,
)
from dssc_jax.statistics.exchangeable import Yardstick
from dssc_jax.study import Study

SHORT = 0.9  # share of the study, or of the longest log: a shorter log is reported
PROBABILITY = 0.9
SHARES = (0.1, 0.2, 0.5)
"""Shares of flights beyond the draws' line for which the number of flights is told."""


@dataclass(frozen=True)
class MetricLimit:
    """The limit of a metric that the next flight keeps with the stated probability."""

    unit: Annotated[str, Quantity("", "unit of the metric")]
    limit: Annotated[float | None, Quantity("that of the metric", "limit for the next flight; None: too few flights")]
    largest: Annotated[float, Quantity("that of the metric", "largest value of the flights")]
    median_of_draws: Annotated[float, Quantity("that of the metric", "median of the study's draws")]
    draws_beyond: Annotated[float | None, Quantity("1", "share of the study's draws beyond the limit")]


@dataclass(frozen=True)
class StudyTest:
    """Whether the flights refute the study."""

    beyond: Annotated[int, Quantity("1", "flights that depart farther than 95 % of the draws")]
    logs_beyond: Annotated[tuple[str, ...], Quantity("", "names of their logs")]
    p_value: Annotated[float, Quantity("1", "probability of at least as many such flights, if the study is right")]
    refuted: Annotated[bool, Quantity("", "whether the p-value is at most 5 %")]
    share_interval: Annotated[tuple[float, float], Quantity("1", "interval of the share of flights beyond")]
    flights_to_refute: Annotated[
        dict[str, int | None],
        Quantity("1", "flights that refute the study in 95 % of all cases if this share is beyond; None: too many"),
    ]
    flights_to_confirm: Annotated[
        dict[str, int | None],
        Quantity("1", "flights that show a smaller share, in 95 % of all cases if the study is right; None: too many"),
    ]


@dataclass(frozen=True)
class NextFlightAnswer:
    """A set in which the next flight lies with a stated probability, and what the flights say of the study."""

    logs: Annotated[tuple[str, ...], Quantity("", "names of the logs")]
    flights: Annotated[int, Quantity("1", "number of flights")]
    draws: Annotated[int, Quantity("1", "number of draws that are compared; as many more give middle and spread")]
    samples: Annotated[int, Quantity("1", "compared samples")]
    probability: Annotated[float, Quantity("1", "least probability that the next flight lies in the set")]
    rank: Annotated[int | None, Quantity("1", "rank of the flight that gives the limits; None: too few flights")]
    least_flights: Annotated[int, Quantity("1", "fewest flights that have a limit with this probability")]
    departure: Annotated[
        float | None, Quantity("1", "largest departure of the next flight from the draws' middle, in their spreads")
    ]
    without_spread: Annotated[tuple[str, ...], Quantity("", "signals that are the same in all draws, and left out")]
    metrics: dict[str, MetricLimit]
    study_test: StudyTest
    warned: Annotated[bool, Quantity("", "whether there is any warning")]
    warnings: tuple[FlightWarning, ...]


@dataclass(eq=False)
class NextFlight(Analysis):
    """A set in which the next flight lies with a stated probability, if flights are exchangeable.

    The dataset has along ``signal`` and ``t``: ``lower`` and ``upper``, the band in which all signals of the next
    flight lie at all times together, NaN without one; ``middle`` and ``spread`` of the draws; ``lowest`` and
    ``highest`` of the flights. Along ``flight`` it has the ``departure`` of each flight and along ``draw`` that of the
    draws compared, ``departure_of_draw``; and for each metric ``NAME`` the values of the flights, and ``NAME_of_draw``.

    Args:
        logs: Names of the logs.
        probability: Least probability that the next flight lies in the set.
        warnings: Where a log disagrees with the study.
    """

    kind = "next-flight"
    title = "What logged flights say of the next one"
    table = ("signal", "t")

    logs: tuple[str, ...]
    probability: float
    warnings: tuple[FlightWarning, ...]

    @property
    def rank(self) -> int | None:
        """The rank, in ascending order, of the flight that gives the limits; None: too few flights."""
        return conformal_rank(len(self.logs), self.probability)

    @property
    def headline(self) -> str:
        """The answer in one line."""
        answer = self.answer
        test = answer.study_test
        verdict = "refute the study" if test.refuted else "do not refute the study"
        flights = f"{answer.flights} flights {verdict}: p = {test.p_value:.3g}"
        if answer.departure is None:
            return f"{flights}; a set for the next one with {100 * self.probability:g} % needs {answer.least_flights}"
        return (
            f"the next flight departs by at most {answer.departure:.3g} spreads from the middle of the draws with a "
            f"probability of at least {100 * self.probability:g} %, whatever its law; {flights}"
        )

    def figure(self) -> Figure:
        """Plot the answer."""
        return next_flight_figure(self)

    @property
    def metric_names(self) -> list[str]:
        """The names of the flights' metrics in the dataset."""
        names = map(str, self.dataset.data_vars)
        return [name for name in names if f"{name}_of_draw" in self.dataset and name != "departure"]

    def limit(self, name: str) -> float | None:
        """The limit that the next flight keeps for the number ``name``; None: too few flights, or it is infinite."""
        if self.rank is None:
            return None
        limit = float(np.sort(self.dataset[name].values)[self.rank - 1])
        return limit if np.isfinite(limit) else None

    @property
    def answer(self) -> NextFlightAnswer:
        """The numbers that summary.json holds."""
        metrics = {}
        for name in self.metric_names:
            values = self.dataset[name].values
            draw_values = self.dataset[f"{name}_of_draw"].values
            limit = self.limit(name)
            share = None if limit is None else float(np.mean(~(draw_values <= limit)))
            unit = str(self.dataset[name].attrs["units"])
            metrics[name] = MetricLimit(unit, limit, float(values.max()), float(np.nanmedian(draw_values)), share)
        spread = self.dataset["spread"].values
        signals = self.dataset["signal"].values
        return NextFlightAnswer(
            logs=self.logs,
            flights=len(self.logs),
            draws=self.dataset.sizes["draw"],
            samples=self.dataset.sizes["t"],
            probability=self.probability,
            rank=self.rank,
            least_flights=least_flights(self.probability),
            departure=self.limit("departure"),
            without_spread=tuple(str(name) for name in signals[np.isnan(spread).all(axis=1)]),
            metrics=metrics,
            study_test=self.study_test(),
            warned=bool(self.warnings),
            warnings=self.warnings,
        )

    def study_test(self) -> StudyTest:
        """The test that refutes the study if too many flights depart beyond a line that at most 5 % of draws exceed."""
        draw_departures = self.dataset["departure_of_draw"].values
        draws = len(draw_departures)
        departure_line = np.sort(draw_departures)[draws - line_rank(draws)]
        is_beyond = self.dataset["departure"].values > departure_line
        logs_beyond = tuple(log for log, beyond in zip(self.logs, is_beyond, strict=True) if beyond)
        beyond_count = len(logs_beyond)
        p_value = beyond_p_value(beyond_count, len(self.logs), draws)
        low, high = clopper_pearson(beyond_count, len(self.logs), CONFIDENCE).tolist()
        return StudyTest(
            beyond=beyond_count,
            logs_beyond=logs_beyond,
            p_value=p_value,
            refuted=p_value <= 1.0 - CONFIDENCE,
            share_interval=(low, high),
            flights_to_refute={f"{share:g}": flights_to_refute(share, draws) for share in SHARES},
            flights_to_confirm={f"{share:g}": flights_to_confirm(share, draws) for share in SHARES},
        )


def next_flight(
    study: Study,
    logs: Sequence[FlightLog],
    *,
    probability: float = PROBABILITY,
    progress: ProgressCallback | None = None,
) -> NextFlight:
    """A set in which the next flight lies with a stated probability, and whether the flights refute the study.

    Nothing is assumed of the flights but that they and the next one are exchangeable. The study's draws only give the
    yardstick by which departures are measured, and the law that is tested. Values may be missing in a log only for
    reasons that have nothing to do with the flight; a sample that one log lacks is left out of all.

    Args:
        study: The study that describes the flights; its sweep is ignored, and its draws are independent.
        logs: The flights, see :func:`dssc_jax.read_log`; at least one.
        probability: Least probability that the next flight lies in the set, in (0, 1). It needs at least p/(1 - p)
            flights.
        progress: Called with the number of draws done, and that of all draws.

    Raises:
        ConfigError: An argument is out of range, two logs hold the same flight, draws are not independent or too few,
            or the logs have no signal in common that differs between the draws.
    """
    require_comparable(study, logs, probability)
    study = study.without_sweep()
    half = study.config.draws // 2
    loop = study.loop
    samples = min(samples_within(log, loop.sample_time, loop.steps) for log in logs)
    references = study_references(study, max(samples, 1))
    signals, flights, desired = logged_curves(study, logs, references)
    stride = max(1, -(-samples * study.config.draws * len(signals) // MOST_NUMBERS))
    flights = flights[..., ::stride]
    for log, flight in zip(logs, flights, strict=True):
        require_samples(study, log, np.isfinite(flight).any(axis=0))
    is_finite = np.all(np.isfinite(flights), axis=0)
    if samples < 1 or not is_finite.any():
        raise ConfigError("logs", "the flights have no sample of any signal in common within the study's duration")
    curves = drawn_curves(study, signals, samples, stride, progress)
    yardstick = Yardstick.of(curves[:half])
    if not (is_finite & np.isfinite(yardstick.spread)).any():
        raise ConfigError("logs", "no logged signal differs between the draws, which gives no spread to measure by")
    compared_curves = curves[half:]
    times = loop.sample_time * stride * np.arange(flights.shape[-1])
    departures = np.array([yardstick.largest_departure(flight, is_finite) for flight in flights])
    draw_departures = np.array([yardstick.largest_departure(curve, is_finite) for curve in compared_curves])
    data = band_columns(yardstick, flights, is_finite)
    data |= number_columns("departure", "1", "largest departure", departures, draw_departures)
    is_measured = measured_samples(study, times)
    for row, signal in enumerate(signals):
        counted = is_finite[row] & is_measured
        if signal.quantity == "y" and counted.any():
            flight_errors = flights[:, row] - desired[:, signal.channel, ::stride]
            draw_errors = compared_curves[:, row] - references[signal.channel, 0, ::stride]
            data |= error_columns(study, signal.channel, flight_errors[:, counted], draw_errors[:, counted])
    coords = {
        "signal": ("signal", [signal.name for signal in signals], {"long_name": "signal"}),
        "t": ("t", times, {"long_name": "time", "units": "s"}),
    }
    dataset = xr.Dataset(data, coords=coords, attrs={"title": study.name})
    warnings = []
    for log in logs:
        for warning in replay_log(study, log).warnings:
            warnings.append(FlightWarning(warning.signal, warning.code, warning.text, log.name))
    analysis = NextFlight(study, dataset, tuple(log.name for log in logs), probability, tuple(warnings))
    departure = analysis.limit("departure")
    return analysis if departure is None else with_band(analysis, departure)


def require_comparable(study: Study, logs: Sequence[FlightLog], probability: float) -> None:
    """Require different flights, enough independent draws, and a probability in (0, 1).

    Args:
        study: The study.
        logs: The flights.
        probability: Least probability that the next flight lies in the set.

    Raises:
        ConfigError: One of these requirements does not hold, or there is no flight.
    """
    if not 0.0 < probability < 1.0:
        raise ConfigError("probability", f"must lie in (0, 1), got {probability:g}")
    if not logs:
        raise ConfigError("logs", "needs at least one flight")
    require_different(logs)
    require_independent(study, "a rank among the draws")
    draws = study.config.draws
    if draws // 2 < FEWEST_DRAWS:
        raise ConfigError("draws", f"must be at least {2 * FEWEST_DRAWS} to compare flights, got {draws}")


def short_log(study: Study, logs: Sequence[FlightLog]) -> FlightLog | None:
    """The shortest log, if it ends clearly before the study and the longest log; no flight is compared beyond its end.

    Returns:
        None if the shortest log covers the share ``SHORT`` of the study or of the longest log.
    """
    lengths = [log.end - log.start for log in logs]
    duration = study.loop.sample_time * study.loop.steps
    shortest = min(lengths)
    return logs[lengths.index(shortest)] if shortest < SHORT * min(max(lengths), duration) else None


def require_different(logs: Sequence[FlightLog]) -> None:
    """Require that no flight is counted twice; raises ConfigError with the names of two logs that hold the same one."""
    names: dict[tuple[bytes, ...], str] = {}
    for log in logs:
        columns = [log.columns[name] for name in sorted(log.columns)]
        content = tuple(part.tobytes() for column in columns for part in column)
        if content in names:
            raise ConfigError("logs", f"'{names[content]}' and '{log.name}' hold the same flight, which counts once")
        names[content] = log.name


def logged_curves(
    study: Study, logs: Sequence[FlightLog], references: np.ndarray
) -> tuple[list[Signal], np.ndarray, np.ndarray]:
    """The signals that all logs have, their values, and the desired outputs of each flight.

    Args:
        study: The study.
        logs: The flights.
        references: The study's references with two derivatives, shape (channels, 3, times).

    Returns:
        The signals; their values, NaN where missing, shape (flights, signals, times); and the desired outputs, as
        logged or else those of the study, shape (flights, channels, times).
    """
    channels = study.loop.channels
    signals_by_flight = []
    desired = np.repeat(references[None, :, 0], len(logs), axis=0)
    for flight, log in enumerate(logs):
        signals_by_name = {}
        for index, channel in enumerate(channels):
            logged = channel_signals(study, log, index, references[index, 0])
            if "y_ref" in logged:
                desired[flight, index] = np.where(np.isfinite(logged["y_ref"]), logged["y_ref"], desired[flight, index])
            signals_by_name |= {signal_name(channel, name): values for name, values in logged.items()}
        signals_by_flight.append(signals_by_name)
    signals = []
    for index, channel in enumerate(channels):
        for quantity in ChannelCurves._fields:
            name = signal_name(channel, quantity)
            if all(name in flight_signals for flight_signals in signals_by_flight):
                signals.append(Signal(index, quantity, name))
    values = np.array([[logged[signal.name] for signal in signals] for logged in signals_by_flight])
    return signals, values.reshape(len(logs), len(signals), references.shape[-1]), desired


def band_columns(yardstick: Yardstick, flights: np.ndarray, is_finite: np.ndarray) -> dict[str, Column]:
    """The columns of the dataset along signals and times; the band is NaN until :func:`with_band` fills it in.

    Args:
        yardstick: Middle and spread of half of the draws.
        flights: The signals of the flights, shape (flights, signals, times).
        is_finite: Whether all flights have a value, shape (signals, times).
    """
    missing = np.full(is_finite.shape, np.nan)
    lowest = np.where(is_finite, flights.min(axis=0), np.nan)
    highest = np.where(is_finite, flights.max(axis=0), np.nan)
    columns = {
        "middle": (yardstick.middle, "median of the draws"),
        "spread": (yardstick.spread, "spread of the draws"),
        "lowest": (lowest, "lowest value of the flights"),
        "highest": (highest, "highest value of the flights"),
        "lower": (missing, "lower end of the band of the next flight"),
        "upper": (missing, "upper end of the band of the next flight"),
    }
    variables = {}
    for name, (values, meaning) in columns.items():
        variables[name] = (NextFlight.table, values, {"long_name": meaning, "units": "that of the signal"})
    return variables


def with_band(analysis: NextFlight, departure: float) -> NextFlight:
    """The analysis with the band of the next flight: the middle, plus and minus ``departure`` times the spread."""
    data = analysis.dataset
    reach = departure * data["spread"]
    lower = (data["middle"] - reach).assign_attrs(data["lower"].attrs)
    upper = (data["middle"] + reach).assign_attrs(data["upper"].attrs)
    return replace(analysis, dataset=data.assign(lower=lower, upper=upper))
