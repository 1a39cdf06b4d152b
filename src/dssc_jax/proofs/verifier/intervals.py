"""Arrays of intervals in float64, rounded outwards; with them the verifier encloses Table 1's functions.

IEEE 754 rounds +, -, *, / and the square root of two numbers to the nearest one. So the exact result is within half a
unit in the last place of the rounded one, or within the smallest number where that underflows.
"""

from dataclasses import dataclass

import numpy as np

UNIT = 2.0**-52
"""Relative widening of an end: twice the error of one rounding, since the widened end is rounded, too."""
LOST_TO_ZERO = 1e-300
"""Absolute widening of an end, more than what any underflow loses."""


@dataclass(frozen=True, slots=True)
class Intervals:
    """An array of intervals. An operation encloses the exact results; its ends are NaN where it is not defined.

    Args:
        low: Lower ends.
        high: Upper ends.
    """

    low: np.ndarray
    high: np.ndarray

    def __add__(self, right: "Intervals") -> "Intervals":
        """Enclose the sums."""
        return outwards(self.low + right.low, self.high + right.high)

    def __sub__(self, right: "Intervals") -> "Intervals":
        """Enclose the differences."""
        return outwards(self.low - right.high, self.high - right.low)

    def __mul__(self, right: "Intervals") -> "Intervals":
        """Enclose the products; the extremes of a product are among the products of the ends."""
        ends = self.low * right.low, self.low * right.high, self.high * right.low, self.high * right.high
        return outwards(np.minimum.reduce(ends), np.maximum.reduce(ends))

    def __truediv__(self, right: "Intervals") -> "Intervals":
        """Enclose the quotients; NaN where the divisor may be 0 or negative."""
        divisor_low = np.where(right.low > 0.0, right.low, np.nan)
        ends = self.low / divisor_low, self.low / right.high, self.high / divisor_low, self.high / right.high
        return outwards(np.minimum.reduce(ends), np.maximum.reduce(ends))

    def selected(self, mask: np.ndarray) -> "Intervals":
        """The intervals at the places where a mask of the same shape is true."""
        return Intervals(self.low[mask], self.high[mask])

    def middle(self) -> "Intervals":
        """A point near the middle of each interval, as an interval without width."""
        points = 0.5 * (self.low + self.high)
        return Intervals(points, points)

    def halves(self) -> tuple["Intervals", "Intervals"]:
        """Cut each interval at a point near its middle into a lower and an upper part, both of which hold the point."""
        points = self.middle().low
        return Intervals(self.low, points), Intervals(points, self.high)


def outwards(low: np.ndarray, high: np.ndarray) -> Intervals:
    """Make intervals from ends that were rounded once, and widen them by more than this rounding may have lost."""
    return Intervals(low - (UNIT * np.abs(low) + LOST_TO_ZERO), high + (UNIT * np.abs(high) + LOST_TO_ZERO))


def exactly(value: float) -> Intervals:
    """A number as an interval without width."""
    point = np.float64(value)
    return Intervals(np.asarray(point), np.asarray(point))


def square_root(low: float, high: float) -> tuple[float, float]:
    """Return the ends of an interval that holds the square roots of all numbers from ``low`` >= 0 to ``high``."""
    root = outwards(np.sqrt(np.float64(low)), np.sqrt(np.float64(high)))
    return max(float(root.low), 0.0), float(root.high)
