"""Make the sliders of a study: which numbers can be moved, on which scale, and how positions change the study."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

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
WIDTHS = (0.1, 10.0)
"""Smallest and largest width of a law, relative to the study's."""
MEDIAN = "median"
WIDTH = "width"
"""Properties of a law that a slider can move."""
CLOCK_SLIDER = "loop.sample_time"
"""Name of the slider of the sample time."""
SAMPLE_TIMES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Positions of the slider of the sample time, relative to the study's sample time."""
FIRST = ("parameters", "controller.functions", "controller", "unmodelled", "actuator")
"""Parts of the loop whose numbers get sliders first; then uncertain numbers, then all others."""


class SliderScale(NamedTuple):
    """The scale of a slider.

    Args:
        low: Lowest position.
        high: Highest position.
        log: Whether the scale is logarithmic.
    """

    low: float
    high: float
    log: bool


SliderEnds: TypeAlias = tuple[float, float]
"""Low and high end of a slider."""


class Slider(NamedTuple):
    """A number of a study, or a property of its law, that can be moved.

    Args:
        name: Dotted name of the number in the study.
        part: Property of the number's law: :data:`MEDIAN`, :data:`WIDTH` or an argument; empty for the number itself.
        meaning: Meaning of the number.
        unit: SI unit; empty for a width, which is a ratio to the width in the study.
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
        """Name and part, which together identify the slider."""
        return f"{self.name} ({self.part})" if self.part else self.name

    @property
    def label(self) -> str:
        """Name, part and unit."""
        return name_with_unit(self.key, self.unit)

    @property
    def is_argument(self) -> bool:
        """Whether the slider makes its number an argument of the compiled program.

        The numbers with laws are arguments already. The sample time is fixed when the program is compiled.
        """
        return not self.part and self.name != CLOCK_SLIDER


def sliders_of(study: Study, names: Sequence[str] | None = None) -> list[Slider]:
    """Return the sliders of a study.

    Args:
        study: The study; each axis of its sweep gives the ends of a slider.
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
            sliders += sliders_of_number(study, name)[:1]  # of a law the median only
        return sliders[:MOST_SLIDERS]
    movable = [number for number in study.numbers.values() if is_movable(number)]
    sorted_names = [number.name for number in sorted(movable, key=precedence)]
    for name in dict.fromkeys([*study.axes, *sorted_names, CLOCK_SLIDER]):
        sliders += sliders_of_number(study, name)
    if len(sliders) > MOST_SLIDERS:  # the last one, of the sample time, is kept
        sliders = [*sliders[: MOST_SLIDERS - 1], sliders[-1]]
    return sliders


def leading_names(study: Study) -> list[str]:
    """Return the numbers that get a slider first if the plant is a vehicle; none for other plants.

    First come the numbers whose quantity is ``leading`` (mass, rotor lag, wind, noise), then the first
    :data:`MOST_GAINS` gains that the controller declares tunable. Numbers that belong to a single channel are left out.
    """
    channels = set(study.loop.channels)
    if len(channels) == 1:
        return []
    names = []
    for number in study.numbers.values():
        tables = number.name.split(".")[1:-1]
        belongs_to_channel = not channels.isdisjoint(tables)
        if number.quantity.leading and is_movable(number) and not belongs_to_channel:
            names.append(number.name)
    tunable = study.loop.controller[0].tunable_gains(study.template.controller[0])
    gains = [f"controller.{name}" for name in tunable if f"controller.{name}" in study.numbers]
    return [*names, *gains[:MOST_GAINS]] if names else []


def required_sliders(study: Study, name: str) -> list[Slider]:
    """Return the sliders of a number that the user names.

    Args:
        study: The study.
        name: Dotted name of the number.

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
    """Return the rank of a number in the order of sliders, see :data:`FIRST`."""
    for rank, part in enumerate(FIRST):
        if number.name.startswith(f"{part}."):
            return rank
    is_uncertain = isinstance(number.value, Law)
    return len(FIRST) if is_uncertain else len(FIRST) + 1


def is_movable(number: Number) -> bool:
    """Whether a number may get a slider if the user names no numbers.

    Initial states, recorded data, whole numbers and numbers that follow from an expression may not.
    """
    if number.expression is not None or number.name.startswith("plant.initial"):
        return False
    return number.quantity.law and not number.quantity.data and not number.quantity.whole


def sliders_of_number(study: Study, name: str) -> list[Slider]:
    """Return the sliders of a number; none if the number cannot be moved.

    A plain or swept number has one slider. A law has two, for its median and its width. A law with ranges has one
    slider for each range.

    Args:
        study: The study.
        name: Dotted name of the number, or :data:`CLOCK_SLIDER`.
    """
    if name == CLOCK_SLIDER:
        follows_from_others = is_expression(study.table["loop"]["sample_time"])
        return [] if follows_from_others else [sample_time_slider(study)]
    number = study.numbers[name]
    if not number.quantity.law or number.quantity.whole or isinstance(number.value, Expression):
        return []
    if name in study.axes:
        start = number.value.median if isinstance(number.value, Law) else float(number.value)
        return sliders_of_axis(number, start, study.axes[name])
    if isinstance(number.value, RangedLaw):
        return sliders_of_ranges(number, number.value)
    if isinstance(number.value, Law):
        return sliders_of_law(number, number.value)
    scale = scale_around(number.value, number.quantity)
    is_inside = scale.low < number.value <= scale.high
    return [number_slider(number, "", scale, number.value)] if is_inside else []


def sliders_of_axis(number: Number, start: float, values: Sequence[float]) -> list[Slider]:
    """Return the slider of a swept number over its axis; none if the axis has no value but the start.

    Args:
        number: The number.
        start: Value of the number, or the median of its law; it lies within the ends of the slider.
        values: Values of the axis.
    """
    low = min(*values, start)
    high = max(*values, start)
    return [number_slider(number, "", SliderScale(low, high, log=low > 0.0), start)] if low < high else []


def sample_time_slider(study: Study) -> Slider:
    """Return the slider of the sample time; the duration is a whole multiple of each of the slider's positions."""
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
    """Return the sliders of median and width of a law.

    There are none if the law cannot be moved, such as a choice, or if its median has no room to move.

    Args:
        number: The number with the law.
        law: The law.
    """
    if not law.movable:
        return []
    scale = scale_around(law.median, number.quantity)._replace(log=law.logarithmic)
    if not math.isfinite(law.median) or not scale.low < scale.high:
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
    return [number_slider(number, MEDIAN, scale, law.median), width]


def sliders_of_ranges(number: Number, law: RangedLaw) -> list[Slider]:
    """Return a slider for each argument of a law that is a range, between the ends of the range."""
    sliders = []
    names = LAWS[law.kind].argument_names  # the last ones may be optional
    for name, (low, high), middle in zip(names, law.ranges, law.arguments, strict=False):
        if low < high:
            meaning = f"{name} of the law of {number.quantity.meaning}"
            sliders.append(Slider(number.name, name, meaning, unit="", low=low, high=high, start=middle, log=False))
    return sliders


def number_slider(number: Number, part: str, scale: SliderScale, start: float) -> Slider:
    """Return a slider of a number or of its law's median, with the number's name, meaning and unit.

    Args:
        number: The number.
        part: As in :class:`Slider`.
        scale: Ends and kind of the slider's scale.
        start: Position at first.
    """
    quantity = number.quantity
    return Slider(number.name, part, quantity.meaning, quantity.unit, scale.low, scale.high, start, scale.log)


def scale_around(value: float, quantity: Quantity, reach: float = DEFAULT_REACH) -> SliderScale:
    """Return the scale of a slider around a value; it is logarithmic for a positive number.

    The ends of a positive number are ``value / reach`` and ``value * reach``. Those of zero are -1 and 1, and those of
    a negative number lie twice its magnitude below and above it. The admissible interval of the quantity cuts the ends.

    Args:
        value: The number.
        quantity: The quantity, for its admissible interval.
        reach: Ratio of the ends to a positive number.
    """
    log = value > 0.0
    if log:
        low = value / reach
        high = value * reach
    else:
        step = 1.0 if value == 0.0 else 2.0 * abs(value)
        low = value - step
        high = value + step
    margin = 1e-3 * (high - low)  # distance from a bound that is not admissible itself
    if quantity.above is not None:
        low = max(low, quantity.above + margin)
    if quantity.at_least is not None:
        low = max(low, quantity.at_least)
    if quantity.below is not None:
        high = min(high, quantity.below - margin)
    if quantity.at_most is not None:
        high = min(high, quantity.at_most)
    return SliderScale(low, high, log and low > 0.0)


def live_extents(sliders: Iterable[Slider]) -> dict[str, SliderEnds]:
    """Return low and high end of each number that a slider makes an argument of the compiled program, by name."""
    return {slider.name: (slider.low, slider.high) for slider in sliders if slider.is_argument}


def admissible_sliders(study: Study, sliders: Sequence[Slider]) -> list[Slider]:
    """Return the sliders whose ends the rules of the models admit together.

    A slider whose ends are not admitted is replaced by one with a smaller reach, or left out if no reach is admitted.

    Args:
        study: The study.
        sliders: The sliders, the most important first: each must be admitted beside the earlier ones.
    """
    if admits(study, live_extents(sliders)):
        return list(sliders)
    admitted_sliders: list[Slider] = []
    for slider in sliders:
        candidates = [slider]
        if slider.is_argument:
            candidates += [with_smaller_reach(study, slider, reach) for reach in SMALLER_REACHES]
        for candidate in candidates:  # the first that is admitted beside the sliders so far
            if admits(study, live_extents([*admitted_sliders, candidate])):
                admitted_sliders.append(candidate)
                break
    return admitted_sliders


def with_smaller_reach(study: Study, slider: Slider, reach: float) -> Slider:
    """Return a slider with a smaller reach around its start, within its present ends.

    Args:
        study: The study, for the quantity of the number.
        slider: The slider.
        reach: Ratio of the ends to a positive number, see :func:`scale_around`.
    """
    scale = scale_around(slider.start, study.quantities[slider.name], reach)
    return slider._replace(low=max(scale.low, slider.low), high=min(scale.high, slider.high))


def admits(study: Study, extents: Mapping[str, SliderEnds]) -> bool:
    """Whether a study is valid with both ends of each extent as swept values.

    Args:
        study: The study.
        extents: Low and high end of each number.
    """
    try:
        study.override({"sweep": {name: sorted(set(extent)) for name, extent in extents.items()}})
    except ConfigError:
        return False
    return True
