"""Fits of a log with a part that the study lacks: which one explains the residual best, and the estimates with it.

The number of the part joins the least squares. Steps of Gauss and Newton go from the best of some sizes, weighted by
the noise of the fit without the part. Both fits then have the noise of their residual, and the logarithms of their
likelihoods tell whether the part is there. Parts have one number each, so that their likelihoods compare as they are.

References:
    R. E. Kass, A. E. Raftery, "Bayes factors", Journal of the American Statistical Association 90 (1995) 773-795.
"""

import math
from copy import copy
from typing import NamedTuple

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.fit.flown_course import Flight
from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.missing_parts import Part
from dssc_jax.flight_logs.fit.prediction import Prediction
from dssc_jax.flight_logs.fit.shifts import likelihood_of_cost, linear_cost
from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.statistics.correlated_noise import Noise, weighted_products

STEPS = 6  # of Gauss and Newton
HALVINGS = 4  # of a step that does not lower the sum of squares
DIFFERENCE = 1e-3  # relative step of the derivative by a size
STRONG_EVIDENCE = 10.0  # difference of twice the log likelihood, "very strong" on the scale of Kass and Raftery (1995)
LEAST_SCREENED = 4.0  # gain of twice the log likelihood under the noise without a part, below which it is not there


class PartPoint(NamedTuple):
    """A point of the least squares with a part.

    Args:
        x: Coordinates of the numbers, shape (p,).
        scale: Unit s of the part's size, such as the first size that is tried.
        scaled: The scaled size z. The size is s exp(z) if only positive sizes are possible, else s z.
    """

    x: np.ndarray
    scale: float
    scaled: float


class FitWithoutPart(NamedTuple):
    """What all fits with a part are compared with.

    Args:
        minimum: The minimum without a part.
        likelihood: Logarithm of the likelihood there, under its noise.
        simulated: What simulated disturbances and winds add to the outputs; None if the study has none.
        candidates: Number of parts that are tried, not counting those with many choices.
        starts: Coordinates of the numbers from which fits with a part begin, shape (p,) each.
    """

    minimum: Minimum
    likelihood: float
    simulated: np.ndarray | None
    candidates: int
    starts: tuple[np.ndarray, ...]


def fit_without_part(
    problem: FitProblem, minimum: Minimum, candidates: int, starts: tuple[np.ndarray, ...]
) -> FitWithoutPart:
    """What fits with one of several candidates are compared with.

    Args:
        problem: The problem of one channel, with the noise of its minimum.
        minimum: The minimum.
        candidates: Number of parts that are tried, not counting those with many choices.
        starts: Coordinates of the numbers from which fits with a part begin, shape (p,) each.
    """
    (readings,) = problem.readings
    (columns,) = problem.columns(minimum.x)
    products, log_det = weighted_products(problem.noises[0], readings.times, columns)
    likelihood = likelihood_of_cost(readings, linear_cost(products), log_det)
    simulated = problem.disturbances.simulate(
        problem.study, problem.names, problem.values(minimum.x), problem.log.commands
    )
    return FitWithoutPart(minimum, likelihood, simulated, candidates, starts)


class PartFit(NamedTuple):
    """The fit of a log with a part.

    Args:
        part: The part.
        size: Its size.
        deviation: Standard deviation of the size.
        x: Coordinates of the numbers with it, shape (p,).
        gain: What the part adds to twice the logarithm of the likelihood, less twice the logarithm of the number of
            choices from which it is the likeliest.
        p_value: Largest probability that any of the parts has as large a gain if none is there.
        residual: Root mean square of the residual with the part.
        noise: Noise of that residual.
    """

    part: Part
    size: float
    deviation: float
    x: np.ndarray
    gain: float
    p_value: float
    residual: float
    noise: Noise


class PartProblem:
    """The least squares of a log of one channel with a part that the study lacks.

    Args:
        problem: The problem without the part, with the noise of its minimum.
        flight: The flight.
        part: The part.
    """

    def __init__(self, problem: FitProblem, flight: Flight, part: Part) -> None:
        self.problem = problem
        self.flight = flight
        self.part = part

    def size(self, point: PartPoint) -> float:
        """The size of the part at a point."""
        return point.scale * (math.exp(point.scaled) if self.part.is_positive else point.scaled)

    def is_possible(self, point: PartPoint) -> bool:
        """Whether the numbers at a point are in their ranges, and a size that has to be positive means something.

        Sizes of either sign are judged after the fit alone.
        """
        size = self.size(point)
        in_range = self.problem.is_admissible(self.problem.values(point.x))
        return in_range and (not self.part.is_positive or self.part.is_possible(self.flight, size))

    def columns(self, point: PartPoint) -> np.ndarray:
        """The residual at a point, and the prediction's slopes by numbers and scaled size, as columns, (n, 2 + p)."""
        columns = self.residual_columns(point)
        moved = self.residual_columns(point._replace(scaled=point.scaled + DIFFERENCE))
        return np.column_stack([columns, (columns[:, 0] - moved[:, 0]) / DIFFERENCE])

    def residual_columns(self, point: PartPoint) -> np.ndarray:
        """The residual at a point, and the prediction's slopes by the numbers, as columns, shape (n, 1 + p)."""
        problem = copy(self.problem)
        problem.predict = self.prediction(point)
        (columns,) = problem.columns(point.x, self.commands(point), self.forces(point))
        return columns

    def prediction(self, point: PartPoint) -> Prediction:
        """The prediction of what the log shows of the output: late or filtered, if the part does that."""
        shown = self.part.outputs
        if shown is None:
            return self.problem.predict
        samples = self.size(point) / self.flight.sample_time

        def predict(
            values: np.ndarray, commands: np.ndarray, forces: np.ndarray | None = None
        ) -> tuple[np.ndarray, np.ndarray]:
            """The predicted output and its slopes, behind the part."""
            predicted, slopes = self.problem.predict(values, commands, forces)
            return shown(predicted, samples), shown(slopes, samples)

        return predict

    def commands(self, point: PartPoint) -> np.ndarray:
        """The commands that a plant with the part gets, shape (1, samples)."""
        return self.part.commands(self.flight, self.size(point))[None, :]

    def forces(self, point: PartPoint) -> np.ndarray | None:
        """The forces on a plant with the part, shape (samples,) [u]; None: the part is no force."""
        return self.part.forces_on(self.flight, self.size(point))

    def products(self, noise: Noise, columns: np.ndarray) -> np.ndarray:
        """Products of columns, shape (n, m), weighted by a noise, shape (m, m); infinite if a column is not finite."""
        (readings,) = self.problem.readings
        if not np.isfinite(columns).all():
            return np.full((columns.shape[1],) * 2, math.inf)
        return weighted_products(noise, readings.times, columns)[0]

    def start(self, x: np.ndarray) -> PartPoint:
        """The point at which the steps begin, for coordinates x of the numbers, shape (p,).

        For positive sizes it has the best of the first sizes, and numbers after one step with that size. Any other part
        begins at the size 0.
        """
        noise, variance = self.problem.noises[0], self.problem.variances[0]
        sizes = self.part.sizes(self.flight)
        if not self.part.is_positive:
            return PartPoint(x, sizes[0], 0.0)
        costs = []
        points = []
        for size in sizes:
            point = PartPoint(x, size, 0.0)
            products = self.products(noise, self.residual_columns(point)) / variance
            step = bounded_step(products, self.problem.prior, x, len(x))
            cost = linear_cost(products) if np.isfinite(products).all() else math.inf
            costs.append(cost)
            points.append(point._replace(x=x + step))
        return points[int(np.argmin(costs))]

    def deviation(self, point: PartPoint, products: np.ndarray) -> float:
        """The standard deviation of the size at a minimum.

        Args:
            point: The minimum.
            products: Weighted products of residual and slopes over the variance of the noise, shape (2 + p, 2 + p).
        """
        information = products[1:, 1:] + np.diag(np.append(self.problem.prior, 0.0))
        variance = float(np.linalg.pinv(information, hermitian=True)[-1, -1])
        slope = self.size(point) if self.part.is_positive else point.scale
        return abs(slope) * math.sqrt(max(variance, 0.0))

    def minimum(self, point: PartPoint, noise: Noise, variance: float) -> PartPoint:
        """The point after Gauss-Newton steps from a given point, each halved until it lowers the sum of squares.

        Args:
            point: The point at which the steps begin.
            noise: Noise by which residual and slopes are weighted.
            variance: Variance of the noise.
        """
        prior = np.append(self.problem.prior, 0.0)
        cost = self.cost(point, noise, variance)
        for _ in range(STEPS):
            products = self.products(noise, self.columns(point)) / variance
            if not np.isfinite(products).all():
                break
            bounded = len(point.x) + self.part.is_positive  # a size of either sign enters in proportion
            step = bounded_step(products, prior, np.append(point.x, 0.0), bounded)
            for _ in range(HALVINGS):
                trial = point._replace(x=point.x + step[:-1], scaled=point.scaled + float(step[-1]))
                if self.is_possible(trial):
                    trial_cost = self.cost(trial, noise, variance)
                    if trial_cost < cost:
                        break
                step = 0.5 * step
            else:
                break
            is_small = cost - trial_cost < 1e-3
            point, cost = trial, trial_cost
            if is_small:
                break
        return point

    def cost(self, point: PartPoint, noise: Noise, variance: float) -> float:
        """Weighted sum of squares at a point, with those of the numbers that keep their laws.

        Args:
            point: The point.
            noise: Noise by which the residual is weighted.
            variance: Variance of the noise.
        """
        products = self.products(noise, self.residual_columns(point)[:, :1])
        return float(products[0, 0]) / variance + float(self.problem.prior @ point.x**2)


def bounded_step(products: np.ndarray, prior: np.ndarray, x: np.ndarray, bounded: int) -> np.ndarray:
    """The Gauss-Newton step, shortened so that no bounded coordinate moves by more than 2, shape (p,).

    Args:
        products: Weighted products of residual and slopes over the variance, shape (1 + p, 1 + p).
        prior: Information of the laws that count, shape (p,).
        x: Coordinates, shape (p,).
        bounded: Number of bounded coordinates, which are the first ones.
    """
    if not np.isfinite(products).all():
        return np.zeros(len(prior))
    information = products[1:, 1:] + np.diag(prior)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), TINY))
    scaled = information * np.outer(scale, scale)
    step = scale * np.linalg.lstsq(scaled, scale * (products[1:, 0] - prior * x), rcond=1e-12)[0]
    return step * min(1.0, 2.0 / max(float(np.abs(step[:bounded]).max()), TINY))


def fitted_part(problem: FitProblem, without: FitWithoutPart, flight: Flight, part: Part) -> PartFit | None:
    """Fit a log with a part; None if the part does not lower the residual, or only with a size that means nothing.

    Args:
        problem: The problem of one channel, with the noise of its minimum.
        without: The fit without a part.
        flight: The flight.
        part: The part.
    """
    (readings,) = problem.readings
    noise, variance = problem.noises[0], problem.variances[0]
    part_problem = PartProblem(problem, flight, part)
    points = [part_problem.minimum(part_problem.start(x), noise, variance) for x in without.starts]
    point = min(points, key=lambda point: part_problem.cost(point, noise, variance))
    if without.minimum.cost - part_problem.cost(point, noise, variance) < LEAST_SCREENED:
        return None
    if not part.is_possible(flight, part_problem.size(point)):
        return None
    noise, fit = problem.noise_search(0, part_problem.columns(point), without.simulated).likeliest()
    point = part_problem.minimum(point, noise, fit.variance)
    columns = part_problem.columns(point)
    products, log_det = weighted_products(noise, readings.times, columns)
    gain = 2.0 * (likelihood_of_cost(readings, linear_cost(products), log_det) - without.likelihood)
    p_value = without.candidates * part.choices * float(stats.chi2.sf(max(gain, 0.0), 1))
    size = part_problem.size(point)
    if not math.isfinite(gain) or not part.is_possible(flight, size):
        return None
    return PartFit(
        part=part,
        size=size,
        deviation=part_problem.deviation(point, products / fit.variance),
        x=point.x,
        gain=gain - 2.0 * math.log(part.choices),
        p_value=min(1.0, p_value),
        residual=rms(columns[:, 0]),
        noise=noise,
    )
