"""What is required of a run: signed margins, and the outcome code that follows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from dssc_jax.metrics import Measure
from dssc_jax.types import Outcome, Scalar


@dataclass(frozen=True)
class Requirement:
    """A bound of one measure. Exactly one of ``maximum`` and ``minimum`` is set, in the metric's unit."""

    measure: Measure
    maximum: float | None = None
    minimum: float | None = None

    @property
    def name(self) -> str:
        """Name of the margin in results; a lower bound says so."""
        return f"margin_{self.measure.name}{'' if self.maximum is not None else '_min'}"

    @property
    def bound(self) -> float:
        """The bound, whichever it is."""
        return self.maximum if self.maximum is not None else self.minimum  # type: ignore[return-value]

    @property
    def scale(self) -> float:
        """What margins are taken relative to where requirements are compared: |bound|, or 1 where that is 0."""
        return abs(self.bound) or 1.0

    @property
    def text(self) -> str:
        """The requirement as one reads it."""
        window, unit = self.measure.window, self.measure.unit
        side = f"<= {self.maximum:g}" if self.maximum is not None else f">= {self.minimum:g}"
        after = f" after {window.after:g} s" if window.after > 0 else ""
        return f"{self.measure.kind}{self.of_channel}{after} {side} {unit}".removesuffix(" 1")

    @property
    def of_channel(self) -> str:
        """The channel's suffix in the measure's name, if any."""
        rest = self.measure.name.removeprefix(self.measure.kind)
        return rest.split("_after_")[0].split("_within_")[0]

    def margin(self, value: Scalar) -> Scalar:
        """Distance to the bound, in the metric's unit: negative where the requirement fails."""
        if self.maximum is not None:
            return self.maximum - value
        return value - self.minimum  # type: ignore[operator]


def judge(
    requirements: tuple[Requirement, ...], values: dict[str, Scalar], ended: Scalar
) -> tuple[Scalar, dict[str, Scalar]]:
    """Outcome code (int32) and the margin of each requirement; -inf where the draw ended early.

    Args:
        requirements: The requirements, the first failing one gives the code.
        values: Every measure's value by name.
        ended: The code of the run itself: OK, or why it ended early.
    """
    alive = ended == Outcome.OK
    outcome = jnp.full((), Outcome.OK, dtype=jnp.int32)
    margins: dict[str, Scalar] = {}
    for index, requirement in reversed(list(enumerate(requirements))):
        margin = requirement.margin(values[requirement.measure.name])
        failed = ~(margin >= 0.0)
        outcome = jnp.where(failed, Outcome.REQUIREMENT + index, outcome)
        margins[requirement.name] = jnp.where(alive, margin, -jnp.inf)
    return jnp.where(alive, outcome, ended).astype(jnp.int32), margins


def worst_margin(requirements: Sequence[Requirement], results: Mapping[str, np.ndarray]) -> np.ndarray:
    """Smallest margin of all requirements, each relative to its bound: negative where a draw fails.

    A draw that ended early, or whose metric is no number, has -inf; without requirements every other one has +inf.

    Args:
        requirements: The requirements.
        results: Margins by name and ``outcome``, of any one shape.

    Returns:
        That shape.
    """
    ended = (results["outcome"] != Outcome.OK) & (results["outcome"] < Outcome.REQUIREMENT)
    worst = np.where(ended, -np.inf, np.inf)
    for requirement in requirements:
        margin = results[requirement.name] / requirement.scale
        worst = np.minimum(worst, np.where(np.isnan(margin), -np.inf, margin))
    return worst
