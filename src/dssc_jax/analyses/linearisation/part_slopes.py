"""What the parts of a loop are at an operating point: smooth, at a corner, beyond it, or not what they declare.

Each part is a function of its own state and inputs. It is pushed to both sides at two sizes, and the effect is compared
with its derivative. Where there is one, the deviation shrinks with the push; at a corner or a jump it does not. A
staircase does not move at all for small pushes, and then jumps.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.analyses.linearisation.smooth_parts import Finding, LoopPart, part_of
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.sample import LoopState, actuate, as_arrays, initial_state, measure, plant_input, step
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import PlantInput, Scalar, tracking_error
from dssc_jax.core.smoothness import SmoothExtent
from dssc_jax.engine.batching import Arrays
from dssc_jax.lanes.plain import plain_options

SMALL, LARGE = 1e-8, 1e-6  # pushes, relative to 1 + |x|, at which differences are compared with the derivative
PUSHES = (SMALL, LARGE, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0)  # under the longer ones, a staircase begins to move
MULTIPLES = (0.0, *(side * push for push in PUSHES for side in (1.0, -1.0)))
SIDES = np.array([1.0, -1.0])[:, None, None]
JUMP = 1e-7  # of an output that stood still under the push before, relative to 1 + |y|
DEVIATION = 1e-3  # of a difference from the derivative, relative to the largest derivative of the same output
SHRINKING = 0.5  # of that deviation from the large push to the small one, where a derivative exists
ROUNDING_NOISE = 64.0 * float(np.finfo(np.float64).eps)  # of an output, relative to 1 + |y|
PUSHES_TOGETHER = 16384  # pushes of all draws that are computed at once
MOST_INPUTS = 32  # inputs that are pushed one by one
RANDOM_DIRECTIONS = 4  # directions in which all inputs are pushed together, and all signals

LaneLoop = Callable[[dict[str, jax.Array], jax.Array], tuple[Loop, LoopParams, jax.Array]]
"""(laws' values, draw index) -> the loop that is linearised, its parameters and its random key."""


class PartMap(NamedTuple):
    """A part as a function of its state and inputs, at one operating point.

    Args:
        apply: ``(part, params, (memory, signals)) -> outputs``.
        memory: The part's own state, which may hold counters.
        signals: Its inputs and, for the plant, its state.
    """

    apply: Callable[[Any, Any, Any], Any]
    memory: Any
    signals: Any


def part_maps(
    loop: Loop, params: LoopParams, key: jax.Array, state: LoopState, k: Scalar, places: Sequence[LoopPart]
) -> list[PartMap]:
    """Every part with its inputs at sample k.

    Args:
        loop: The models and the clock.
        params: Their parameters.
        key: The draw's random key.
        state: The loop's state before the sample.
        k: Index of the sample.
        places: The parts.
    """
    t, dt = k * loop.sample_time, loop.sample_time
    _, recorded = step(loop, params, key, state, k)
    references = recorded.references
    commands = tuple(sample.u_total for sample in recorded.instant.channels)
    zipped = zip(loop.unmodelled, params.unmodelled, state.channels, commands, strict=True)
    sampled = tuple(model.sample(own, channel.unmodelled, u, dt) for model, own, channel, u in zipped)
    disturbances = tuple(channel.disturbance for channel in state.channels)
    actuation = actuate(loop, params, sampled, commands)
    drive = plant_input(loop, params, disturbances, state.wind, state.plant, actuation, t)

    def plant(part: Any, own: Any, inputs: Any) -> Any:
        _, (at, actuation) = inputs
        slope = part.derivative(own, at, PlantInput(actuation, drive.disturbance, drive.wind), t)
        return slope, measure(loop, params, at, references)

    def sensor(part: Any, own: Any, inputs: Any, i: int) -> Any:
        stream = jax.random.fold_in(loop.key(key, "sensor", loop.channels[i]), k + 1)
        return part.step(own, *inputs, stream, t, dt)

    def unmodelled(part: Any, own: Any, inputs: Any) -> Any:
        z, u = inputs
        begin = part.sample(own, z, u, dt)
        end = part.step(own, begin, u, dt)
        return end, part.output(own, begin, u), part.output(own, end, u)

    def of(place: LoopPart) -> PartMap:
        i = place.channel
        channel, controlled = state.channels[i], recorded.controlled[i]
        measurement = recorded.measurements[i]
        match place.slot:
            case "plant":
                return PartMap(plant, (), (state.plant, drive.command))
            case "sensor":
                return PartMap(lambda part, own, at: sensor(part, own, at, i), channel.sensor, measurement)
            case "differentiator":
                return PartMap(
                    lambda part, own, at: part.step(own, *at, dt), channel.differentiator, controlled.reading
                )
            case "controller":
                return PartMap(
                    lambda part, own, at: part.step(own, *at, controlled.reference, dt)[:2],
                    channel.controller,
                    controlled.sensed,
                )
            case "unmodelled":
                return PartMap(unmodelled, channel.unmodelled, commands[i])
            case _:
                sigma = tracking_error(measurement, references[i], params.controller[i].l0).sigma
                return PartMap(
                    lambda part, own, at: part.value(own, channel.disturbance, *at[1], t), (), (measurement, sigma)
                )

    return [of(place) for place in places]


class Slopes(NamedTuple):
    """A part near its operating point, along a direction.

    Args:
        value: Its outputs, shape (outputs,).
        slope: Their derivative, shape (outputs,).
        inner: That of its substitute for its inner side; without a substitute, its own.
    """

    value: Any
    slope: Any
    inner: Any


def vector_of(tree: Any) -> jax.Array:
    """The numbers of a tree as a vector."""
    return ravel_pytree(as_arrays(tree))[0]


def slopes_of(place: LoopPart, part_map: PartMap, part: Any, params: Any, point: jax.Array, axis: jax.Array) -> Slopes:
    """A part at a point near its operating point."""
    _, unravel = ravel_pytree(as_arrays((part_map.memory, part_map.signals)))

    def derivative(model: Any, own: Any) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(lambda at: vector_of(part_map.apply(model, own, unravel(at))), (point,), (axis,))

    value, slope = derivative(part, params)
    inner = derivative(*place.substitute(params))[1] if place.inner else slope
    return Slopes(value, slope, inner)


def examination(
    lane: LaneLoop, places: Sequence[LoopPart]
) -> Callable[[Arrays, np.ndarray, np.ndarray, int], np.ndarray]:
    """Find what every part is at the operating points of many draws.

    Args:
        lane: The loop of a draw, in which parts that are smooth nowhere have been replaced.
        places: The parts.

    Returns:
        (laws' values, draw indices, states of shape (n, states), sample) -> a :class:`Finding` for each part, shape
        (n, places).
    """

    def maps_of(*arguments: Any) -> tuple[Loop, LoopParams, list[PartMap]]:
        values, index, state, k = arguments
        loop, params, key = lane(values, index)
        _, unravel = ravel_pytree(initial_state(loop, params, key))
        return loop, params, part_maps(loop, params, key, unravel(state), k, places)

    def inputs(*arguments: Any) -> list[tuple[jax.Array, jax.Array]]:
        _, _, maps = maps_of(*arguments)
        return [(vector_of(part_map.memory), vector_of(part_map.signals)) for part_map in maps]

    def pushed(lane_inputs: Any, k: jax.Array, points: list[jax.Array], axes: list[jax.Array]) -> list[Slopes]:
        loop, params, maps = maps_of(*lane_inputs, k)
        own = (part_of(loop, params, place) for place in places)
        zipped = zip(places, maps, own, points, axes, strict=True)
        return [slopes_of(place, part_map, *part, point, axis) for place, part_map, part, point, axis in zipped]

    options = plain_options()
    inputs_of = jax.jit(jax.vmap(inputs, in_axes=(0, 0, 0, None)), compiler_options=options)
    push = jax.jit(jax.vmap(pushed, in_axes=(0, None, 0, 0)), compiler_options=options)

    def of(values: Arrays, indices: np.ndarray, states: np.ndarray, k: int) -> np.ndarray:
        with arithmetic():
            vectors = inputs_of(values, indices, states, k)
            patterns = same_length([directions(memory.shape[1], signals.shape[1]) for memory, signals in vectors])
            points = [np.concatenate(pair, axis=1) for pair in vectors]
            count, rows = len(indices), len(MULTIPLES) * len(patterns[0])
            together = min(count, max(1, PUSHES_TOGETHER // rows))
            blocks = []
            for first in range(0, count, together):
                draw = np.minimum(np.arange(first, first + together), count - 1)
                lanes = np.repeat(draw, rows)
                moved, axes = zip(
                    *(pushes(point[draw], own) for point, own in zip(points, patterns, strict=True)), strict=True
                )
                own = {name: column[lanes] for name, column in values.items()}
                slopes = push((own, indices[lanes], states[lanes]), k, list(moved), list(axes))
                shape = (together, len(MULTIPLES), len(patterns[0]), -1)
                blocks.append(
                    [
                        finding(place, Slopes(*(np.asarray(part).reshape(shape) for part in one)), memory.shape[1], own)
                        for place, one, (memory, _), own in zip(places, slopes, vectors, patterns, strict=True)
                    ]
                )
        return np.concatenate([np.stack(part, axis=1) for part in blocks])[:count]

    return of


def directions(memory: int, signals: int) -> np.ndarray:
    """Directions in which a part is pushed, shape (directions, memory + signals): if few, one by one, and together."""
    random = np.random.default_rng(0)
    together = random.uniform(0.5, 1.5, (RANDOM_DIRECTIONS, memory + signals)) * random.choice(
        [-1.0, 1.0], (RANDOM_DIRECTIONS, 1)
    )
    together[: RANDOM_DIRECTIONS // 2, ::2] *= -1.0
    alone = together.copy()
    alone[:, :memory] = 0.0
    parts = [together, alone] if memory and signals else [together]
    if memory + signals <= MOST_INPUTS:
        parts.append(np.eye(memory + signals))
    return np.concatenate(parts)


def same_length(patterns: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Directions of several parts, repeated until all parts have as many."""
    longest = max(map(len, patterns))
    return [pattern[np.arange(longest) % len(pattern)] for pattern in patterns]


def pushes(points: np.ndarray, pattern: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pushed points and their directions, each of shape (n * multiples * directions, inputs).

    Args:
        points: Operating points, shape (n, inputs).
        pattern: Directions relative to 1 + abs(x), shape (directions, inputs).
    """
    axes = pattern * (1.0 + np.abs(points))[:, None, :]
    axes = np.broadcast_to(axes[:, None], (len(points), len(MULTIPLES), *pattern.shape))
    moved = points[:, None, None, :] + np.array(MULTIPLES)[:, None, None] * axes
    return moved.reshape(-1, points.shape[1]), axes.reshape(-1, points.shape[1])


def finding(place: LoopPart, near: Slopes, memory: int, pattern: np.ndarray) -> np.ndarray:
    """What one part is at the operating points: a :class:`Finding` of each draw, shape (n,).

    Args:
        place: The part.
        near: What the pushes gave, each of shape (n, multiples, directions, outputs).
        memory: How many inputs are the part's own state.
        pattern: Directions, shape (directions, inputs).
    """
    value, slopes, inner = near.value[:, 0, 0], near.slope[:, 0], near.inner[:, 0]
    with np.errstate(all="ignore"):
        moves = near.value[:, 1:].reshape(len(value), -1, 2, *slopes.shape[1:]) - value[:, None, None, None]
        noise = ROUNDING_NOISE * (1.0 + np.abs(value))[:, None, None]

        def error(derivative: np.ndarray, index: int) -> np.ndarray:
            """Deviation of both differences from a derivative, shape (n, sides, directions, outputs)."""
            push = PUSHES[index]
            sides = moves[:, index] * SIDES / push
            apart = np.maximum(np.abs(sides - derivative[:, None]) - noise / push, 0.0)
            return np.where(np.isfinite(apart), apart, np.inf)

        small, large = error(slopes, 0), error(slopes, 1)
        largest = np.max(np.abs(slopes), axis=1)[:, None, None]
        defect = np.any((small > DEVIATION * largest) & (small > SHRINKING * large), axis=(1, 2, 3))
        if place.smoothness.extent != SmoothExtent.PIECEWISE:
            defect |= np.any(staircase(moves, slopes, value) & ~np.any(pattern[:, :memory], axis=1), axis=1)
        corner, beyond = np.zeros((2, len(value)), dtype=bool)
        if place.inner:
            scale = DEVIATION * np.maximum(largest, np.max(np.abs(inner), axis=1)[:, None, None])
            one_side = np.any(np.all(error(inner, 1) <= scale, axis=3), axis=1)
            cornered = np.any(large > scale, axis=(1, 2, 3))
            corner = cornered & np.all(one_side, axis=1)
            beyond = ~cornered & np.any(np.abs(inner - slopes) > scale[:, 0], axis=(1, 2))
    return np.select([corner, defect, beyond], [Finding.CORNER, Finding.DEFECT, Finding.BEYOND], Finding.SMOOTH)


def staircase(moves: np.ndarray, slopes: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Whether an output stands still for pushes along a direction and then jumps, shape (n, directions).

    Args:
        moves: Effects of the pushes, shape (n, pushes, sides, directions, outputs).
        slopes: Derivatives, shape (n, directions, outputs).
        value: Outputs at the operating point, shape (n, outputs).
    """
    size = np.abs(moves)
    still = (size[:, :-1] == 0.0) & (slopes == 0.0)[:, None, None]
    jumps = np.isfinite(size[:, 1:]) & (size[:, 1:] > JUMP * (1.0 + np.abs(value))[:, None, None, None])
    return np.any(still & jumps, axis=(1, 2, 4))
