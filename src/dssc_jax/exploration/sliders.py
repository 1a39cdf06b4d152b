"""Sliders: which numbers of a study can be moved, on which scale, and the study that their positions describe."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.quantities import Quantity
from dssc_jax.study import Study
from dssc_jax.study.components import Number
from dssc_jax.study.laws import Law

MOST = 14  # sliders of a page that names none
DEFAULT_REACH = 10.0  # a positive number moves between a tenth and ten times its value
NARROWER = (3.0, 1.5)  # reaches to try where the rules of a model do not admit the widest
POSITION_COUNT = 81  # positions of a slider
WIDTHS = (0.1, 10.0)  # of a law, relative to its own
MEDIAN, WIDTH = "median", "width"
CLOCK_SLIDER = "loop.sample_time"
SAMPLE_TIMES = (0.25, 0.5, 1.0, 2.0, 4.0)  # relative to the study's own
FIRST = ("controller.functions", "controller", "unmodelled")
"""Parts of the loop whose numbers get sliders first; then uncertain numbers, then all others."""

SliderEnds = tuple[float, float]
Positions = Mapping["Slider", float]


class Slider(NamedTuple):
    """A number that can be moved.

    Args:
        name: Dotted name of the number in the study.
        part: What moves: empty for the number itself, :data:`MEDIAN` or :data:`WIDTH` of its law.
        meaning: The standard term.
        unit: SI unit; empty for a width, which is relative to the study's.
        low: Lowest position.
        high: Highest position.
        start: The study's own position.
        log: Whether the scale is logarithmic.
        steps: The positions, if only these are possible.
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
        names: Dotted names of the numbers to move; None: the swept ones, then gains, unmodelled dynamics and laws.

    Raises:
        ConfigError: There is no such number, or it cannot be moved.
    """
    if names is None:
        movable = [name for name, number in study.numbers.items() if is_movable(number)]
        movable = [*study.axes, *sorted(movable, key=lambda name: precedence(study.numbers[name]))]
        wanted = list(dict.fromkeys([*movable, CLOCK_SLIDER]))
        made = [slider for name in wanted for slider in sliders_of_number(study, name)]
        return made if len(made) <= MOST else [*made[: MOST - 1], made[-1]]
    return [slider for name in dict.fromkeys(names) for slider in required_sliders(study, name)]


def required_sliders(study: Study, name: str) -> list[Slider]:
    """The sliders of a number that the user named.

    Raises:
        ConfigError: There is no such number, or it cannot be moved.
    """
    if name != CLOCK_SLIDER and name not in study.numbers:
        raise ConfigError(study.source, f"'{name}' is no number of the loop; {nearest(name, study.numbers)}")
    made = sliders_of_number(study, name)
    if not made:
        raise ConfigError(study.source, f"'{name}' cannot be moved: it is fixed before tracing, or a choice")
    return made


def precedence(number: Number) -> int:
    """Place of a number in the order of sliders, see :data:`FIRST`."""
    certain = not isinstance(number.value, Law)
    return next((i for i, part in enumerate(FIRST) if number.name.startswith(f"{part}.")), len(FIRST) + certain)


def is_movable(number: Number) -> bool:
    """Whether a number gets a slider without being asked for: initial states and records do not."""
    return number.quantity.law and not number.quantity.data and not number.name.startswith("plant.initial")


def sliders_of_number(study: Study, name: str) -> list[Slider]:
    """One slider of a number, two of a law; none if it cannot be moved."""
    if name == CLOCK_SLIDER:
        own = study.loop.sample_time
        steps = tuple(share * own for share in SAMPLE_TIMES if is_whole(study.config.loop.duration / (share * own)))
        return [Slider(name, "", "sample time T_s", "s", steps[0], steps[-1], own, True, steps)]
    number = study.numbers[name]
    if not number.quantity.law:
        return []
    if name in study.axes:
        values = study.axes[name]
        low, high, start = min(values), max(values), study_value(study, number)
        low, high = min(low, start), max(high, start)
        log = low > 0.0
        return [slider_at(number, "", low, high, start, log)] if low < high else []
    if isinstance(number.value, Law):
        return sliders_of_law(number, number.value)
    low, high, log = extent_around(number.value, number.quantity)
    return [slider_at(number, "", low, high, number.value, log)] if low < number.value <= high else []


def study_value(study: Study, number: Number) -> float:
    """The study's own value of a swept number, or its law's median."""
    return number.value.median if isinstance(number.value, Law) else float(number.value)


def is_whole(count: float) -> bool:
    """Whether a number of samples is whole."""
    return count >= 1.0 and abs(count - round(count)) <= 1e-6 * count


def sliders_of_law(number: Number, law: Law) -> list[Slider]:
    """The median and the width of a law; none of a choice."""
    if not law.movable:
        return []
    log = law.logarithmic
    low, high, _ = extent_around(law.median, number.quantity)
    if not math.isfinite(law.median) or not low < high:
        return []
    width = Slider(number.name, WIDTH, f"width of {number.quantity.meaning}", "", *WIDTHS, 1.0, True)
    return [slider_at(number, MEDIAN, low, high, law.median, log), width]


def slider_at(number: Number, part: str, low: float, high: float, start: float, log: bool) -> Slider:
    """A slider of a number."""
    return Slider(number.name, part, number.quantity.meaning, number.quantity.unit, low, high, start, log)


def extent_around(value: float, quantity: Quantity, reach: float = DEFAULT_REACH) -> tuple[float, float, bool]:
    """The ends of a slider, and whether its scale is logarithmic.

    A positive number moves between a ``reach``-th and ``reach`` times its value, zero by one unit, a negative number
    by twice its magnitude; all within the admissible interval.
    """
    if value > 0.0:
        low, high, log = value / reach, value * reach, True
    else:
        step = 2.0 * abs(value) or 1.0
        low, high, log = value - step, value + step, False
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
    return {s.name: (s.low, s.high) for s in sliders if not s.part and s.name != CLOCK_SLIDER}


def admitted(study: Study, sliders: Sequence[Slider]) -> list[Slider]:
    """The sliders, narrowed or left out where the rules of a model do not admit their ends together."""
    if admits(study, live_extents(sliders)):
        return list(sliders)
    kept: list[Slider] = []
    for slider in sliders:
        shapes = [slider, *(narrowed(study, slider, reach) for reach in NARROWER)] if not slider.part else [slider]
        fits = (shape for shape in shapes if admits(study, live_extents([*kept, shape])))
        kept += [fit] if (fit := next(fits, None)) is not None else []
    return kept


def narrowed(study: Study, slider: Slider, reach: float) -> Slider:
    """A slider of smaller reach."""
    if slider.name == CLOCK_SLIDER:
        return slider
    low, high, _ = extent_around(slider.start, study.quantities[slider.name], reach)
    return slider._replace(low=max(low, slider.low), high=min(high, slider.high))


def admits(study: Study, extents: Mapping[str, SliderEnds]) -> bool:
    """Whether a study admits the ends of all extents as swept values."""
    try:
        study.override({"sweep": {name: sorted(set(extent)) for name, extent in extents.items()}})
    except ConfigError:
        return False
    return True


def changes_of(study: Study, positions: Positions) -> dict[str, Any]:
    """What to override in a study so that it is as its sliders stand; sliders at their start change nothing.

    Raises:
        ConfigError: A law cannot be moved there.
    """
    changes: dict[str, Any] = {}
    laws: dict[str, dict[str, float]] = {}
    for slider, position in positions.items():
        if slider.part:
            laws.setdefault(slider.name, {})[slider.part] = float(position)
        elif position != slider.start or slider.name in study.axes:
            changes[slider.name] = float(position)
    for name, parts in laws.items():
        law = study.numbers[name].value
        assert isinstance(law, Law)  # only laws have parts
        median, share = parts.get(MEDIAN, law.median), parts.get(WIDTH, 1.0)
        if (median, share) != (law.median, 1.0):
            try:
                moved = law.moved(median, share)
            except ValueError as error:
                raise ConfigError(name, str(error)) from None
            changes[name] = {moved.kind: list(moved.arguments)}
    return changes


def grid(slider: Slider, count: int = POSITION_COUNT) -> tuple[float, ...]:
    """The positions of a slider: its ends and its start as they are, and others rounded to four significant digits.

    No two positions have the same text.
    """
    if slider.steps:
        return slider.steps
    if slider.log:
        ends = math.log(slider.low), math.log(slider.high)
        values = [math.exp(value) for value in np.linspace(*ends, count)]
    else:
        values = np.linspace(slider.low, slider.high, count).tolist()
    by_text = {position_text(value): float(position_text(value)) for value in values[1:-1]}
    by_text |= {position_text(value): value for value in (slider.low, slider.high, slider.start)}
    return tuple(sorted(value for value in by_text.values() if slider.low <= value <= slider.high))


def position_text(value: float) -> str:
    """A position as the page shows it."""
    return f"{value:.4g}"
