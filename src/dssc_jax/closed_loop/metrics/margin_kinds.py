"""Margins of the linearised loop that a study can require, and the units of their bounds."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from dssc_jax.core.signals import Scalar


def decibel(value: float) -> float:
    """The ratio 10^(value/20) that a value in decibels stands for."""
    return float(10.0 ** (value / 20.0))


def identity(value: float) -> float:
    """The value itself: the conversion of a unit to itself."""
    return value


# The units in which a bound may be written, each with the function that converts a value to the first of them.
RATIO = MappingProxyType({"1": identity, "dB": decibel})
ANGLE = MappingProxyType({"rad": identity, "deg": math.radians})
TIME = MappingProxyType({"s": identity, "ms": lambda value: 1e-3 * value, "us": lambda value: 1e-6 * value})
FREQUENCY = MappingProxyType({"rad/s": identity, "Hz": lambda value: 2.0 * math.pi * value})


@dataclass(frozen=True)
class MarginKind:
    """A kind of margin of the linearised loop, such as the phase margin.

    Args:
        field: Name of the margin in :class:`dssc_jax.engine.linearisation.response.ClassicalMargins`.
        name: Beginning of the name in results.
        meaning: Meaning in words.
        units: Units of a bound, each with its conversion to the first one, which is the unit of the margin.
        good: ``large`` or ``small``: which values are good.
        neutral: The value at the limit of stability, which unstable loops also get; NaN: the margin has no such value.
        most: The largest possible value.
    """

    field: str
    name: str
    meaning: str
    units: Mapping[str, Callable[[float], float]]
    good: str
    neutral: float
    most: float = math.inf

    @property
    def worst(self) -> float:
        """The value that replaces NaN: that at the limit of stability, or else the infinity on the bad side."""
        has_limit = not math.isnan(self.neutral)
        if has_limit:
            return self.neutral
        return -math.inf if self.good == "large" else math.inf

    def in_unit(self, value: float, unit: str) -> float:
        """Convert a value in the margin's own unit, such as rad, to another of its units, such as deg.

        A gain is converted to decibels as 20 log10; a gain of 0 or less is -inf dB.
        """
        if self.units[unit] is decibel:
            return 20.0 * math.log10(value) if value > 0.0 else -math.inf
        return value / self.units[unit](1.0)

    @property
    def unit(self) -> str:
        """The unit of the margin."""
        return next(iter(self.units))


MARGIN_KINDS = {
    "gain": MarginKind("gain_upper", "gain_margin", "gain margin", RATIO, "large", neutral=1.0),
    "gain_lower": MarginKind("gain_lower", "gain_lower_margin", "lower gain margin", RATIO, "small", neutral=1.0),
    "phase": MarginKind("phase", "phase_margin", "phase margin", ANGLE, "large", neutral=0.0, most=math.pi),
    "delay": MarginKind("delay", "delay_margin", "delay margin", TIME, "large", neutral=0.0),
    "disk": MarginKind("disk", "disk_margin", "disk margin alpha", RATIO, "large", neutral=0.0),
    "modulus": MarginKind("modulus", "modulus_margin", "modulus margin", RATIO, "large", neutral=0.0),
    "sensitivity": MarginKind(
        "sensitivity_peak", "sensitivity_peak", "peak sensitivity M_s", RATIO, "small", neutral=math.inf
    ),
    "complementary": MarginKind(
        "complementary_peak",
        "complementary_peak",
        "peak complementary sensitivity M_t",
        RATIO,
        "small",
        neutral=math.inf,
    ),
    "bandwidth": MarginKind("bandwidth", "bandwidth", "bandwidth of T", FREQUENCY, "large", neutral=math.nan),
}
"""Every margin that a requirement can bound, by its name in ``[[requirement]]``."""


@dataclass(frozen=True)
class LoopMargin:
    """A margin of the loop broken at one point.

    Args:
        kind: The kind of margin.
        place: Name of the break point, see :func:`dssc_jax.closed_loop.break_points.place_names`.
    """

    kind: MarginKind
    place: str


NO_MARGINS: Mapping[str, Scalar] = MappingProxyType({})
"""Values of required margins, by the name of the measure, for a loop without any."""
