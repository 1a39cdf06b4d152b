"""A failure probability from strata along the border of failure that a pilot's draws predict.

The strata are ranges of the predicted slack, narrow near the border. Their probabilities follow from the prediction
alone, on Sobol nets, without a simulation. Fresh draws in each stratum give its share of failures: many where the
prediction is in doubt, elsewhere just enough to show that hardly any fails. The estimate has no bias, and the
interval holds, however bad the prediction is: then it takes as many draws as plain Monte Carlo.
"""

from dataclasses import dataclass

import numpy as np

from dssc_jax.analyses.probability.surrogate import Surrogate
from dssc_jax.analyses.rare_events.estimate import Counter, SlackFunction
from dssc_jax.core.numerics import stream
from dssc_jax.engine.sampling import generator, inside_cube, sobol_points
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.statistics.stratified import allocate_draws, stratified_interval

PILOT = 256  # plain draws
MOST_EXTRA_DRAWS = 512  # largest number of draws near the border that improve the prediction
DRAWS_PER_EXTRA_DRAW = 8  # planned draws in the strata for each of these
BAND = 4  # ratio of the sample's points nearest to the border to these, which are spread over them
SAMPLE = 2**14  # points whose predictions decide the strata
NETS = 16
NET_POINTS = 2**12  # points of a net
NARROW_NET_POINTS = 2**14  # the same for a narrow interval
NARROW_WIDTH = 0.01  # an interval asked to be narrower is narrow
FIRST_MASS = 0.01  # probability of the two strata at the border
GROWTH = 2.5  # ratio of a stratum's probability to that of its neighbour at the border
RESERVE = 1.0  # ratio of the width that the draws aim at to the one asked


@dataclass(frozen=True)
class StratifiedEstimate:
    """A failure probability from strata.

    Args:
        simulations: All simulations: those of the prediction and those of the strata.
        weights: Probability of each stratum from each net, shape (nets, strata).
        failures: Failed draws of each stratum, shape (strata,).
        draws: Draws of each stratum, shape (strata,).
        edges: Scaled predicted slacks between the strata, shape (strata - 1,).
    """

    simulations: int
    weights: np.ndarray
    failures: np.ndarray
    draws: np.ndarray
    edges: np.ndarray

    @property
    def probability(self) -> float:
        """The failure probability."""
        return float(self.weights.mean(axis=0) @ (self.failures / self.draws))

    def interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Its interval; see :func:`dssc_jax.statistics.stratified.stratified_interval`."""
        return stratified_interval(self.weights, self.failures, self.draws, confidence)


def strata_edges(predictions: np.ndarray) -> np.ndarray:
    """Edges of strata whose probabilities grow on both sides of a prediction of 0."""
    sorted_predictions = np.sort(predictions)
    count = len(sorted_predictions)
    border = int(np.searchsorted(sorted_predictions, 0.0))
    positions = {border}
    for direction in (-1, 1):
        mass = FIRST_MASS * count
        place = border + direction * mass
        while mass < 0.9 * count and mass < place < count - mass:
            positions.add(int(place))
            mass *= GROWTH
            place += direction * mass
    inner_positions = sorted(place for place in positions if 0 < place < count)
    return np.unique(sorted_predictions[inner_positions])


def stratified_probability(
    slack: SlackFunction, dimension: int, seeds: tuple[int, ...], width: float, most: int
) -> StratifiedEstimate:
    """Estimate a failure probability with an interval of about a given width.

    Args:
        slack: Computes slacks of points of the unit cube, shape (n, d), with noise indices (n,).
        dimension: d.
        seeds: Seeds of the random numbers.
        width: Upper minus lower limit for which the number of draws is chosen.
        most: Largest number of draws in the strata, which may leave the interval wider.
    """
    counter = Counter(slack)
    rng = generator(*seeds, stream("strata"))
    points = inside_cube(rng.random((PILOT, dimension)))
    surrogate = Surrogate(points, counter(points, counter.fresh(PILOT)), np.ones(PILOT))
    sample = inside_cube(rng.random((SAMPLE, dimension)))
    edges, draws = planned_strata(surrogate, surrogate(sample), width, most)
    extra_draws = min(MOST_EXTRA_DRAWS, int(draws.sum()) // DRAWS_PER_EXTRA_DRAW)
    if extra_draws > PILOT // 4:  # otherwise they would add at most a quarter to the pilot
        surrogate = improved(surrogate, sample, extra_draws, counter)
        sample = inside_cube(rng.random((SAMPLE, dimension)))
        edges, draws = planned_strata(surrogate, surrogate(sample), width, most)
    strata = len(draws)
    size = NARROW_NET_POINTS if width < NARROW_WIDTH else NET_POINTS
    weights = np.empty((NETS, strata))
    for net in range(NETS):
        predictions = surrogate(inside_cube(sobol_points(dimension, 0, size, (*seeds, stream("strata"), net))))
        weights[net] = np.bincount(np.searchsorted(edges, predictions), minlength=strata) / size
    stratum_points, stratum = points_in_strata(surrogate, edges, draws, dimension, rng)
    failed = counter(stratum_points, counter.fresh(len(stratum_points))) < 0.0
    failures = np.bincount(stratum[failed], minlength=strata)
    return StratifiedEstimate(counter.simulations, weights, failures, draws, edges)


def improved(surrogate: Surrogate, sample: np.ndarray, extra_draws: int, counter: Counter) -> Surrogate:
    """The prediction with further draws near the predicted border, chosen from a plain sample.

    Within the band from which they are chosen, all draws together count as often as the pilot's are expected to.
    """
    distances = np.abs(surrogate(sample))
    nearest = np.argsort(distances)[: BAND * extra_draws]
    border_points = sample[nearest[::BAND]]
    points = np.concatenate([surrogate.points, border_points])
    slacks = np.concatenate([surrogate.slacks, counter(border_points, counter.fresh(extra_draws))])
    expected_in_band = PILOT * len(nearest) / len(sample)
    in_band = np.abs(surrogate(points)) <= distances[nearest[-1]]
    return Surrogate(points, slacks, np.where(in_band, expected_in_band / (expected_in_band + extra_draws), 1.0))


def planned_strata(
    surrogate: Surrogate, predictions: np.ndarray, width: float, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """Edges of the strata, and the number of draws in each."""
    edges = strata_edges(predictions)
    stratum = np.searchsorted(edges, predictions)
    weights = np.bincount(stratum, minlength=len(edges) + 1) / len(predictions)
    shares = np.bincount(stratum, surrogate.failing(predictions), len(edges) + 1) / (weights * len(predictions))
    return edges, allocate_draws(weights, shares, RESERVE * width, most)


def points_in_strata(
    surrogate: Surrogate, edges: np.ndarray, draws: np.ndarray, dimension: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Independent points of the unit cube, a fixed number in each stratum, and their strata."""
    missing = draws.copy()
    points = []
    strata = []
    while missing.any():
        candidates = inside_cube(rng.random((SAMPLE, dimension)))
        stratum = np.searchsorted(edges, surrogate(candidates))
        for index in np.flatnonzero(missing):
            members = np.flatnonzero(stratum == index)[: missing[index]]
            points.append(candidates[members])
            strata.append(np.full(len(members), index))
            missing[index] -= len(members)
    return np.concatenate(points), np.concatenate(strata)
