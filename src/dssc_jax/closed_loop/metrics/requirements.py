"""Requirements on metrics: their slacks, negative if violated, and the resulting outcome code."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.metrics.streaming import Accumulator, Course, Measure
from dssc_jax.closed_loop.metrics.window import samples_before_end, span_of
from dssc_jax.core.signals import Outcome, Scalar

VIOLATED_AT = "violated_at_"
"""Prefix of the name of a time of violation in results."""


@dataclass(frozen=True)
class Requirement:
    """A bound on one measure; exactly one of ``maximum`` and ``minimum`` is set.

    Args:
        measure: The measure.
        maximum: Upper bound in the metric's unit.
        minimum: Lower bound in the metric's unit; 0 for the robustness of a formula.
        typical_slack: Typical distance of draws from the bound in the metric's unit, which scales slacks if the bound
            is 0; None: unknown.
        formula: Text of the formula; empty for other requirements.
        written: The bound as the study file states it, with a unit; empty if the study states a plain number.
    """

    measure: Measure
    maximum: float | None = None
    minimum: float | None = None
    typical_slack: float | None = None
    formula: str = ""
    written: str = ""

    @property
    def label(self) -> str:
        """Name among the study's requirements: the measure's name, with ``_min`` for a lower bound on a metric.

        The ending lets a metric have both an upper and a lower bound. A formula has one bound only, and keeps its name.
        """
        is_lower_bound = self.maximum is None and not self.formula
        return f"{self.measure.name}_min" if is_lower_bound else self.measure.name

    @property
    def name(self) -> str:
        """Name of the slack in results, such as ``slack_error_max``."""
        return f"slack_{self.label}"

    @property
    def violation_name(self) -> str:
        """Name, in results, of the time at which a violation became certain, such as ``violated_at_error_max``."""
        return f"{VIOLATED_AT}{self.label}"

    @property
    def violation_is_final(self) -> bool:
        """Whether a violated bound stays violated, so that each sample is checked for the first violation.

        A violation is final if the metric can only rise and has a maximum, or can only fall and has a minimum.
        """
        towards_bound = Course.RISES if self.maximum is not None else Course.FALLS
        return self.measure.metric.course == towards_bound

    @property
    def bound(self) -> float:
        """The bound in the metric's unit, whether it is an upper or a lower one."""
        return self.maximum if self.maximum is not None else self.minimum  # type: ignore[return-value]

    @property
    def scale(self) -> float:
        """Size by which a slack is divided, to make the slacks of different requirements comparable: usually |bound|.

        A bound of 0 gives no size. The typical slack then takes its place, or 1 if the typical slack is unknown.
        """
        return abs(self.bound) or self.typical_slack or 1.0

    @property
    def text(self) -> str:
        """The requirement in words, such as ``error_max_x after 2 s <= 0.1 m``, or the full text of a formula."""
        if self.formula:
            return f"{self.label}: {self.formula}"
        sign = "<=" if self.maximum is not None else ">="
        if self.written:
            return f"{self.measure.label} {sign} {self.written}"
        bound_text = f"{self.bound:g} {self.measure.unit}".removesuffix(" 1")  # the unit of a pure number
        return f"{self.measure.label}{self.measure.window_text} {sign} {bound_text}"

    @property
    def short_text(self) -> str:
        """The requirement in words, or only the name of a formula, for tables."""
        return self.label if self.formula else self.text

    def shown(self, value: float) -> tuple[float, str]:
        """Convert a value of the metric to the unit in which the study states the bound; returns value and unit."""
        margin = self.measure.metric.margin
        written_unit = self.written.split(" ")[-1]
        if margin is not None and written_unit in margin.kind.units:
            return margin.kind.in_unit(value, written_unit), written_unit
        return value, self.measure.unit

    def slack(self, value: Scalar) -> Scalar:
        """Signed distance of a value from the bound, in the metric's unit: negative if the requirement is violated.

        For a loop without an operating point, the margin is NaN and counts as the margin at the limit of stability.
        """
        margin = self.measure.metric.margin
        if margin is not None:
            value = jnp.where(jnp.isnan(value), margin.kind.neutral, value)
        if self.maximum is not None:
            return self.maximum - value
        return value - self.minimum  # type: ignore[operator]


def with_typical_slacks(
    requirements: Sequence[Requirement], results: Mapping[str, np.ndarray]
) -> tuple[Requirement, ...]:
    """Set the typical slack of each requirement, the median of |slack| over some draws.

    Args:
        requirements: The requirements.
        results: Slacks of the draws by name, shape (draws,) each. Without a finite slack, the typical slack is None.
    """
    completed = []
    for requirement in requirements:
        slacks = np.abs(results[requirement.name])
        finite_slacks = slacks[np.isfinite(slacks)]
        typical_slack = float(np.median(finite_slacks)) if finite_slacks.size else None
        completed.append(replace(requirement, typical_slack=typical_slack))
    return tuple(completed)


def counted_places(requirements: Sequence[Requirement], label: str) -> list[int]:
    """Find the indices of the requirements that count as failures.

    Args:
        requirements: The requirements.
        label: Label of the requirements that count; empty: all count.
    """
    return [index for index, requirement in enumerate(requirements) if label in ("", requirement.label)]


def violated(slack: Any) -> Any:
    """Whether a requirement with this slack is violated; NaN counts as violated.

    Args:
        slack: The slack, a traced number or an array.
    """
    return ~(slack >= 0.0)  # not slack < 0, which is False for NaN


def ended_early(outcome: Any) -> Any:
    """Whether a draw with this outcome code ended early, and so violates every requirement.

    Args:
        outcome: One code, or an array of codes of any shape.
    """
    return (outcome != Outcome.OK) & (outcome < Outcome.REQUIREMENT)


def watch(
    requirements: tuple[Requirement, ...],
    measures: tuple[Measure, ...],
    accumulators: tuple[Accumulator, ...],
    violations: tuple[Scalar, ...],
    samples: Scalar,
    steps: int,
    sample_time: float,
) -> tuple[Scalar, ...]:
    """Note, after a sample, which requirements with a final violation are violated for the first time.

    A violation is final if the requirement can never be met again. Other requirements are not watched.

    Args:
        requirements: All requirements.
        measures: All measures.
        accumulators: Accumulator of each measure after the sample.
        violations: The result after the previous sample; 0 for each watched requirement before the first sample.
        samples: Number of samples so far.
        steps: Number of samples of the run.
        sample_time: Sample time T_s [s].

    Returns:
        For each watched requirement, the number of samples after which it was first violated; 0: not yet.
    """
    accumulator_of = {measure.name: acc for measure, acc in zip(measures, accumulators, strict=True)}
    updated_violations = []
    final_requirements = [requirement for requirement in requirements if requirement.violation_is_final]
    for requirement, violated_after in zip(final_requirements, violations, strict=True):
        measure = requirement.measure
        span = span_of(measure.window, steps, sample_time)
        value = measure.metric.value(accumulator_of[measure.name], measure.window, span)
        is_first = (violated_after == 0.0) & (requirement.slack(value) < 0.0)
        updated_violations.append(jnp.where(is_first, jnp.asarray(samples, jnp.result_type(float)), violated_after))
    return tuple(updated_violations)


def certain_violations(
    requirements: tuple[Requirement, ...],
    measures: tuple[Measure, ...],
    accumulators: tuple[Accumulator, ...],
    violations: tuple[Scalar, ...],
    steps: Scalar,
    sample_time: float,
) -> dict[str, Scalar]:
    """Count the samples after which the violation of each requirement, if it is violated, was certain.

    A final violation is certain as soon as it occurs. A formula tells the sample itself. The violation of any other
    requirement is certain at the end of its window.

    Args:
        requirements: The requirements.
        measures: All measures.
        accumulators: Accumulator of each measure at the end of the draw.
        violations: Result of :func:`watch` at the end of the draw.
        steps: Number of samples of the draw.
        sample_time: Sample time T_s [s].

    Returns:
        The number of samples by the requirement's label; it means nothing if the requirement is met.
    """
    accumulator_of = {measure.name: acc for measure, acc in zip(measures, accumulators, strict=True)}
    final_violations = iter(violations)
    samples = {}
    for requirement in requirements:
        measure = requirement.measure
        if requirement.violation_is_final:
            violated_after = next(final_violations)
            samples[requirement.label] = jnp.where(violated_after > 0.0, violated_after, steps)
        elif measure.metric.certain_after is not None:
            samples[requirement.label] = measure.metric.certain_after(accumulator_of[measure.name])
        else:
            samples[requirement.label] = samples_before_end(measure.window, sample_time, steps)
    return samples


def judge(
    requirements: tuple[Requirement, ...], values: dict[str, Scalar], ended: Scalar
) -> tuple[Scalar, dict[str, Scalar]]:
    """Judge a draw by its requirements.

    Args:
        requirements: The requirements; the first violated requirement gives the code.
        values: Value of every measure by name.
        ended: Code of the flight: OK, or the reason of its early end.

    Returns:
        The outcome code (int32), and the slack of each requirement by name, -inf if the draw ended early.
    """
    is_complete = ended == Outcome.OK
    outcome = jnp.full((), Outcome.OK, dtype=jnp.int32)
    slacks: dict[str, Scalar] = {}
    for index, requirement in reversed(list(enumerate(requirements))):  # the first one writes its code last
        slack = requirement.slack(values[requirement.measure.name])
        outcome = jnp.where(violated(slack), Outcome.REQUIREMENT + index, outcome)
        slacks[requirement.name] = jnp.where(is_complete, slack, -jnp.inf)
    return jnp.where(is_complete, outcome, ended).astype(jnp.int32), slacks


def binding_requirement(requirements: Sequence[Requirement], results: Mapping[str, np.ndarray]) -> np.ndarray:
    """Find the index of the requirement with the smallest slack, relative to its scale, in each draw.

    A slack of NaN counts as the smallest of all.

    Args:
        requirements: The requirements.
        results: Slacks by name, all of one shape, which the result has, too.
    """
    slacks = np.array([results[requirement.name] / requirement.scale for requirement in requirements])
    return np.argmin(np.where(np.isnan(slacks), -np.inf, slacks), axis=0)


def first_violation(
    requirements: Sequence[Requirement], results: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Find the requirement that each draw violates first, and when; violations by an early end do not count.

    Args:
        requirements: The requirements; of two that are violated at the same sample, the first in the list counts.
        results: Times of violation by name, and ``failed_at``, all of one shape.

    Returns:
        Index of the requirement, -1 if there is none, and the time [s], NaN if there is none; arrays of that shape.
    """
    failed_at = results["failed_at"]
    first_index = np.full(failed_at.shape, -1)
    first_time = np.where(np.isnan(failed_at), np.inf, failed_at)  # from an early end on, violations do not count
    for index, requirement in enumerate(requirements):
        times = results[requirement.violation_name]
        is_earlier = times < first_time
        first_index = np.where(is_earlier, index, first_index)
        first_time = np.where(is_earlier, times, first_time)
    return first_index, np.where(first_index >= 0, first_time, np.nan)


def worst_slack(requirements: Sequence[Requirement], results: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the smallest slack of each draw relative to the requirements' scales: negative if the draw fails.

    A draw that ended early, or that has a NaN slack, has -inf. Without requirements all other draws have +inf.

    Args:
        requirements: The requirements.
        results: Slacks by name, and ``outcome``, all of one shape, which the result has, too.
    """
    worst = np.where(ended_early(results["outcome"]), -np.inf, np.inf)
    for requirement in requirements:
        slack = results[requirement.name] / requirement.scale
        worst = np.minimum(worst, np.where(np.isnan(slack), -np.inf, slack))
    return worst
