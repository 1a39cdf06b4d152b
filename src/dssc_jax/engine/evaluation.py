"""Evaluation of a study at any values of some of its numbers by one compiled program, optionally with derivatives."""

import math
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.metrics.margin_measures import margins_of
from dssc_jax.closed_loop.metrics.requirements import VIOLATED_AT, Requirement, binding_requirement, violated
from dssc_jax.core.contracts import Controller, Plant
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import Outcome, Scalar
from dssc_jax.engine.batching import BLOCK, Engine, Lane, evaluate, lane_of_study, values_of_draws
from dssc_jax.engine.kernels import Form
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study

NOT_DIFFERENTIATED = ("outcome", "failed_at", "settled_at")
DIRECTION = "direction"  # a further number of a lane: the index of the number by which the lane differentiates


def is_differentiated(name: str) -> bool:
    """Whether a result has derivatives; an outcome and a time of whole samples have none."""
    return name not in NOT_DIFFERENTIATED and not name.startswith(VIOLATED_AT)


class Derivative(NamedTuple):
    """The key of a derivative among results.

    Args:
        of: Name of the metric or slack.
        by: Name of the study's number by which the metric or slack is differentiated.
    """

    of: str
    by: str


@dataclass
class Evaluator:
    """A compiled study that is simulated at any values of some of its numbers; a call runs many lanes.

    Args:
        study: The study; its sweep is ignored.
        extents: Lowest and highest value of each number that is set separately in every lane. Both ends are checked
            like values of a sweep. The values that lanes set replace the number's law.
        lanes: Largest number of lanes of a batch.

    Raises:
        ConfigError: A name is not a number of the loop, an end is not admissible, or the loop needs whole numbers where
            values between the ends are none.
    """

    study: Study
    extents: Mapping[str, tuple[float, float]]
    lanes: int = BLOCK
    swept: Study = field(init=False)

    def __post_init__(self) -> None:
        """Check the numbers, and make the engine, in whose study they are swept."""
        require_values_between(self.study, self.extents)
        axes = {name: sorted(set(extent)) for name, extent in self.extents.items()}
        self.swept = self.study.override({"sweep": axes})
        self.engine = self.compiled()

    def compiled(self) -> Engine:
        """The engine that all batches share."""
        return Engine(self.swept, self.lanes)

    def values_of_draws(self, draws: slice) -> Arrays:
        """Draw the values of the uncertain numbers that lanes do not set, in a range of draws, shape (draws,) each."""
        return values_of_draws(self.swept, draws)

    def __call__(self, indices: np.ndarray, values: Mapping[str, np.ndarray]) -> Arrays:
        """Metrics, slacks and outcome of each lane, shape (n,) each.

        Args:
            indices: Draw index of each lane, shape (n,).
            values: Value of every number with a law or in ``extents``, shape (n,) each.
        """
        accepted_names = {*self.engine.names, *margins_of(self.swept.measures)}
        accepted = {name: column for name, column in values.items() if name in accepted_names}
        return evaluate(self.engine, accepted, indices)

    def fails(self, indices: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Whether each lane fails, shape (n,).

        Margins of the linearised loop are slow, so they are computed only for lanes that meet all other requirements.

        Args:
            indices: Draw index of each lane, shape (n,).
            values: Value of every number with a law or in ``extents``, shape (n,) each.
        """
        margins = margins_of(self.swept.measures)
        if not margins:
            return self(indices, values)["outcome"] != Outcome.OK
        required = [rule for rule in self.swept.requirements if rule.measure.name in margins]
        # first the flights: values that just meet the requirements stand for the margins
        placeholders = {name: np.full(len(indices), np.nan) for name in margins}
        placeholders |= {rule.measure.name: np.full(len(indices), rule.bound) for rule in required}
        flights = self(indices, {**values, **placeholders})
        candidates = np.flatnonzero(flights["outcome"] == Outcome.OK)
        is_failed = np.ones(len(indices), bool)
        if candidates.size:
            numbers = {name: column[candidates] for name, column in values.items()}
            margin_values = self.engine.margins(numbers, indices[candidates])
            with arithmetic(self.swept.config.loop.precision):
                slacks = [rule.slack(jnp.asarray(margin_values[rule.measure.name])) for rule in required]
            violations = [violated(np.asarray(slack)) for slack in slacks]
            is_failed[candidates] = np.any(violations, axis=0)
        return is_failed


def require_values_between(study: Study, extents: Mapping[str, tuple[float, float]]) -> None:
    """Require that numbers may have any value between the ends of their ranges.

    Args:
        study: The study.
        extents: Lowest and highest value of each number.

    Raises:
        ConfigError: A number must be whole, or a number that must be whole follows from it.
    """
    for name, (low, high) in extents.items():
        whole_numbers = [number for number in study.numbers.values() if number.quantity.whole]
        affected_names = [number.name for number in whole_numbers if name in (number.name, *number.sources)]
        if affected_names and low != high:
            rule = f"a search takes values between {low:g} and {high:g}, and {affected_names[0]} is a whole number"
            raise ConfigError(name, f"{rule}; sweep it instead, over whole numbers")


def plant_and_controllers(study: Study) -> list[tuple[str, Plant | Controller]]:
    """List the parts of a study that may be native code, each with the name of its table."""
    return [("plant", study.loop.plant), *(("controller", part) for part in study.loop.controller)]


def native_code(study: Study) -> str:
    """Find the first file of native code that the plant or a controller calls; empty if there is none.

    Without native code the whole loop can be differentiated.
    """
    files = [part.native for _, part in plant_and_controllers(study) if part.native]
    return files[0] if files else ""


def require_derivatives(study: Study) -> None:
    """Require that derivatives pass through the loop of a study.

    Raises:
        ConfigError: The plant or a controller is native code.
    """
    for slot, part in plant_and_controllers(study):
        if part.native:
            raise ConfigError(slot, f"is native code ({part.native}), through which no derivative passes")


def require_steps_in_any_order(study: Study, feature: str) -> None:
    """Require that a loop's steps may run in any order and more than once.

    Args:
        study: The study.
        feature: The feature that needs such steps, for the message.

    Raises:
        ConfigError: The plant or a controller keeps its state outside of JAX.
    """
    for slot, part in plant_and_controllers(study):
        if part.begin is not None:
            rule = f"keeps its state outside of JAX ({part.native}), so its steps are made once and in order"
            raise ConfigError(slot, f"{rule}; {feature} is not offered for it: use `run` or `simulate`")


@dataclass
class GradientEvaluator(Evaluator):
    """An evaluator that also computes the derivative of every metric and slack with respect to some numbers.

    The derivatives are additional results with keys of type :class:`Derivative`. Forward mode computes each lane once
    for each number, and its memory does not grow with the duration. Reverse mode takes one backward pass for each
    metric and slack, for any count of numbers. To save memory, it stores the state at about sqrt(steps) samples only,
    and computes the samples between them again. Margins of the linearised loop are differentiated by central
    differences.

    Args:
        names: Dotted names of the numbers to differentiate by.
        reverse: Whether to use reverse mode.

    Reference:
        A. Griewank, A. Walther, "Algorithm 799: revolve", ACM TOMS 26 (2000) 19-45: checkpoints.
    """

    names: Sequence[str] = ()
    reverse: bool = False

    def compiled(self) -> Engine:
        """The engine of the program with derivatives.

        Forward mode has a lane for each draw and number. Reverse mode runs as plain XLA, which can differentiate it.
        """
        if self.reverse:
            program = partial(reverse_mode, names=self.names)
            return Engine(self.swept, self.lanes, program=program, kernel=Form.SCAN)
        lanes = min(BLOCK, self.lanes * len(self.names))
        return Engine(self.swept, lanes, program=partial(forward_mode, names=self.names), extra=(DIRECTION,))

    def __call__(self, indices: np.ndarray, values: Mapping[str, np.ndarray]) -> Arrays:
        """Results of each lane, as in :class:`Evaluator`, and their derivatives.

        Args:
            indices: Draw index of each lane, shape (n,).
            values: Value of every number with a law or in ``extents``, shape (n,) each.

        Raises:
            ConfigError: The plant or a controller is native code.
        """
        require_derivatives(self.swept)
        numbers = dict(values) | self.engine.margins(dict(values), indices)
        results = self._flights(indices, numbers)
        if not margins_of(self.swept.measures):
            return results
        for name in self.names:
            slopes = self.engine.margins.slopes(dict(values), indices, name)
            results |= {Derivative(margin, name): slope for margin, slope in slopes.items()}
            for requirement in self.swept.requirements:
                if requirement.measure.name in slopes:
                    sign = 1.0 if requirement.maximum is None else -1.0  # slack: value - minimum, or maximum - value
                    results[Derivative(requirement.name, name)] = sign * slopes[requirement.measure.name]
        return results

    def _flights(self, indices: np.ndarray, values: Arrays) -> Arrays:
        """Results and derivatives of the simulation, with the margins of the linearised loop as constants.

        In forward mode, all lanes run once for the first number, then once for the second, and so on.

        Args:
            indices: Draw index of each lane, shape (n,).
            values: All numbers of each lane by name, shape (n,).
        """
        if self.reverse:
            return super().__call__(indices, values)
        count = len(indices)
        size = len(self.names)
        repeated_values = {name: np.tile(column, size) for name, column in values.items() if name != DIRECTION}
        repeated_values[DIRECTION] = np.repeat(np.arange(size), count)
        columns = super().__call__(np.tile(indices, size), repeated_values)
        results = {}
        for key, column in columns.items():
            if isinstance(key, Derivative):
                rows = column.reshape(size, count)
                for name, row in zip(self.names, rows, strict=True):
                    results[Derivative(key.of, name)] = row
            else:
                results[key] = column[:count]  # the same for every number
        return results


def worst_slopes(requirements: Sequence[Requirement], results: Arrays, names: Sequence[str]) -> np.ndarray:
    """Compute the gradient of each lane's smallest slack with respect to the numbers in ``names``, shape (n, numbers).

    The slacks are divided by the scales of their requirements.

    Args:
        requirements: The study's requirements.
        results: Results of a :class:`GradientEvaluator`, shape (n,) each.
        names: Dotted names of the numbers.
    """
    binding = binding_requirement(requirements, results)  # index of the requirement, shape (n,)
    lanes = np.arange(len(binding))
    columns = []
    for name in names:
        slopes = []
        for requirement in requirements:
            slopes.append(results[Derivative(requirement.name, name)] / requirement.scale)
        columns.append(np.array(slopes)[binding, lanes])
    return np.stack(columns, axis=1)


def metrics_and_slacks(
    plain: Lane, values: Mapping[str, jax.Array], index: jax.Array
) -> Callable[[dict[str, jax.Array]], tuple[dict[str, Scalar], dict[str, Scalar]]]:
    """Return a lane as a function of some of its numbers, for JAX to differentiate.

    The function returns the results that have derivatives, and all results.

    Args:
        plain: The program of the lane.
        values: All numbers of the lane; the function's argument replaces some of them.
        index: Draw index.
    """

    def run_lane(numbers: dict[str, jax.Array]) -> tuple[dict[str, Scalar], dict[str, Scalar]]:
        """The results with derivatives, and all results."""
        results = plain({**values, **numbers}, index)
        differentiated = {name: value for name, value in results.items() if is_differentiated(name)}
        return differentiated, results

    return run_lane


def with_derivatives(results: Mapping[str, Scalar], slopes: Mapping[Derivative, Scalar]) -> dict[Any, Scalar]:
    """Join results and derivatives in one pytree.

    The pytree is an OrderedDict: JAX would sort the keys of a dict, but strings and derivatives cannot be ordered.
    """
    return OrderedDict([*results.items(), *slopes.items()])


def forward_mode(study: Study, names: Sequence[str]) -> Lane:
    """Return the program of a lane in forward mode.

    The program differentiates by one number; :data:`DIRECTION`, a further number of the lane, is its index in
    ``names``.
    """
    plain = lane_of_study(study)

    def lane(values: dict[str, jax.Array], index: jax.Array) -> dict[str, Scalar]:
        """The results of the lane, and the derivative of each with respect to the selected number."""
        lane_values = {name: value for name, value in values.items() if name != DIRECTION}
        numbers = {name: lane_values[name] for name in names}
        tangent = {name: jnp.where(values[DIRECTION] == i, 1.0, 0.0) for i, name in enumerate(names)}
        run_lane = metrics_and_slacks(plain, lane_values, index)
        _, slopes, results = jax.jvp(run_lane, (numbers,), (tangent,), has_aux=True)
        return with_derivatives(results, {Derivative(of, DIRECTION): slope for of, slope in slopes.items()})

    return lane


def reverse_mode(study: Study, names: Sequence[str]) -> Lane:
    """Return the program of a lane in reverse mode: one backward pass for each metric and slack.

    Checkpoints about every sqrt(steps) samples keep the memory small.

    Args:
        study: The study.
        names: Dotted names of the numbers to differentiate by.
    """
    plain = lane_of_study(study, axis_name=None, segment=math.isqrt(study.loop.steps))

    def lane(values: dict[str, jax.Array], index: jax.Array) -> dict[str, Scalar]:
        """The results of the lane, and the derivative of each with respect to every number in ``names``."""
        numbers = {name: values[name] for name in names}
        jacobian = jax.jacrev(metrics_and_slacks(plain, values, index), has_aux=True)
        slopes_by_result, results = jacobian(numbers)
        derivatives = {}
        for result, slopes in slopes_by_result.items():
            for number, slope in slopes.items():
                derivatives[Derivative(result, number)] = slope
        return with_derivatives(results, derivatives)

    return lane


def require_independent(study: Study, purpose: str) -> None:
    """Require independent draws, which order statistics and exact tests need.

    Args:
        study: The study.
        purpose: What needs independent draws, for the message.

    Raises:
        ConfigError: The study's draws are points of a Sobol or Latin-hypercube design.
    """
    if not study.config.independent:
        kind = study.config.sampling
        raise ConfigError(study.source, f"{purpose} needs independent draws: sampling = 'random', got '{kind}'")
