"""New draws that are simulated under changed laws."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from dssc_jax.core.signals import Outcome, ProgressCallback
from dssc_jax.engine.batching import BLOCK, Engine, evaluate
from dssc_jax.engine.sampling import inside_cube, values_at_levels
from dssc_jax.results.scored_draws import scores_of
from dssc_jax.study import Study


@dataclass
class FreshDraws:
    """New draws that are simulated under changed laws. Every change sees the same draws.

    Args:
        study: The study, without a sweep.
        start: Index of the first new draw; the result has the draws with smaller indices.
        count: Number of draws.
        progress: Called with the simulations done.
    """

    study: Study
    start: int
    count: int
    progress: ProgressCallback | None = None

    def __post_init__(self) -> None:
        """Set the count of simulations to 0; it covers all changes together."""
        self.simulated = 0

    @cached_property
    def indices(self) -> np.ndarray:
        """Indices of the draws, shape (count,)."""
        return np.arange(self.start, self.start + self.count)

    @cached_property
    def scores(self) -> np.ndarray:
        """Standard normal scores of the draws under the study's laws, shape (count, laws)."""
        return scores_of(self.study, self.indices)

    @cached_property
    def engine(self) -> Engine:
        """The compiled study, which simulates the draws."""
        return Engine(self.study, min(BLOCK, self.count))

    def count_failures(self, scores: np.ndarray) -> int:
        """Simulate the draws with changed scores, shape (count, laws), and count the failures.

        Changing the score has the same effect as changing the law: the draw takes the value that the study's own law
        has at the changed score.
        """
        levels = inside_cube(special.ndtr(scores))
        outcomes = evaluate(self.engine, values_at_levels(self.study, levels), self.indices)["outcome"]
        self.simulated += self.count
        if self.progress:
            self.progress(self.simulated, None)  # the total is not known
        return int(np.count_nonzero(outcomes != Outcome.OK))
