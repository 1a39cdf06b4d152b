"""Classify the parts of a loop at an operating point: smooth, at a corner, beyond it, or not as they declare.

Each part is a function of its own state and inputs. It is pushed to both sides at two sizes, and the effect is compared
with its derivative. Where there is one, the deviation shrinks with the push; at a corner or a jump it does not. A
staircase does not move at all for small pushes, and then jumps.
"""

from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.readings import signal_values
from dssc_jax.closed_loop.sample import (
    LoopState,
    actuate,
    as_arrays,
    initial_state,
    measure,
    plant_input,
    sampled_command,
    step,
)
from dssc_jax.core.contracts import Controller, Differentiator, Disturbance, Plant, Sensor, Unmodelled
from dssc_jax.core.signals import (
    Command,
    Measurement,
    Measurements,
    Params,
    Scalar,
    Signals,
    State,
    tracking_error,
)
from dssc_jax.core.smoothness import SmoothExtent
from dssc_jax.engine.linearisation.lane_programs import (
    SAMPLE,
    STATE,
    LaneProgram,
    Numbers,
    columns_of,
    numbers_of,
    numbers_of_study,
    vector_in,
)
from dssc_jax.engine.linearisation.smooth_parts import Finding, LoopPart, Part, part_of
from dssc_jax.engine.sampling import Arrays

SMALL = 1e-8  # pushes, relative to 1 + |x|, at which differences are compared with the derivative
LARGE = 1e-6
PUSHES = (SMALL, LARGE, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0)  # under the longer ones, a staircase begins to move
MULTIPLES = (0.0, *(side * push for push in PUSHES for side in (1.0, -1.0)))
SIDES = np.array([1.0, -1.0])[:, None, None]
JUMP = 1e-7  # of an output that stood still under the push before, relative to 1 + |y|
DEVIATION = 1e-3  # of a difference from the derivative, relative to the largest derivative of the same output
SHRINKING = 0.5  # of that deviation from the large push to the small one, where a derivative exists
ROUNDING_NOISE = 64.0 * float(np.finfo(np.float64).eps)  # of an output, relative to 1 + |y|
BATCH_PUSHES = 16384  # pushes of all draws that are computed at once
SINGLE_INPUTS = 32  # inputs that are pushed one by one
RANDOM_DIRECTIONS = 4  # directions in which all inputs are pushed together, and all signals

POINT = "@point "
AXIS = "@axis "

LaneValues: TypeAlias = dict[str, jax.Array]
"""The values of the laws of one draw, by name."""

LaneLoop: TypeAlias = Callable[[LaneValues, jax.Array], tuple[Loop, LoopParams, jax.Array]]
"""(laws' values, draw index) -> the loop that is linearised, its parameters and its random key."""

Examination: TypeAlias = Callable[[Arrays, np.ndarray, np.ndarray, int], np.ndarray]
"""(laws' values, draw indices, states, sample) -> a :class:`Finding` for each part, shape (n, parts)."""

Array = TypeVar("Array", jax.Array, np.ndarray)


class PartMap(NamedTuple):
    """A part as a function of its state and inputs, at one operating point.

    Args:
        apply: ``(part, params, memory, signals) -> outputs``.
        memory: The part's own state, which may hold counters.
        signals: Its inputs and, for the plant, its state.
    """

    apply: Callable[..., object]
    memory: object
    signals: object


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
    dt = loop.sample_time
    t = k * dt
    _, recorded = step(loop, params, key, state, k)
    references = recorded.references
    commands = tuple(sample.u_total for sample in recorded.instant.channels)
    sampled = []
    for i, channel in enumerate(state.channels):
        sampled.append(sampled_command(loop, params, key, channel.unmodelled, i, commands[i], k))
    actuation = actuate(loop, params, tuple(sampled), commands)
    disturbances = state.disturbances
    drive = plant_input(loop, params, disturbances, state.wind, state.plant, actuation, t)

    def plant(_: int) -> PartMap:
        def apply(
            part: Plant[Measurements, Signals], p: Params, memory: tuple[()], signals: tuple[State, Signals]
        ) -> tuple[State, tuple[Measurements, Signals]]:
            plant_state, command = signals
            slope = part.derivative(p, plant_state, drive._replace(command=command), t)
            outputs = measure(loop, params, plant_state, references)
            shown = signal_values(loop, params, plant_state, outputs, drive._replace(command=command))
            return slope, (outputs, shown)

        return PartMap(apply, (), (state.plant, drive.command))

    def sensor(i: int) -> PartMap:
        def apply(part: Sensor, p: Params, memory: State, signals: Measurement) -> tuple[State, Measurement]:
            stream = jax.random.fold_in(loop.key(key, "sensor", loop.channels[i]), k + 1)
            return part.step(p, memory, signals, stream, t, dt)

        return PartMap(apply, state.channels[i].sensor, recorded.measurements[i])

    def differentiator(i: int) -> PartMap:
        def apply(part: Differentiator, p: Params, memory: State, signals: Measurement) -> tuple[State, Measurement]:
            return part.step(p, memory, signals, dt)

        return PartMap(apply, state.channels[i].differentiator, recorded.controlled[i].reading)

    def controller(i: int) -> PartMap:
        controlled = recorded.controlled[i]

        def apply(part: Controller, p: Params, memory: State, signals: Measurement) -> tuple[State, Command]:
            return part.step(p, memory, signals, controlled.reference, dt)[:2]

        return PartMap(apply, state.channels[i].controller, controlled.sensed)

    def unmodelled(i: int) -> PartMap:
        def apply(part: Unmodelled, p: Params, memory: State, signals: Scalar) -> tuple[State, Scalar, Scalar]:
            stream = jax.random.fold_in(loop.key(key, "unmodelled", loop.channels[i]), k + 1)
            begin = part.sample(p, memory, signals, stream, dt)
            end = part.step(p, begin, signals, dt)
            return end, part.output(p, begin, signals), part.output(p, end, signals)

        return PartMap(apply, state.channels[i].unmodelled, commands[i])

    def disturbance(i: int) -> PartMap:
        def apply(part: Disturbance, p: Params, memory: tuple[()], signals: tuple[Measurement, Scalar]) -> Scalar:
            measurement, sigma = signals
            return part.value(p, disturbances[i], measurement, sigma, t)

        measurement = recorded.measurements[i]
        sigma = tracking_error(measurement, references[i], params.controller[i].l0).sigma
        return PartMap(apply, (), (measurement, sigma))

    def signal_sensor(i: int) -> PartMap:
        def apply(part: Sensor, p: Params, memory: State, signals: Scalar) -> tuple[State, Scalar]:
            stream = jax.random.fold_in(loop.key(key, "signal", loop.measures[i].name), k + 1)
            after, shown = part.step(p, memory, Measurement(signals, 0.0), stream, t, dt)
            return after, shown.y

        values = signal_values(loop, params, state.plant, recorded.measurements, drive)
        return PartMap(apply, state.signals[i], values[i])

    def named_input(i: int) -> PartMap:
        def apply(part: Disturbance, p: Params, memory: tuple[()], signals: tuple[Measurement, Scalar]) -> Scalar:
            measurement, sigma = signals
            return part.value(p, state.inputs[i], measurement, sigma, t)

        sigma = tracking_error(recorded.measurements[0], references[0], params.controller[0].l0).sigma
        return PartMap(apply, (), (recorded.measurements[0], sigma))

    map_of = {
        "signal_sensor": signal_sensor,
        "inputs": named_input,
        "plant": plant,
        "sensor": sensor,
        "differentiator": differentiator,
        "controller": controller,
        "unmodelled": unmodelled,
        "disturbance": disturbance,
    }
    return [map_of[place.slot](place.channel) for place in places]


class Slopes(NamedTuple, Generic[Array]):
    """A part near its operating point, along a direction.

    Args:
        value: Its outputs, shape (outputs,).
        slope: Their derivative, shape (outputs,).
        inner: That of its substitute for its inner side; without a substitute, that of the part.
    """

    value: Array
    slope: Array
    inner: Array


def vector_of(tree: object) -> jax.Array:
    """The numbers of a tree as a vector."""
    return ravel_pytree(as_arrays(tree))[0]


def slopes_of(
    place: LoopPart, part_map: PartMap, part: Part, params: Params, point: jax.Array, axis: jax.Array
) -> Slopes[jax.Array]:
    """A part at a point near its operating point."""
    _, unravel = ravel_pytree(as_arrays((part_map.memory, part_map.signals)))

    def derivative(model: Part, p: Params) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(lambda inputs: vector_of(part_map.apply(model, p, *unravel(inputs))), (point,), (axis,))

    value, slope = derivative(part, params)
    inner = derivative(*place.inner_side(params))[1] if place.inner else slope
    return Slopes(value, slope, inner)


def examination(lane: LaneLoop, places: Sequence[LoopPart]) -> Examination:
    """Classify every part at the operating points of many draws; what is not examined counts as smooth.

    Args:
        lane: The loop of a draw, in which parts that are smooth nowhere have been replaced.
        places: The parts.
    """
    examined = [index for index, place in enumerate(places) if place.examined]
    chosen = [places[index] for index in examined]
    if not chosen:
        return lambda values, indices, states, k: np.full((len(indices), len(places)), Finding.SMOOTH.value)
    examine_chosen = examination_of(lane, chosen)

    def examine(values: Arrays, indices: np.ndarray, states: np.ndarray, k: int) -> np.ndarray:
        findings = np.full((len(indices), len(places)), Finding.SMOOTH.value)
        findings[:, examined] = examine_chosen(values, indices, states, k)
        return findings

    return examine


def examination_of(lane: LaneLoop, places: Sequence[LoopPart]) -> Examination:
    """The same for parts that are all examined."""

    def lane_maps(values: LaneValues, index: jax.Array) -> tuple[Loop, LoopParams, list[PartMap]]:
        loop, params, key = lane(numbers_of_study(values), index)
        _, unravel = ravel_pytree(initial_state(loop, params, key))
        state = unravel(vector_in(values, STATE))
        return loop, params, part_maps(loop, params, key, state, values[SAMPLE].astype(jnp.int32), places)

    def inputs(values: LaneValues, index: jax.Array) -> tuple[Numbers, ...]:
        _, _, maps = lane_maps(values, index)
        vectors = []
        for part_map in maps:
            vectors += [vector_of(part_map.memory), vector_of(part_map.signals)]
        return tuple(map(numbers_of, vectors))

    def pushed(values: LaneValues, index: jax.Array) -> tuple[Numbers, ...]:
        loop, params, maps = lane_maps(values, index)
        vectors: list[jax.Array] = []
        for i, (place, part_map) in enumerate(zip(places, maps, strict=True)):
            part, part_params = part_of(loop, params, place)
            point = vector_in(values, f"{POINT}{i}")
            axis = vector_in(values, f"{AXIS}{i}")
            vectors += slopes_of(place, part_map, part, part_params, point, axis)
        return tuple(map(numbers_of, vectors))

    inputs_of = LaneProgram(inputs)
    push = LaneProgram(pushed)

    def examine(values: Arrays, indices: np.ndarray, states: np.ndarray, k: int) -> np.ndarray:
        count = len(indices)
        columns = values | columns_of(STATE, states) | {SAMPLE: np.full(count, k)}
        vectors = inputs_of(columns, indices)
        memories = vectors[::2]
        points = [np.concatenate(pair, axis=1) for pair in zip(memories, vectors[1::2], strict=True)]
        sizes = [
            (memory.shape[1], point.shape[1] - memory.shape[1]) for memory, point in zip(memories, points, strict=True)
        ]
        patterns = repeated([directions(*size) for size in sizes])
        rows = len(MULTIPLES) * len(patterns[0])
        batch = max(1, BATCH_PUSHES // rows)
        findings = []
        for first in range(0, count, batch):
            draws = np.arange(first, min(first + batch, count))
            lanes = np.repeat(draws, rows)
            pushed_columns = {name: column[lanes] for name, column in columns.items()}
            for i, (point, pattern) in enumerate(zip(points, patterns, strict=True)):
                moved, axes = pushes(point[draws], pattern)
                pushed_columns |= columns_of(f"{POINT}{i}", moved) | columns_of(f"{AXIS}{i}", axes)
            found = push(pushed_columns, indices[lanes])
            shape = (len(draws), len(MULTIPLES), len(patterns[0]), -1)
            arrays = [array.reshape(shape) for array in found]
            kinds = []
            for i, place in enumerate(places):
                kinds.append(finding(place, Slopes(*arrays[3 * i : 3 * i + 3]), sizes[i][0], patterns[i]))
            findings.append(np.stack(kinds, axis=1))
        return np.concatenate(findings)

    return examine


def directions(memory: int, signals: int) -> np.ndarray:
    """Directions in which a part is pushed, shape (directions, memory + signals): if few, one by one, and together."""
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


def repeated(patterns: Sequence[np.ndarray]) -> list[np.ndarray]:
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


def finding(place: LoopPart, pushed: Slopes[np.ndarray], memory: int, pattern: np.ndarray) -> np.ndarray:
    """Classify one part at the operating points: a :class:`Finding` of each draw, shape (n,).

    Args:
        place: The part.
        pushed: The part under the pushes, each array of shape (n, multiples, directions, outputs).
        memory: How many inputs are the part's own state.
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

        small = error(slopes, 0)
        large = error(slopes, 1)
        largest = np.max(np.abs(slopes), axis=1)[:, None, None]
        defect = np.any((small > DEVIATION * largest) & (small > SHRINKING * large), axis=(1, 2, 3))
        if place.remaining.extent != SmoothExtent.PIECEWISE:
            signal_directions = ~np.any(pattern[:, :memory], axis=1)
            defect |= np.any(staircase(moves, slopes, value) & signal_directions, axis=1)
        corner = np.zeros(len(value), dtype=bool)
        outside = np.zeros(len(value), dtype=bool)
        if place.inner:
            scale = DEVIATION * np.maximum(largest, np.max(np.abs(inner), axis=1)[:, None, None])
            inner_side = np.any(np.all(error(inner, 1) <= scale, axis=3), axis=1)
            cornered = np.any(large > scale, axis=(1, 2, 3))
            corner = cornered & np.all(inner_side, axis=1)
            outside = ~cornered & np.any(np.abs(inner - slopes) > scale[:, 0], axis=(1, 2))
    return np.select([corner, defect, outside], [Finding.CORNER, Finding.DEFECT, Finding.BEYOND], Finding.SMOOTH)


def staircase(moves: np.ndarray, slopes: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Whether an output stands still for pushes along a direction and then jumps, shape (n, directions).

    Args:
        moves: Effects of the pushes, shape (n, pushes, sides, directions, outputs).
        slopes: Derivatives, shape (n, directions, outputs).
        value: Outputs at the operating point, shape (n, outputs).
    """
    size = np.abs(moves)
    unmoved = (size[:, :-1] == 0.0) & (slopes == 0.0)[:, None, None]
    jumps = np.isfinite(size[:, 1:]) & (size[:, 1:] > JUMP * (1.0 + np.abs(value))[:, None, None, None])
    return np.any(unmoved & jumps, axis=(1, 2, 4))
