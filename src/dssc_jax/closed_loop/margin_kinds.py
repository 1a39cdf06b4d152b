"""Margins of the linearised loop that a study can require, and the units in which it may write their bounds."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from dssc_jax.core.signals import Scalar


def decibel(value: float) -> float:
    """A factor from decibels."""
    return float(10.0 ** (value / 20.0))


def plain(value: float) -> float:
    """The number itself."""
    return value


RATIO = MappingProxyType({"1": plain, "dB": decibel})
ANGLE = MappingProxyType({"rad": plain, "deg": math.radians})
TIME = MappingProxyType({"s": plain, "ms": lambda value: 1e-3 * value, "us": lambda value: 1e-6 * value})
FREQUENCY = MappingProxyType({"rad/s": plain, "Hz": lambda value: 2.0 * math.pi * value})
"""Units in which a bound may be written, each with its conversion to the first one."""


@dataclass(frozen=True)
class MarginKind:
    """A margin of the linearised loop.

    Args:
        field: Name of the margin in :class:`dssc_jax.engine.linearisation.response.ClassicalMargins`.
        name: Beginning of the name in results.
        meaning: In words.
        units: Units of a bound, each with its conversion to the first one, in which the margin is.
        good: ``large`` or ``small``: the side that is good.
        neutral: The value at the limit of stability, which an unstable loop has, too; NaN: there is none.
        most: The largest value that a loop can have.
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
        """The value as which a loop without a margin counts: that at the limit of stability, or the bad end."""
        if math.isnan(self.neutral):
            return -math.inf if self.good == "large" else math.inf
        return self.neutral

    def in_unit(self, value: float, unit: str) -> float:
        """A value of the margin in one of its units."""
        if self.units[unit] is decibel:
            return 20.0 * math.log10(value) if value > 0.0 else -math.inf
        return value / self.units[unit](1.0)

    @property
    def unit(self) -> str:
        """The unit of the value."""
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
    """A margin at a place where the loop is broken.

    Args:
        kind: The margin.
        place: Name of the break point.
    """

    kind: MarginKind
    place: str


NO_MARGINS: Mapping[str, Scalar] = MappingProxyType({})
"""The margins of a loop of which none is required, by measure."""
