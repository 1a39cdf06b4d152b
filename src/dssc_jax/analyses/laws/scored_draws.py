"""The scores of a result's draws, and simulations of the draws that a changed law of the scores gives."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import special

from dssc_jax.core.signals import Outcome, ProgressCallback
from dssc_jax.engine.batching import BLOCK, Engine, evaluate
from dssc_jax.engine.sampling import inside, mixing, unit_points, values_at_levels
from dssc_jax.results.result import Result
from dssc_jax.study import Study


def scores_of(study: Study, indices: np.ndarray) -> np.ndarray:
    """The scores of draws, correlated as the study says, shape (n, laws)."""
    return special.ndtri(unit_points(study, indices)) @ mixing(study).T


@dataclass
class ScoredDraws:
    """The draws of a result in the space of scores.

    Args:
        result: The result, without a sweep.
    """

    result: Result
    scores: np.ndarray = field(init=False)
    failed: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.scores = scores_of(self.result.study, self.result.dataset["draw"].values)
        self.failed = self.result.failed.values

    @property
    def names(self) -> list[str]:
        """The numbers whose laws can be changed: those with a location and a width."""
        return [name for name, law in self.result.study.laws.items() if law.movable]

    @cached_property
    def precision(self) -> np.ndarray:
        """The inverse of the scores' correlation matrix, shape (laws, laws)."""
        matrix = mixing(self.result.study)
        return np.linalg.inv(matrix @ matrix.T)

    def free(self, names: list[str]) -> np.ndarray:
        """Which of the laws have these names, shape (laws,)."""
        return np.isin(list(self.result.study.laws), names)


@dataclass
class FreshDraws:
    """New draws that are simulated under changed laws; the same ones for every change.

    Args:
        study: The study, without a sweep.
        start: Index of the first draw; earlier ones are those of the result.
        count: Number of draws.
        progress: Called with the simulations done.
    """

    study: Study
    start: int
    count: int
    progress: ProgressCallback | None = None

    def __post_init__(self) -> None:
        self.simulated = 0

    @cached_property
    def indices(self) -> np.ndarray:
        """The draws, shape (count,)."""
        return np.arange(self.start, self.start + self.count)

    @cached_property
    def scores(self) -> np.ndarray:
        """Their scores under the study's laws, shape (count, laws)."""
        return scores_of(self.study, self.indices)

    @cached_property
    def engine(self) -> Engine:
        """The compiled study."""
        return Engine(self.study, min(BLOCK, self.count))

    def failures(self, scores: np.ndarray) -> int:
        """How many of the draws fail with these scores, shape (count, laws)."""
        values = values_at_levels(self.study, inside(special.ndtr(scores)))
        outcomes = evaluate(self.engine, values, self.indices)["outcome"]
        self.simulated += self.count
        if self.progress:
            self.progress(self.simulated, None)
        return int(np.count_nonzero(outcomes != Outcome.OK))
