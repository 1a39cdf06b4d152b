"""Classification of the parts of a loop at its operating points, by the effects of small and large pushes.

State and inputs of each part are pushed, and the effect on its outputs is compared with the derivative: a part may be
smooth there, lie at a corner such as a limit, or have no derivative.
"""

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
from dssc_jax.engine.linearisation.lane_programs import LaneProgram, LaneValues
from dssc_jax.engine.linearisation.part_maps import PartMap, part_maps
from dssc_jax.engine.linearisation.pushes import MULTIPLES, Slopes, directions, equally_long, finding, pushes
from dssc_jax.engine.linearisation.smooth_parts import Finding, LoopPart, Part, part_of
from dssc_jax.engine.sampling import Arrays

BATCH_PUSHES = 16384  # most pushes, of all draws, that are computed at once

LaneLoop: TypeAlias = Callable[[LaneValues, jax.Array], tuple[Loop, LoopParams, jax.Array]]
"""``(numbers of the study by name, draw index) -> the loop to linearise, its parameters and its random key``."""

Examination: TypeAlias = Callable[[Arrays, np.ndarray, np.ndarray, int], np.ndarray]
"""``(numbers by name, draw indices, states, sample) -> class of each part``, a :class:`Finding`, shape (n, parts)."""


def vector_of(tree: object) -> jax.Array:
    """Concatenate the numbers of a tree to a vector."""
    vector, _ = ravel_pytree(as_arrays(tree))
    return vector


def value_and_slope(
    part_map: PartMap, part: Part, params: Params, point: jax.Array, direction: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Compute the outputs of a model at a point, and their derivative along a direction.

    Args:
        part_map: The part as a function of its state and inputs.
        part: The model: the part itself, or the substitute for it.
        params: The model's parameters.
        point: State and inputs of the part, as a vector.
        direction: Direction of the derivative, of the same shape.
    """
    _, tree_from_vector = ravel_pytree(as_arrays((part_map.memory, part_map.signals)))

    def outputs(state_and_inputs: jax.Array) -> jax.Array:
        """The outputs as a vector, from state and inputs as a vector."""
        memory, signals = tree_from_vector(state_and_inputs)
        return vector_of(part_map.apply(part, params, memory, signals))

    return jax.jvp(outputs, (point,), (direction,))


def slopes_of(
    place: LoopPart, part_map: PartMap, part: Part, params: Params, point: jax.Array, direction: jax.Array
) -> Slopes[jax.Array]:
    """Compute the outputs of a part and their derivatives along a direction, at a point near its operating point.

    A part with a kink, such as a limit, also has an inner side: a substitute model whose derivative is that of the part
    within the limit. Any other part has the same derivative on both sides.

    Args:
        place: The part's place in the loop, which tells whether there is an inner side.
        part_map: The part as a function of its state and inputs.
        part: The model.
        params: The model's parameters.
        point: State and inputs of the part, as a vector.
        direction: Direction of the derivatives, of the same shape.
    """
    value, slope = value_and_slope(part_map, part, params, point, direction)
    inner_slope = slope
    if place.has_inner_side:
        inner_part, inner_params = place.inner_side(params)
        _, inner_slope = value_and_slope(part_map, inner_part, inner_params, point, direction)
    return Slopes(value, slope, inner_slope)


def examination(lane: LaneLoop, places: Sequence[LoopPart]) -> Examination:
    """Return the function that classifies every part at the operating points of many draws.

    Parts of the package that are smooth everywhere need no examination, and count as smooth.

    Args:
        lane: The loop of a draw, with substitutes for parts that are smooth nowhere.
        places: The parts.
    """
    examined_indices = [index for index, place in enumerate(places) if place.is_examined]
    examined_places = [places[index] for index in examined_indices]
    examine_places = push_examination(lane, examined_places) if examined_places else None

    def examine(values: Arrays, indices: np.ndarray, states: np.ndarray, k: int) -> np.ndarray:
        """The class of each part in each draw, shape (n, parts)."""
        findings = np.full((len(indices), len(places)), Finding.SMOOTH.value)
        if examine_places is not None:
            findings[:, examined_indices] = examine_places(values, indices, states, k)
        return findings

    return examine


def push_examination(lane: LaneLoop, places: Sequence[LoopPart]) -> Examination:
    """Return the function that classifies every part at the operating points of many draws by pushes.

    Args:
        lane: The loop of a draw, with substitutes for parts that are smooth nowhere.
        places: The parts, all of which are examined.
    """

    def lane_maps(numbers: LaneValues, vectors: LaneValues, index: jax.Array) -> tuple[Loop, LoopParams, list[PartMap]]:
        """The loop of a draw with its parameters, and its parts as functions at the operating point.

        Args:
            numbers: Numbers of the draw by name.
            vectors: The ``state`` at the operating point, and the index of the ``sample``.
            index: Index of the draw.
        """
        loop, params, key = lane(numbers, index)
        _, state_from_vector = ravel_pytree(initial_state(loop, params, key))
        k = vectors["sample"][0].astype(jnp.int32)
        return loop, params, part_maps(loop, params, key, state_from_vector(vectors["state"]), k, places)

    def inputs(numbers: LaneValues, vectors: LaneValues, index: jax.Array) -> tuple[jax.Array, ...]:
        """State and inputs of the first part, then of the second part, and so on, at the operating point of a draw."""
        _, _, maps = lane_maps(numbers, vectors, index)
        results = []
        for part_map in maps:
            results += [vector_of(part_map.memory), vector_of(part_map.signals)]
        return tuple(results)

    def slopes_under_pushes(numbers: LaneValues, vectors: LaneValues, index: jax.Array) -> tuple[jax.Array, ...]:
        """The :class:`Slopes` of each part under one push: three vectors for each part, in the parts' order."""
        loop, params, maps = lane_maps(numbers, vectors, index)
        results: list[jax.Array] = []
        for i, (place, part_map) in enumerate(zip(places, maps, strict=True)):
            part, part_params = part_of(loop, params, place)
            point = vectors[f"point-{i}"]
            direction = vectors[f"direction-{i}"]
            results += slopes_of(place, part_map, part, part_params, point, direction)
        return tuple(results)

    inputs_of = LaneProgram(inputs)
    push = LaneProgram(slopes_under_pushes)

    def examine(values: Arrays, indices: np.ndarray, states: np.ndarray, k: int) -> np.ndarray:
        """The class of each part in each draw, shape (n, parts); draws run in batches of a limited size."""
        count = len(indices)
        operating_points = {"state": states, "sample": np.full((count, 1), k)}
        results = inputs_of(values, operating_points, indices)
        memories, signals = results[::2], results[1::2]
        points = [np.concatenate(vectors, axis=1) for vectors in zip(memories, signals, strict=True)]
        memory_sizes = [memory.shape[1] for memory in memories]
        signal_sizes = [signal.shape[1] for signal in signals]
        patterns = equally_long([directions(*sizes) for sizes in zip(memory_sizes, signal_sizes, strict=True)])
        rows = len(MULTIPLES) * len(patterns[0])  # pushes of a draw
        batch = max(1, BATCH_PUSHES // rows)
        findings = []
        for first in range(0, count, batch):
            draws = np.arange(first, min(first + batch, count))
            lanes = np.repeat(draws, rows)
            numbers = {name: column[lanes] for name, column in values.items()}
            vectors = {name: column[lanes] for name, column in operating_points.items()}
            for i, (point, pattern) in enumerate(zip(points, patterns, strict=True)):
                vectors[f"point-{i}"], vectors[f"direction-{i}"] = pushes(point[draws], pattern)
            shape = (len(draws), len(MULTIPLES), len(patterns[0]), -1)
            arrays = [array.reshape(shape) for array in push(numbers, vectors, indices[lanes])]
            columns = []
            for i, place in enumerate(places):
                pushed = Slopes(*arrays[3 * i : 3 * i + 3])  # value, slope and inner slope of part i
                columns.append(finding(place, pushed, memory_sizes[i], patterns[i]))
            findings.append(np.stack(columns, axis=1))
        return np.concatenate(findings)

    return examine
