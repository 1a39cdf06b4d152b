"""Requirements on metrics: their slacks, negative if violated, and the resulting outcome code."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.metrics import Accumulator, Course, Measure
from dssc_jax.closed_loop.window import samples_before_end, span_of
from dssc_jax.core.signals import Outcome, Scalar

VIOLATED_AT = "violated_at_"
"""First characters of the name of a time of violation in results."""


@dataclass(frozen=True)
class Requirement:
    """A bound on one measure. Exactly one of ``maximum`` and ``minimum`` is set, in the metric's unit.

    ``typical_slack`` is a typical distance from the bound in that unit, if it is known; it serves where the bound is 0.
    Of a formula, whose robustness must not be negative, ``formula`` is the text. ``written`` is the bound as the study
    has it, if that has another unit.
    """

    measure: Measure
    maximum: float | None = None
    minimum: float | None = None
    typical_slack: float | None = None
    formula: str = ""
    written: str = ""

    @property
    def label(self) -> str:
        """Name among the study's requirements: that of the measure, marked if it is a lower bound."""
        has_plain_name = self.maximum is not None or self.formula
        return self.measure.name if has_plain_name else f"{self.measure.name}_min"

    @property
    def name(self) -> str:
        """Name of the slack in results."""
        return f"slack_{self.label}"

    @property
    def violation_name(self) -> str:
        """Name in results of the time at which it is first violated."""
        return f"{VIOLATED_AT}{self.label}"

    @property
    def is_watched(self) -> bool:
        """Whether a violation is certain as soon as the value so far violates the bound."""
        return self.measure.metric.course == (Course.RISES if self.maximum is not None else Course.FALLS)

    @property
    def bound(self) -> float:
        """The upper or lower bound."""
        return self.maximum if self.maximum is not None else self.minimum  # type: ignore[return-value]

    @property
    def scale(self) -> float:
        """Scale of slacks when requirements are compared: |bound|, else the typical slack if that is known, else 1."""
        return abs(self.bound) or self.typical_slack or 1.0

    @property
    def text(self) -> str:
        """The requirement in words, with a formula in full."""
        if self.formula:
            return f"{self.label}: {self.formula}"
        if self.written:
            return f"{self.measure.label} {'<=' if self.maximum is not None else '>='} {self.written}"
        side = f"<= {self.maximum:g}" if self.maximum is not None else f">= {self.minimum:g}"
        return f"{self.measure.label}{self.measure.window_text} {side} {self.measure.unit}".removesuffix(" 1")

    @property
    def short(self) -> str:
        """The requirement in a table: a formula by its name, any other in words."""
        return self.label if self.formula else self.text

    def shown(self, value: float) -> tuple[float, str]:
        """A value of the metric, and its unit: that in which the bound was written, if it was written with one."""
        margin = self.measure.metric.margin
        written_unit = self.written.split(" ")[-1]
        if margin is not None and written_unit in margin.kind.units:
            return margin.kind.in_unit(value, written_unit), written_unit
        return value, self.measure.unit

    def slack(self, value: Scalar) -> Scalar:
        """Signed distance to the bound, in the metric's unit: negative if the requirement is violated.

        Where the loop has no operating point its margins are NaN; the slack is then that at the limit of stability.
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
    """The requirements with their typical slack: the median of |slack| over some draws, None if no slack is finite.

    Args:
        requirements: The requirements.
        results: The slack of each requirement by its name.
    """
    result = []
    for requirement in requirements:
        slacks = np.abs(results[requirement.name])
        finite = slacks[np.isfinite(slacks)]
        result.append(replace(requirement, typical_slack=float(np.median(finite)) if finite.size else None))
    return tuple(result)


def counted_places(requirements: Sequence[Requirement], label: str) -> list[int]:
    """Indices of the requirements that count: those of a label, or all where it is empty."""
    return [place for place, requirement in enumerate(requirements) if label in ("", requirement.label)]


def violated(slack: Any) -> Any:
    """Whether a requirement is violated according to its slack; NaN counts as violated.

    Args:
        slack: A traced value or a NumPy array, any shape.

    Returns:
        That shape.
    """
    return ~(slack >= 0.0)


def ended_early(outcome: Any) -> Any:
    """Whether a draw ended early, and so violates every requirement, from outcome codes of any shape."""
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
    """Note for each watched requirement the number of samples after which it was first violated; 0: not yet.

    Args:
        requirements: The requirements.
        measures: The metrics.
        accumulators: The metrics' accumulators after the last sample.
        violations: What was noted before that sample; one number for each watched requirement.
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
    """The number of samples after which a violation of each requirement was certain, by its label, if it is violated.

    Most metrics that must stay below a bound only rise, and tell it at once; so does the metric of a formula. Any other
    requirement is judged at the end of its window.
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
    """Outcome code (int32) and the slack of each requirement; -inf if the draw ended early.

    Args:
        requirements: The requirements; the first violated one, in this order, gives the code.
        values: Every measure's value by name.
        ended: The code of the run itself: OK, or why it ended early.
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
    """Index of the requirement with the smallest slack relative to its bound; a NaN counts as smallest."""
    slacks = np.array([results[requirement.name] / requirement.scale for requirement in requirements])
    return np.argmin(np.where(np.isnan(slacks), -np.inf, slacks), axis=0)


def first_violation(
    requirements: Sequence[Requirement], results: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """The requirement that each draw violates first, and when; one that it violates by ending early does not count.

    Args:
        requirements: The requirements; at the same sample the first one in this order counts.
        results: Times of violation by name, and ``failed_at``, of any one shape.

    Returns:
        Index of the requirement, -1 if there is none, and the time [s], NaN if there is none; each of that shape.
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
    """Smallest slack of all requirements, each relative to its bound: negative if a draw fails.

    A draw that ended early, or whose metric is NaN, has -inf; without requirements all other draws have +inf.

    Args:
        requirements: The requirements.
        results: Slacks by name and ``outcome``, of any one shape.

    Returns:
        That shape.
    """
    worst = np.where(ended_early(results["outcome"]), -np.inf, np.inf)
    for requirement in requirements:
        slack = results[requirement.name] / requirement.scale
        worst = np.minimum(worst, np.where(np.isnan(slack), -np.inf, slack))
    return worst
