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

SMALL = 1e-8  # the two pushes, relative to 1 + |x|, whose effects are compared with the derivative
LARGE = 1e-6
PUSHES = (SMALL, LARGE, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0)  # pushes beyond LARGE find the jumps of a staircase
MULTIPLES = (0.0, *(side * push for push in PUSHES for side in (1.0, -1.0)))  # no push, then each push to both sides
SIDES = np.array([1.0, -1.0])[:, None, None]  # shape (sides, 1, 1)
JUMP = 1e-7  # least jump of an output that did not move under the previous push, relative to 1 + |y|
DEVIATION = 1e-3  # deviation of a difference from the derivative, relative to the largest derivative of that output
SHRINKING = 0.5  # ratio of the deviations at the small and the large push, below which a derivative exists
ROUNDING_NOISE = 64.0 * float(np.finfo(np.float64).eps)  # rounding of an output, relative to 1 + |y|
SINGLE_INPUTS = 32  # inputs that are pushed one by one
RANDOM_DIRECTIONS = 4  # directions in which all inputs are pushed together, and all signals

Array = TypeVar("Array", jax.Array, np.ndarray)


class Slopes(NamedTuple, Generic[Array]):
    """Outputs of a part near its operating point, and their derivatives along a direction.

    Args:
        value: The part's outputs, shape (outputs,).
        slope: Derivative of the outputs, shape (outputs,).
        inner: The same derivative of the substitute for the inner side of a boundary, such as a command without its
            limit; equal to ``slope`` for a part without a substitute.
    """

    value: Array
    slope: Array
    inner: Array


def directions(memory: int, signals: int) -> np.ndarray:
    """Directions in which a part is pushed, shape (directions, memory + signals).

    Random directions push all inputs together, or the signals alone. If there are few inputs, each input is also pushed
    separately.

    Args:
        memory: Number of state variables of the part.
        signals: Number of the part's other inputs.
    """
    random = np.random.default_rng(0)
    sizes = random.uniform(0.5, 1.5, (RANDOM_DIRECTIONS, memory + signals))
    joint = sizes * random.choice([-1.0, 1.0], (RANDOM_DIRECTIONS, 1))
    joint[: RANDOM_DIRECTIONS // 2, ::2] *= -1.0  # in half of them, every second input is pushed the other way
    signals_alone = joint.copy()
    signals_alone[:, :memory] = 0.0
    parts = [joint, signals_alone] if memory and signals else [joint]
    if memory + signals <= SINGLE_INPUTS:
        parts.append(np.eye(memory + signals))
    return np.concatenate(parts)


def equally_long(patterns: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The directions of several parts, repeated cyclically until all parts have the same number, to share one batch.

    Args:
        patterns: Directions of each part, shape (directions of the part, inputs of the part).
    """
    longest = max(map(len, patterns))
    return [pattern[np.arange(longest) % len(pattern)] for pattern in patterns]


def pushes(points: np.ndarray, pattern: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The inputs of a part after each push, and the directions, shape (n * multiples * directions, inputs) each.

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

    A derivative exists if the effect of a push deviates little from it, or deviates less for a smaller push. A part
    with a substitute is at a corner if two conditions hold: the part's own derivative fails, and in every direction the
    substitute's derivative is right on at least one side. The part is beyond its boundary if its own derivative holds
    and differs from the substitute's.

    Args:
        place: The part.
        pushed: The part under the pushes, each array of shape (n, multiples, directions, outputs).
        memory: Number of state variables among the part's inputs, which come first.
        pattern: Directions, shape (directions, inputs).
    """
    no_push = 0  # index of the multiple 0.0
    value = pushed.value[:, no_push, 0]  # the same in all directions
    slopes = pushed.slope[:, no_push]
    inner = pushed.inner[:, no_push]
    with np.errstate(all="ignore"):
        moves = pushed.value[:, 1:].reshape(len(value), -1, 2, *slopes.shape[1:]) - value[:, None, None, None]
        noise = ROUNDING_NOISE * (1.0 + np.abs(value))[:, None, None]

        def error(derivative: np.ndarray, index: int) -> np.ndarray:
            """Deviation of difference quotients from a derivative, shape (n, sides, directions, outputs).

            Args:
                derivative: The derivative, shape (n, directions, outputs).
                index: Index of the push in :data:`PUSHES`.
            """
            push = PUSHES[index]
            differences = moves[:, index] * SIDES / push
            deviation = np.maximum(np.abs(differences - derivative[:, None]) - noise / push, 0.0)
            return np.where(np.isfinite(deviation), deviation, np.inf)

        small_error = error(slopes, PUSHES.index(SMALL))
        large_error = error(slopes, PUSHES.index(LARGE))
        largest = np.max(np.abs(slopes), axis=1)[:, None, None]  # derivative of each output over all directions
        is_large_deviation = (small_error > DEVIATION * largest) & (small_error > SHRINKING * large_error)
        is_defect = np.any(is_large_deviation, axis=(1, 2, 3))
        if place.remaining.extent != SmoothExtent.PIECEWISE:
            signal_directions = ~np.any(pattern[:, :memory], axis=1)
            is_defect |= np.any(staircase(moves, slopes, value) & signal_directions, axis=1)
        is_corner = np.zeros(len(value), dtype=bool)
        is_beyond = np.zeros(len(value), dtype=bool)
        if place.has_inner_side:
            scale = DEVIATION * np.maximum(largest, np.max(np.abs(inner), axis=1)[:, None, None])
            inner_error = error(inner, PUSHES.index(LARGE))
            has_inner_side = np.any(np.all(inner_error <= scale, axis=3), axis=1)  # on one side of each direction
            has_large_error = np.any(large_error > scale, axis=(1, 2, 3))
            is_corner = has_large_error & np.all(has_inner_side, axis=1)
            is_beyond = ~has_large_error & np.any(np.abs(inner - slopes) > scale[:, 0], axis=(1, 2))
    findings = [Finding.CORNER, Finding.DEFECT, Finding.BEYOND]
    return np.select([is_corner, is_defect, is_beyond], findings, Finding.SMOOTH)


def staircase(moves: np.ndarray, slopes: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Whether an output does not move under a push and jumps under the next larger one, shape (n, directions).

    A quantiser behaves like this: its derivative is 0, yet a larger push moves its output.

    Args:
        moves: Effects of the pushes, shape (n, pushes, sides, directions, outputs).
        slopes: Derivatives, shape (n, directions, outputs).
        value: Outputs at the operating point, shape (n, outputs).
    """
    smaller_push = np.abs(moves[:, :-1])
    larger_push = np.abs(moves[:, 1:])
    is_unmoved = (smaller_push == 0.0) & (slopes == 0.0)[:, None, None]
    least_jump = JUMP * (1.0 + np.abs(value))[:, None, None, None]
    jumps = np.isfinite(larger_push) & (larger_push > least_jump)
    return np.any(is_unmoved & jumps, axis=(1, 2, 4))
