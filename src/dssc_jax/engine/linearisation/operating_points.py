"""Linearisation of every draw's sampled loop at an operating point, and the search for its equilibrium."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.closed_loop.break_points import place_names, sample_map, undisturbed
from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.influences import closure
from dssc_jax.engine.linearisation.lane_programs import LaneProgram, Values
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
NEWTON_STEPS = 30  # most steps towards an equilibrium
STALLED = 1e-6  # relative change of a move below which a Newton step counts as stalled
MOST_STALLS = 3  # stalled steps in a row that end the search
EQUILIBRIUM_TOLERANCE = 1e-9  # largest change of the state by a sample, relative to 1 + |state|
PUSH = 1e-7  # size of a push that tests the derivative
PUSH_TOLERANCE = 0.2  # largest deviation of its effect from the derivative's prediction, relative to the latter

LoopWithParams = tuple[Loop, LoopParams]


def lane_loop(study: Study, places: tuple[LoopPart, ...], is_resting: bool) -> LaneLoop:
    """The :func:`linearised_loop` of a draw with its random key, as a function of its numbers and index."""
    return lambda values, index: (
        *linearised_loop(study, values, places, is_resting),
        draw_key(study.config.seed, index),
    )


def linearised_loop(
    study: Study, values: dict[str, jax.Array], places: tuple[LoopPart, ...], is_resting: bool
) -> LoopWithParams:
    """The loop of one draw for linearisation, with substitutes for the parts that are smooth nowhere.

    Args:
        study: The study.
        values: The draw's numbers by name.
        places: The parts of the loop.
        is_resting: Whether the loop is at rest, without disturbances.
    """
    loop = study.loop
    params = study.params(values)
    if is_resting:
        loop, params = undisturbed(loop, params)
    return substituted(loop, params, places)


def at_origin(study: Study) -> Study:
    """The study with the plant's initial state at zero, for plants of one channel; other studies are unchanged."""
    initial = study.table["plant"].get("initial")
    if len(study.loop.channels) > 1 or not isinstance(initial, list):
        return study
    return replace(study.override({"plant.initial": [0.0] * len(initial)}), loop=study.loop)


class Linearisation:
    """The compiled linearisation of a study: the derivatives of one sample.

    A lane is one draw and one direction, since one derivative per lane compiles and runs far faster than all in one.

    Args:
        study: The study.
        places: The parts of its loop.
        is_resting: Whether the loop is at rest, without disturbances.
    """

    def __init__(self, study: Study, places: tuple[LoopPart, ...], is_resting: bool) -> None:
        self.places = places
        self.points = len(place_names(study.loop.channels))

        def derivative(numbers: Values, vectors: Values, index: jax.Array) -> tuple[jax.Array, ...]:
            state = vectors["state"]
            direction = jnp.where(jnp.arange(len(state) + self.points) == vectors["direction"], 1.0, 0.0)
            loop, params = linearised_loop(study, numbers, places, is_resting)
            loop, params = with_inner_sides(loop, params, places, vectors["findings"])
            k = vectors["sample"][0].astype(jnp.int32)
            sample = sample_map(loop, params, draw_key(study.config.seed, index), k)
            at = (state, jnp.zeros(self.points))
            (next_state, _), slopes = jax.jvp(sample, at, (direction[: len(state)], direction[len(state) :]))
            return next_state, *slopes

        self.program = LaneProgram(derivative)

    def __call__(
        self, values: Arrays, indices: np.ndarray, states: np.ndarray, k: int, findings: np.ndarray
    ) -> StateMatrices:
        """The linearised loops of n draws at some states.

        Args:
            values: Values of the uncertain numbers, each of shape (n,).
            indices: Draw indices, shape (n,).
            states: Operating points, shape (n, states).
            k: Index of the sample.
            findings: The :class:`Finding` of each part, shape (n, parts).
        """
        count, order = states.shape
        size = order + self.points
        draw, direction = np.divmod(np.arange(count * size), size)
        derivatives = self._derivatives(values, indices, states, k, findings, draw, direction)
        next_states, state_slopes, signal_slopes = derivatives
        a = state_slopes.reshape(count, size, order).swapaxes(1, 2)
        c = signal_slopes.reshape(count, size, self.points).swapaxes(1, 2)
        first_rows = next_states.reshape(count, size, order)[:, 0]
        return StateMatrices(first_rows, a[..., :order], a[..., order:], c[..., :order])

    def next_states(
        self, values: Arrays, indices: np.ndarray, states: np.ndarray, k: int, findings: np.ndarray
    ) -> np.ndarray:
        """The states of n draws after one sample, shape (n, states); arguments as for a call."""
        draw = np.arange(len(states))
        return self._derivatives(values, indices, states, k, findings, draw, np.zeros_like(draw))[0]

    def resolve_open_loops(
        self, values: Arrays, indices: np.ndarray, states: np.ndarray, k: int, findings: np.ndarray
    ) -> np.ndarray:
        """The findings, where a part on its boundary counts as beyond it if another part opens the loop.

        In an open loop the derivative of the part does not matter, as where an actuator and its controller share a
        limit. Arguments as for a call.
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
        """For some lanes: the next state, and the derivatives of state and signals along one direction.

        Args:
            values: Values of the uncertain numbers, each of shape (n,).
            indices: Draw indices, shape (n,).
            states: Operating points, shape (n, states).
            k: Index of the sample.
            findings: The :class:`Finding` of each part, shape (n, parts).
            draw: Row of those arrays for each lane, shape (lanes,).
            direction: Index of the state, or of the break point behind the states, shape (lanes,).
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
    """Notes on the parts at a corner, where substitutes stand for them, or beyond one.

    Args:
        study: The study.
        places: The parts of its loop.
        findings: The :class:`Finding` of each draw and part, shape (n, parts).
        point: Name of the operating point.

    Raises:
        ConfigError: A part has no derivative at an operating point.
    """
    notes = require_smooth_at(study, places, findings)
    return tuple(f"{text} ({point}: {count} of {len(findings)} draws)" for text, count in notes.items())


class Resting(NamedTuple):
    """Equilibria of the undisturbed loop of n draws, and the linearised loops there.

    Args:
        states: The states, shape (n, states).
        matrices: Matrices of the loops, without substitutes for corners.
        is_settled: Which draws are at rest in these states, shape (n,).
        relevant_states: States on which the loop's signals depend, either there or with all parts within their
            boundaries, shape (n, states); the others need not be at rest.
    """

    states: np.ndarray
    matrices: StateMatrices
    is_settled: np.ndarray
    relevant_states: np.ndarray


def better_equilibria(earlier: Resting, later: Resting) -> Resting:
    """The earlier equilibria, or the later ones in draws where the earlier search failed or found an open loop."""
    is_better = later.is_settled & (~earlier.is_settled | (earlier.matrices.is_open() & ~later.matrices.is_open()))

    def select(early: np.ndarray, late: np.ndarray) -> np.ndarray:
        return np.where(is_better.reshape(-1, *[1] * (early.ndim - 1)), late, early)

    return jax.tree.map(select, earlier, later)


class RestingLoop:
    """The undisturbed loop of a study as compiled programs, which find its equilibria.

    Args:
        study: The study, without a sweep.
        places: The parts of its loop.
    """

    def __init__(self, study: Study, places: tuple[LoopPart, ...]) -> None:
        self.study = at_origin(study)
        self.places = places
        self.linearise = Linearisation(self.study, places, is_resting=True)
        self.initial_states = LaneProgram(self._initial_state)
        self.final_states = LaneProgram(self._final_state)

    def _initial_state(self, numbers: Values, vectors: Values, index: jax.Array) -> tuple[jax.Array]:
        """The state before the first sample; a program of a lane."""
        loop, params = linearised_loop(self.study, numbers, self.places, is_resting=True)
        return (ravel_pytree(initial_state(loop, params, draw_key(self.study.config.seed, index)))[0],)

    def _final_state(self, numbers: Values, vectors: Values, index: jax.Array) -> tuple[jax.Array]:
        """The state after a flight of the study's duration at the constant reference; a program of a lane."""
        loop, params = linearised_loop(self.study, numbers, self.places, is_resting=True)
        sample = sample_map(loop, params, draw_key(self.study.config.seed, index), jnp.asarray(1))
        no_additions = jnp.zeros(len(place_names(loop.channels)))
        steps = self.study.loop.steps
        return (jax.lax.fori_loop(0, steps, lambda _, state: sample(state, no_additions)[0], vectors["state"]),)

    def start(self, values: Arrays, indices: np.ndarray) -> np.ndarray:
        """The states after the first sample, which controllers may treat unlike all others, shape (n, states)."""
        (states,) = self.initial_states(values, {}, indices)
        return self.linearise.next_states(values, indices, states, 0, self.smooth(len(indices)))

    def inner_dependence(self, values: Arrays, indices: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Which states the loop's signals depend on if every part is within its boundaries, shape (n, states).

        Beyond a limit no signal depends on the states that drive the limited part, such as a moving integrator.
        """
        if not any(place.has_inner_side for place in self.places):
            return np.zeros(states.shape, bool)
        matrices = self.linearise(values, indices, states, 1, self.within_boundaries(len(indices)))
        return closure(np.any(matrices.c, axis=1), matrices.a != 0.0)

    def smooth(self, count: int) -> np.ndarray:
        """Findings that treat every part as smooth, shape (count, parts)."""
        return np.full((count, len(self.places)), Finding.SMOOTH.value)

    def within_boundaries(self, count: int) -> np.ndarray:
        """Findings that treat every part as within its boundaries, shape (count, parts)."""
        return np.full((count, len(self.places)), Finding.CORNER.value)

    def settle(self, values: Arrays, indices: np.ndarray) -> Resting:
        """Find the equilibria by Newton's method, from the states after the first sample.

        If the first command is at a limit, it does not depend on the states. Then Newton's method fails, or finds where
        the plant rests at that command. In such draws it starts again from the equilibrium of the loop without limits,
        and then from the end of a simulation at the constant reference, where a stable loop has left the limit.

        Args:
            values: Values of the uncertain numbers, each of shape (n,).
            indices: Draw indices, shape (n,).
        """
        initial_states = self.start(values, indices)
        equilibria = self.settled_from(initial_states, values, indices, self.smooth(len(indices)))
        has_limits = any(place.has_inner_side for place in self.places)
        if has_limits and np.any(~equilibria.is_settled | equilibria.matrices.is_open()):
            unlimited = self.settled_from(initial_states, values, indices, self.within_boundaries(len(indices)))
            retrial = self.settled_from(unlimited.states, values, indices, self.smooth(len(indices)))
            equilibria = better_equilibria(equilibria, retrial)
        if not equilibria.is_settled.all():
            (final_states,) = self.final_states(values, {"state": initial_states}, indices)
            retrial = self.settled_from(final_states, values, indices, self.smooth(len(indices)))
            equilibria = better_equilibria(equilibria, retrial)
        return equilibria

    def settled_from(self, states: np.ndarray, values: Arrays, indices: np.ndarray, findings: np.ndarray) -> Resting:
        """The equilibria that Newton's method finds from some states, shape (n, states).

        The search also ends once steps no longer change the move of the states in a sample: a command is at a limit.
        """
        trial = 0
        stall_counts = np.zeros(len(indices), int)
        last_move = np.full(states.shape, np.inf)
        inner_states = self.inner_dependence(values, indices, states)
        matrices = self.linearise(values, indices, states, 1, findings)
        while True:
            move = matrices.next_states - states
            is_finite = np.all(np.isfinite(matrices.a), axis=(1, 2)) & np.all(np.isfinite(move), axis=1)
            relevant_states = inner_states | closure(np.any(matrices.c, axis=1), matrices.a != 0.0)
            largest_move = np.max(np.abs(move) * relevant_states / (1.0 + np.abs(states)), axis=1)
            is_settled = is_finite & (largest_move <= EQUILIBRIUM_TOLERANCE)
            is_stalled = np.max(np.abs(move - last_move), axis=1) <= STALLED * np.max(np.abs(move), axis=1)
            stall_counts = np.where(is_stalled, stall_counts + 1, 0)
            last_move = move
            is_moving = is_finite & ~is_settled & (stall_counts < MOST_STALLS)
            if not is_moving.any() or trial == NEWTON_STEPS:
                return Resting(states, matrices, is_settled, relevant_states)
            trial += 1
            states = states.copy()
            for mask in np.unique(relevant_states[is_moving], axis=0):
                draws = np.flatnonzero(is_moving & np.all(relevant_states == mask, axis=1))
                slopes = np.eye(int(np.count_nonzero(mask))) - matrices.a[np.ix_(draws, mask, mask)]
                inverse = np.linalg.pinv(slopes, rcond=len(slopes[0]) * np.finfo(float).eps)
                states[np.ix_(draws, mask)] += (inverse @ move[np.ix_(draws, mask)][..., None])[..., 0]
            lanes = np.flatnonzero(is_moving)
            values_of_lanes = {name: column[lanes] for name, column in values.items()}
            new_matrices = self.linearise(values_of_lanes, indices[lanes], states[lanes], 1, findings[lanes])
            for array, rows in zip(matrices, new_matrices, strict=True):
                array[lanes] = rows


def require_derivative(
    study: Study,
    next_states: Callable[[np.ndarray], np.ndarray],
    states: np.ndarray,
    matrices: StateMatrices,
    is_checked: np.ndarray,
    relevant_states: np.ndarray,
) -> None:
    """Require that a small push away from the equilibrium has the effect that the derivative predicts.

    Args:
        study: The study.
        next_states: (states of shape (n, states)) -> the states after one sample.
        states: The equilibria, shape (n, states).
        matrices: The linearised loops there.
        is_checked: Which draws have an equilibrium and no part at a corner, shape (n,).
        relevant_states: Which states the loop's signals depend on, shape (n, states); only these are pushed and
            compared.

    Raises:
        ConfigError: The effect differs: the loop switches, or its gain is infinite there.
    """
    push = PUSH * relevant_states * np.random.default_rng(0).choice([-1.0, 1.0], states.shape)
    for side in (push, -push):
        predicted = np.einsum("nij,nj->ni", matrices.a, side)
        actual = next_states(states + side) - matrices.next_states
        largest_deviation = np.max(np.abs(actual - predicted) * relevant_states, axis=1)
        relative_deviation = largest_deviation / np.max(np.abs(predicted), axis=1, initial=PUSH)
        worst = np.max(relative_deviation[is_checked])
        if not worst <= PUSH_TOLERANCE:
            raise ConfigError(
                study.source,
                f"has no linearisation at its equilibrium: the effect of a deviation of {PUSH:g} differs by "
                f"{100.0 * worst:.3g} % from that of the derivative, as where a controller switches or its gain is "
                "infinite there; describing functions (dssc-jax theory) cover such loops",
            )
