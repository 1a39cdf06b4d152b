"""The search for the worst wind of each signal: candidates, then steps towards the extreme wind of the gradient.

The height of a signal is its value with the sign that makes a larger height worse. A climb raises the height.

The method is due to Frank and Wolfe: a step goes from the present wind towards the extreme wind, which maximises the
linearised signal over all winds within the bounds. For a nearly linear loop the whole step is the best, and the result
switches where the gradient changes its sign, as Pontryagin's principle says of the worst disturbance.

Reference:
    M. Frank, P. Wolfe, "An algorithm for quadratic programming", Naval Research Logistics Quarterly 3 (1956) 95-110.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.falsification.search_sets import SEARCH_EDGE
from dssc_jax.analyses.worst_wind.flights import WindFlights
from dssc_jax.analyses.worst_wind.wind_set import WindSet
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import medians
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study.laws import Law

RANDOM = 1024
"""Number of random winds among the candidates."""
STARTS = 2
"""Number of candidates of each kind, resonant and random, from which the climb of each signal starts."""
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)
"""Lengths of the steps towards the extreme wind that are tried, as shares of the way."""
LEAST_GAIN = 3e-4
"""Relative improvement below which a climb ends."""


class Points(NamedTuple):
    """Points of the search, each of which defines a flight: n winds, each with values of the uncertain numbers.

    Args:
        winds: The winds [m/s], shape (n, size, 3).
        numbers: Value of each uncertain number, shape (n,) each.
    """

    winds: np.ndarray
    numbers: Arrays

    def select(self, places: np.ndarray) -> "Points":
        """The points at the indices ``places``."""
        return Points(self.winds[places], {name: column[places] for name, column in self.numbers.items()})

    def replace(self, places: np.ndarray, replacements: "Points") -> "Points":
        """A copy of the points, with ``replacements`` at the indices ``places``."""
        winds = np.array(self.winds)
        winds[places] = replacements.winds
        numbers = {name: np.array(column) for name, column in self.numbers.items()}
        for name, column in replacements.numbers.items():
            numbers[name][places] = column
        return Points(winds, numbers)


def join_points(parts: list[Points]) -> Points:
    """The points of several sets, one set after the other."""
    numbers = {}
    for name in parts[0].numbers:
        numbers[name] = np.concatenate([part.numbers[name] for part in parts])
    return Points(np.concatenate([part.winds for part in parts]), numbers)


def number_ranges(laws: dict[str, Law], names: list[str]) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of each uncertain number that the search can move, by name.

    A choice between a few values cannot be moved. A law without ends is cut at its levels 1e-6 and 1 - 1e-6.

    Args:
        laws: The laws of a study, by name.
        names: Names of the uncertain numbers.
    """
    ranges = {}
    for name in names:
        law = laws[name]
        if not law.movable:
            continue
        low, high = law.support
        if not (np.isfinite(low) and np.isfinite(high)):
            low, high = law.quantile(np.array([SEARCH_EDGE, 1.0 - SEARCH_EDGE]))
        ranges[name] = (float(low), float(high))
    return ranges


class WorstFlight(NamedTuple):
    """The worst flight found for a signal.

    Args:
        value: Worst value of the signal; +-inf if the flight ends early.
        candidate: Worst value among the candidates, before any climb.
        point: The wind and the uncertain numbers of the flight, a single point.
    """

    value: float
    candidate: float
    point: Points


class Climbs(NamedTuple):
    """Climbs that advance together, each towards the worst value of a signal.

    Args:
        signals: Name of the signal of each climb, n names.
        points: The point that each climb has reached.
        heights: Height of the climb's signal at each point, shape (n,).
    """

    signals: list[str]
    points: Points
    heights: np.ndarray


@dataclass
class Ascent:
    """The search for the worst wind of each signal; :meth:`run` runs it.

    Args:
        flights: The compiled study.
        winds: The set of winds within the bounds.
        signals: Names of the signals to drive to their worst.
        rounds: Largest number of steps of a climb.
        rng: Random generator of the candidates.
        progress: Called with the rounds done and their largest number.
        flown: Number of flights so far.
        differentiated: Number of derivatives so far: flights, times the numbers by which each was differentiated.
    """

    flights: WindFlights
    winds: WindSet
    signals: list[str]
    rounds: int
    rng: np.random.Generator
    progress: ProgressCallback | None = None
    flown: int = field(default=0, init=False)
    differentiated: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        """Find the ranges in which the search can move uncertain numbers."""
        self.ranges = number_ranges(self.flights.compiled_study.laws, self.flights.numbers)

    def run(self) -> dict[str, WorstFlight]:
        """Search for the worst flight of each signal, by name of the signal."""
        candidates = self.first_climbs()
        tops = self.climb(candidates)
        worst_flights = {}
        for name in self.signals:
            places = np.array([place for place, signal in enumerate(candidates.signals) if signal == name])
            top = places[np.argmax(tops.heights[places])]
            sign = self.flights.signals[name].sign
            worst_flights[name] = WorstFlight(
                value=sign * float(tops.heights[top]),
                candidate=sign * float(candidates.heights[places].max()),
                point=tops.points.select(np.array([top])),
            )
        return worst_flights

    def first_climbs(self) -> Climbs:
        """The starts of the climbs: for each signal, the worst resonant and the worst random candidates."""
        candidate_sets = [self.candidates(winds) for winds in self.first_winds()]
        signals: list[str] = []
        starts: list[Points] = []
        start_heights: list[np.ndarray] = []
        for candidates in candidate_sets:
            heights = self.heights(candidates)
            for name in self.signals:
                worst = np.argsort(-heights[name], kind="stable")[:STARTS]
                signals += [name] * len(worst)
                starts.append(candidates.select(worst))
                start_heights.append(heights[name][worst])
        return Climbs(signals, join_points(starts), np.concatenate(start_heights))

    def first_winds(self) -> list[np.ndarray]:
        """The winds of the candidates [m/s], by kind: resonant winds, then random winds, shape (n, size, 3) each."""
        return [self.winds.resonant_winds(), self.winds.random_winds(RANDOM, self.rng)]

    def report(self, rounds: int) -> None:
        """Report the rounds done, and their largest number; the candidates count as one round."""
        if self.progress:
            self.progress(rounds, self.rounds + 1)

    def candidates(self, winds: np.ndarray) -> Points:
        """Candidates with given winds: each wind with the median vehicle, then each wind with a random extreme vehicle.

        An extreme vehicle has a random end of each number's range, or a random value of a number that the search cannot
        move. Without uncertain numbers there is only the median vehicle.

        Args:
            winds: The winds [m/s], shape (n, size, 3).
        """
        count = len(winds)
        laws = self.flights.compiled_study.laws
        middle = medians(self.flights.compiled_study)
        median_points = Points(winds, {name: np.full(count, middle[name]) for name in self.flights.numbers})
        if not self.flights.numbers:
            return median_points
        corners = {}
        for name in self.flights.numbers:
            random_values = laws[name].quantile(self.rng.uniform(SEARCH_EDGE, 1.0 - SEARCH_EDGE, count))
            corners[name] = self.rng.choice(self.ranges[name], count) if name in self.ranges else random_values
        return join_points([median_points, Points(winds, corners)])

    def heights(self, points: Points) -> Arrays:
        """Fly at n points, and return the height of each signal by name, shape (n,) each; inf for an early end."""
        self.flown += len(points.winds)
        results = self.flights(points.winds, points.numbers)
        return {name: self.flights.signals[name].sign * results[name] for name in self.signals}

    def climb(self, climbs: Climbs) -> Climbs:
        """Carry out climbs in rounds, and return where they end.

        In each round every climb steps towards the extreme wind of its signal's gradient. A climb ends when a round
        improves its height by too little, or when its flight ends early, which is the worst that can happen.
        """
        points = climbs.points
        heights = np.array(climbs.heights)
        active = np.flatnonzero(np.isfinite(heights))  # the climbs that go on
        for finished_rounds in range(self.rounds):
            self.report(finished_rounds + 1)
            if not active.size:
                break
            active_signals = [climbs.signals[place] for place in active]
            trials, trial_heights = self.best_trials(active_signals, points.select(active))
            gains = trial_heights - heights[active]
            relative_gains = gains / np.maximum(np.abs(heights[active]), np.finfo(float).tiny)
            is_higher = trial_heights > heights[active]
            risen = active[is_higher]
            points = points.replace(risen, trials.select(np.flatnonzero(is_higher)))
            heights[risen] = trial_heights[is_higher]
            active = active[(relative_gains > LEAST_GAIN) & np.isfinite(heights[active])]
        self.report(self.rounds + 1 if active.size else self.rounds)  # an early end of all climbs leaves one round open
        return Climbs(climbs.signals, points, heights)

    def best_trials(self, signals: list[str], points: Points) -> tuple[Points, np.ndarray]:
        """Fly the trial points of a step from each of n points, and choose the trial point with the largest height.

        Args:
            signals: The signal of each point, n names.
            points: The n points.

        Returns:
            The n best trial points, and the height of the signal at each, shape (n,).
        """
        count = len(signals)
        trial_sets = self.trials(signals, points)
        trials = join_points(trial_sets)  # one set of n points after the other
        heights = self.heights(trials)
        heights_by_set = np.empty((len(trial_sets), count))
        for row, signal in enumerate(signals):
            heights_by_set[:, row] = heights[signal].reshape(len(trial_sets), count)[:, row]
        best_set = np.argmax(heights_by_set, axis=0)
        rows = np.arange(count)
        return trials.select(best_set * count + rows), heights_by_set[best_set, rows]

    def trials(self, signals: list[str], points: Points) -> list[Points]:
        """The trial points of a step from each of n points, towards the extreme wind of the signal's gradient.

        The worst moment of a flight may come before the end of the flight. The last trial delays the extreme wind until
        the worst moment is at the end, so that more wind can precede it.

        Args:
            signals: The signal of each point, n names.
            points: The n points.

        Returns:
            Sets of n points each: one set for each of :data:`SHARES`, at this share of the way to the extreme wind and
            numbers; the extreme wind with the present numbers; and the delayed extreme wind with the extreme numbers.
        """
        slopes = self.flights.with_slopes(points.winds, points.numbers, signals)
        self.differentiated += len(signals) * (len(self.flights.grid.names) + len(self.flights.numbers))
        signs = np.array([self.flights.signals[name].sign for name in signals])
        wind_slopes = signs[:, None, None] * slopes.wind
        number_slopes = {name: signs * column for name, column in slopes.numbers.items()}
        extreme_winds = self.winds.extreme_winds(wind_slopes, points.winds)
        extreme = Points(extreme_winds, self.extreme_numbers(number_slopes, points.numbers))
        delayed_winds = self.winds.follow(postpone(extreme.winds, wind_slopes))
        return [
            *(interpolate(points, extreme, share) for share in SHARES),
            Points(extreme.winds, points.numbers),
            Points(delayed_winds, extreme.numbers),
        ]

    def extreme_numbers(self, slopes: Arrays, numbers: Arrays) -> Arrays:
        """Each uncertain number at the end of its range towards which the signal gets worse, shape (n,) each.

        A number without an effect stays, and so does a number that the search cannot move.

        Args:
            slopes: Derivatives of the height by each number, shape (n,) each.
            numbers: The present values, shape (n,) each.
        """
        extreme = dict(numbers)
        for name, (low, high) in self.ranges.items():
            has_effect = slopes[name] != 0.0
            worse_end = np.where(slopes[name] > 0.0, high, low)
            extreme[name] = np.where(has_effect, worse_end, numbers[name])
        return extreme


def interpolate(points: Points, extreme: Points, share: float) -> Points:
    """Points at a share of the way from ``points`` (share 0) to ``extreme`` (share 1)."""
    winds = (1.0 - share) * points.winds + share * extreme.winds
    numbers = {}
    for name, column in points.numbers.items():
        numbers[name] = (1.0 - share) * column + share * extreme.numbers[name]
    return Points(winds, numbers)


def postpone(winds: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Delay winds so that the last vector with an effect comes last in the flight, shape (n, size, 3).

    The later vectors, which have no effect, move to the beginning of the flight.

    Args:
        winds: The winds [m/s], shape (n, size, 3).
        slopes: Derivatives of a signal by the winds, shape (n, size, 3); 0 for a vector without an effect.
    """
    delayed_winds = np.array(winds)
    size = winds.shape[1]
    for index, slope in enumerate(slopes):
        effective = np.flatnonzero(np.any(slope != 0.0, axis=1))
        if effective.size:
            delay = size - 1 - effective[-1]
            delayed_winds[index] = np.roll(winds[index], delay, axis=0)
    return delayed_winds
