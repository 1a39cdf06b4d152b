"""Pushes of a part at an operating point, which tell whether it is smooth there, at a corner, or beyond one.

State and inputs of the part are pushed to both sides by several sizes, and the effect is compared with the derivative.
Where the derivative exists, the deviation shrinks with the push; at a corner or a jump it does not. A staircase does
not move at all under small pushes, and then jumps.
"""

from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar

import jax
import numpy as np

from dssc_jax.core.smoothness import SmoothExtent
from dssc_jax.engine.linearisation.smooth_parts import Finding, LoopPart

SMALL = 1e-8  # pushes, relative to 1 + |x|, whose effects are compared with the derivative
LARGE = 1e-6
PUSHES = (SMALL, LARGE, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0)  # the larger ones find the jumps of a staircase
MULTIPLES = (0.0, *(side * push for push in PUSHES for side in (1.0, -1.0)))
SIDES = np.array([1.0, -1.0])[:, None, None]
JUMP = 1e-7  # least jump of an output that did not move under the previous push, relative to 1 + |y|
DEVIATION = 1e-3  # deviation of a difference from the derivative, relative to the largest derivative of that output
SHRINKING = 0.5  # ratio of the deviations at the small and the large push, below which a derivative exists
ROUNDING_NOISE = 64.0 * float(np.finfo(np.float64).eps)  # rounding of an output, relative to 1 + |y|
SINGLE_INPUTS = 32  # inputs that are pushed one by one
RANDOM_DIRECTIONS = 4  # directions in which all inputs are pushed together, and all signals

Array = TypeVar("Array", jax.Array, np.ndarray)


class Slopes(NamedTuple, Generic[Array]):
    """A part near its operating point, along a direction.

    Args:
        value: Its outputs, shape (outputs,).
        slope: Their derivative, shape (outputs,).
        inner: The derivative of its substitute for its inner side; without a substitute, that of the part.
    """

    value: Array
    slope: Array
    inner: Array


def directions(memory: int, signals: int) -> np.ndarray:
    """Directions in which a part is pushed, shape (directions, memory + signals).

    They are random directions of all inputs together and of the signals alone, and each single input if there are few.

    Args:
        memory: Number of state variables of the part.
        signals: Number of its other inputs.
    """
    random = np.random.default_rng(0)
    sizes = random.uniform(0.5, 1.5, (RANDOM_DIRECTIONS, memory + signals))
    joint = sizes * random.choice([-1.0, 1.0], (RANDOM_DIRECTIONS, 1))
    joint[: RANDOM_DIRECTIONS // 2, ::2] *= -1.0
    signals_alone = joint.copy()
    signals_alone[:, :memory] = 0.0
    parts = [joint, signals_alone] if memory and signals else [joint]
    if memory + signals <= SINGLE_INPUTS:
        parts.append(np.eye(memory + signals))
    return np.concatenate(parts)


def equally_long(patterns: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The directions of several parts, repeated until all parts have the same number."""
    longest = max(map(len, patterns))
    return [pattern[np.arange(longest) % len(pattern)] for pattern in patterns]


def pushes(points: np.ndarray, pattern: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points after each push, and their directions, shape (n * multiples * directions, inputs) each.

    Args:
        points: Operating points, shape (n, inputs).
        pattern: Directions relative to 1 + abs(x), shape (directions, inputs).
    """
    axes = pattern * (1.0 + np.abs(points))[:, None, :]
    axes = np.broadcast_to(axes[:, None], (len(points), len(MULTIPLES), *pattern.shape))
    pushed_points = points[:, None, None, :] + np.array(MULTIPLES)[:, None, None] * axes
    return pushed_points.reshape(-1, points.shape[1]), axes.reshape(-1, points.shape[1])


def finding(place: LoopPart, pushed: Slopes[np.ndarray], memory: int, pattern: np.ndarray) -> np.ndarray:
    """Classify a part at the operating points of n draws: a :class:`Finding` each, shape (n,).

    Args:
        place: The part.
        pushed: The part under the pushes, each array of shape (n, multiples, directions, outputs).
        memory: Number of state variables among the part's inputs, which come first.
        pattern: Directions, shape (directions, inputs).
    """
    value = pushed.value[:, 0, 0]
    slopes = pushed.slope[:, 0]
    inner = pushed.inner[:, 0]
    with np.errstate(all="ignore"):
        moves = pushed.value[:, 1:].reshape(len(value), -1, 2, *slopes.shape[1:]) - value[:, None, None, None]
        noise = ROUNDING_NOISE * (1.0 + np.abs(value))[:, None, None]

        def error(derivative: np.ndarray, index: int) -> np.ndarray:
            """Deviation of both differences from a derivative, shape (n, sides, directions, outputs)."""
            push = PUSHES[index]
            differences = moves[:, index] * SIDES / push
            deviation = np.maximum(np.abs(differences - derivative[:, None]) - noise / push, 0.0)
            return np.where(np.isfinite(deviation), deviation, np.inf)

        small_error = error(slopes, 0)
        large_error = error(slopes, 1)
        largest = np.max(np.abs(slopes), axis=1)[:, None, None]
        is_large_deviation = (small_error > DEVIATION * largest) & (small_error > SHRINKING * large_error)
        is_defect = np.any(is_large_deviation, axis=(1, 2, 3))
        if place.remaining.extent != SmoothExtent.PIECEWISE:
            signal_directions = ~np.any(pattern[:, :memory], axis=1)
            is_defect |= np.any(staircase(moves, slopes, value) & signal_directions, axis=1)
        is_corner = np.zeros(len(value), dtype=bool)
        is_beyond = np.zeros(len(value), dtype=bool)
        if place.has_inner_side:
            scale = DEVIATION * np.maximum(largest, np.max(np.abs(inner), axis=1)[:, None, None])
            inner_side = np.any(np.all(error(inner, 1) <= scale, axis=3), axis=1)
            has_large_error = np.any(large_error > scale, axis=(1, 2, 3))
            is_corner = has_large_error & np.all(inner_side, axis=1)
            is_beyond = ~has_large_error & np.any(np.abs(inner - slopes) > scale[:, 0], axis=(1, 2))
    findings = [Finding.CORNER, Finding.DEFECT, Finding.BEYOND]
    return np.select([is_corner, is_defect, is_beyond], findings, Finding.SMOOTH)


def staircase(moves: np.ndarray, slopes: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Whether an output does not move under a push along a direction and jumps under the next, shape (n, directions).

    Args:
        moves: Effects of the pushes, shape (n, pushes, sides, directions, outputs).
        slopes: Derivatives, shape (n, directions, outputs).
        value: Outputs at the operating point, shape (n, outputs).
    """
    size = np.abs(moves)
    unmoved = (size[:, :-1] == 0.0) & (slopes == 0.0)[:, None, None]
    jumps = np.isfinite(size[:, 1:]) & (size[:, 1:] > JUMP * (1.0 + np.abs(value))[:, None, None, None])
    return np.any(unmoved & jumps, axis=(1, 2, 4))
