"""Check the derivatives of the metrics against central differences, in the search's coordinates."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple, TypedDict

import numpy as np
from scipy.special import logit

from dssc_jax.analyses.tuning.problem import Problem
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.quantities import Quantity
from dssc_jax.engine.evaluation import Derivative
from dssc_jax.engine.sampling import Arrays

DIFFERENCE_STEP = 1e-5  # step of the differences
SEARCH_STEP = 0.03  # a typical step of a search, in its coordinates
PREDICTION_ERROR = 0.5  # relative error that is allowed in the prediction of such a step's effect
AGREEMENT = 1e-4  # largest relative difference of derivatives that agree
DIFFERENCE_NOISE = 1e-8  # rounding of a difference relative to the value, with three powers of ten of room
KINK = 1e-3  # least relative jump of the slope at a kink; curvature alone changes the slope by about the step
SHOWN = 5  # number of disagreements that are stored
INSET = 0.05  # share of an interval's logarithm that is left out at both ends


@dataclass(frozen=True)
class GradientAgreement:
    """How well the derivatives of metrics agree with differences, at random points along each coordinate.

    The "longer step" of ``predictive`` is 0.03 of a coordinate, a typical step of a search: in a loop that chatters,
    derivatives can be exact without predicting the effect of such a step. Points whose draw ended early are not
    compared. An entry of ``disagreeing`` has the metric, the number, the point and both slopes.
    """

    points: Annotated[int, Quantity("1", "random points, each with its own draw")]
    compared: Annotated[int, Quantity("1", "derivatives compared")]
    kinks: Annotated[float, Quantity("1", "share at which the slopes on the two sides differ")]
    agreeing: Annotated[float, Quantity("1", "share of the others that agrees to 1e-4")]
    useful: Annotated[float, Quantity("1", "share of all that agrees")]
    predictive: Annotated[float, Quantity("1", "share that predicts the effect of a longer step to within a half")]
    ended: Annotated[int, Quantity("1", "points whose draw ended early")]
    finite: Annotated[bool, Quantity("", "whether no derivative of a completed draw is NaN or infinite")]
    kinked: Annotated[dict[str, dict[str, float]], Quantity("1", "share of kinks of each metric along each number")]
    disagreeing: Annotated[list[JsonObject], Quantity("", "largest disagreements away from kinks")]

    @property
    def text(self) -> str:
        """The result in one line."""
        return (
            f"{100 * self.agreeing:.1f} % of {self.compared} derivatives agree with central differences to 1e-4 away "
            f"from kinks, which are {100 * self.kinks:.1f} %; {100 * self.predictive:.1f} % predict a longer step"
        )


class Shares(TypedDict):
    """The fields of :class:`GradientAgreement` that follow from a :class:`DerivativePair`."""

    kinks: float
    agreeing: float
    useful: float
    finite: bool


class DerivativePair(NamedTuple):
    """Derivatives and their approximations by central differences; each array is (metrics, points, tuned numbers).

    Args:
        exact: Derivatives.
        central: Central differences.
        kink: Whether forward and backward difference disagree, so that there is no derivative.
        agree: Whether derivative and central difference agree.
    """

    exact: np.ndarray
    central: np.ndarray
    kink: np.ndarray
    agree: np.ndarray

    @property
    def shares(self) -> Shares:
        """Share of kinks, shares of agreement away from kinks and overall, and whether every derivative is finite."""
        total = max(self.exact.size, 1)
        smooth = max(int(np.count_nonzero(~self.kink)), 1)
        return {
            "kinks": float(np.count_nonzero(self.kink) / total),
            "agreeing": float(np.count_nonzero(self.agree & ~self.kink) / smooth),
            "useful": float(np.count_nonzero(self.agree) / total),
            "finite": bool(np.isfinite(self.exact).all()),
        }

    def worst(self) -> list[tuple[int, ...]]:
        """Indices of the :data:`SHOWN` worst disagreements away from kinks, the largest relative difference first."""
        scale = np.maximum(np.abs(self.exact), np.abs(self.central))
        distance = np.abs(self.exact - self.central) / np.where(scale > 0.0, scale, 1.0)
        distance = np.nan_to_num(distance, nan=np.inf)  # a derivative that is not a number disagrees most
        places = [tuple(place) for place in np.argwhere(~self.agree & ~self.kink).tolist()]
        return sorted(places, key=lambda place: -distance[place])[:SHOWN]


def compare_derivatives(
    exact: np.ndarray, value: np.ndarray, forward: np.ndarray, backward: np.ndarray
) -> DerivativePair:
    """Compare derivatives with forward and backward differences: whether there is a kink, and whether they agree.

    All arrays have the same shape.

    Args:
        exact: Derivatives.
        value: Values, whose rounding limits the accuracy of the differences.
        forward: Forward differences.
        backward: Backward differences.
    """
    noise = DIFFERENCE_NOISE * np.abs(value)
    central = 0.5 * (forward + backward)
    larger_side = np.maximum(np.abs(forward), np.abs(backward))
    kink = np.abs(forward - backward) > KINK * larger_side + noise
    agree = np.abs(exact - central) <= AGREEMENT * np.maximum(np.abs(exact), np.abs(central)) + noise
    return DerivativePair(exact, central, kink, agree)


def check_gradients(problem: Problem, points: int, seed: int = 0) -> GradientAgreement:
    """Compare derivatives of metrics by the search's coordinates with central differences, at random points and draws.

    The points are uniform in the logarithms of the tuned numbers, over the middle 90 % of each interval's logarithm.

    Args:
        problem: The problem; its objective and limits determine the metrics.
        points: Number of points; each has one random draw.
        seed: Seed of the points.
    """
    rng = np.random.default_rng(seed)
    coordinates = problem.plan.coordinates
    tuned_count = len(coordinates.names)
    centre = logit(rng.uniform(INSET, 1.0 - INSET, (points, tuned_count)))
    draws = rng.choice(problem.train, points)
    shifts = coordinate_shifts(tuned_count)
    z = (centre + shifts[:, None, :]).reshape(-1, tuned_count)  # all points at the first shift, then all at the next
    lanes = {name: np.tile(column[draws], len(shifts)) for name, column in problem.laws.items()}
    lanes |= coordinates.numbers(z)
    results = problem.without_derivatives(np.tile(draws, len(shifts)), lanes)
    unshifted_lanes = {name: column[:points] for name, column in lanes.items()}
    derivatives = problem.with_derivatives(draws, unshifted_lanes)
    ended_early = np.isfinite(results["failed_at"]).reshape(len(shifts), points)
    is_complete = ~np.any(ended_early, axis=0)
    metrics = list(problem.plan.measures)
    values = np.stack([results[name].reshape(len(shifts), points)[:, is_complete] for name in metrics])
    exact = derivatives_by_coordinates(problem, metrics, derivatives, centre)[:, is_complete]
    differences = differences_of(values, tuned_count)
    comparison = compare_derivatives(exact, differences.value, differences.forward, differences.backward)
    predictive = is_predictive(exact, differences.value, differences.step_slope)
    count = int(np.count_nonzero(is_complete))
    tuned = {name: column[is_complete] for name, column in coordinates.tuned(centre).items()}
    return GradientAgreement(
        points=points,
        compared=comparison.exact.size,
        predictive=float(np.mean(predictive)) if predictive.size else 0.0,
        ended=points - count,
        kinked=kink_shares(comparison.kink, metrics, coordinates.names),
        disagreeing=[disagreement(comparison, place, metrics, tuned) for place in comparison.worst()],
        **comparison.shares,
    )


def kink_shares(kink: np.ndarray, metrics: Sequence[str], numbers: Sequence[str]) -> dict[str, dict[str, float]]:
    """Share of the points at which a metric has a kink along a tuned number, by metric and number; 0 without points.

    Args:
        kink: Whether there is a kink, shape (metrics, points, tuned numbers).
        metrics: Names of the metrics.
        numbers: Names of the tuned numbers.
    """
    shares = np.mean(kink, axis=1) if kink.shape[1] else np.zeros((len(metrics), len(numbers)))
    by_metric = {}
    for metric, row in zip(metrics, shares.tolist(), strict=True):
        by_metric[metric] = dict(zip(numbers, row, strict=True))
    return by_metric


def coordinate_shifts(tuned_count: int) -> np.ndarray:
    """Shifts of a point at which its metrics are computed, shape (1 + 4 tuned numbers, tuned numbers).

    The rows are in this order: no shift; a short step forward along each coordinate; a short step backward along each;
    a typical step of a search forward along each; such a step backward along each.
    """
    axes = np.eye(tuned_count)
    no_shift = np.zeros((1, tuned_count))
    return np.concatenate(
        [no_shift, DIFFERENCE_STEP * axes, -DIFFERENCE_STEP * axes, SEARCH_STEP * axes, -SEARCH_STEP * axes]
    )


def derivatives_by_coordinates(
    problem: Problem, metrics: Sequence[str], derivatives: Arrays, centre: np.ndarray
) -> np.ndarray:
    """Derivatives of metrics by the search's coordinates, shape (metrics, points, tuned numbers), by the chain rule.

    Args:
        problem: Objective and limits as functions of the search's coordinates.
        metrics: Names of the metrics.
        derivatives: Derivatives of the metrics by the loop's numbers at the points, by ``Derivative(metric, number)``,
            shape (points,) each.
        centre: Coordinates of the points, shape (points, tuned numbers).
    """
    number_slopes = problem.plan.coordinates.slopes(centre)
    rows = []
    for metric in metrics:
        terms = [derivatives[Derivative(metric, name)][:, None] * number_slopes[name] for name in problem.names]
        rows.append(np.sum(terms, axis=0))
    return np.stack(rows)


class Differences(NamedTuple):
    """Values of metrics at points, and their differences along the coordinates; shape (metrics, points, numbers) each.

    Args:
        value: Values at the points themselves, repeated along the coordinates.
        forward: Forward differences over a short step, per unit of the coordinate.
        backward: Backward differences over a short step, per unit of the coordinate.
        step_slope: Central differences over a typical step of a search, per unit of the coordinate.
    """

    value: np.ndarray
    forward: np.ndarray
    backward: np.ndarray
    step_slope: np.ndarray


def differences_of(values: np.ndarray, tuned_count: int) -> Differences:
    """The differences of metrics along the coordinates, from their values at shifted points.

    Args:
        values: Values at the :func:`coordinate_shifts` of each point, shape (metrics, shifts, points).
        tuned_count: Number of tuned numbers.
    """
    metrics, _, points = values.shape
    shifted = values[:, 1:].reshape(metrics, 4, tuned_count, points)  # 4: two lengths, each forward and backward
    higher, lower, step_higher, step_lower = shifted.transpose(1, 0, 3, 2)  # shape (metrics, points, numbers) each
    value = np.broadcast_to(values[:, 0, :, None], higher.shape)
    forward = (higher - value) / DIFFERENCE_STEP
    backward = (value - lower) / DIFFERENCE_STEP
    return Differences(value, forward, backward, (step_higher - step_lower) / (2.0 * SEARCH_STEP))


def is_predictive(exact: np.ndarray, value: np.ndarray, step_slope: np.ndarray) -> np.ndarray:
    """Whether each derivative predicts the effect of a typical step of a search; all arrays have the same shape.

    Args:
        exact: Derivatives.
        value: Values, whose rounding limits the accuracy of the differences.
        step_slope: Central differences over a typical step of a search.
    """
    tolerance = PREDICTION_ERROR * np.maximum(np.abs(exact), np.abs(step_slope)) + DIFFERENCE_NOISE * np.abs(value)
    return np.abs(exact - step_slope) <= tolerance


def disagreement(
    comparison: DerivativePair, place: tuple[int, ...], metrics: Sequence[str], tuned: Mapping[str, np.ndarray]
) -> JsonObject:
    """Describe one disagreement for JSON: metric, tuned number, point, derivative and central difference.

    Args:
        comparison: All derivatives and differences.
        place: Index of the metric, of the point and of the tuned number.
        metrics: Names of the metrics.
        tuned: The tuned numbers at the points, by name, each of shape (points,).
    """
    metric, point, number = place
    return {
        "metric": metrics[metric],
        "number": list(tuned)[number],
        "at": {name: float(column[point]) for name, column in tuned.items()},
        "derivative": float(comparison.exact[place]),
        "difference": float(comparison.central[place]),
    }
