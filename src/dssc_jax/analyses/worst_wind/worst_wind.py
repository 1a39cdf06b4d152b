"""Search for the wind within bounds that drives each signal of a flight to its worst value.

Each wind found can be flown again. Nothing is claimed of winds that were not tried, which may be worse.
"""

import time
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.defaults import CLIMBS, LEAST_SEGMENTS, MOST_CLIMBS, MOST_SEGMENTS, SEGMENTS
from dssc_jax.analyses.worst_wind.ascent import Ascent, WorstFlight
from dssc_jax.analyses.worst_wind.flights import AXES, WindFlights, WindGrid, require_certain_wind
from dssc_jax.analyses.worst_wind.wind_set import Limits, WindSet
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.quantities import Quantity, unit_and_meaning
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import BLOCK
from dssc_jax.results.analysis import Analysis
from dssc_jax.study import Study
from dssc_jax.study.known_draws import study_of_draw

ON_REQUEST = ("error_rate_max",)
"""Metrics of a flight that are signals only on request."""
OF_ALL_DRAWS = ("sampling", "replicates", "correlation", "sweep", "draws")
"""Settings that concern all draws of a study together, which the study of a single flight does not have."""
UNIT_OF_SIGNAL = "that of the signal"


@dataclass(frozen=True)
class SignalAnswer:
    """The worst value found of a signal, and the uncertain numbers of that flight."""

    signal: Annotated[str, Quantity("", "the signal, by the name of its metric")]
    meaning: Annotated[str, Quantity("", "what it is")]
    unit: Annotated[str, Quantity("", "unit of the signal")]
    worst: Annotated[float | None, Quantity(UNIT_OF_SIGNAL, "worst value; None if the flight ends early")]
    candidate: Annotated[float | None, Quantity(UNIT_OF_SIGNAL, "worst value among the first candidates")]
    numbers: Annotated[dict[str, float], Quantity("that of the number", "value of each uncertain number")]


@dataclass(frozen=True)
class WorstWindAnswer:
    """The answer of a search for the worst wind: its bounds, the worst value found of each signal, and its cost."""

    speed: Annotated[float, Quantity("m/s", "bound of the horizontal wind's norm")]
    vertical: Annotated[float, Quantity("m/s", "bound of the vertical wind")]
    rate: Annotated[float | None, Quantity("m/s^2", "bound of |w'|; None: the wind may jump")]
    signals: list[SignalAnswer]
    vectors: Annotated[int, Quantity("1", "vectors of a wind")]
    interval: Annotated[float, Quantity("s", "time between two vectors")]
    flights: Annotated[int, Quantity("1", "flights in given winds")]
    slopes: Annotated[int, Quantity("1", "flights with the derivative along one number")]
    seconds: Annotated[float, Quantity("s", "computing time")]


@dataclass(eq=False)
class WorstWind(Analysis):
    """The worst wind found for each signal of a flight.

    The dataset has along ``signal``: ``worst``, the worst value; ``candidate``, the worst value among the first
    candidates; and the value of each uncertain number. Along ``signal`` and ``time`` it has the wind as ``wind_x``,
    ``wind_y`` and ``wind_z``. A vector of the wind holds until the next time; where the rate is bounded, it is the knot
    of a cubic spline. :meth:`flight` is the study that flies in the wind.

    Args:
        units: Unit of each signal.
        meanings: What each signal is, in words.
        limits: The bounds of the wind.
        interval: Time between two vectors [s].
        flights: Number of flights in given winds.
        slopes: Number of derivatives: flights, times the numbers by which each was differentiated.
        seconds: Computing time [s].
    """

    kind = "worst-wind"
    title = "The worst wind"
    table = ("signal",)

    units: tuple[str, ...]
    meanings: tuple[str, ...]
    limits: Limits
    interval: float
    flights: int
    slopes: int
    seconds: float

    @property
    def signals(self) -> list[str]:
        """Names of the signals, in the order in which they were asked for."""
        return self.dataset["signal"].values.tolist()

    @property
    def grid(self) -> WindGrid:
        """The times at which the winds have vectors."""
        return WindGrid(self.interval, self.dataset.sizes["time"], smooth=self.limits.rate is not None)

    def wind(self, signal: str) -> np.ndarray:
        """The worst wind of a signal [m/s], shape (vectors, 3); see :func:`dssc_jax.fly_winds`."""
        row = self._row(signal)
        return np.stack([row[f"wind_{axis}"].values for axis in AXES], axis=1)

    def numbers(self, signal: str) -> dict[str, float]:
        """Value of each uncertain number in the worst flight of a signal, by dotted name."""
        row = self._row(signal)
        return {name: float(row[name]) for name in self.study.laws}

    def flight(self, signal: str) -> Study:
        """The study whose only draw is the worst flight of a signal: wind and numbers replace bounds and laws.

        Example:
            ``dj.simulate(worst.flight("error_max_x"))``
        """
        table = {name: value for name, value in self.study.table.items() if name not in OF_ALL_DRAWS}
        table["wind"] = self.grid.table(self.wind(signal).T.tolist())
        return study_of_draw(Study.from_table(table, self.study.source), self.numbers(signal))

    def _row(self, signal: str) -> xr.Dataset:
        """The part of the dataset that belongs to a signal.

        Raises:
            ConfigError: The signal was not searched for.
        """
        if signal not in self.signals:
            raise ConfigError("signal", f"'{signal}' was not searched for; {nearest(signal, self.signals)}")
        return self.dataset.sel(signal=signal)

    @property
    def headline(self) -> str:
        """The effect of the worst wind found on the first signal, in one line."""
        first = self.answer.signals[0]
        if first.worst is None:
            effect = "ends the flight early"
        else:
            effect = f"drives {first.signal} to {first.worst:.4g} {first.unit}".removesuffix(" 1")  # no unit
        return f"the worst wind found of at most {self.limits.speed:g} m/s {effect}"

    def figure(self) -> Figure:
        """Plot the wind that drives each signal to its worst value."""
        return plotting.worst_wind(self)

    @property
    def answer(self) -> WorstWindAnswer:
        """The bounds, and the worst value found of each signal, as ``summary.json`` has them."""
        return WorstWindAnswer(
            speed=self.limits.speed,
            vertical=self.limits.vertical,
            rate=self.limits.rate,
            signals=[self.signal_answer(name) for name in self.signals],
            vectors=self.dataset.sizes["time"],
            interval=self.interval,
            flights=self.flights,
            slopes=self.slopes,
            seconds=self.seconds,
        )

    def signal_answer(self, signal: str) -> SignalAnswer:
        """The worst value found of a signal with its meaning and unit, read from the dataset."""
        row = self._row(signal)
        place = self.signals.index(signal)
        return SignalAnswer(
            signal=signal,
            meaning=self.meanings[place],
            unit=self.units[place],
            worst=finite_or_none(float(row["worst"])),
            candidate=finite_or_none(float(row["candidate"])),
            numbers=self.numbers(signal),
        )


def finite_or_none(value: float) -> float | None:
    """The value, or None in place of infinity or NaN, which JSON does not have."""
    return value if np.isfinite(value) else None


def worst_wind(
    study: Study,
    *,
    signals: list[str] | None = None,
    segments: int = SEGMENTS,
    rounds: int = CLIMBS,
    seed: int = 0,
    progress: ProgressCallback | None = None,
) -> WorstWind:
    """Find the wind within the bounds of a study's wind that drives each signal to its worst value.

    Candidates are winds that swing along a line with a period, which may resonate with the loop, and winds that switch
    to random extremes. For each signal, climbs start at the two worst candidates of either kind. A climb steps towards
    the extreme wind of the signal's gradient. Uncertain numbers of the study move, too, within the support of their
    laws; a number with a choice of values keeps its value.

    Args:
        study: The study, whose wind declares its bounds; with ``kind = "bounded"`` the parameters of the wind are the
            bounds. The study's sweep is ignored, and all flights have the in-loop noise of draw 0.
        signals: Metrics of a flight, see :func:`dssc_jax.fly_winds`: the largest |e|, |e'| and |sigma| of each channel,
            the largest tilt, the largest and the smallest thrust of a rotor. None: all but |e'|.
        segments: Parts of the flight, of whole samples; a wind may change between two.
        rounds: Most steps of a climb; 0: the best candidate is the answer.
        seed: Seed of the random candidates.
        progress: Called with the rounds done.

    Raises:
        ConfigError: The bounds of the wind are unknown or uncertain, or it never blows; a signal is unknown;
            ``segments`` or ``rounds`` is out of range.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/hover_wind.toml").override({"loop.duration": 10.0})
        >>> worst = dj.worst_wind(study, signals=["error_max_x"], segments=20, rounds=2)
        >>> 0.3 < worst.answer.signals[0].worst < 0.5
        True
    """
    began = time.perf_counter()
    study = study.without_sweep()
    chosen = signals or []
    if not LEAST_SEGMENTS <= segments <= MOST_SEGMENTS:
        raise ConfigError("segments", f"must be in {LEAST_SEGMENTS} .. {MOST_SEGMENTS}, got {segments}")
    if not 0 <= rounds <= MOST_CLIMBS:
        raise ConfigError("rounds", f"must be in 0 .. {MOST_CLIMBS}, got {rounds}")
    limits = wind_limits(study)
    grid = WindGrid.of(study, segments, smooth=limits.rate is not None)
    flights = WindFlights(study, grid, BLOCK)
    for name in chosen:
        if name not in flights.signals:
            raise ConfigError("signals", f"unknown signal '{name}'; {nearest(name, flights.signals)}")
    default_names = [name for name, signal in flights.signals.items() if signal.measure.kind not in ON_REQUEST]
    names = list(dict.fromkeys(chosen or default_names))  # each name once
    ascent = Ascent(
        flights=flights,
        winds=WindSet(limits, grid),
        signals=names,
        rounds=rounds,
        rng=np.random.default_rng(seed),
        progress=progress,
    )
    worst_flights = ascent.run()
    measures = [flights.signals[name].measure for name in names]
    return WorstWind(
        study,
        worst_wind_dataset(flights, worst_flights),
        units=tuple(measure.unit for measure in measures),
        meanings=tuple(measure.meaning for measure in measures),
        limits=limits,
        interval=grid.interval,
        flights=ascent.flown,
        slopes=ascent.differentiated,
        seconds=time.perf_counter() - began,
    )


def switching_winds(study: Study, count: int, *, segments: int = SEGMENTS, seed: int = 0) -> np.ndarray:
    """Random winds within the bounds of a study's wind, for :func:`dssc_jax.fly_winds`.

    Each wind switches at random times to random extremes. The mean time between two switches is random, too, from one
    part of the flight to all of it.

    Args:
        study: The study, whose wind declares its bounds.
        count: Number of winds.
        segments: Parts of the flight, of whole samples; a wind may change between two.
        seed: Seed of the winds.

    Returns:
        The winds [m/s], shape (count, vectors, 3). Where the rate is bounded, they are the knots of splines, which
        ``smooth=True`` of :func:`dssc_jax.fly_winds` flies.

    Raises:
        ConfigError: The bounds of the wind are unknown or uncertain, or it never blows; or a number is too small.

    Example:
        >>> import dssc_jax as dj
        >>> dj.switching_winds(dj.Study.load("studies/hover_wind.toml"), 7).shape
        (7, 100, 3)
    """
    if count < 0 or segments < 1:
        raise ConfigError("winds", f"need a count >= 0 and segments >= 1, got {count} and {segments}")
    limits = wind_limits(study)
    grid = WindGrid.of(study, segments, smooth=limits.rate is not None)
    return WindSet(limits, grid).random_winds(count, np.random.default_rng(seed))


def wind_limits(study: Study) -> Limits:
    """The bounds that a study's wind declares; they must be certain numbers.

    Raises:
        ConfigError: The wind declares no bounds, they are uncertain, or both are 0, so that the wind never blows.
    """
    require_certain_wind(study)
    bounds = study.loop.wind.bounds
    if bounds is None:
        raise ConfigError("wind.kind", "this wind declares no bounds; use kind = 'bounded', or one that declares them")
    speed, vertical, rate = bounds(study.params({}).wind)
    if speed <= 0.0 and vertical <= 0.0:
        raise ConfigError("wind", "never blows; use kind = 'bounded' with the bounds of the wind")
    return Limits(float(speed), float(vertical), None if rate is None else float(rate))


def worst_wind_dataset(flights: WindFlights, worst_flights: dict[str, WorstFlight]) -> xr.Dataset:
    """The dataset of :class:`WorstWind`: values, uncertain numbers and wind of the worst flight, by signal.

    Args:
        flights: The compiled study.
        worst_flights: The worst flight of each signal, by name.
    """
    worst_values = np.array([worst.value for worst in worst_flights.values()])
    candidates = np.array([worst.candidate for worst in worst_flights.values()])
    variables: dict[str, tuple[object, np.ndarray, dict[str, str]]] = {
        "worst": ("signal", worst_values, unit_and_meaning(UNIT_OF_SIGNAL, "worst value found")),
        "candidate": ("signal", candidates, unit_and_meaning(UNIT_OF_SIGNAL, "worst value of the candidates")),
    }
    for name in flights.numbers:
        quantity = flights.study.quantities[name]
        values = np.array([float(worst.point.numbers[name][0]) for worst in worst_flights.values()])
        variables[name] = ("signal", values, unit_and_meaning(quantity.unit, quantity.meaning))
    for index, axis in enumerate(AXES):
        winds = np.stack([worst.point.winds[0, :, index] for worst in worst_flights.values()])  # 0: the only point
        attributes = unit_and_meaning("m/s", f"worst wind along {axis}")
        variables[f"wind_{axis}"] = (("signal", "time"), winds, attributes)
    coords = {
        "signal": ("signal", list(worst_flights), unit_and_meaning("", "signal, by the name of its metric")),
        "time": ("time", flights.grid.times, unit_and_meaning("s", "time of the wind's vector")),
    }
    return xr.Dataset(variables, coords=coords, attrs={"title": flights.study.name})
