"""The slack of the worst requirement as a function of points, for methods that sample where draws fail."""

from collections.abc import Callable

import numpy as np

from dssc_jax.closed_loop.metrics.requirements import worst_slack
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import Engine, evaluate, is_noisy
from dssc_jax.engine.sampling import values_at
from dssc_jax.study import Study

LANES = 2048  # lanes of a batch

SlackFunction = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(points, shape (n, d); indices of the in-loop noise, shape (n,)) -> slacks, shape (n,); negative: failure.

The points are in the coordinates of a method: the unit cube, or standard normal space.
"""


class StudySlacks:
    """The worst requirement's slack of a study at points of the unit cube: a :data:`SlackFunction`.

    Args:
        study: The study, without a sweep.
        progress: Called with the number of simulations done, and None since their total is not known beforehand.
    """

    def __init__(self, study: Study, progress: ProgressCallback | None) -> None:
        """Compile the study for batches of :data:`LANES` draws."""
        self.study = study
        self.progress = progress
        self.engine = Engine(study, LANES)
        self.simulations = 0

    @property
    def noisy(self) -> bool:
        """Whether the loop has in-loop noise, so that two draws with the same numbers may differ."""
        return is_noisy(self.engine)

    def __call__(self, points: np.ndarray, noise_index: np.ndarray) -> np.ndarray:
        """Simulate one draw at each point, and return the slack of its worst requirement, shape (n,).

        Args:
            points: Points of the unit cube, shape (n, d).
            noise_index: Index of the in-loop noise of each draw, shape (n,).
        """
        results = evaluate(self.engine, values_at(self.study, points), noise_index)
        self.simulations += len(points)
        if self.progress:
            self.progress(self.simulations, None)  # the total is not known
        return worst_slack(self.study.requirements, results)


class SlackCounter:
    """A slack function that counts its evaluations, and hands out indices of in-loop noise that no point has used.

    Args:
        slack: Computes the slacks.
    """

    def __init__(self, slack: SlackFunction) -> None:
        """Start the counts of simulations and of noise indices at 0."""
        self.slack = slack
        self.simulations = 0
        self.noise_count = 0  # indices of in-loop noise provided so far

    def unused_noise(self, count: int) -> np.ndarray:
        """Return indices of in-loop noise that no point has used, shape (count,)."""
        first = self.noise_count
        self.noise_count += count
        return np.arange(first, self.noise_count)

    def __call__(self, points: np.ndarray, noise_index: np.ndarray) -> np.ndarray:
        """Compute the slack of each point, shape (n,).

        NaN becomes -inf: the simulation produced no slack, which is a failure.

        Args:
            points: Points in the coordinates of a method, shape (n, d).
            noise_index: Index of the in-loop noise of each point, shape (n,).
        """
        self.simulations += len(points)
        slacks = self.slack(points, noise_index)
        return np.where(np.isnan(slacks), -np.inf, slacks)
