"""Linearisation of every draw's sampled loop at an operating point.

The derivatives are those of one sample, the step that the simulation runs. A part without a derivative there is
replaced by the substitute that it declares.
"""

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.break_points import place_names, sample_map, undisturbed
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.engine.linearisation.lane_programs import LaneProgram, LaneValues
from dssc_jax.engine.linearisation.matrices import StateMatrices
from dssc_jax.engine.linearisation.part_slopes import LaneLoop
from dssc_jax.engine.linearisation.smooth_parts import (
    Finding,
    LoopPart,
    require_smooth_at,
    substituted,
    with_inner_sides,
)
from dssc_jax.engine.sampling import Arrays, draw_key
from dssc_jax.study import Study

EQUILIBRIUM = "equilibrium"

LoopWithParams = tuple[Loop, LoopParams]


def lane_loop(study: Study, places: tuple[LoopPart, ...], is_resting: bool) -> LaneLoop:
    """Return the function that gives a draw's loop for linearisation, its parameters and its random key.

    Args:
        study: The study.
        places: The parts of the loop.
        is_resting: Whether the loop is at rest, without disturbances.

    Returns:
        ``(numbers of the draw by name, index of the draw) -> (loop, parameters, random key)``.
    """

    def loop_of_draw(values: LaneValues, index: jax.Array) -> tuple[Loop, LoopParams, jax.Array]:
        """The loop, its parameters and the random key of the draw with these numbers and this index."""
        loop, params = loop_to_linearise(study, values, places, is_resting)
        return loop, params, draw_key(study.config.seed, index)

    return loop_of_draw


def loop_to_linearise(
    study: Study, values: dict[str, jax.Array], places: tuple[LoopPart, ...], is_resting: bool
) -> LoopWithParams:
    """The loop of one draw in the form that is linearised, and its parameters; the function itself linearises nothing.

    Parts that are smooth nowhere are replaced by the substitutes that they declare.

    Args:
        study: The study.
        values: The draw's numbers by name.
        places: The parts of the loop, with their declarations of smoothness.
        is_resting: Whether to hold the reference, and to leave out disturbances, wind and sensor noise, so that the
            loop can rest.
    """
    loop = study.loop
    params = study.params(values)
    if is_resting:
        loop, params = undisturbed(loop, params)
    return substituted(loop, params, places)


class Linearisation:
    """The compiled linearisation of a study: a call gives the derivatives of one sample of many draws.

    A lane is one draw and one direction, which is a state or the signal added at a break point. One derivative per lane
    compiles and runs far faster than all derivatives in one lane.

    Args:
        study: The study.
        places: The parts of the study's loop.
        is_resting: Whether the loop is at rest, without disturbances.
    """

    def __init__(self, study: Study, places: tuple[LoopPart, ...], is_resting: bool) -> None:
        """Prepare the program; it is compiled when it first runs. The arguments are those of the class."""
        self.places = places
        self.points = len(place_names(study.loop.channels))  # number of break points

        def derivative(numbers: LaneValues, vectors: LaneValues, index: jax.Array) -> tuple[jax.Array, ...]:
            """The next state of a draw, and the derivatives of state and signals along one direction.

            Args:
                numbers: Numbers of the draw by name.
                vectors: The ``state``, the ``direction`` (its index), the index of the ``sample``, and the
                    ``findings``.
                index: Index of the draw.
            """
            state = vectors["state"]
            order = len(state)
            direction = jnp.where(jnp.arange(order + self.points) == vectors["direction"], 1.0, 0.0)
            loop, params = loop_to_linearise(study, numbers, places, is_resting)
            loop, params = with_inner_sides(loop, params, places, vectors["findings"])
            k = vectors["sample"][0].astype(jnp.int32)
            sample = sample_map(loop, params, draw_key(study.config.seed, index), k)
            no_additions = jnp.zeros(self.points)
            tangent = (direction[:order], direction[order:])
            (next_state, _), slopes = jax.jvp(sample, (state, no_additions), tangent)
            return next_state, *slopes

        self.program = LaneProgram(derivative)

    def __call__(
        self, values: Arrays, indices: np.ndarray, states: np.ndarray, k: int, findings: np.ndarray
    ) -> StateMatrices:
        """The linearised loops of n draws, each at its own state.

        Args:
            values: Values of the uncertain numbers, each of shape (n,).
            indices: Draw indices, shape (n,).
            states: Operating points, shape (n, states).
            k: Index of the sample.
            findings: The :class:`Finding` of each part, shape (n, parts).
        """
        count, order = states.shape
        size = order + self.points  # directions of a draw: the states, then the break points
        draw, direction = np.divmod(np.arange(count * size), size)
        derivatives = self._derivatives(values, indices, states, k, findings, draw, direction)
        next_states, state_slopes, signal_slopes = derivatives
        ab = state_slopes.reshape(count, size, order).swapaxes(1, 2)  # [A, B]
        cd = signal_slopes.reshape(count, size, self.points).swapaxes(1, 2)  # [C, D]
        next_state_of_draw = next_states.reshape(count, size, order)[:, 0]  # the same in all lanes of a draw
        return StateMatrices(next_state_of_draw, ab[..., :order], ab[..., order:], cd[..., :order])

    def next_states(
        self, values: Arrays, indices: np.ndarray, states: np.ndarray, k: int, findings: np.ndarray
    ) -> np.ndarray:
        """The states of n draws after one sample, shape (n, states).

        Args:
            values: Values of the uncertain numbers, each of shape (n,).
            indices: Draw indices, shape (n,).
            states: States before the sample, shape (n, states).
            k: Index of the sample.
            findings: The :class:`Finding` of each part, shape (n, parts).
        """
        draw = np.arange(len(states))
        any_direction = np.zeros_like(draw)  # its derivatives are not read
        next_states, *_ = self._derivatives(values, indices, states, k, findings, draw, any_direction)
        return next_states

    def resolve_open_loops(
        self, values: Arrays, indices: np.ndarray, states: np.ndarray, k: int, findings: np.ndarray
    ) -> np.ndarray:
        """The findings, in which a part without a derivative counts as beyond its boundary if the loop is open.

        In an open loop such a part's derivative does not matter. An example is an actuator and its controller that
        share a limit: either of them opens the loop. To find such draws, the loop is linearised with the substitutes of
        these parts.

        Args:
            values: Values of the uncertain numbers, each of shape (n,).
            indices: Draw indices, shape (n,).
            states: Operating points, shape (n, states).
            k: Index of the sample.
            findings: The :class:`Finding` of each part, shape (n, parts).

        Returns:
            The :class:`Finding` of each part, shape (n, parts).
        """
        has_inner_side = np.array([place.has_inner_side for place in self.places])
        is_beyond = np.any(findings == Finding.BEYOND, axis=1)[:, None]
        is_doubtful = (findings == Finding.DEFECT) & has_inner_side & is_beyond
        lanes = np.flatnonzero(np.any(is_doubtful, axis=1))
        if not len(lanes):
            return findings
        trial_findings = np.where(is_doubtful, Finding.CORNER.value, findings)[lanes]
        numbers = {name: column[lanes] for name, column in values.items()}
        matrices = self(numbers, indices[lanes], states[lanes], k, trial_findings)
        open_lanes = lanes[matrices.is_open()]
        findings = findings.copy()
        findings[open_lanes] = np.where(is_doubtful[open_lanes], Finding.BEYOND.value, findings[open_lanes])
        return findings

    def _derivatives(
        self,
        values: Arrays,
        indices: np.ndarray,
        states: np.ndarray,
        k: int,
        findings: np.ndarray,
        draw: np.ndarray,
        direction: np.ndarray,
    ) -> list[np.ndarray]:
        """For each of some lanes, the next state, and the derivatives of state and signals along one direction.

        Args:
            values: Values of the uncertain numbers, each of shape (n,).
            indices: Draw indices, shape (n,).
            states: Operating points, shape (n, states).
            k: Index of the sample.
            findings: The :class:`Finding` of each part, shape (n, parts).
            draw: Row of the arrays above for each lane, shape (lanes,).
            direction: Direction of each lane's derivatives: index of a state, or number of states plus index of a break
                point, shape (lanes,).
        """
        numbers = {name: column[draw] for name, column in values.items()}
        vectors = {
            "state": states[draw],
            "findings": findings[draw],
            "direction": direction[:, None],
            "sample": np.full((len(draw), 1), k),
        }
        return self.program(numbers, vectors, indices[draw])


def corner_notes(study: Study, places: tuple[LoopPart, ...], findings: np.ndarray, point: str) -> tuple[str, ...]:
    """Notes for the reader of the results on the parts that lie at or beyond a corner, with the number of draws.

    At a corner the part's substitute takes its place.

    Args:
        study: The study.
        places: The parts of the study's loop.
        findings: The :class:`Finding` of each draw and part, shape (n, parts).
        point: Name of the operating point.

    Raises:
        ConfigError: A part has no derivative at an operating point.
    """
    notes = require_smooth_at(study, places, findings)
    return tuple(f"{text} ({point}: {count} of {len(findings)} draws)" for text, count in notes.items())
