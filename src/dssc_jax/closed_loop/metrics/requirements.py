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
        typical_slack: Typical distance from the bound in the metric's unit, a scale if the bound is 0; None: unknown.
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
        """Name among the study's requirements: that of the measure, with ``_min`` for a lower bound on a metric."""
        has_plain_name = self.maximum is not None or self.formula
        return self.measure.name if has_plain_name else f"{self.measure.name}_min"

    @property
    def name(self) -> str:
        """Name of the slack in results."""
        return f"slack_{self.label}"

    @property
    def violation_name(self) -> str:
        """Name of the time of the first violation in results."""
        return f"{VIOLATED_AT}{self.label}"

    @property
    def is_watched(self) -> bool:
        """Whether a violation before the end is final: the metric cannot return to the other side of the bound."""
        return self.measure.metric.course == (Course.RISES if self.maximum is not None else Course.FALLS)

    @property
    def bound(self) -> float:
        """The upper or lower bound."""
        return self.maximum if self.maximum is not None else self.minimum  # type: ignore[return-value]

    @property
    def scale(self) -> float:
        """Scale on which slacks of different requirements compare: |bound|, or if that is 0 the typical slack or 1."""
        return abs(self.bound) or self.typical_slack or 1.0

    @property
    def text(self) -> str:
        """The requirement in words, with the full text of a formula."""
        if self.formula:
            return f"{self.label}: {self.formula}"
        if self.written:
            return f"{self.measure.label} {'<=' if self.maximum is not None else '>='} {self.written}"
        side = f"<= {self.maximum:g}" if self.maximum is not None else f">= {self.minimum:g}"
        return f"{self.measure.label}{self.measure.window_text} {side} {self.measure.unit}".removesuffix(" 1")

    @property
    def short(self) -> str:
        """The requirement in words, or only the name of a formula, for tables."""
        return self.label if self.formula else self.text

    def shown(self, value: float) -> tuple[float, str]:
        """A value of the metric in the unit in which the study states the bound, and that unit."""
        margin = self.measure.metric.margin
        written_unit = self.written.split(" ")[-1]
        if margin is not None and written_unit in margin.kind.units:
            return margin.kind.in_unit(value, written_unit), written_unit
        return value, self.measure.unit

    def slack(self, value: Scalar) -> Scalar:
        """Signed distance of a value from the bound, in the metric's unit: negative if the requirement is violated.

        The margins of a loop without an operating point are NaN, and count as those at the limit of stability.
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
    """The requirements with typical slacks: the median of |slack| over some draws, or None if no slack is finite.

    Args:
        requirements: The requirements.
        results: Slacks of the draws by name, shape (draws,) each.
    """
    result = []
    for requirement in requirements:
        slacks = np.abs(results[requirement.name])
        finite = slacks[np.isfinite(slacks)]
        result.append(replace(requirement, typical_slack=float(np.median(finite)) if finite.size else None))
    return tuple(result)


def counted_places(requirements: Sequence[Requirement], label: str) -> list[int]:
    """Indices of the requirements with a label; of all requirements if the label is empty."""
    return [index for index, requirement in enumerate(requirements) if label in ("", requirement.label)]


def violated(slack: Any) -> Any:
    """Whether a requirement is violated according to its slack, a traced number or array; NaN counts as violated."""
    return ~(slack >= 0.0)


def ended_early(outcome: Any) -> Any:
    """Whether a draw ended early, and so violates every requirement, from its outcome code; arrays of any shape."""
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
    """The number of samples after which each watched requirement was first violated, after one more sample; 0: not yet.

    Args:
        requirements: The requirements.
        measures: All measures.
        accumulators: Their accumulators after the sample.
        violations: The result before the sample, a number for each requirement that is watched.
        samples: Number of samples so far.
        steps: Number of samples of the run.
        sample_time: T_s [s].
    """
    states = {measure.name: acc for measure, acc in zip(measures, accumulators, strict=True)}
    updates = []
    watched_requirements = (requirement for requirement in requirements if requirement.is_watched)
    for requirement, times in zip(watched_requirements, violations, strict=True):
        measure = requirement.measure
        value = measure.metric.value(states[measure.name], measure.window, span_of(measure.window, steps, sample_time))
        is_first = (times == 0.0) & (requirement.slack(value) < 0.0)
        updates.append(jnp.where(is_first, jnp.asarray(samples, jnp.result_type(float)), times))
    return tuple(updates)


def certain_violations(
    requirements: tuple[Requirement, ...],
    measures: tuple[Measure, ...],
    accumulators: tuple[Accumulator, ...],
    violations: tuple[Scalar, ...],
    steps: Scalar,
    sample_time: float,
) -> dict[str, Scalar]:
    """By label of a requirement, the number of samples after which its violation was certain, if it is violated.

    A violation by a metric that can only rise towards its bound is certain at once, and a formula tells the sample
    itself. For any other requirement it is certain at the end of its window.

    Args:
        requirements: The requirements.
        measures: All measures.
        accumulators: Their accumulators at the end of the draw.
        violations: Result of :func:`watch` at the end of the draw.
        steps: Number of samples of the draw.
        sample_time: T_s [s].
    """
    states = {measure.name: acc for measure, acc in zip(measures, accumulators, strict=True)}
    remaining = iter(violations)
    samples = {}
    for requirement in requirements:
        measure = requirement.measure
        if requirement.is_watched:
            times = next(remaining)
            samples[requirement.label] = jnp.where(times > 0.0, times, steps)
        elif measure.metric.certain_after is not None:
            samples[requirement.label] = measure.metric.certain_after(states[measure.name])
        else:
            samples[requirement.label] = samples_before_end(measure.window, sample_time, steps)
    return samples


def judge(
    requirements: tuple[Requirement, ...], values: dict[str, Scalar], ended: Scalar
) -> tuple[Scalar, dict[str, Scalar]]:
    """Outcome code of a draw (int32), and the slack of each requirement by name, -inf if the draw ended early.

    Args:
        requirements: The requirements; the first one that is violated gives the code.
        values: Value of every measure by name.
        ended: Code of the flight: OK, or the reason of its early end.
    """
    is_complete = ended == Outcome.OK
    outcome = jnp.full((), Outcome.OK, dtype=jnp.int32)
    slacks: dict[str, Scalar] = {}
    for index, requirement in reversed(list(enumerate(requirements))):
        slack = requirement.slack(values[requirement.measure.name])
        outcome = jnp.where(violated(slack), Outcome.REQUIREMENT + index, outcome)
        slacks[requirement.name] = jnp.where(is_complete, slack, -jnp.inf)
    return jnp.where(is_complete, outcome, ended).astype(jnp.int32), slacks


def binding_requirement(requirements: Sequence[Requirement], results: Mapping[str, np.ndarray]) -> np.ndarray:
    """Index of each draw's requirement with the smallest slack relative to its scale; NaN counts as smallest."""
    slacks = np.array([results[requirement.name] / requirement.scale for requirement in requirements])
    return np.argmin(np.where(np.isnan(slacks), -np.inf, slacks), axis=0)


def first_violation(
    requirements: Sequence[Requirement], results: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """The requirement that each draw violates first, and the time; violations by an early end do not count.

    Args:
        requirements: The requirements; of two that are violated at the same sample, the earlier one counts.
        results: Times of violation by name, and ``failed_at``, all of one shape.

    Returns:
        Index of the requirement, -1 if there is none, and the time [s], NaN if there is none; arrays of that shape.
    """
    failed_at = results["failed_at"]
    first = np.full(failed_at.shape, -1)
    earliest = np.where(np.isnan(failed_at), np.inf, failed_at)
    for number, requirement in enumerate(requirements):
        times = results[requirement.violation_name]
        is_earlier = times < earliest
        first = np.where(is_earlier, number, first)
        earliest = np.where(is_earlier, times, earliest)
    return first, np.where(first >= 0, earliest, np.nan)


def worst_slack(requirements: Sequence[Requirement], results: Mapping[str, np.ndarray]) -> np.ndarray:
    """Smallest slack of each draw over all requirements, relative to their scales: negative if the draw fails.

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
