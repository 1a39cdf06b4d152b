"""Sliders: which numbers of a study can be moved, on which scale, and the study that their positions describe."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.quantities import Quantity
from dssc_jax.study import Study
from dssc_jax.study.expressions import is_expression
from dssc_jax.study.laws import LAWS, Law, RangedLaw
from dssc_jax.study.numbers import Number
from dssc_jax.study.parameters import Expression

GAINS = 2  # number of sliders for gains of a vehicle's controller
MOST_SLIDERS = 14  # of a page that names none
DEFAULT_REACH = 10.0  # a positive number moves between a tenth and ten times its value
NARROWER = (3.0, 1.5)  # reaches to try where the rules of a model do not admit the widest
POSITION_COUNT = 81  # positions of a slider
WIDTHS = (0.1, 10.0)  # least and largest width of a law, relative to its own
MEDIAN = "median"
WIDTH = "width"
CLOCK_SLIDER = "loop.sample_time"
SAMPLE_TIMES = (0.25, 0.5, 1.0, 2.0, 4.0)  # relative to the study's own
FIRST = ("parameters", "controller.functions", "controller", "unmodelled", "actuator")
"""Parts of the loop whose numbers get sliders first; then uncertain numbers, then all others."""

SliderEnds: TypeAlias = tuple[float, float]
Positions: TypeAlias = Mapping["Slider", float]
Change: TypeAlias = float | dict[str, list[float]]
"""A new value of a number, or a new law."""


class Slider(NamedTuple):
    """A number that can be moved."""

    name: str  # dotted name of the number in the study
    part: str  # empty for the number itself, MEDIAN or WIDTH of its law
    meaning: str  # the standard term
    unit: str  # SI unit; empty for a width, which is relative to the study's
    low: float  # lowest position
    high: float  # highest position
    start: float  # the study's own position
    log: bool  # whether the scale is logarithmic
    steps: tuple[float, ...] = ()  # the positions, if only these are possible

    @property
    def key(self) -> str:
        """A name that no other slider has."""
        return f"{self.name} ({self.part})" if self.part else self.name

    @property
    def label(self) -> str:
        """Name, part and unit."""
        return f"{self.key} [{self.unit}]" if self.unit not in ("", "1") else self.key


def sliders_of(study: Study, names: Sequence[str] | None = None) -> list[Slider]:
    """The sliders of a study.

    Args:
        study: The study; the ends of its sweep's axes are the ends of their sliders.
        names: Dotted names of the numbers to move; None: the swept ones, then gains, unmodelled dynamics and laws; of
            a vehicle see :func:`leading_names`.

    Raises:
        ConfigError: There is no such number, or it cannot be moved.
    """
    if names is not None:
        return [slider for name in dict.fromkeys(names) for slider in required_sliders(study, name)]
    usual = leading_names(study)
    if usual:
        groups = [sliders_of_number(study, name)[:1] for name in dict.fromkeys([*study.axes, *usual, CLOCK_SLIDER])]
        return [slider for group in groups for slider in group][:MOST_SLIDERS]
    movable = [number for number in study.numbers.values() if is_movable(number)]
    sorted_names = [number.name for number in sorted(movable, key=precedence)]
    sliders = []
    for name in dict.fromkeys([*study.axes, *sorted_names, CLOCK_SLIDER]):
        sliders += sliders_of_number(study, name)
    if len(sliders) > MOST_SLIDERS:  # the last is the clock's
        sliders = [*sliders[: MOST_SLIDERS - 1], sliders[-1]]
    return sliders


def leading_names(study: Study) -> list[str]:
    """The numbers with which the exploration of a vehicle begins; none of another plant.

    They are those whose quantity is ``leading`` (mass, rotor lag, wind, noise), and two usual gains of its controller.
    A number of a single channel is not among them.
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
    return [*names, *gains[:GAINS]] if names else []


def required_sliders(study: Study, name: str) -> list[Slider]:
    """The sliders of a number that the user named."""
    if name != CLOCK_SLIDER and name not in study.numbers:
        raise ConfigError(study.source, f"'{name}' is no number of the loop; {nearest(name, study.numbers)}")
    if name in study.numbers and study.numbers[name].expression:
        raise ConfigError(study.source, f"'{name}' {study.numbers[name].follows}")
    sliders = sliders_of_number(study, name)
    if not sliders:
        raise ConfigError(study.source, f"'{name}' cannot be moved: it is fixed before tracing, or a choice")
    return sliders


def precedence(number: Number) -> int:
    """Place of a number in the order of sliders, see :data:`FIRST`."""
    for place, part in enumerate(FIRST):
        if number.name.startswith(f"{part}."):
            return place
    return len(FIRST) if isinstance(number.value, Law) else len(FIRST) + 1


def is_movable(number: Number) -> bool:
    """Whether a number gets a slider without being asked for: initial states, records and what follows do not."""
    free = number.expression is None and not number.name.startswith("plant.initial")
    return free and number.quantity.law and not number.quantity.data and not number.quantity.whole


def sliders_of_number(study: Study, name: str) -> list[Slider]:
    """One slider of a number, two of a law; none if it cannot be moved."""
    if name == CLOCK_SLIDER:
        return [] if is_expression(study.table["loop"]["sample_time"]) else [sample_time_slider(study)]
    number = study.numbers[name]
    if not number.quantity.law or number.quantity.whole or isinstance(number.value, Expression):
        return []
    if name in study.axes:
        start = number.value.median if isinstance(number.value, Law) else float(number.value)
        low = min(*study.axes[name], start)
        high = max(*study.axes[name], start)
        return [slider_at(number, "", low, high, start, low > 0.0)] if low < high else []
    if isinstance(number.value, RangedLaw):
        return sliders_of_ranges(number, number.value)
    if isinstance(number.value, Law):
        return sliders_of_law(number, number.value)
    low, high, log = extent_around(number.value, number.quantity)
    return [slider_at(number, "", low, high, number.value, log)] if low < number.value <= high else []


def sample_time_slider(study: Study) -> Slider:
    """The slider of the sample time, whose positions divide the duration."""
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
    """The median and the width of a law; none of a choice."""
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
    return [slider_at(number, MEDIAN, low, high, law.median, log), width]


def sliders_of_ranges(number: Number, law: RangedLaw) -> list[Slider]:
    """A slider for each argument of a law that is a range, from its lowest to its highest value."""
    sliders = []
    for name, (low, high), middle in zip(LAWS[law.kind].argument_names, law.ranges, law.arguments, strict=False):
        if low < high:
            meaning = f"{name} of the law of {number.quantity.meaning}"
            sliders.append(
                Slider(
                    name=number.name, part=name, meaning=meaning, unit="", low=low, high=high, start=middle, log=False
                )
            )
    return sliders


def slider_at(number: Number, part: str, low: float, high: float, start: float, log: bool) -> Slider:
    """A slider of a number."""
    return Slider(
        name=number.name,
        part=part,
        meaning=number.quantity.meaning,
        unit=number.quantity.unit,
        low=low,
        high=high,
        start=start,
        log=log,
    )


def extent_around(value: float, quantity: Quantity, reach: float = DEFAULT_REACH) -> tuple[float, float, bool]:
    """The ends of a slider, and whether its scale is logarithmic.

    A positive number moves between a ``reach``-th and ``reach`` times its value, zero by one unit, a negative number
    by twice its magnitude; all within the admissible interval.
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
    """The numbers that are arguments of the compiled program, with their extents.

    A law's values are arguments anyway, and the sample time is fixed when the program is compiled.
    """
    numbers = [slider for slider in sliders if not slider.part and slider.name != CLOCK_SLIDER]
    return {slider.name: (slider.low, slider.high) for slider in numbers}


def admitted(study: Study, sliders: Sequence[Slider]) -> list[Slider]:
    """The sliders, narrowed or left out where the rules of a model do not admit their ends together."""
    if admits(study, live_extents(sliders)):
        return list(sliders)
    admitted_sliders: list[Slider] = []
    for slider in sliders:
        candidates = [slider]
        if not slider.part and slider.name != CLOCK_SLIDER:
            candidates += [narrow(study, slider, reach) for reach in NARROWER]
        for candidate in candidates:
            if admits(study, live_extents([*admitted_sliders, candidate])):
                admitted_sliders.append(candidate)
                break
    return admitted_sliders


def narrow(study: Study, slider: Slider, reach: float) -> Slider:
    """A slider of smaller reach."""
    low, high, _ = extent_around(slider.start, study.quantities[slider.name], reach)
    return slider._replace(low=max(low, slider.low), high=min(high, slider.high))


def admits(study: Study, extents: Mapping[str, SliderEnds]) -> bool:
    """Whether a study admits the ends of all extents as swept values."""
    try:
        study.override({"sweep": {name: sorted(set(extent)) for name, extent in extents.items()}})
    except ConfigError:
        return False
    return True


def changes_of(study: Study, positions: Positions) -> dict[str, Change]:
    """What to override in a study so that it is as its sliders stand; sliders at their start change nothing.

    Raises:
        ConfigError: A law cannot be moved there.
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
        if isinstance(law, RangedLaw):
            names = LAWS[law.kind].argument_names
            arguments = [parts.get(argument, middle) for argument, middle in zip(names, law.arguments, strict=False)]
            changes[name] = {law.kind: arguments}
            continue
        median = parts.get(MEDIAN, law.median)
        share = parts.get(WIDTH, 1.0)
        if (median, share) != (law.median, 1.0):
            try:
                moved_law = law.moved(median, share)
            except ValueError as error:
                raise ConfigError(name, str(error)) from None
            changes[name] = {moved_law.kind: list(moved_law.arguments)}
    return changes


def grid(slider: Slider) -> tuple[float, ...]:
    """The positions of a slider: its ends and its start as they are, and others rounded to four significant digits.

    No two positions have the same text.
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
