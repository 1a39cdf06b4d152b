"""Interval arithmetic on arrays, and the range of a function over a box.

An operation's ends are computed in float64 as the operation itself would compute them. So an interval encloses what
float64 gives at every point of its arguments, up to the last bit of exp, log, sin, cos and powers; it is no enclosure
in exact arithmetic.

Reference:
    R. E. Moore, R. B. Kearfott, M. J. Cloud, Introduction to Interval Analysis (2009): inclusion and subdivision.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

ROUNDS = 60  # rounds of subdivision
MOST_BOXES = 4096
MOST_CORNERS = 8  # of a box's sides, whose corners are all tried
TOLERANCE = 1e-4  # share of the range's width
LARGEST = float(np.finfo(float).max)
SMALLEST = math.ulp(0.0)
TURN = 2.0 * math.pi


class Interval(NamedTuple):
    """An array of intervals.

    Args:
        low: Lower ends, any shape.
        high: Upper ends, of the same shape.
        defined: Whether the function whose range the interval is has a value at every point of its arguments, of the
            same shape.
    """

    low: np.ndarray
    high: np.ndarray
    defined: np.ndarray

    @classmethod
    def of(cls, low: np.ndarray | float, high: np.ndarray | float) -> "Interval":
        """The interval between two ends; unbounded ends are the largest numbers."""
        lowest, highest = np.broadcast_arrays(np.clip(low, -LARGEST, LARGEST), np.clip(high, -LARGEST, LARGEST))
        return cls(lowest, highest, np.ones(lowest.shape, bool))


Function: TypeAlias = Callable[..., Interval]
"""(Interval of each argument) -> interval of the values."""


def hull(corners: Sequence[np.ndarray], *arguments: Interval, defined: np.ndarray | bool = True) -> Interval:
    """The smallest interval that contains several values.

    Args:
        corners: The values, arrays of one shape; a NaN makes the interval unbounded.
        arguments: The arguments of the operation, whose ``defined`` the result inherits.
        defined: Whether the operation itself has a value everywhere.
    """
    stacked = np.stack(np.broadcast_arrays(*corners))
    low = np.where(np.isnan(stacked), -np.inf, stacked).min(axis=0)
    high = np.where(np.isnan(stacked), np.inf, stacked).max(axis=0)
    for argument in arguments:
        defined = defined & argument.defined
    return Interval(low, high, np.broadcast_to(defined, low.shape))


def add(a: Interval, b: Interval) -> Interval:
    """a + b."""
    return hull([a.low + b.low, a.high + b.high], a, b)


def subtract(a: Interval, b: Interval) -> Interval:
    """a - b."""
    return hull([a.low - b.high, a.high - b.low], a, b)


def negative(a: Interval) -> Interval:
    """-a."""
    return Interval(-a.high, -a.low, a.defined)


def multiply(a: Interval, b: Interval) -> Interval:
    """a b."""
    return hull([x * y for x, y in itertools.product(a[:2], b[:2])], a, b)


def divide(a: Interval, b: Interval) -> Interval:
    """a/b, undefined where b may vanish."""
    return hull([x / y for x, y in itertools.product(a[:2], b[:2])], a, b, defined=~contains(b, 0.0))


def contains(a: Interval, value: float) -> np.ndarray:
    """Whether a value lies in an interval."""
    return (a.low <= value) & (value <= a.high)


def power(a: Interval, b: Interval) -> Interval:
    """a^b, undefined where a may be negative and b is not a fixed whole number, or a vanishes and b is not positive."""
    corners = [np.power(x, y) for x, y in itertools.product(a[:2], b[:2])]
    integer = (b.low == b.high) & (b.low == np.round(b.low))
    has_zero = contains(a, 0.0)
    defined = np.where(has_zero, (b.low > 0.0) | (integer & (b.low == 0.0)), True) & ((a.low >= 0.0) | integer)
    even = integer & (np.mod(b.low, 2.0) == 0.0)
    corners.append(np.where(even & has_zero & (b.low > 0.0), 0.0, corners[0]))
    return hull(corners, a, b, defined=defined)


def square_root(a: Interval) -> Interval:
    """The square root of a, undefined below 0."""
    return hull([np.sqrt(a.low), np.sqrt(a.high)], a, defined=a.low >= 0.0)


def exponential(a: Interval) -> Interval:
    """exp a, which is positive even where it underflows."""
    return hull([np.maximum(np.exp(a.low), SMALLEST), np.exp(a.high)], a)


def logarithm(a: Interval) -> Interval:
    """log a, undefined at and below 0."""
    return hull([np.log(a.low), np.log(a.high)], a, defined=a.low > 0.0)


def range_of_sine(function: Callable[[np.ndarray], np.ndarray], crest: float, a: Interval) -> Interval:
    """The range of a sine or cosine over an interval.

    Args:
        function: The sine or cosine. Its maxima 1 are at ``crest`` + 2 pi k, its minima -1 half a turn later.
        crest: Place of a maximum [rad].
        a: The interval of its argument [rad].
    """
    first_crest = np.ceil((a.low - crest) / TURN)  # k of the first maximum from the lower end on
    first_trough = np.ceil((a.low - crest - math.pi) / TURN)
    has_crest = crest + TURN * first_crest <= a.high
    has_trough = crest + math.pi + TURN * first_trough <= a.high
    of_ends = hull([function(a.low), function(a.high)], a)
    low = np.where(has_trough, -1.0, np.maximum(of_ends.low, -1.0))
    high = np.where(has_crest, 1.0, np.minimum(of_ends.high, 1.0))
    return Interval(low, high, of_ends.defined)


def sine(a: Interval) -> Interval:
    """sin a."""
    return range_of_sine(np.sin, math.pi / 2.0, a)


def cosine(a: Interval) -> Interval:
    """cos a."""
    return range_of_sine(np.cos, 0.0, a)


def absolute(a: Interval) -> Interval:
    """|a|."""
    return maximum(a, negative(a))


def minimum(a: Interval, b: Interval) -> Interval:
    """The smaller of a and b."""
    return Interval(np.minimum(a.low, b.low), np.minimum(a.high, b.high), a.defined & b.defined)


def maximum(a: Interval, b: Interval) -> Interval:
    """The greater of a and b."""
    return Interval(np.maximum(a.low, b.low), np.maximum(a.high, b.high), a.defined & b.defined)


class Range(NamedTuple):
    """The range of a function over a box.

    Args:
        low: A lower bound of its values, near the least one.
        high: An upper bound, near the greatest.
        undefined: A point near which the function may have no value, with a coordinate for each side of the box; None
            if the function has a value everywhere.
    """

    low: float
    high: float
    undefined: tuple[float, ...] | None


def range_of(function: Function, sides: Sequence[tuple[float, float]]) -> Range:
    """Bound the values of a function over a box.

    Interval arithmetic encloses the values over each part of the box. Parts whose enclosure exceeds the values found so
    far by more than a tolerance are halved.

    Args:
        function: Takes an interval for each argument, arrays of any shape.
        sides: Lower and upper end of each argument.
    """
    with np.errstate(all="ignore"):
        box = Interval.of(*np.array(sides, float).reshape(-1, 2).T[:, None, :])
        lowest, greatest = values_at(function, corner_points(box))
        low = math.inf
        high = -math.inf
        lows = box.low
        highs = box.high
        for remaining in reversed(range(ROUNDS)):
            enclosures = function(*intervals(lows, highs))
            shape = (len(lows),)
            outer_low, outer_high, defined = (np.broadcast_to(part, shape) for part in enclosures)
            inner = values_at(function, 0.5 * lows + 0.5 * highs)
            lowest = min(lowest, inner[0])
            greatest = max(greatest, inner[1])
            tolerance = TOLERANCE * (greatest - lowest) if greatest > lowest else 0.0
            is_undecided = ~defined | (outer_low < lowest - tolerance) | (outer_high > greatest + tolerance)
            if not remaining or 2 * np.count_nonzero(is_undecided) > MOST_BOXES:
                is_undecided = np.zeros(shape, bool)
            is_decided = ~is_undecided
            if np.any(is_decided & ~defined):
                centre = 0.5 * lows[is_decided & ~defined][0] + 0.5 * highs[is_decided & ~defined][0]
                return Range(-math.inf, math.inf, tuple(centre.tolist()))
            low = min(low, outer_low[is_decided].min(initial=math.inf))
            high = max(high, outer_high[is_decided].max(initial=-math.inf))
            if not is_undecided.any():
                break
            lows, highs = halve(lows[is_undecided], highs[is_undecided], (box.high - box.low)[0])
    return Range(float(low), float(high), None)


def intervals(lows: np.ndarray, highs: np.ndarray) -> list[Interval]:
    """Boxes as intervals: one for each side, of shape (boxes,); the arguments have shape (boxes, sides)."""
    return [Interval.of(low, high) for low, high in zip(lows.T, highs.T, strict=True)]


def corner_points(box: Interval) -> np.ndarray:
    """The corners of one box, shape (corners, sides).

    A box with more than :data:`MOST_CORNERS` sides has too many; of these, only the two extreme ones are taken.
    """
    ends = list(zip(box.low[0], box.high[0], strict=True))
    points = list(itertools.product(*ends)) if len(ends) <= MOST_CORNERS else [*zip(*ends, strict=True)]
    return np.array(points).reshape(len(points), len(ends))


def values_at(function: Function, points: np.ndarray) -> tuple[float, float]:
    """The least and the greatest value of a function at points of shape (n, sides).

    Points where the function has no value are ignored; without any other, the result is (inf, -inf).
    """
    values = function(*intervals(points, points))
    has_value = np.broadcast_to(values.defined, (len(points),))
    low, high = (np.broadcast_to(end, (len(points),))[has_value] for end in values[:2])
    return float(low.min(initial=math.inf)), float(high.max(initial=-math.inf))


def halve(lows: np.ndarray, highs: np.ndarray, widths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Halve each box along its longest side.

    Args:
        lows: Lower ends, shape (boxes, sides).
        highs: Upper ends, the same shape.
        widths: Widths of the whole box, relative to which sides are compared, shape (sides,).

    Returns:
        Lower and upper ends of the halves, shape (2 boxes, sides).
    """
    side = np.argmax((highs - lows) / np.where(widths > 0.0, widths, 1.0), axis=1)
    rows = np.arange(len(lows))
    middle = 0.5 * lows[rows, side] + 0.5 * highs[rows, side]
    upper_lows = lows.copy()
    lower_highs = highs.copy()
    upper_lows[rows, side] = middle
    lower_highs[rows, side] = middle
    return np.concatenate([lows, upper_lows]), np.concatenate([lower_highs, highs])
