"""The error of integration between the samples: some draws again, with twice the substeps.

A loop in which everything between the samples is held exactly has none; see
:func:`dssc_jax.closed_loop.hold.is_exact`. For others, draws spread over the study are simulated with the study's
substeps and with twice as many. A method of order p leaves about 1/(2^p - 1) of the change.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dssc_jax.closed_loop.hold import is_exact, order_between_samples
from dssc_jax.closed_loop.requirements import ended_early
from dssc_jax.closed_loop.sample import held_parts
from dssc_jax.core.json_types import JsonObject
from dssc_jax.engine.batching import Engine, evaluate, lane_numbers
from dssc_jax.engine.sampling import Arrays
from dssc_jax.statistics.order import typical_size
from dssc_jax.study import Study

CHECKED_DRAWS = 16
NEGLIGIBLE = 0.01
"""Change of a required metric, in shares of its bound, below which nothing is said (assumed)."""
DIVERGING = 1e3
"""Change of a metric, in shares of its bound or median size, above which the plant or its integration diverges
(assumed)."""

MOST_SUBSTEPS = 1000  # that a study may have

FRACTION = ", but for the fraction of a delay, which acts through the mean of its commands over the sample"
AVERAGED = "a delay's fraction of a sample acts through the mean of its commands over the sample"


class IntegrationError(NamedTuple):
    """The change of some draws when the steps between the samples are halved.

    Args:
        exact: Whether everything between the samples is held exactly; then nothing was simulated.
        draws: Number of draws simulated again.
        substeps: Substeps of the study.
        change: Largest change of a required metric in shares of its bound; without requirements, of any metric in
            shares of its median size. Infinite if a draw ends early with one of the two numbers of substeps alone.
        metric: The metric with the largest change; empty if none changes.
        scale: ``bound`` or ``median size``.
        verdicts: Number of draws whose outcome changes.
        remedy: Number of substeps that is expected to make the change negligible.
        order: Order of the error in the length of a substep, from which the remedy follows.
        averaged: Whether a command that changes within a sample acts through its mean, as behind a delay of a fraction.
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
        """Whether a verdict changes, or a metric by more than :data:`NEGLIGIBLE`."""
        return self.verdicts > 0 or self.change > NEGLIGIBLE

    @property
    def text(self) -> str:
        """The error in words."""
        if self.exact:
            return "between the samples everything is held exactly" + (FRACTION if self.averaged else "")
        size = f"{self.change:.1g}" if self.change < 1e-4 else f"{100.0 * self.change:.2g} %"
        changes = f"{self.metric} changes by at most {size} of its {self.scale}" if self.metric else "no metric changes"
        flips = "no verdict changes" if not self.verdicts else f"{self.verdicts} verdicts change"
        halved = f"with {2 * self.substeps} substeps instead of {self.substeps} (order {self.order})"
        text = f"{halved}, {changes} and {flips} in {self.draws} draws"
        return f"{text}; {AVERAGED}" if self.averaged else text

    @property
    def warning(self) -> str:
        """The remedy, in words; empty if the error does not matter."""
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
        """For JSON; an infinite change is None."""
        finite = self.change if np.isfinite(self.change) else None
        return self._asdict() | {"change": finite, "text": self.text, "warning": self.warning}


def integration_error(study: Study, draws: int = CHECKED_DRAWS) -> IntegrationError:
    """Simulate some draws of a study again, with twice the substeps.

    Args:
        study: The study; with a sweep, the draws are spread over its points.
        draws: Number of draws at most.
    """
    loop = study.loop
    order = order_between_samples(held_parts(loop))
    parts = zip(loop.unmodelled, study.template.unmodelled, strict=True)
    averaged = any(model.averages(params) for model, params in parts)
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
    total = int(np.prod(shape))
    lane_indices = np.unique(np.linspace(0, total - 1, min(draws, total)).astype(int))
    count = len(lane_indices)
    lanes = np.unravel_index(lane_indices, shape)
    values = lane_numbers(study, lanes)
    results = []
    for substeps in (loop.substeps, 2 * loop.substeps):
        engine = Engine(replace(study, loop=replace(loop, substeps=substeps)), count)
        results.append(evaluate(engine, {name: values[name] for name in engine.names}, lanes[-1]))
    change, metric = largest_change(study, *results)
    verdicts = int(np.count_nonzero(results[0]["outcome"] != results[1]["outcome"]))
    scale = "bound" if study.requirements else "median size"
    error_ratio = max(2.0, change / NEGLIGIBLE) if np.isfinite(change) else 2.0**order
    doublings = int(np.ceil(np.log2(error_ratio) / order))
    remedy = min(MOST_SUBSTEPS, loop.substeps * 2 ** max(1, doublings))
    return IntegrationError(
        exact=False,
        draws=count,
        substeps=loop.substeps,
        change=change,
        metric=metric,
        scale=scale,
        verdicts=verdicts,
        remedy=remedy,
        order=order,
        averaged=averaged,
    )


def largest_change(study: Study, coarse: Arrays, fine: Arrays) -> tuple[float, str]:
    """Largest change of a required metric (without requirements, of any) in shares of its scale, and the metric."""
    scales = {}
    for requirement in study.requirements:
        scales[requirement.measure.name] = requirement.scale
    if not scales:
        scales = {measure.name: typical_size(fine[measure.name]) for measure in study.measures}
    worst = 0.0
    name = ""
    for metric, scale in scales.items():
        coarse_values = coarse[metric]
        fine_values = fine[metric]
        is_finite = np.isfinite(coarse_values) & np.isfinite(fine_values)
        differences = np.where(is_finite, coarse_values, 0.0) - np.where(is_finite, fine_values, 0.0)
        relative_changes = np.abs(differences) / scale
        change = float(np.max(relative_changes, initial=0.0))
        is_ended = [ended_early(arrays["outcome"]) for arrays in (coarse, fine)]
        if np.any(is_ended[0] != is_ended[1]):
            change = float("inf")
        if change > worst:
            worst = change
            name = metric
    return worst, name
