"""The sliders of a study: which numbers can be moved, on which scale, and how positions change the study."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.quantities import Quantity
from dssc_jax.results.schema import name_with_unit
from dssc_jax.study import Study
from dssc_jax.study.expressions import is_expression
from dssc_jax.study.laws import LAWS, Law, RangedLaw
from dssc_jax.study.numbers import Number
from dssc_jax.study.parameters import Expression

MOST_GAINS = 2
"""Number of sliders for gains of a vehicle's controller."""
MOST_SLIDERS = 14
"""Largest number of sliders if the user names no numbers."""
DEFAULT_REACH = 10.0
"""Ratio of the ends of a positive number's slider to the number."""
SMALLER_REACHES = (3.0, 1.5)
"""Ratios that are tried if the rules of a model do not admit the ends."""
POSITION_COUNT = 81
WIDTHS = (0.1, 10.0)
"""Smallest and largest width of a law, relative to the study's."""
MEDIAN = "median"
WIDTH = "width"
CLOCK_SLIDER = "loop.sample_time"
SAMPLE_TIMES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Sample times, relative to the study's."""
FIRST = ("parameters", "controller.functions", "controller", "unmodelled", "actuator")
"""Parts of the loop whose numbers get sliders first; then uncertain numbers, then all others."""

SliderEnds: TypeAlias = tuple[float, float]
Positions: TypeAlias = Mapping["Slider", float]
Change: TypeAlias = float | dict[str, list[float]]
"""A new value of a number, or a new law."""


class Slider(NamedTuple):
    """A number of a study, or a property of its law, that can be moved.

    Args:
        name: Dotted name of the number in the study.
        part: Property of the number's law: :data:`MEDIAN`, :data:`WIDTH` or an argument; empty for the number itself.
        meaning: Meaning of the number.
        unit: SI unit; empty for a width, which is relative to the study's.
        low: Lowest position.
        high: Highest position.
        start: Position that describes the study itself.
        log: Whether the scale is logarithmic.
        steps: The possible positions; empty if all between the ends are possible.
    """

    name: str
    part: str
    meaning: str
    unit: str
    low: float
    high: float
    start: float
    log: bool
    steps: tuple[float, ...] = ()

    @property
    def key(self) -> str:
        """Name and part, which no other slider has."""
        return f"{self.name} ({self.part})" if self.part else self.name

    @property
    def label(self) -> str:
        """Name, part and unit."""
        return name_with_unit(self.key, self.unit)

    @property
    def is_argument(self) -> bool:
        """Whether the number is an argument of the compiled program.

        A law's values are arguments in any case, and the sample time is fixed when the program is compiled.
        """
        return not self.part and self.name != CLOCK_SLIDER


def sliders_of(study: Study, names: Sequence[str] | None = None) -> list[Slider]:
    """The sliders of a study.

    Args:
        study: The study; the ends of its sweep's axes are the ends of their sliders.
        names: Dotted names of the numbers to move; None: the swept ones, then gains, unmodelled dynamics and laws; for
            a vehicle see :func:`leading_names`.

    Raises:
        ConfigError: There is no such number, or it cannot be moved.
    """
    sliders = []
    if names is not None:
        for name in dict.fromkeys(names):
            sliders += required_sliders(study, name)
        return sliders
    usual_names = leading_names(study)
    if usual_names:
        for name in dict.fromkeys([*study.axes, *usual_names, CLOCK_SLIDER]):
            sliders += sliders_of_number(study, name)[:1]
        return sliders[:MOST_SLIDERS]
    movable = [number for number in study.numbers.values() if is_movable(number)]
    sorted_names = [number.name for number in sorted(movable, key=precedence)]
    for name in dict.fromkeys([*study.axes, *sorted_names, CLOCK_SLIDER]):
        sliders += sliders_of_number(study, name)
    if len(sliders) > MOST_SLIDERS:  # the last is the clock's
        sliders = [*sliders[: MOST_SLIDERS - 1], sliders[-1]]
    return sliders


def leading_names(study: Study) -> list[str]:
    """Names of the numbers that get a slider first if the plant is a vehicle; none for other plants.

    They are the numbers whose quantity is ``leading`` (mass, rotor lag, wind, noise), and two usual gains of the
    controller. Numbers of a single channel are not among them.
    """
    channels = study.loop.channels
    if len(channels) == 1:
        return []
    names = []
    for number in study.numbers.values():
        inner = number.name.split(".")[1:-1]
        if number.quantity.leading and is_movable(number) and not set(inner) & set(channels):
            names.append(number.name)
    tunable = study.loop.controller[0].tunable_gains(study.template.controller[0])
    gains = [f"controller.{name}" for name in tunable if f"controller.{name}" in study.numbers]
    return [*names, *gains[:MOST_GAINS]] if names else []


def required_sliders(study: Study, name: str) -> list[Slider]:
    """The sliders of a number that the user names.

    Raises:
        ConfigError: There is no such number, or it cannot be moved.
    """
    if name != CLOCK_SLIDER and name not in study.numbers:
        raise ConfigError(study.source, f"'{name}' is no number of the loop; {nearest(name, study.numbers)}")
    if name in study.numbers and study.numbers[name].expression:
        raise ConfigError(study.source, f"'{name}' {study.numbers[name].follows}")
    sliders = sliders_of_number(study, name)
    if not sliders:
        raise ConfigError(study.source, f"'{name}' cannot be moved: it is fixed before tracing, or a choice")
    return sliders


def precedence(number: Number) -> int:
    """Rank of a number in the order of sliders, see :data:`FIRST`."""
    for place, part in enumerate(FIRST):
        if number.name.startswith(f"{part}."):
            return place
    return len(FIRST) if isinstance(number.value, Law) else len(FIRST) + 1


def is_movable(number: Number) -> bool:
    """Whether a number gets a slider unless the user names numbers.

    Initial states, recorded data, whole numbers and numbers that follow from an expression do not.
    """
    if number.expression is not None or number.name.startswith("plant.initial"):
        return False
    return number.quantity.law and not number.quantity.data and not number.quantity.whole


def sliders_of_number(study: Study, name: str) -> list[Slider]:
    """The sliders of a number: one for a plain or swept number, two for a law; none if the number cannot be moved."""
    if name == CLOCK_SLIDER:
        return [] if is_expression(study.table["loop"]["sample_time"]) else [sample_time_slider(study)]
    number = study.numbers[name]
    if not number.quantity.law or number.quantity.whole or isinstance(number.value, Expression):
        return []
    if name in study.axes:
        start = number.value.median if isinstance(number.value, Law) else float(number.value)
        low = min(*study.axes[name], start)
        high = max(*study.axes[name], start)
        return [number_slider(number, "", low, high, start, low > 0.0)] if low < high else []
    if isinstance(number.value, RangedLaw):
        return sliders_of_ranges(number, number.value)
    if isinstance(number.value, Law):
        return sliders_of_law(number, number.value)
    low, high, log = extent_around(number.value, number.quantity)
    return [number_slider(number, "", low, high, number.value, log)] if low < number.value <= high else []


def sample_time_slider(study: Study) -> Slider:
    """The slider of the sample time; the duration is a multiple of each of its positions."""
    start = study.loop.sample_time
    steps = []
    for factor in SAMPLE_TIMES:
        count = study.config.loop.duration / (factor * start)
        if count >= 1.0 and abs(count - round(count)) <= 1e-6 * count:
            steps.append(factor * start)
    return Slider(
        name=CLOCK_SLIDER,
        part="",
        meaning="sample time T_s",
        unit="s",
        low=steps[0],
        high=steps[-1],
        start=start,
        log=True,
        steps=tuple(steps),
    )


def sliders_of_law(number: Number, law: Law) -> list[Slider]:
    """The sliders of median and width of a law; none for a law that cannot be moved, such as a choice."""
    if not law.movable:
        return []
    log = law.logarithmic
    low, high, _ = extent_around(law.median, number.quantity)
    if not math.isfinite(law.median) or not low < high:
        return []
    narrowest, widest = WIDTHS
    width = Slider(
        name=number.name,
        part=WIDTH,
        meaning=f"width of {number.quantity.meaning}",
        unit="",
        low=narrowest,
        high=widest,
        start=1.0,
        log=True,
    )
    return [number_slider(number, MEDIAN, low, high, law.median, log), width]


def sliders_of_ranges(number: Number, law: RangedLaw) -> list[Slider]:
    """A slider for each argument of a law that is a range, from the low to the high end of the range."""
    sliders = []
    for name, (low, high), middle in zip(LAWS[law.kind].argument_names, law.ranges, law.arguments, strict=False):
        if low < high:
            meaning = f"{name} of the law of {number.quantity.meaning}"
            sliders.append(Slider(number.name, name, meaning, unit="", low=low, high=high, start=middle, log=False))
    return sliders


def number_slider(number: Number, part: str, low: float, high: float, start: float, log: bool) -> Slider:
    """A slider of a number or of its law's median, with the meaning and the unit of the number."""
    return Slider(number.name, part, number.quantity.meaning, number.quantity.unit, low, high, start, log)


def extent_around(value: float, quantity: Quantity, reach: float = DEFAULT_REACH) -> tuple[float, float, bool]:
    """Low and high end of a slider around a value, and whether its scale is logarithmic.

    A positive number moves between ``value / reach`` and ``value * reach``, zero by one unit to both sides, and a
    negative number by twice its magnitude. All stay within the admissible interval of the quantity.

    Args:
        value: The number.
        quantity: The quantity, for its admissible interval.
        reach: Ratio of the ends to a positive number.
    """
    log = value > 0.0
    step = 2.0 * abs(value) or 1.0
    low = value / reach if log else value - step
    high = value * reach if log else value + step
    inside = 1e-3 * (high - low)
    for bound, margin in ((quantity.above, inside), (quantity.at_least, 0.0)):
        if bound is not None and not low >= bound + margin:
            low = bound + margin
    for bound, margin in ((quantity.below, inside), (quantity.at_most, 0.0)):
        if bound is not None and not high <= bound - margin:
            high = bound - margin
    return low, high, log and low > 0.0


def live_extents(sliders: Iterable[Slider]) -> dict[str, SliderEnds]:
    """Low and high end of the numbers that are arguments of the compiled program, by name."""
    return {slider.name: (slider.low, slider.high) for slider in sliders if slider.is_argument}


def admissible_sliders(study: Study, sliders: Sequence[Slider]) -> list[Slider]:
    """The sliders, with less reach or without those whose ends the rules of a model do not admit together."""
    if admits(study, live_extents(sliders)):
        return list(sliders)
    admitted_sliders: list[Slider] = []
    for slider in sliders:
        candidates = [slider]
        if slider.is_argument:
            candidates += [with_smaller_reach(study, slider, reach) for reach in SMALLER_REACHES]
        for candidate in candidates:
            if admits(study, live_extents([*admitted_sliders, candidate])):
                admitted_sliders.append(candidate)
                break
    return admitted_sliders


def with_smaller_reach(study: Study, slider: Slider, reach: float) -> Slider:
    """A slider with a smaller reach around its start, within its present ends."""
    low, high, _ = extent_around(slider.start, study.quantities[slider.name], reach)
    return slider._replace(low=max(low, slider.low), high=min(high, slider.high))


def admits(study: Study, extents: Mapping[str, SliderEnds]) -> bool:
    """Whether a study is valid with the ends of all extents as swept values."""
    try:
        study.override({"sweep": {name: sorted(set(extent)) for name, extent in extents.items()}})
    except ConfigError:
        return False
    return True


def study_changes(study: Study, positions: Positions) -> dict[str, Change]:
    """The changes of a study that positions of its sliders describe, by dotted name; none for sliders at their start.

    Args:
        study: The study, with its sweep.
        positions: Position of each slider.

    Raises:
        ConfigError: A law cannot be moved to its position.
    """
    changes: dict[str, Change] = {}
    laws: dict[str, dict[str, float]] = {}
    for slider, position in positions.items():
        if slider.part:
            laws.setdefault(slider.name, {})[slider.part] = float(position)
        elif position != slider.start or slider.name in study.axes:
            changes[slider.name] = float(position)
    for name, parts in laws.items():
        law = study.numbers[name].value
        assert isinstance(law, Law)  # only laws have parts
        law_table = changed_law(name, law, parts)
        if law_table is not None:
            changes[name] = law_table
    return changes


def changed_law(name: str, law: Law, parts: Mapping[str, float]) -> dict[str, list[float]] | None:
    """The table of a law at positions of its sliders; None if the law is that of the study.

    Args:
        name: Dotted name of the number, for messages.
        law: The law in the study.
        parts: Positions by part, see :attr:`Slider.part`.

    Raises:
        ConfigError: The law cannot be moved there.
    """
    if isinstance(law, RangedLaw):
        names = LAWS[law.kind].argument_names
        return {law.kind: [parts.get(part, middle) for part, middle in zip(names, law.arguments, strict=False)]}
    median = parts.get(MEDIAN, law.median)
    width = parts.get(WIDTH, 1.0)
    if (median, width) == (law.median, 1.0):
        return None
    try:
        moved_law = law.moved(median, width)
    except ValueError as error:
        raise ConfigError(name, str(error)) from None
    return {moved_law.kind: list(moved_law.arguments)}


def slider_positions(slider: Slider) -> tuple[float, ...]:
    """The positions of a slider, increasing: ends and start exactly, the others rounded to four significant digits.

    No two positions have the same :func:`position_text`.
    """
    if slider.steps:
        return slider.steps
    if slider.log:
        values = [math.exp(value) for value in np.linspace(math.log(slider.low), math.log(slider.high), POSITION_COUNT)]
    else:
        values = np.linspace(slider.low, slider.high, POSITION_COUNT).tolist()
    by_text = {position_text(value): float(position_text(value)) for value in values[1:-1]}
    by_text |= {position_text(value): value for value in (slider.low, slider.high, slider.start)}
    return tuple(sorted(value for value in by_text.values() if slider.low <= value <= slider.high))


def position_text(value: float) -> str:
    """A position as the page shows it."""
    return f"{value:.4g}"
