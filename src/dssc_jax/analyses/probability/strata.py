"""A failure probability from strata along the border of failure that a pilot's draws predict.

The strata are ranges of the predicted slack, narrow near the border. Their probabilities follow from the prediction
alone, on Sobol nets, without a simulation. Fresh draws in each stratum give its share of failures: many where the
prediction is in doubt, elsewhere just enough to show that hardly any fails. The estimate has no bias, and the
interval holds, however bad the prediction is: then it takes as many draws as plain Monte Carlo.
"""

from dataclasses import dataclass

import numpy as np

from dssc_jax.analyses.probability.surrogate import Surrogate
from dssc_jax.analyses.slacks import SlackCounter, SlackFunction
from dssc_jax.core.numerics import stream
from dssc_jax.engine.sampling import generator, inside_cube, sobol_points
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.statistics.stratified import allocate_draws, stratified_interval

PILOT = 256  # plain draws from which the slack is predicted
MOST_EXTRA_DRAWS = 512  # largest number of extra draws near the border, which improve the prediction
DRAWS_PER_EXTRA_DRAW = 8  # planned draws in the strata for each extra draw
BAND = 4  # every BAND-th of the points nearest to the border is an extra draw
SAMPLE = 2**14  # points whose predictions decide the strata
NETS = 16  # independent Sobol nets, each of which estimates the strata's probabilities
NET_POINTS = 2**12  # points of a net
NARROW_NET_POINTS = 2**14  # points of a net, if the interval is to be narrower than NARROW_WIDTH
NARROW_WIDTH = 0.01
FIRST_MASS = 0.01  # probability of each of the two strata at the border
GROWTH = 2.5  # probability of a stratum over its neighbour's, which is nearer to the border
RESERVE = 1.0  # ratio of the width that the draws aim at to the width that was asked for


@dataclass(frozen=True)
class StratifiedEstimate:
    """A failure probability from the failed draws in each of several strata, whose probabilities are known.

    Args:
        simulations: Number of simulations, for the prediction and in the strata.
        weights: Probability of each stratum, computed from each of several Sobol nets, shape (nets, strata).
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
        """The failure probability: the sum of the strata's shares of failures, weighted by their probabilities."""
        return float(self.weights.mean(axis=0) @ (self.failures / self.draws))

    def interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """The interval of the failure probability (:func:`dssc_jax.statistics.stratified.stratified_interval`)."""
        return stratified_interval(self.weights, self.failures, self.draws, confidence)


def strata_edges(predictions: np.ndarray) -> np.ndarray:
    """Edges of strata in the predicted slack, in ascending order: fine near 0, coarse far from it.

    The edge at the border of failure is the smallest prediction that is not negative. Away from the border in both
    directions, each stratum is more probable than its neighbour nearer to the border.

    Args:
        predictions: Predicted slacks of a plain sample, shape (n,).

    Returns:
        The edges, shape (strata - 1,); each is a prediction of the sample.
    """
    sorted_predictions = np.sort(predictions)
    count = len(sorted_predictions)
    border = int(np.searchsorted(sorted_predictions, 0.0))
    positions = {border}
    for direction in (-1, 1):  # towards failing, towards passing draws
        mass = FIRST_MASS * count  # points in the next stratum
        place = border + direction * mass
        while mass < 0.9 * count and mass < place < count - mass:
            positions.add(int(place))
            mass *= GROWTH
            place += direction * mass
    inner_positions = sorted(place for place in positions if 0 < place < count)
    return np.unique(sorted_predictions[inner_positions])


def stratified_probability(
    slack: SlackFunction, dimension: int, seeds: tuple[int, ...], width: float, most_draws: int
) -> StratifiedEstimate:
    """Estimate a failure probability with an interval of about a given width, by strata of a predicted slack.

    Plain draws give the prediction. If many draws are planned for the strata, extra draws near the predicted border of
    failure improve the prediction first.

    Args:
        slack: Computes slacks at points of the unit cube.
        dimension: Number d of coordinates of a point.
        seeds: Seeds of the random numbers.
        width: Upper minus lower limit for which the number of draws is chosen.
        most_draws: Largest number of draws in the strata, which may leave the interval wider.
    """
    counter = SlackCounter(slack)
    rng = generator(*seeds, stream("strata"))
    points = inside_cube(rng.random((PILOT, dimension)))
    surrogate = Surrogate(points, counter(points, counter.unused_noise(PILOT)), np.ones(PILOT))
    sample = inside_cube(rng.random((SAMPLE, dimension)))
    edges, draws = plan_strata(surrogate, surrogate(sample), width, most_draws)
    extra_draws = min(MOST_EXTRA_DRAWS, int(draws.sum()) // DRAWS_PER_EXTRA_DRAW)
    if extra_draws > PILOT // 4:  # otherwise they would add at most a quarter to the pilot
        surrogate = improve_surrogate(surrogate, sample, extra_draws, counter)
        sample = inside_cube(rng.random((SAMPLE, dimension)))
        edges, draws = plan_strata(surrogate, surrogate(sample), width, most_draws)
    size = NARROW_NET_POINTS if width < NARROW_WIDTH else NET_POINTS
    weights = np.empty((NETS, len(draws)))
    for net in range(NETS):
        net_points = inside_cube(sobol_points(dimension, 0, size, (*seeds, stream("strata"), net)))
        weights[net] = stratum_counts(edges, surrogate(net_points)) / size
    stratum_points, stratum = points_in_strata(surrogate, edges, draws, dimension, rng)
    failed = counter(stratum_points, counter.unused_noise(len(stratum_points))) < 0.0
    failures = np.bincount(stratum[failed], minlength=len(draws))
    return StratifiedEstimate(
        simulations=counter.simulations, weights=weights, failures=failures, draws=draws, edges=edges
    )


def stratum_counts(edges: np.ndarray, predictions: np.ndarray) -> np.ndarray:
    """Count the points in each stratum, shape (strata,); a stratum includes its upper edge.

    Args:
        edges: Edges of the strata, shape (strata - 1,).
        predictions: Predicted slack of each point, shape (n,).
    """
    return np.bincount(np.searchsorted(edges, predictions), minlength=len(edges) + 1)


def improve_surrogate(surrogate: Surrogate, sample: np.ndarray, extra_draws: int, counter: SlackCounter) -> Surrogate:
    """Fit the prediction again, with extra draws in a band around the predicted border.

    The band contains the points of the sample that are nearest to the border; every :data:`BAND`-th of them is an extra
    draw. All draws in the band together get the weight that the pilot's draws alone are expected to have there, so that
    the dense draws do not count too much.

    Args:
        surrogate: The prediction from the pilot's draws.
        sample: Plain points of the unit cube, shape (n, d).
        extra_draws: Number of extra draws.
        counter: Computes the slacks of the extra draws.
    """
    distances = np.abs(surrogate(sample))
    nearest = np.argsort(distances)[: BAND * extra_draws]
    border_points = sample[nearest[::BAND]]
    points = np.concatenate([surrogate.points, border_points])
    slacks = np.concatenate([surrogate.slacks, counter(border_points, counter.unused_noise(extra_draws))])
    is_in_band = np.abs(surrogate(points)) <= distances[nearest[-1]]
    expected_pilot_draws = PILOT * len(nearest) / len(sample)  # draws of the pilot expected in the band
    weight_in_band = expected_pilot_draws / (expected_pilot_draws + extra_draws)
    return Surrogate(points, slacks, np.where(is_in_band, weight_in_band, 1.0))


def plan_strata(
    surrogate: Surrogate, predictions: np.ndarray, width: float, most_draws: int
) -> tuple[np.ndarray, np.ndarray]:
    """Choose the strata of a prediction, and the number of draws in each that gives the interval its width.

    Args:
        surrogate: The prediction.
        predictions: Predicted slacks of a plain sample, shape (n,).
        width: Width of the interval to reach.
        most_draws: Largest number of draws.

    Returns:
        The edges of the strata, shape (strata - 1,), and the number of draws in each, shape (strata,).
    """
    edges = strata_edges(predictions)
    stratum = np.searchsorted(edges, predictions)
    weights = stratum_counts(edges, predictions) / len(predictions)
    expected_failures = np.bincount(stratum, surrogate.failure_probability(predictions), len(edges) + 1)
    failing_shares = expected_failures / (weights * len(predictions))
    return edges, allocate_draws(weights, failing_shares, RESERVE * width, most_draws)


def points_in_strata(
    surrogate: Surrogate, edges: np.ndarray, draws: np.ndarray, dimension: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draw independent points of the unit cube by rejection, until each stratum has a fixed number of points.

    Args:
        surrogate: The prediction.
        edges: Edges of the strata, shape (strata - 1,).
        draws: Number of points in each stratum, shape (strata,).
        dimension: Number d of coordinates.
        rng: Random generator.

    Returns:
        The points, shape (n, d), and the index of the stratum of each, shape (n,).
    """
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
