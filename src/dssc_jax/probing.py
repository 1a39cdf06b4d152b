"""Draws of a study at any values of chosen numbers, by one compiled program: what searches over a number stand on."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import jax
import numpy as np

from dssc_jax import requirements
from dssc_jax.engine import BLOCK, Arrays, Engine, Lane, drawn, evaluate, simulated
from dssc_jax.errors import ConfigError
from dssc_jax.study import Study
from dssc_jax.types import Scalar


@dataclass
class Probe:
    """A study whose ``extents`` are given anew with every batch.

    Args:
        study: The study; its own sweep is left aside.
        extents: Lowest and highest value of each number to come, checked like the ends of a sweep; a value takes the
            place of the number's law.
        lanes: Lanes of a batch at most.
        program: What is computed of each lane.

    Raises:
        ConfigError: a name is no number of the loop, or an end is not admissible.
    """

    study: Study
    extents: Mapping[str, tuple[float, float]]
    lanes: int = BLOCK
    program: Callable[[Study], Lane] = simulated
    swept: Study = field(init=False)

    def __post_init__(self) -> None:
        axes = {name: sorted(set(extent)) for name, extent in self.extents.items()}
        self.swept = self.study.override({"sweep": axes})
        self.engine = Engine(self.swept, self.lanes, program=self.program)

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


def differentiated(names: Sequence[str], reverse: bool = False) -> Callable[[Study], Lane]:
    """The program that also computes the derivative of every metric and margin with respect to some of the numbers.

    The derivatives are further results, see :func:`derivative`. Forward mode: a tangent for each number rides along, so
    memory does not grow with the duration. Reverse mode: a pass back for each metric and margin, whatever the count of
    numbers; the state is kept at some sqrt(steps) samples, and what is between is computed again.

    Args:
        names: The numbers.
        reverse: Reverse mode.

    Reference:
        A. Griewank, A. Walther, "Algorithm 799: revolve", ACM TOMS 26 (2000) 19-45: checkpoints.
    """
    jacobian = jax.jacrev if reverse else jax.jacfwd

    def program(study: Study) -> Lane:
        plain = simulated(study, together=None, segment=math.isqrt(study.loop.steps) if reverse else None)
        codes = ("outcome", "failed_at", "settled_at")

        def lane(values: dict[str, jax.Array], index: jax.Array) -> dict[str, Scalar]:
            def smooth(moved: dict[str, jax.Array]) -> tuple[dict[str, Scalar], dict[str, Scalar]]:
                found = plain({**values, **moved}, index)
                return {name: value for name, value in found.items() if name not in codes}, found

            slopes, found = jacobian(smooth, has_aux=True)({name: values[name] for name in names})
            return found | {derivative(of, name): slope for of, row in slopes.items() for name, slope in row.items()}

        return lane

    return program


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
