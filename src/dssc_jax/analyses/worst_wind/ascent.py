"""The search for the worst wind of each signal: candidates, then steps towards the extreme wind of the gradient.

The method is that of Frank and Wolfe: a step goes from the present wind towards the one that maximises the linearised
signal over all winds within the bounds. For a loop that is nearly linear the whole step is the best one, and the result
switches where the gradient changes its sign, as Pontryagin's principle says of the worst disturbance.

Reference:
    M. Frank, P. Wolfe, "An algorithm for quadratic programming", Naval Research Logistics Quarterly 3 (1956) 95-110.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.falsification.search_sets import SEARCH_EDGE
from dssc_jax.analyses.worst_wind.flights import Slopes, WindFlights
from dssc_jax.analyses.worst_wind.wind_set import WindSet
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import medians
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study.laws import Law

RANDOM = 1024
"""Random switching winds among the candidates."""
STARTS = 2
"""Winds of each kind, resonant and random, from which each signal is improved."""
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)
"""Steps towards the extreme wind that are tried, as shares of the way."""
LEAST_GAIN = 3e-4
"""Relative improvement below which a climb ends."""


class Points(NamedTuple):
    """Winds with values of the uncertain numbers.

    Args:
        winds: Shape (n, size, 3) [m/s].
        numbers: Value of each uncertain number, shape (n,) each.
    """

    winds: np.ndarray
    numbers: Arrays

    def selected(self, places: np.ndarray) -> "Points":
        """Some of the points."""
        return Points(self.winds[places], {name: column[places] for name, column in self.numbers.items()})

    def replaced(self, places: np.ndarray, replacements: "Points") -> "Points":
        """The points with others at some places."""
        winds = np.array(self.winds)
        winds[places] = replacements.winds
        numbers = {name: np.array(column) for name, column in self.numbers.items()}
        for name, column in replacements.numbers.items():
            numbers[name][places] = column
        return Points(winds, numbers)


def joined(parts: list[Points]) -> Points:
    """All points of several sets."""
    names = parts[0].numbers
    numbers = {name: np.concatenate([part.numbers[name] for part in parts]) for name in names}
    return Points(np.concatenate([part.winds for part in parts]), numbers)


def box_of(laws: dict[str, Law], names: list[str]) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of each uncertain number that can move; laws without ends are cut at a small level."""
    box = {}
    for name in names:
        if not laws[name].movable:
            continue
        ends = laws[name].quantile(np.array([SEARCH_EDGE, 1.0 - SEARCH_EDGE]))
        support = np.array(laws[name].support)
        low, high = support if np.all(np.isfinite(support)) else ends
        box[name] = (float(low), float(high))
    return box


class Worst(NamedTuple):
    """What the search has found of one signal.

    Args:
        value: The worst value; +-inf if the flight ends early.
        candidate: The worst value among the candidates.
        point: The wind and the numbers, a single point.
    """

    value: float
    candidate: float
    point: Points


@dataclass
class Ascent:
    """A search in progress.

    Args:
        flights: The study, compiled.
        winds: The winds within the bounds.
        signals: Names of the signals to drive to their worst.
        rounds: Most steps of a climb.
        rng: Random generator of the candidates.
        progress: Called with the rounds done.
        flown: Flights so far.
        differentiated: Flights with the derivative along one number so far.
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
        self.box = box_of(self.flights.flying.laws, self.flights.numbers)

    def run(self) -> dict[str, Worst]:
        """The worst wind of each signal."""
        kinds = [self.candidates(winds) for winds in self.first_winds()]
        names: list[str] = []
        starts: list[Points] = []
        columns: list[np.ndarray] = []
        for kind in kinds:
            heights = self.heights(kind)
            for name in self.signals:
                worst = np.argsort(-heights[name], kind="stable")[:STARTS]
                names += [name] * len(worst)
                starts.append(kind.selected(worst))
                columns.append(heights[name][worst])
        points = joined(starts)
        best = np.concatenate(columns)
        first = np.array(best)
        points, best = self.climb(names, points, best)
        worst_points = {}
        for name in self.signals:
            places = np.array([place for place, signal in enumerate(names) if signal == name])
            top = places[np.argmax(best[places])]
            sign = self.flights.signals[name].sign
            candidate = float(first[places].max())
            worst_points[name] = Worst(sign * float(best[top]), sign * candidate, points.selected(np.array([top])))
        return worst_points

    def report(self, rounds: int) -> None:
        """Tell how many rounds are done; the candidates count as one."""
        if self.progress:
            self.progress(rounds, self.rounds + 1)

    def first_winds(self) -> list[np.ndarray]:
        """The winds to begin with, by their kind: resonant ones and random ones, shape (n, size, 3) each."""
        return [self.winds.resonant(), self.winds.switching(RANDOM, self.rng)]

    def candidates(self, winds: np.ndarray) -> Points:
        """Winds with the median vehicle; with uncertain numbers, each also with a corner of the box."""
        count = len(winds)
        laws = self.flights.flying.laws
        middle = medians(self.flights.flying)
        median_points = Points(winds, {name: np.full(count, middle[name]) for name in self.flights.numbers})
        if not self.flights.numbers:
            return median_points
        corners = {}
        for name in self.flights.numbers:
            random_values = laws[name].quantile(self.rng.uniform(SEARCH_EDGE, 1.0 - SEARCH_EDGE, count))
            corners[name] = self.rng.choice(self.box[name], count) if name in self.box else random_values
        return joined([median_points, Points(winds, corners)])

    def heights(self, points: Points) -> Arrays:
        """Each signal at some points, signed so that more is worse, shape (n,) each."""
        self.flown += len(points.winds)
        results = self.flights(points.winds, points.numbers)
        return {name: self.flights.signals[name].sign * results[name] for name in self.signals}

    def climb(self, names: list[str], points: Points, best: np.ndarray) -> tuple[Points, np.ndarray]:
        """Improve each point for its own signal, all at once.

        Args:
            names: The signal of each point, shape (n,).
            points: Where to begin.
            best: The signal's height there, shape (n,).

        Returns:
            The points reached, and their heights.
        """
        active = np.flatnonzero(np.isfinite(best))
        for finished_rounds in range(self.rounds):
            self.report(finished_rounds + 1)
            if not active.size:
                break
            signals = [names[place] for place in active]
            trials = self.trials(signals, points.selected(active))
            heights = self.heights(joined(trials))
            rows = np.array([heights[signal].reshape(len(trials), -1)[:, i] for i, signal in enumerate(signals)])
            best_trials = np.argmax(rows, axis=1)
            trial_heights = rows[np.arange(len(active)), best_trials]
            better = trial_heights > best[active]
            improved_points = active[better]
            places = np.flatnonzero(better)
            for step, place in zip(best_trials[better], places, strict=True):
                points = points.replaced(active[[place]], trials[step].selected(np.array([place])))
            gains = (trial_heights - best[active]) / np.maximum(np.abs(best[active]), np.finfo(float).tiny)
            best = np.array(best)
            best[improved_points] = trial_heights[better]
            active = active[(gains > LEAST_GAIN) & np.isfinite(best[active])]
        self.report(self.rounds + 1 if active.size else self.rounds)
        return points, best

    def trials(self, signals: list[str], points: Points) -> list[Points]:
        """Steps of each point towards the extreme wind and vehicle of its signal's gradient, and that wind later.

        A flight's worst moment may come before its end. The last trial moves the extreme wind, so that this moment
        becomes the last one and more wind can precede it.
        """
        slopes = self.flights.with_slopes(points.winds, points.numbers, signals)
        self.differentiated += len(signals) * (3 * self.winds.grid.size + len(self.flights.numbers))
        signs = np.array([self.flights.signals[name].sign for name in signals])
        signed_slopes = Slopes(
            signs[:, None, None] * slopes.wind, {n: signs * column for n, column in slopes.numbers.items()}
        )
        extreme = Points(self.winds.extreme(signed_slopes.wind, points.winds), self.corners(signed_slopes, points))
        trials = [between(points, extreme, share) for share in SHARES]
        trials.append(Points(extreme.winds, points.numbers))
        trials.append(Points(self.winds.within(postponed(extreme.winds, signed_slopes.wind)), extreme.numbers))
        return trials

    def corners(self, signed_slopes: Slopes, points: Points) -> Arrays:
        """Each number at the end of its range towards which the signal rises; the present value if the slope is 0."""
        numbers = dict(points.numbers)
        for name, (low, high) in self.box.items():
            slope = signed_slopes.numbers[name]
            numbers[name] = np.where(slope > 0.0, high, np.where(slope < 0.0, low, points.numbers[name]))
        return numbers


def between(points: Points, extreme: Points, share: float) -> Points:
    """Points at a share of the way to others."""
    winds = (1.0 - share) * points.winds + share * extreme.winds
    numbers = {}
    for name, column in points.numbers.items():
        numbers[name] = (1.0 - share) * column + share * extreme.numbers[name]
    return Points(winds, numbers)


def postponed(winds: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Winds postponed until the last vector with a slope is the last of the wind, shape (n, size, 3) all.

    The first vectors are then those that came last, which had no effect.
    """
    moved_winds = np.array(winds)
    for row, (wind, slope) in enumerate(zip(winds, slopes, strict=True)):
        effective = np.flatnonzero(np.any(slope != 0.0, axis=1))
        if effective.size:
            moved_winds[row] = np.roll(wind, len(wind) - 1 - effective[-1], axis=0)
    return moved_winds
