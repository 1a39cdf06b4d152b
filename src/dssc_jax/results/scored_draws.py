"""The draws of a study in the space of scores, where its laws are normal."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from dssc_jax.engine.sampling import mixing, unit_points
from dssc_jax.statistics.any_failures import AnyFailures
from dssc_jax.statistics.law_changes import Change
from dssc_jax.statistics.worst_changes import WeightedDraws
from dssc_jax.study import Study


def scores_of(study: Study, indices: np.ndarray) -> np.ndarray:
    """The scores of draws, correlated as the study says, shape (n, laws)."""
    return special.ndtri(unit_points(study, indices)) @ mixing(study).T


@dataclass(frozen=True)
class ScoredDraws:
    """The scores of all draws of a study without a sweep, and which of them failed.

    Args:
        study: The study.
        scores: Shape (n, laws).
        failed: Shape (n,).
    """

    study: Study
    scores: np.ndarray
    failed: np.ndarray

    @classmethod
    def of(cls, study: Study, failed: np.ndarray) -> "ScoredDraws":
        """The draws of a study, of which some failed, shape (n,)."""
        return cls(study, scores_of(study, np.arange(len(failed))), failed)

    @property
    def names(self) -> list[str]:
        """The numbers whose laws can be changed: those with a location and a width."""
        return [name for name, law in self.study.laws.items() if law.movable]

    @cached_property
    def precision(self) -> np.ndarray:
        """The inverse of the scores' correlation matrix, shape (laws, laws)."""
        matrix = mixing(self.study)
        return np.linalg.inv(matrix @ matrix.T)

    def free(self, names: list[str]) -> np.ndarray:
        """Whether each law has one of these names, shape (laws,)."""
        return np.isin(list(self.study.laws), names)

    def weighted(self, family: type[Change], confidence: float) -> WeightedDraws:
        """The draws with weights for changes of a family, of all laws that can be changed."""
        return WeightedDraws(family(self.precision), self.scores, self.failed, self.free(self.names), confidence)

    def bounds(self, interval: tuple[float, float]) -> AnyFailures:
        """What holds whatever draws fail, from the interval of the failure probability."""
        return AnyFailures(self.precision, interval)
