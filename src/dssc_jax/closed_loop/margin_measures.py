"""Margins of the linearised loop among a draw's metrics.

A margin belongs to a loop, not to a flight. It is computed before the flight and is one of the draw's numbers; its
accumulator starts at the value, and no sample changes it.
"""

from collections.abc import Sequence

from dssc_jax.closed_loop.margin_kinds import LoopMargin
from dssc_jax.closed_loop.metrics import Accumulator, Measure, Metric, Observed, itself, suffixed
from dssc_jax.closed_loop.window import WHOLE_RUN, Window
from dssc_jax.core.signals import Scalar


def unchanged(acc: Accumulator, observed: Observed, window: Window) -> Accumulator:
    """The accumulator."""
    return acc


def first_sample(acc: Accumulator) -> Scalar:
    """The number of samples after which a missed margin is certain: it is missed from the start."""
    return 1.0


def margin_measure(margin: LoopMargin, usual_place: str) -> Measure:
    """The measure of a margin; its name tells the break point unless that is the usual one."""
    kind = margin.kind
    place = "" if margin.place == usual_place else margin.place.replace(" ", "_")
    metric = Metric(
        kind.unit,
        f"{kind.meaning} at {margin.place}",
        unchanged,
        itself,
        certain_after=first_sample,
        margin=margin,
    )
    return Measure(suffixed(kind.name, place), kind.name, WHOLE_RUN, None, metric, channel_name=place)


def margins_of(measures: Sequence[Measure]) -> dict[str, LoopMargin]:
    """The margins of the linearised loop among some measures, by name."""
    return {measure.name: measure.metric.margin for measure in measures if measure.metric.margin is not None}
