"""Draws of a study at any values of chosen numbers, by one compiled program: what searches over a number stand on."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax import requirements
from dssc_jax.engine import BLOCK, Arrays, Engine, Lane, drawn, evaluate, simulated
from dssc_jax.errors import ConfigError
from dssc_jax.study import Study
from dssc_jax.types import Scalar

CODES = ("outcome", "failed_at", "settled_at")  # results without a derivative
WHICH = "which number's tangent"  # the place of a lane's number among those that a probe differentiates by


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
        self.engine = self.compiled()

    def compiled(self) -> Engine:
        """The program that all batches share."""
        return Engine(self.swept, self.lanes)

    def drawn(self, draws: slice) -> Arrays:
        """Values of the laws that are left, for a range of draws."""
        return drawn(self.swept, draws)

    def __call__(self, indices: np.ndarray, values: Mapping[str, np.ndarray]) -> Arrays:
        """Metrics, margins and outcome of each lane.

        Args:
            indices: Draw of each lane, shape (n,).
            values: Every law's and every probed number's value, each of shape (n,).
        """
        return evaluate(self.engine, {name: values[name] for name in self.engine.names}, indices)


@dataclass
class SteepProbe(Probe):
    """A probe that also computes the derivative of every metric and margin with respect to some of the numbers.

    The derivatives are further results, see :func:`derivative`. Forward mode: each lane is computed once for each
    number, with the tangent of that one; memory does not grow with the duration. Reverse mode: a pass back for each
    metric and margin, whatever the count of numbers; the state is kept at some sqrt(steps) samples, and what is between
    is computed again.

    Args:
        names: The numbers.
        reverse: Reverse mode.

    Reference:
        A. Griewank, A. Walther, "Algorithm 799: revolve", ACM TOMS 26 (2000) 19-45: checkpoints.
    """

    names: Sequence[str] = ()
    reverse: bool = False

    def compiled(self) -> Engine:
        """The program with derivatives."""
        if self.reverse:
            return Engine(self.swept, self.lanes, program=partial(backward, names=self.names))
        lanes = min(BLOCK, self.lanes * len(self.names))
        return Engine(self.swept, lanes, program=partial(forward, names=self.names), extra=(WHICH,))

    def __call__(self, indices: np.ndarray, values: Mapping[str, np.ndarray]) -> Arrays:
        """As of a probe, and the derivatives."""
        if self.reverse:
            return super().__call__(indices, values)
        count, size = len(indices), len(self.names)
        tiled = {name: np.tile(values[name], size) for name in self.engine.names if name != WHICH}
        found = super().__call__(np.tile(indices, size), tiled | {WHICH: np.repeat(np.arange(size), count)})
        results = {}
        for of, column in found.items():
            own, end, _ = of.partition(derivative("", ""))
            if end:
                rows = column.reshape(size, count)
                results |= {derivative(own, name): row for name, row in zip(self.names, rows, strict=True)}
            else:
                results[of] = column[:count]
        return results


def smooth(plain: Lane, values: Mapping[str, jax.Array], index: jax.Array) -> Callable[[Any], tuple[Any, Any]]:
    """A lane's metrics and margins as a function of some of its numbers; beside them everything that it computes."""

    def moved(numbers: dict[str, jax.Array]) -> tuple[dict[str, Scalar], dict[str, Scalar]]:
        found = plain({**values, **numbers}, index)
        return {name: value for name, value in found.items() if name not in CODES}, found

    return moved


def forward(study: Study, names: Sequence[str]) -> Lane:
    """The program in forward mode, along the one number whose place each lane tells."""
    plain = simulated(study)

    def lane(values: dict[str, jax.Array], index: jax.Array) -> dict[str, Scalar]:
        own = {name: value for name, value in values.items() if name != WHICH}
        numbers = {name: own[name] for name in names}
        tangent = {name: jnp.where(values[WHICH] == i, 1.0, 0.0) for i, name in enumerate(names)}
        _, slopes, found = jax.jvp(smooth(plain, own, index), (numbers,), (tangent,), has_aux=True)
        return found | {derivative(of, ""): slope for of, slope in slopes.items()}

    return lane


def backward(study: Study, names: Sequence[str]) -> Lane:
    """The program in reverse mode: a pass back for each metric and margin."""
    plain = simulated(study, together=None, segment=math.isqrt(study.loop.steps))

    def lane(values: dict[str, jax.Array], index: jax.Array) -> dict[str, Scalar]:
        numbers = {name: values[name] for name in names}
        slopes, found = jax.jacrev(smooth(plain, values, index), has_aux=True)(numbers)
        return found | {derivative(of, name): slope for of, row in slopes.items() for name, slope in row.items()}

    return lane


def derivative(of: str, name: str) -> str:
    """The result that holds the derivative of a metric or margin with respect to a number."""
    return f"{of}|{name}"


def require_independent(study: Study, purpose: str) -> None:
    """Require independent draws, for statements that order statistics and exact tests make of them.

    Raises:
        ConfigError: the study's draws are points of a design.
    """
    kind = study.config.sampling
    if kind != "random":
        raise ConfigError(study.source, f"{purpose} needs independent draws: sampling = 'random', got '{kind}'")


def worst_margin(study: Study, results: Arrays) -> np.ndarray:
    """:func:`dssc_jax.requirements.worst_margin` of a study."""
    return requirements.worst_margin(study.requirements, results)
