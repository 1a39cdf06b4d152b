"""The linearised loop on parts of the box as a linear function of its numbers, with a bound of the deviations.

The bound comes from deviations that are measured at points of the part and widened, so it is no proof.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import schur

from dssc_jax.analyses.worst_loop.family import Evaluate

WIDENED = 1.5
"""Factor of the measured deviations from a linear dependence, since those between the points may be larger."""
CORNERED = 4  # largest number of sides with which the deviations are measured at all corners and edges
RANDOM_CORNERS = 32  # random corners at which the deviations are measured with more sides
MOST_PARALLEL = 1e6  # largest condition number of the matrix of modes


class LinearModel(NamedTuple):
    """M = [[A, B], [C, 0]] of the loop on a part of the box, as centre + sum of u_i slopes_i + E, u_i in [-1, 1].

    The states are the modes of the loop in the middle of the part.

    Args:
        centre: M in the middle, shape (m, m).
        slopes: Half the change of M across the part along each side, shape (sides, m, m).
        deviation: A bound of abs(E), entry by entry, shape (m, m): the largest deviation measured at some points, times
            :data:`WIDENED`.
        bends: The part of the measured deviation that comes from each side alone, shape (sides, m, m).
    """

    centre: np.ndarray
    slopes: np.ndarray
    deviation: np.ndarray
    bends: np.ndarray


def measurement_points(sides: int) -> np.ndarray:
    """Points of [-1, 1]^sides at which deviations from a linear dependence are measured, shape (n, sides).

    :func:`linear_model` relies on the order of the points: the centre, the middles of the upper faces, the middles of
    the lower faces, then the points halfway from the centre to each of these. With at most :data:`CORNERED` sides all
    corners and all middles of edges follow; with more sides, the corners of the square of each pair of sides, and
    random corners.
    """
    unit = np.eye(sides)
    points = [np.zeros((1, sides)), unit, -unit, 0.5 * unit, -0.5 * unit]
    if sides <= CORNERED:
        steps = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=sides)))
        is_corner_or_edge = np.count_nonzero(steps, axis=1) >= max(2, sides - 1)
        points.append(steps[is_corner_or_edge])
    else:
        for i, j in itertools.combinations(range(sides), 2):
            first = unit[[i]]
            second = unit[[j]]
            points += [first + second, first - second, second - first, -first - second]
        points.append(np.random.default_rng(0).choice([-1.0, 1.0], (RANDOM_CORNERS, sides)))
    return np.concatenate(points)


class LinearModels:
    """The linear models of a loop on parts of the box, each computed once.

    Args:
        evaluate: (points) -> M = [[A, B], [C, 0]] of the loop there.
        channels: Columns of B.
    """

    def __init__(self, evaluate: Evaluate, channels: int) -> None:
        """Start without a model; each is computed when it is first needed."""
        self.evaluate = evaluate
        self.channels = channels
        self.models: dict[bytes, LinearModel] = {}

    def on(self, lows: np.ndarray, highs: np.ndarray) -> list[LinearModel]:
        """The model of each of n parts of the box; one call of ``evaluate`` serves all parts that are new.

        Args:
            lows: Lower corner of each part, shape (n, sides).
            highs: Upper corner of each part, shape (n, sides).
        """
        keys = [low.tobytes() + high.tobytes() for low, high in zip(lows, highs, strict=True)]
        new_parts = {key: index for index, key in enumerate(keys) if key not in self.models}  # each once
        if new_parts:
            indices = list(new_parts.values())
            unit_points = measurement_points(lows.shape[1])
            middle = 0.5 * (lows + highs)[indices, None]
            half_widths = 0.5 * (highs - lows)[indices, None]
            points = middle + half_widths * unit_points  # shape (new parts, points of each, sides)
            matrices = self.evaluate(points.reshape(-1, points.shape[-1]))
            for key, matrices_of_part in zip(new_parts, np.split(matrices, len(indices)), strict=True):
                self.models[key] = linear_model(unit_points, matrices_of_part, self.channels)
        return [self.models[key] for key in keys]


def linear_model(points: np.ndarray, matrices: np.ndarray, channels: int) -> LinearModel:
    """Fit a linear model to the loop on a part of the box, and bound the deviation of the model from the loop.

    The bound follows from deviations that are measured at the points, widened by :data:`WIDENED`.

    Args:
        points: The points of :func:`measurement_points`, shape (n, sides).
        matrices: M = [[A, B], [C, 0]] of the loop at these points of the part, shape (n, m, m).
        channels: Columns of B.
    """
    sides = points.shape[1]
    upper_faces = slice(1, 1 + sides)
    lower_faces = slice(1 + sides, 1 + 2 * sides)
    halfway = slice(1 + 2 * sides, 1 + 3 * sides)
    matrices = to_modes(matrices, channels)
    centre = matrices[0]
    slopes = 0.5 * (matrices[upper_faces] - matrices[lower_faces])
    deviations = np.abs(matrices - centre - np.einsum("ni,ijk->njk", points, slopes))
    bends = np.maximum(deviations[upper_faces], 4.0 * deviations[halfway])  # a parabola is 4 times as far at the face
    deviation = np.maximum(deviations.max(axis=0), bends.sum(axis=0))
    return LinearModel(centre, slopes, WIDENED * deviation, bends)


def stack_models(models: Sequence[LinearModel]) -> LinearModel:
    """The fields of n linear models, each stacked along a new first dimension."""
    return LinearModel(
        centre=np.stack([model.centre for model in models]),
        slopes=np.stack([model.slopes for model in models]),
        deviation=np.stack([model.deviation for model in models]),
        bends=np.stack([model.bends for model in models]),
    )


def to_modes(matrices: np.ndarray, channels: int) -> np.ndarray:
    """Transform matrices [[A, B], [C, 0]] so that the modes of the first A become the states, shape (n, m, m) both.

    If the modes are nearly parallel, the Schur vectors of the first A are used instead. If the first A is not finite,
    it has no modes, and the states are not changed.
    """
    result = matrices.astype(complex)
    a = matrices[0, :-channels, :-channels]
    if not np.all(np.isfinite(a)):
        return result
    _, modes = np.linalg.eig(a)
    if np.linalg.cond(modes) > MOST_PARALLEL:
        modes = schur(a, output="complex")[1]
    result[:, :-channels] = np.linalg.solve(modes, result[:, :-channels])
    result[:, :, :-channels] = result[:, :, :-channels] @ modes
    return result
