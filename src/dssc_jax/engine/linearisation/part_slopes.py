"""Classification of the parts of a loop at its operating points, by the effects of small and large pushes."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.core.numerics import as_arrays
from dssc_jax.core.signals import Params
from dssc_jax.engine.linearisation.lane_programs import LaneProgram, Values
from dssc_jax.engine.linearisation.part_maps import PartMap, part_maps
from dssc_jax.engine.linearisation.pushes import MULTIPLES, Slopes, directions, equally_long, finding, pushes
from dssc_jax.engine.linearisation.smooth_parts import Finding, LoopPart, Part, part_of
from dssc_jax.engine.sampling import Arrays

BATCH_PUSHES = 16384  # most pushes, of all draws, that are computed at once

LaneLoop: TypeAlias = Callable[[Values, jax.Array], tuple[Loop, LoopParams, jax.Array]]
"""(numbers of the study by name, draw index) -> the loop to linearise, its parameters and its random key."""

Examination: TypeAlias = Callable[[Arrays, np.ndarray, np.ndarray, int], np.ndarray]
"""(numbers of the study by name, draw indices, states, sample) -> :class:`Finding` of each part, shape (n, parts)."""


def vector_of(tree: object) -> jax.Array:
    """The numbers of a tree as a vector."""
    return ravel_pytree(as_arrays(tree))[0]


def slopes_of(
    place: LoopPart, part_map: PartMap, part: Part, params: Params, point: jax.Array, axis: jax.Array
) -> Slopes[jax.Array]:
    """Outputs of a part and their derivatives at a point near its operating point.

    Args:
        place: The part's place in the loop.
        part_map: The part as a function of its state and inputs.
        part: The model.
        params: Its parameters.
        point: State and inputs of the part, as a vector.
        axis: Direction of the derivatives, of the same shape.
    """
    _, unravel = ravel_pytree(as_arrays((part_map.memory, part_map.signals)))

    def derivative(model: Part, p: Params) -> tuple[jax.Array, jax.Array]:
        def outputs(inputs: jax.Array) -> jax.Array:
            return vector_of(part_map.apply(model, p, *unravel(inputs)))

        return jax.jvp(outputs, (point,), (axis,))

    value, slope = derivative(part, params)
    inner = derivative(*place.inner_side(params))[1] if place.has_inner_side else slope
    return Slopes(value, slope, inner)


def examination(lane: LaneLoop, places: Sequence[LoopPart]) -> Examination:
    """The function that classifies every part at the operating points of many draws.

    Parts of the package that are smooth everywhere need no examination, and count as smooth.

    Args:
        lane: The loop of a draw, with substitutes for parts that are smooth nowhere.
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
    """The function of :func:`examination` for parts that all need examination."""

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
