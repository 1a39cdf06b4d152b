"""Draws of a study at any values of chosen numbers, by one compiled program: what searches over a number stand on."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from dssc_jax.engine import BLOCK, Arrays, Engine, drawn
from dssc_jax.study import Study
from dssc_jax.types import Outcome


@dataclass
class Probe:
    """A study whose ``extents`` are given anew with every batch.

    Args:
        study: The study; its own sweep is left aside.
        extents: Lowest and highest value of each number to come, checked like the ends of a sweep; a value takes the
            place of the number's law.
        lanes: Lanes of a batch at most.

    Raises:
        ConfigError: a name is no number of the loop, or an end is not admissible.
    """

    study: Study
    extents: Mapping[str, tuple[float, float]]
    lanes: int = BLOCK
    swept: Study = field(init=False)

    def __post_init__(self) -> None:
        axes = {name: sorted(set(extent)) for name, extent in self.extents.items()}
        self.swept = self.study.override({"sweep": axes})
        self.engine = Engine(self.swept, self.lanes)

    def drawn(self, draws: slice) -> Arrays:
        """Values of the laws that are left, for a range of draws."""
        return drawn(self.swept, draws)

    def __call__(self, indices: np.ndarray, values: Mapping[str, np.ndarray]) -> Arrays:
        """Metrics, margins and outcome of each lane.

        Args:
            indices: Draw of each lane, shape (n,), n <= lanes.
            values: Every law's and every probed number's value, each of shape (n,).
        """
        return self.engine(values, indices)()


def worst_margin(study: Study, results: Arrays) -> np.ndarray:
    """Smallest margin of all requirements, each relative to its bound: negative where a draw fails.

    A draw that ended early, or whose metric is no number, has -inf; without requirements every other one has +inf.
    """
    ended = (results["outcome"] != Outcome.OK) & (results["outcome"] < Outcome.REQUIREMENT)
    worst = np.where(ended, -np.inf, np.inf)
    for requirement in study.requirements:
        margin = results[requirement.name] / (abs(requirement.bound) or 1.0)
        worst = np.minimum(worst, np.where(np.isnan(margin), -np.inf, margin))
    return worst
