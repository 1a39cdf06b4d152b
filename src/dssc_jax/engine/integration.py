"""The error of integration between the samples, from draws that are simulated again with twice the substeps.

A loop with an exact solution between the samples has none
(:func:`dssc_jax.closed_loop.between_samples.hold.is_exact`). For others, draws spread over the study are simulated with
the study's substeps and with twice as many. With a method of order p, the error that remains is about 1/(2^p - 1) of
the change.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dssc_jax.closed_loop.between_samples.hold import is_exact, order_between_samples
from dssc_jax.closed_loop.metrics.requirements import ended_early
from dssc_jax.closed_loop.sample import held_parts
from dssc_jax.core.json_types import JsonObject
from dssc_jax.engine.batching import Engine, Lanes, evaluate, lane_numbers
from dssc_jax.engine.sampling import Arrays
from dssc_jax.statistics.order import typical_size
from dssc_jax.study import Study

CHECKED_DRAWS = 16
NEGLIGIBLE = 0.01
"""Change of a required metric, in shares of its bound, up to which no warning appears (assumed)."""
DIVERGING = 1e3
"""Change of a metric, in shares of its bound or median size, above which the plant or its integration diverges
(assumed)."""

MOST_SUBSTEPS = 1000  # of a study

FRACTION = ", but for the fraction of a delay, which acts through the mean of its commands over the sample"
AVERAGED = "a delay's fraction of a sample acts through the mean of its commands over the sample"


class IntegrationError(NamedTuple):
    """The change of some draws when the steps between the samples are halved.

    Args:
        exact: Whether the loop has an exact solution between the samples; then nothing was simulated.
        draws: Number of draws simulated again.
        substeps: Substeps of the study.
        change: Largest change of a required metric in shares of its bound; without requirements, of any metric in
            shares of its median size. Infinite if a draw ends early with one of the two numbers of substeps alone.
        metric: The metric with the largest change; empty if none changes.
        scale: ``bound`` or ``median size``.
        verdicts: Number of draws whose outcome changes.
        remedy: Number of substeps that should make the change negligible.
        order: Order of the error in the length of a substep.
        averaged: Whether a command that changes within a sample acts through its mean, as behind a fractional delay.
    """

    exact: bool
    draws: int
    substeps: int
    change: float
    metric: str
    scale: str
    verdicts: int
    remedy: int
    order: int
    averaged: bool = False

    @property
    def matters(self) -> bool:
        """Whether halved steps change a verdict, or a metric by more than :data:`NEGLIGIBLE`."""
        return self.verdicts > 0 or self.change > NEGLIGIBLE

    @property
    def text(self) -> str:
        """The error in words: what changes with twice the substeps, and in how many draws it was tried."""
        if self.exact:
            exception = FRACTION if self.averaged else ""
            return f"between the samples everything is held exactly{exception}"
        size = f"{self.change:.1g}" if self.change < 1e-4 else f"{100.0 * self.change:.2g} %"
        changes = f"{self.metric} changes by at most {size} of its {self.scale}" if self.metric else "no metric changes"
        flips = f"{self.verdicts} verdicts change" if self.verdicts else "no verdict changes"
        halved = f"with {2 * self.substeps} substeps instead of {self.substeps} (order {self.order})"
        text = f"{halved}, {changes} and {flips} in {self.draws} draws"
        return f"{text}; {AVERAGED}" if self.averaged else text

    @property
    def warning(self) -> str:
        """The error and its remedy in words; empty if the error does not matter."""
        if not self.matters:
            return ""
        remedy = f"set loop.substeps = {self.remedy}, or shorten loop.sample_time"
        if DIVERGING < self.change < np.inf:
            remedy = (
                "the plant or its integration diverges: look at the plant's signs, units and derivatives first, then "
                f"{remedy}"
            )
        return f"the integration between the samples is too coarse: {self.text}; {remedy}"

    def to_dict(self) -> JsonObject:
        """The error as plain data for JSON, where None stands for an infinite change."""
        finite = self.change if np.isfinite(self.change) else None
        return self._asdict() | {"change": finite, "text": self.text, "warning": self.warning}


def integration_error(study: Study, draws: int = CHECKED_DRAWS) -> IntegrationError:
    """Measure the error of integration of a study, by some draws with the study's substeps and with twice as many.

    Args:
        study: The study; with a sweep, the draws are spread over its points.
        draws: Most draws.
    """
    loop = study.loop
    order = order_between_samples(held_parts(loop))
    models_with_params = zip(loop.unmodelled, study.template.unmodelled, strict=True)
    averaged = any(model.averages(params) for model, params in models_with_params)
    if is_exact(held_parts(loop)):
        return IntegrationError(
            exact=True,
            draws=0,
            substeps=loop.substeps,
            change=0.0,
            metric="",
            scale="",
            verdicts=0,
            remedy=loop.substeps,
            order=order,
            averaged=averaged,
        )
    shape = (*(len(values) for values in study.axes.values()), study.config.draws)
    total = math.prod(shape)
    lane_indices = np.unique(np.linspace(0, total - 1, min(draws, total)).astype(int))  # evenly over the grid
    lanes = np.unravel_index(lane_indices, shape)
    coarse = results_with_substeps(study, lanes, loop.substeps)
    fine = results_with_substeps(study, lanes, 2 * loop.substeps)
    change, metric = largest_change(study, coarse, fine)
    verdicts = int(np.count_nonzero(coarse["outcome"] != fine["outcome"]))
    scale = "bound" if study.requirements else "median size"
    # 2^n times the substeps divide the change by 2^(order n); one doubling at least, also of an infinite change
    error_ratio = max(2.0, change / NEGLIGIBLE) if np.isfinite(change) else 2.0**order
    doublings = int(np.ceil(np.log2(error_ratio) / order))
    remedy = min(MOST_SUBSTEPS, loop.substeps * 2 ** max(1, doublings))
    return IntegrationError(
        exact=False,
        draws=len(lane_indices),
        substeps=loop.substeps,
        change=change,
        metric=metric,
        scale=scale,
        verdicts=verdicts,
        remedy=remedy,
        order=order,
        averaged=averaged,
    )


def results_with_substeps(study: Study, lanes: Lanes, substeps: int) -> Arrays:
    """Results of n lanes of a study, simulated with another number of substeps, by name, shape (n,) each.

    Args:
        study: The study.
        lanes: Indices of the lanes along each axis of the sweep and along the draws, shape (n,) each.
        substeps: Number of steps of the integrator in a sample.
    """
    *_, draws = lanes
    engine = Engine(replace(study, loop=replace(study.loop, substeps=substeps)), len(draws))
    values = lane_numbers(study, lanes)
    return evaluate(engine, {name: values[name] for name in engine.names}, draws)


def largest_change(study: Study, coarse: Arrays, fine: Arrays) -> tuple[float, str]:
    """The largest change of a metric in shares of its scale, and the metric's name, empty if none changes.

    With requirements, the required metrics count, in shares of the requirements' scales. Without requirements, all
    metrics count, in shares of their typical sizes. If a draw ends early with one number of substeps and not with the
    other, the change is infinite.

    Args:
        study: The study.
        coarse: Results of some lanes with the study's substeps, shape (n,) each.
        fine: Results of the same lanes with twice the substeps, shape (n,) each.
    """
    scales = {requirement.measure.name: requirement.scale for requirement in study.requirements}
    if not scales:
        scales = {measure.name: typical_size(fine[measure.name]) for measure in study.measures}
    is_end_different = np.any(ended_early(coarse["outcome"]) != ended_early(fine["outcome"]))
    largest = 0.0
    metric_of_largest = ""
    for metric, scale in scales.items():
        coarse_values = coarse[metric]
        fine_values = fine[metric]
        is_finite = np.isfinite(coarse_values) & np.isfinite(fine_values)
        differences = np.where(is_finite, coarse_values, 0.0) - np.where(is_finite, fine_values, 0.0)
        relative_changes = np.abs(differences) / scale
        change = np.inf if is_end_different else float(np.max(relative_changes, initial=0.0))
        if change > largest:
            largest = change
            metric_of_largest = metric
    return largest, metric_of_largest
