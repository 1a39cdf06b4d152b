"""The draws of a study as standard normal scores: every law is transformed into the standard normal law."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from dssc_jax.engine.sampling import score_mixing_matrix, unit_points
from dssc_jax.statistics.any_failures import AnyFailures
from dssc_jax.statistics.law_changes import Change
from dssc_jax.statistics.worst_changes import WeightedDraws
from dssc_jax.study import Study


def scores_of(study: Study, indices: np.ndarray) -> np.ndarray:
    """Standard normal scores of draws, correlated as the study declares.

    Args:
        study: The study.
        indices: Indices of the draws, shape (n,).

    Returns:
        The score of each draw for each law, shape (n, laws).
    """
    independent_scores = special.ndtri(unit_points(study, indices))
    return independent_scores @ score_mixing_matrix(study).T


@dataclass(frozen=True)
class ScoredDraws:
    """The scores of all draws of a study without a sweep, and which of the draws failed.

    Args:
        study: The study.
        scores: Score of each draw for each law, shape (n, laws).
        failed: Whether each draw failed, shape (n,).
    """

    study: Study
    scores: np.ndarray
    failed: np.ndarray

    @classmethod
    def of(cls, study: Study, failed: np.ndarray) -> "ScoredDraws":
        """Compute the scores of a study's draws; ``failed`` tells whether each draw failed, shape (n,)."""
        return cls(study, scores_of(study, np.arange(len(failed))), failed)

    @property
    def names(self) -> list[str]:
        """Names of the numbers whose laws can be shifted and widened."""
        return [name for name, law in self.study.laws.items() if law.movable]

    @cached_property
    def precision(self) -> np.ndarray:
        """The inverse of the scores' correlation matrix, shape (laws, laws)."""
        matrix = score_mixing_matrix(self.study)
        return np.linalg.inv(matrix @ matrix.T)

    def free(self, names: list[str]) -> np.ndarray:
        """Whether each law belongs to a number among ``names``, and so may change, shape (laws,)."""
        return np.isin(list(self.study.laws), names)

    def weighted(self, family: type[Change], confidence: float) -> WeightedDraws:
        """The draws in a form that gives them weights if all laws change that can be shifted and widened.

        Args:
            family: The family of changes, such as a shift of the means.
            confidence: Confidence of the statements that follow from the weights.
        """
        return WeightedDraws(family(self.precision), self.scores, self.failed, self.free(self.names), confidence)

    def bounds(self, interval: tuple[float, float]) -> AnyFailures:
        """Bounds of the failure probability under changed laws that hold for every set of failing draws.

        Args:
            interval: Interval of the failure probability under the present laws.
        """
        return AnyFailures(self.precision, interval)
