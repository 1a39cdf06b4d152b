"""Interval arithmetic on arrays, and the range of a function over a box.

The ends of an operation's result are computed in float64, by the operation itself. So an interval encloses the float64
values of the operation at all points of its arguments, up to the last bit of exp, log, sin, cos and powers. It is no
enclosure in exact arithmetic.

Reference:
    R. E. Moore, R. B. Kearfott, M. J. Cloud, Introduction to Interval Analysis (2009): inclusion and subdivision.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

ROUNDS = 60  # rounds of subdivision
MOST_BOXES = 4096  # parts of a box that are enclosed at once
MOST_CORNERS = 8  # most sides of a box whose corners are all tried
TOLERANCE = 1e-4  # by which an enclosure may exceed the values found, as a share of the range's width
LARGEST = float(np.finfo(float).max)
SMALLEST = math.ulp(0.0)
INFINITE = 1e100  # size from which an end of the range over an unbounded box counts as infinite
TURN = 2.0 * math.pi


class Interval(NamedTuple):
    """An array of intervals.

    Args:
        low: Lower ends, any shape.
        high: Upper ends, of the same shape.
        defined: Whether the function that has this range has a value at every point of its arguments, of the same
            shape.
    """

    low: np.ndarray
    high: np.ndarray
    defined: np.ndarray

    @classmethod
    def of(cls, low: np.ndarray | float, high: np.ndarray | float) -> "Interval":
        """Return the interval between two ends; an infinite end becomes the largest finite number of its sign."""
        lowest, highest = np.broadcast_arrays(np.clip(low, -LARGEST, LARGEST), np.clip(high, -LARGEST, LARGEST))
        return cls(lowest, highest, np.ones(lowest.shape, bool))


Function: TypeAlias = Callable[..., Interval]
"""A function by its range: ``(interval of each argument) -> interval of the values``."""


def hull(corners: Sequence[np.ndarray], *arguments: Interval, defined: np.ndarray | bool = True) -> Interval:
    """Return the smallest interval that contains several values, the extremes of an operation.

    Args:
        corners: The values, arrays of one shape; a NaN makes the interval unbounded.
        arguments: The arguments of the operation. The result is defined only where all of them are.
        defined: Whether the operation itself has a value for all points of its arguments.
    """
    stacked = np.stack(np.broadcast_arrays(*corners))
    low = np.where(np.isnan(stacked), -np.inf, stacked).min(axis=0)
    high = np.where(np.isnan(stacked), np.inf, stacked).max(axis=0)
    for argument in arguments:
        defined = defined & argument.defined
    return Interval(low, high, np.broadcast_to(defined, low.shape))


def end_pairs(a: Interval, b: Interval) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the four pairs of an end of a and an end of b; an operation monotonic in both has its extremes there."""
    return list(itertools.product((a.low, a.high), (b.low, b.high)))


def add(a: Interval, b: Interval) -> Interval:
    """Return the interval of the sums a + b."""
    return hull([a.low + b.low, a.high + b.high], a, b)


def subtract(a: Interval, b: Interval) -> Interval:
    """Return the interval of the differences a - b."""
    return hull([a.low - b.high, a.high - b.low], a, b)


def negative(a: Interval) -> Interval:
    """Return the interval of the numbers -a."""
    return Interval(-a.high, -a.low, a.defined)


def multiply(a: Interval, b: Interval) -> Interval:
    """Return the interval of the products a b."""
    return hull([x * y for x, y in end_pairs(a, b)], a, b)


def divide(a: Interval, b: Interval) -> Interval:
    """Return the interval of the quotients a/b, which is not defined where b may be 0."""
    return hull([x / y for x, y in end_pairs(a, b)], a, b, defined=~contains(b, 0.0))


def contains(a: Interval, value: float) -> np.ndarray:
    """Return whether a value lies in each interval, an array of truth values of the intervals' shape."""
    return (a.low <= value) & (value <= a.high)


def power(a: Interval, b: Interval) -> Interval:
    """Return the interval of the powers a^b.

    The power is not defined if a may be negative and b is not one whole number. It is not defined either if a may be 0
    and b is neither positive throughout nor the number 0.
    """
    corners = [np.power(x, y) for x, y in end_pairs(a, b)]
    is_integer = (b.low == b.high) & (b.low == np.round(b.low))  # b is one whole number
    has_zero = contains(a, 0.0)
    zero_is_allowed = (b.low > 0.0) | (is_integer & (b.low == 0.0))
    defined = np.where(has_zero, zero_is_allowed, True) & ((a.low >= 0.0) | is_integer)
    is_even = is_integer & (np.mod(b.low, 2.0) == 0.0)
    has_minimum_inside = is_even & has_zero & (b.low > 0.0)  # a^b is 0 at a = 0, and not less at the ends
    corners.append(np.where(has_minimum_inside, 0.0, corners[0]))
    return hull(corners, a, b, defined=defined)


def square_root(a: Interval) -> Interval:
    """Return the interval of the square roots of a, which is not defined if a may be negative."""
    return hull([np.sqrt(a.low), np.sqrt(a.high)], a, defined=a.low >= 0.0)


def exponential(a: Interval) -> Interval:
    """Return the interval of exp a; its lower end is positive even where the exponential underflows to 0."""
    return hull([np.maximum(np.exp(a.low), SMALLEST), np.exp(a.high)], a)


def logarithm(a: Interval) -> Interval:
    """Return the interval of log a, which is not defined if a may be 0 or negative."""
    return hull([np.log(a.low), np.log(a.high)], a, defined=a.low > 0.0)


def range_of_sine(function: Callable[[np.ndarray], np.ndarray], crest: float, a: Interval) -> Interval:
    """Return the range of a sine or cosine over an interval.

    Args:
        function: The sine or cosine. It has maxima 1 at ``crest`` + 2 pi k, and minima -1 half a turn later.
        crest: Place of a maximum [rad].
        a: The interval of the angles [rad].
    """
    first_crest = np.ceil((a.low - crest) / TURN)  # k of the first maximum from the lower end on
    first_trough = np.ceil((a.low - crest - math.pi) / TURN)
    has_crest = crest + TURN * first_crest <= a.high
    has_trough = crest + math.pi + TURN * first_trough <= a.high
    end_range = hull([function(a.low), function(a.high)], a)
    low = np.where(has_trough, -1.0, np.maximum(end_range.low, -1.0))
    high = np.where(has_crest, 1.0, np.minimum(end_range.high, 1.0))
    return Interval(low, high, end_range.defined)


def sine(a: Interval) -> Interval:
    """Return the interval of sin a, for angles a in rad."""
    return range_of_sine(np.sin, math.pi / 2.0, a)


def cosine(a: Interval) -> Interval:
    """Return the interval of cos a, for angles a in rad."""
    return range_of_sine(np.cos, 0.0, a)


def absolute(a: Interval) -> Interval:
    """Return the interval of |a|; it begins at 0 if a has numbers of both signs."""
    enclosing = maximum(a, negative(a))
    return enclosing._replace(low=np.maximum(enclosing.low, 0.0))


def minimum(a: Interval, b: Interval) -> Interval:
    """Return the interval of the smaller of a number in a and a number in b."""
    return Interval(np.minimum(a.low, b.low), np.minimum(a.high, b.high), a.defined & b.defined)


def maximum(a: Interval, b: Interval) -> Interval:
    """Return the interval of the greater of a number in a and a number in b."""
    return Interval(np.maximum(a.low, b.low), np.maximum(a.high, b.high), a.defined & b.defined)


class Range(NamedTuple):
    """The range of a function over a box.

    Args:
        low: A lower bound of the values, near the least value; -inf if there is none.
        high: An upper bound of the values, near the greatest value; inf if there is none.
        undefined: A point near which the function may have no value, with a coordinate for each side of the box; None
            if the function has a value everywhere.
    """

    low: float
    high: float
    undefined: tuple[float, ...] | None


def range_of(function: Function, sides: Sequence[tuple[float, float]]) -> Range:
    """Bound the values of a function over a box.

    Interval arithmetic encloses the values over each part of the box. Parts whose enclosure exceeds the values found so
    far by more than a tolerance are halved, until no such part is left or there are too many parts or rounds.

    Args:
        function: The function, which takes an interval for each argument, arrays of any shape.
        sides: Lower and upper end of each argument.
    """
    with np.errstate(all="ignore"):
        lower_ends, upper_ends = np.array(sides, float).reshape(-1, 2).T
        box = Interval.of(lower_ends[None], upper_ends[None])  # one box, shape (1, sides)
        lowest, greatest = values_at(function, corner_points(box))  # of the values found so far
        low = math.inf  # bounds over the parts that are decided
        high = -math.inf
        lows = box.low  # the undecided parts, shape (parts, sides)
        highs = box.high
        for remaining in reversed(range(ROUNDS)):
            enclosures = function(*intervals(lows, highs))
            shape = (len(lows),)
            outer_low, outer_high, defined = (np.broadcast_to(part, shape) for part in enclosures)
            least_at_centres, greatest_at_centres = values_at(function, 0.5 * lows + 0.5 * highs)
            lowest = min(lowest, least_at_centres)
            greatest = max(greatest, greatest_at_centres)
            tolerance = TOLERANCE * (greatest - lowest) if greatest > lowest else 0.0
            is_undecided = ~defined | (outer_low < lowest - tolerance) | (outer_high > greatest + tolerance)
            is_last_round = not remaining or 2 * np.count_nonzero(is_undecided) > MOST_BOXES
            if is_last_round:
                is_undecided = np.zeros(shape, bool)
            is_decided = ~is_undecided
            undefined_parts = np.flatnonzero(is_decided & ~defined)
            if len(undefined_parts):
                part = undefined_parts[0]
                centre = 0.5 * lows[part] + 0.5 * highs[part]
                return Range(-math.inf, math.inf, undefined=tuple(centre.tolist()))
            low = min(low, outer_low[is_decided].min(initial=math.inf))
            high = max(high, outer_high[is_decided].max(initial=-math.inf))
            if not is_undecided.any():
                break
            lows, highs = halve(lows[is_undecided], highs[is_undecided], (box.high - box.low)[0])
    return infinite_ends(function, sides, Range(float(low), float(high), undefined=None))


def infinite_ends(function: Function, sides: Sequence[tuple[float, float]], bounds: Range) -> Range:
    """Replace the ends of a range that are finite only because :meth:`Interval.of` cuts a box to finite numbers.

    An end is replaced by infinity if the function is infinite at a corner of the uncut box, as log x is at infinity, or
    if the end is larger than :data:`INFINITE`. A box without infinite sides keeps its range.

    Args:
        function: The function.
        sides: Lower and upper end of each argument, which may be infinite.
        bounds: Range of the function over the cut box.
    """
    lower_ends, upper_ends = np.array(sides, float).reshape(-1, 2).T
    if np.all(np.isfinite([lower_ends, upper_ends])):
        return bounds
    corners = corner_points(Interval(lower_ends[None], upper_ends[None], np.ones(lower_ends.shape, bool)[None]))
    has_value = np.ones(len(corners), bool)
    with np.errstate(all="ignore"):
        low_at, high_at, _ = function(*(Interval(column, column, has_value) for column in corners.T))
    has_no_low = bounds.low <= -INFINITE or bool(np.any(high_at == -np.inf))
    has_no_high = bounds.high >= INFINITE or bool(np.any(low_at == np.inf))
    return bounds._replace(low=-math.inf if has_no_low else bounds.low, high=math.inf if has_no_high else bounds.high)


def intervals(lows: np.ndarray, highs: np.ndarray) -> list[Interval]:
    """Return boxes as a list of intervals, one for each side, of shape (boxes,) each.

    Args:
        lows: Lower ends, shape (boxes, sides).
        highs: Upper ends, the same shape.
    """
    return [Interval.of(low, high) for low, high in zip(lows.T, highs.T, strict=True)]


def corner_points(box: Interval) -> np.ndarray:
    """Return the corners of one box, shape (corners, sides).

    A box with more than :data:`MOST_CORNERS` sides has too many corners. The result then has only two of them: the
    corner of all lower ends and the corner of all upper ends.

    Args:
        box: The box, whose ends have shape (1, sides).
    """
    (lower_ends,) = box.low
    (upper_ends,) = box.high
    sides = len(lower_ends)
    if sides > MOST_CORNERS:
        return np.array([lower_ends, upper_ends])
    points = list(itertools.product(*zip(lower_ends, upper_ends, strict=True)))
    return np.array(points).reshape(len(points), sides)


def values_at(function: Function, points: np.ndarray) -> tuple[float, float]:
    """Return the least and the greatest value of a function at some points.

    Points where the function has no value do not count. If it has a value at no point, the result is (inf, -inf).

    Args:
        function: The function.
        points: Shape (n, sides).
    """
    shape = (len(points),)
    low, high, has_value = (np.broadcast_to(part, shape) for part in function(*intervals(points, points)))
    least = low[has_value].min(initial=math.inf)
    greatest = high[has_value].max(initial=-math.inf)
    return float(least), float(greatest)


def halve(lows: np.ndarray, highs: np.ndarray, widths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Halve each box along its longest side.

    Args:
        lows: Lower ends, shape (boxes, sides).
        highs: Upper ends, the same shape.
        widths: Widths of the whole box, shape (sides,). The longest side is the longest one relative to these.

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
