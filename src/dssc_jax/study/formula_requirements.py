"""Requirements that a formula is true, and the signals that formulas can name."""

from collections.abc import Callable, Mapping
from typing import TypeAlias

from dssc_jax.closed_loop.metrics.formulas import formula_metric, memory_size
from dssc_jax.closed_loop.metrics.requirements import Requirement
from dssc_jax.closed_loop.metrics.signal_metrics import SampledSignal
from dssc_jax.closed_loop.metrics.streaming import Measure
from dssc_jax.closed_loop.metrics.window import WHOLE_RUN
from dssc_jax.core.errors import ConfigError
from dssc_jax.study.formulas import FormulaParser
from dssc_jax.study.schema import RequirementTable, StudyTable
from dssc_jax.study.table_errors import value_errors_at

SMOOTHING = 0.01
"""Width of the smooth minimum in derivatives, as a share of the smallest number in the formula (assumed)."""
MOST_MEMORY = 8000  # most samples in the delay lines of a formula

Constants: TypeAlias = Callable[[str, str], float]
"""(text of an expression, place in the study that needs the value) -> value, a plain number."""

TIME = SampledSignal("s", "time", lambda instant: instant.t)
VEHICLE_SIGNALS = {
    "tilt": SampledSignal("rad", "tilt of body z", lambda instant: instant.plant.tilt),
    "phi": SampledSignal("rad", "roll", lambda instant: instant.plant.phi),
    "theta": SampledSignal("rad", "pitch", lambda instant: instant.plant.theta),
}
"""Signals of a vehicle that belong to no channel, from what the plant reports."""


def formula_signals(loop_signals: Mapping[str, SampledSignal]) -> dict[str, SampledSignal]:
    """Signals that a formula can name: the time ``t`` and all signals of the loop.

    Tilt, roll and pitch of a vehicle are taken from :data:`VEHICLE_SIGNALS`.

    Args:
        loop_signals: Signals of the loop, by the names of their columns in a trajectory.
    """
    vehicle_signals = {name: signal for name, signal in VEHICLE_SIGNALS.items() if name in loop_signals}
    return {**loop_signals, "t": TIME, **vehicle_signals}


def formula_requirement(
    table: RequirementTable, place: str, config: StudyTable, signals: Mapping[str, SampledSignal], parameters: Constants
) -> Requirement:
    """Parse the requirement that a formula is true.

    The metric of the requirement is the formula's robustness, which must be at least 0.

    Args:
        table: Table of the requirement, which has a formula.
        place: Dotted path of the table, such as ``requirement.0``.
        config: Tables of the study.
        signals: Signals that the formula can name.
        parameters: (text of an expression, place that needs the value) -> value, a plain number.

    Raises:
        ConfigError: The formula is not valid, needs too many past samples, or the study ends settled draws early.
    """
    place_of_text = f"{place}.formula"
    text = " ".join(str(table.formula).split())
    if config.loop.settled:
        raise ConfigError(place_of_text, "is judged over whole flights; take out [loop.settled], which ends them early")

    def parameter(name: str) -> float:
        """Value of a parameter that the formula names."""
        return parameters(f"={name}", place_of_text)

    with value_errors_at(place_of_text):
        parsed_formula = FormulaParser(text, signals, parameter, config.loop.sample_time, config.loop.steps).parse()
    size = memory_size(parsed_formula.formula)
    if size > MOST_MEMORY:
        rule = f"needs a memory of {size} samples, and {MOST_MEMORY} are the most"
        remedy = "an operator within another one keeps the samples of its interval: shorten that, or lengthen T_s"
        raise ConfigError(place_of_text, f"{rule}; {remedy}")
    width = table.smoothing
    if width is None:
        width = SMOOTHING * (1.0 if parsed_formula.size is None else parsed_formula.size)
    _, _, index = place.rpartition(".")
    name = table.name or f"formula_{int(index) + 1}"
    metric = formula_metric(parsed_formula.formula, parsed_formula.unit, f"robustness of {text}", width)
    measure = Measure(name, kind=name, window=WHOLE_RUN, channel=None, custom=metric, channel_name="")
    return Requirement(measure, minimum=0.0, typical_slack=parsed_formula.size, formula=text)
