"""Margins of the linearised loop as metrics of a draw.

A margin belongs to a loop, and not to a flight. The margin is computed before the flight. Its accumulator starts at the
value, and no sample changes the value.
"""

from collections.abc import Sequence

from dssc_jax.closed_loop.metrics.margin_kinds import LoopMargin
from dssc_jax.closed_loop.metrics.streaming import Accumulator, Measure, Metric, MetricInput, final_value, suffixed
from dssc_jax.closed_loop.metrics.window import WHOLE_RUN, Window
from dssc_jax.core.signals import Scalar


def keep_value(acc: Accumulator, sample: MetricInput, window: Window) -> Accumulator:
    """The margin itself, which is computed before the flight: no sample changes it, so only ``acc`` is read."""
    return acc


def decision_sample(acc: Accumulator) -> Scalar:
    """Number of samples after which the verdict on a margin is certain: 1, as the flight cannot change a margin."""
    return 1.0


def margin_measure(margin: LoopMargin, usual_place: str) -> Measure:
    """The measure of a margin at one break point.

    Args:
        margin: The margin.
        usual_place: Name of the break point that the measure's name leaves out.
    """
    kind = margin.kind
    place = "" if margin.place == usual_place else margin.place.replace(" ", "_")
    metric = Metric(
        kind.unit,
        f"{kind.meaning} at {margin.place}",
        keep_value,
        final_value,
        certain_after=decision_sample,
        margin=margin,
    )
    return Measure(
        name=suffixed(kind.name, place),
        kind=kind.name,
        window=WHOLE_RUN,
        channel=None,  # of the loop, not of one channel
        custom=metric,
        channel_name=place,
    )


def margins_of(measures: Sequence[Measure]) -> dict[str, LoopMargin]:
    """The margins of the linearised loop among some measures, by the measures' names."""
    return {measure.name: measure.metric.margin for measure in measures if measure.metric.margin is not None}
