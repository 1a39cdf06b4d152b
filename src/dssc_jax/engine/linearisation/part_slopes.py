"""Classify the parts of a loop at its operating points: each as a function of its state and inputs, under pushes."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

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
from dssc_jax.engine.linearisation.lane_programs import LaneProgram, Values
from dssc_jax.engine.linearisation.pushes import MULTIPLES, Slopes, directions, equally_long, finding, pushes
from dssc_jax.engine.linearisation.smooth_parts import Finding, LoopPart, Part, part_of
from dssc_jax.engine.sampling import Arrays

BATCH_PUSHES = 16384  # pushes of all draws that are computed at once

LaneLoop: TypeAlias = Callable[[Values, jax.Array], tuple[Loop, LoopParams, jax.Array]]
"""(laws' values, draw index) -> the loop that is linearised, its parameters and its random key."""

Examination: TypeAlias = Callable[[Arrays, np.ndarray, np.ndarray, int], np.ndarray]
"""(laws' values, draw indices, states, sample) -> a :class:`Finding` for each part, shape (n, parts)."""


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
            measured = signal_values(loop, params, plant_state, outputs, drive._replace(command=command))
            return slope, (outputs, measured)

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
            sensor_state, reading = part.step(p, memory, Measurement(signals, 0.0), stream, t, dt)
            return sensor_state, reading.y

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
    inner = derivative(*place.inner_side(params))[1] if place.has_inner_side else slope
    return Slopes(value, slope, inner)


def examination(lane: LaneLoop, places: Sequence[LoopPart]) -> Examination:
    """Classify every part at the operating points of many draws; what is not examined counts as smooth.

    Args:
        lane: The loop of a draw, in which parts that are smooth nowhere have been replaced.
        places: The parts.
    """
    examined_indices = [index for index, place in enumerate(places) if place.is_examined]
    examined_places = [places[index] for index in examined_indices]
    if not examined_places:
        return lambda values, indices, states, k: np.full((len(indices), len(places)), Finding.SMOOTH.value)
    examine_places = examination_of(lane, examined_places)

    def examine(values: Arrays, indices: np.ndarray, states: np.ndarray, k: int) -> np.ndarray:
        findings = np.full((len(indices), len(places)), Finding.SMOOTH.value)
        findings[:, examined_indices] = examine_places(values, indices, states, k)
        return findings

    return examine


def examination_of(lane: LaneLoop, places: Sequence[LoopPart]) -> Examination:
    """As :func:`examination`, for parts that are all examined."""

    def lane_maps(numbers: Values, vectors: Values, index: jax.Array) -> tuple[Loop, LoopParams, list[PartMap]]:
        loop, params, key = lane(numbers, index)
        _, unravel = ravel_pytree(initial_state(loop, params, key))
        k = vectors["sample"][0].astype(jnp.int32)
        return loop, params, part_maps(loop, params, key, unravel(vectors["state"]), k, places)

    def inputs(numbers: Values, vectors: Values, index: jax.Array) -> tuple[jax.Array, ...]:
        _, _, maps = lane_maps(numbers, vectors, index)
        results = []
        for part_map in maps:
            results += [vector_of(part_map.memory), vector_of(part_map.signals)]
        return tuple(results)

    def slopes_under_pushes(numbers: Values, vectors: Values, index: jax.Array) -> tuple[jax.Array, ...]:
        loop, params, maps = lane_maps(numbers, vectors, index)
        results: list[jax.Array] = []
        for i, (place, part_map) in enumerate(zip(places, maps, strict=True)):
            part, part_params = part_of(loop, params, place)
            point = vectors[f"point-{i}"]
            axis = vectors[f"axis-{i}"]
            results += slopes_of(place, part_map, part, part_params, point, axis)
        return tuple(results)

    inputs_of = LaneProgram(inputs)
    push = LaneProgram(slopes_under_pushes)

    def examine(values: Arrays, indices: np.ndarray, states: np.ndarray, k: int) -> np.ndarray:
        count = len(indices)
        at = {"state": states, "sample": np.full((count, 1), k)}
        results = inputs_of(values, at, indices)
        memories = results[::2]
        points = [np.concatenate(pair, axis=1) for pair in zip(memories, results[1::2], strict=True)]
        sizes = []
        for memory, point in zip(memories, points, strict=True):
            sizes.append((memory.shape[1], point.shape[1] - memory.shape[1]))
        patterns = equally_long([directions(*size) for size in sizes])
        rows = len(MULTIPLES) * len(patterns[0])
        batch = max(1, BATCH_PUSHES // rows)
        findings = []
        for first in range(0, count, batch):
            draws = np.arange(first, min(first + batch, count))
            lanes = np.repeat(draws, rows)
            numbers = {name: column[lanes] for name, column in values.items()}
            vectors = {name: column[lanes] for name, column in at.items()}
            for i, (point, pattern) in enumerate(zip(points, patterns, strict=True)):
                vectors[f"point-{i}"], vectors[f"axis-{i}"] = pushes(point[draws], pattern)
            shape = (len(draws), len(MULTIPLES), len(patterns[0]), -1)
            arrays = [array.reshape(shape) for array in push(numbers, vectors, indices[lanes])]
            kinds = []
            for i, place in enumerate(places):
                kinds.append(finding(place, Slopes(*arrays[3 * i : 3 * i + 3]), sizes[i][0], patterns[i]))
            findings.append(np.stack(kinds, axis=1))
        return np.concatenate(findings)

    return examine
