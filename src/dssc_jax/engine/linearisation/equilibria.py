"""The search for the equilibrium of every draw's undisturbed loop, at which it is linearised.

The loop rests in a state that one sample does not move. A state on which no signal of the loop depends need not rest.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.closed_loop.break_points import place_names, sample_map
from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.influences import closure
from dssc_jax.engine.linearisation.lane_programs import LaneProgram, LaneValues
from dssc_jax.engine.linearisation.matrices import StateMatrices
from dssc_jax.engine.linearisation.operating_points import Linearisation, loop_to_linearise
from dssc_jax.engine.linearisation.smooth_parts import Finding, LoopPart
from dssc_jax.engine.sampling import Arrays, draw_key
from dssc_jax.study import Study

FIRST_SAMPLE = 0
LATER_SAMPLE = 1  # index of any other sample: controllers may treat the first one unlike all others
NEWTON_STEPS = 30  # most steps towards an equilibrium
STALLED = 1e-6  # relative change of a move below which a Newton step counts as stalled
MOST_STALLS = 3  # stalled steps in a row that end the search
EQUILIBRIUM_TOLERANCE = 1e-9  # largest change of the state by a sample, relative to 1 + |state|
PUSH = 1e-7  # size of a push that tests the derivative
PUSH_TOLERANCE = 0.2  # largest deviation of its effect from the derivative's prediction, relative to the latter


def at_origin(study: Study) -> Study:
    """The study with the plant's initial state at 0, so that the search for an equilibrium begins there.

    A study with several channels, or without a list of initial values, is returned as it is.
    """
    initial = study.table["plant"].get("initial")
    if len(study.loop.channels) > 1 or not isinstance(initial, list):
        return study
    return replace(study.override({"plant.initial": [0.0] * len(initial)}), loop=study.loop)


class Resting(NamedTuple):
    """Equilibria of the undisturbed loop of n draws, and the loops linearised at them.

    Args:
        states: The states at the end of the search, shape (n, states).
        matrices: Matrices of the loops linearised at these states, without substitutes for corners.
        is_settled: Whether each draw is at rest in its state, shape (n,).
        relevant_states: States on which the loop's signals depend, either at the end of the search or with all parts
            within their boundaries, shape (n, states). The other states need not be at rest.
    """

    states: np.ndarray
    matrices: StateMatrices
    is_settled: np.ndarray
    relevant_states: np.ndarray


def better_equilibria(earlier: Resting, later: Resting) -> Resting:
    """The better equilibrium of each draw, out of two searches.

    The later search wins if the earlier one failed, or if the loop is open at the earlier equilibrium and closed at the
    later one. A later search that failed never wins.
    """
    is_better = later.is_settled & (~earlier.is_settled | (earlier.matrices.is_open() & ~later.matrices.is_open()))

    def select(early: np.ndarray, late: np.ndarray) -> np.ndarray:
        """The rows of ``late`` in draws where the later search is better, else those of ``early``, shape (n, ...)."""
        row_is_better = is_better.reshape(-1, *[1] * (early.ndim - 1))
        return np.where(row_is_better, late, early)

    return jax.tree.map(select, earlier, later)


class RestingLoop:
    """The undisturbed loop of a study as compiled programs, which find its equilibria.

    Args:
        study: The study, without a sweep.
        places: The parts of the study's loop.
    """

    def __init__(self, study: Study, places: tuple[LoopPart, ...]) -> None:
        """Prepare the programs; each is compiled when it first runs."""
        self.study = at_origin(study)
        self.places = places
        self.linearise = Linearisation(self.study, places, is_resting=True)
        self.initial_states = LaneProgram(self._initial_state)
        self.final_states = LaneProgram(self._final_state)

    def _initial_state(self, numbers: LaneValues, vectors: LaneValues, index: jax.Array) -> tuple[jax.Array]:
        """The state before the first sample as a vector: the program of one lane, which takes no ``vectors``."""
        loop, params = loop_to_linearise(self.study, numbers, self.places, is_resting=True)
        state, _ = ravel_pytree(initial_state(loop, params, draw_key(self.study.config.seed, index)))
        return (state,)

    def _final_state(self, numbers: LaneValues, vectors: LaneValues, index: jax.Array) -> tuple[jax.Array]:
        """The state after a flight of the study's duration at the constant reference, as the program of one lane.

        The flight starts at ``vectors["state"]``. Every sample is computed as the same later sample, because
        controllers may treat the first sample unlike all others.
        """
        loop, params = loop_to_linearise(self.study, numbers, self.places, is_resting=True)
        sample = sample_map(loop, params, draw_key(self.study.config.seed, index), jnp.asarray(LATER_SAMPLE))
        no_additions = jnp.zeros(len(place_names(loop.channels)))

        def advance(_: jax.Array, state: jax.Array) -> jax.Array:
            """The state after one more sample."""
            next_state, _ = sample(state, no_additions)
            return next_state

        return (jax.lax.fori_loop(0, self.study.loop.steps, advance, vectors["state"]),)

    def start(self, values: Arrays, indices: np.ndarray) -> np.ndarray:
        """The states after the first sample, which controllers may treat unlike all others, shape (n, states).

        Args:
            values: Numbers of n draws, shape (n,) each.
            indices: Indices of the draws, shape (n,).
        """
        (initial_states,) = self.initial_states(values, {}, indices)  # {}: it takes no vectors
        smooth_parts = self.smooth(len(indices))  # each part is taken as it is
        return self.linearise.next_states(values, indices, initial_states, FIRST_SAMPLE, smooth_parts)

    def inner_dependence(self, values: Arrays, indices: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Which states the loop's signals depend on if every part is within its boundaries, shape (n, states).

        An equilibrium requires that these states are at rest, too. Beyond a limit no signal depends on the states that
        drive the limited part, so that a loop with a moving integrator would pass for one at rest.

        Args:
            values: Values of the uncertain numbers, shape (n,) each.
            indices: Draw indices, shape (n,).
            states: Operating points, shape (n, states).
        """
        if not any(place.has_inner_side for place in self.places):
            return np.zeros(states.shape, bool)
        matrices = self.linearise(values, indices, states, LATER_SAMPLE, self.within_boundaries(len(indices)))
        return closure(np.any(matrices.c, axis=1), matrices.a != 0.0)

    def smooth(self, count: int) -> np.ndarray:
        """The finding "smooth" for every part of ``count`` draws, without any substitute, shape (count, parts)."""
        return np.full((count, len(self.places)), Finding.SMOOTH.value)

    def within_boundaries(self, count: int) -> np.ndarray:
        """The finding "at a corner" for every part of ``count`` draws, shape (count, parts).

        With this finding, each part with an inner side is replaced by its substitute for it.
        """
        return np.full((count, len(self.places)), Finding.CORNER.value)

    def settle(self, values: Arrays, indices: np.ndarray) -> Resting:
        """Find the equilibrium of each of n draws by Newton's method, from the states after the first sample.

        If the first command is at a limit, it does not depend on the states. Newton's method then fails, or finds where
        the plant rests at that command. Such draws start again from the equilibrium of the loop without limits. Draws
        that still fail start from the end of a simulation at the constant reference, where a stable loop has left the
        limit.

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
        """The equilibria that Newton's method finds from some states.

        A step solves (1 - A) dx = x+ - x for the relevant states, where x+ is the state after a sample. In a draw with
        a command at a limit, steps may not change the move x+ - x any more. The search of such a draw also ends.

        Args:
            states: The states at which the search begins, shape (n, states).
            values: Values of the uncertain numbers, each of shape (n,).
            indices: Draw indices, shape (n,).
            findings: The :class:`Finding` of each part, shape (n, parts).
        """
        trial = 0
        stall_counts = np.zeros(len(indices), int)
        last_move = np.full(states.shape, np.inf)
        inner_states = self.inner_dependence(values, indices, states)
        matrices = self.linearise(values, indices, states, LATER_SAMPLE, findings)
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
            states = newton_step(states, matrices.a, move, relevant_states, is_moving)
            lanes = np.flatnonzero(is_moving)
            values_of_lanes = {name: column[lanes] for name, column in values.items()}
            new_matrices = self.linearise(values_of_lanes, indices[lanes], states[lanes], LATER_SAMPLE, findings[lanes])
            for array, rows in zip(matrices, new_matrices, strict=True):
                array[lanes] = rows


def newton_step(
    states: np.ndarray, a: np.ndarray, move: np.ndarray, relevant_states: np.ndarray, is_moving: np.ndarray
) -> np.ndarray:
    """The states after one step of Newton's method towards an equilibrium, shape (n, states).

    Args:
        states: The states before the step, shape (n, states).
        a: Derivative of the state after a sample with respect to the state, shape (n, states, states).
        move: Change of the state by a sample, shape (n, states).
        relevant_states: Which states must rest, shape (n, states); only these change.
        is_moving: Which draws take a step, shape (n,).
    """
    next_states = states.copy()
    for mask in np.unique(relevant_states[is_moving], axis=0):  # draws with the same relevant states together
        draws = np.flatnonzero(is_moving & np.all(relevant_states == mask, axis=1))
        block = np.ix_(draws, mask)
        slopes = np.eye(int(np.count_nonzero(mask))) - a[np.ix_(draws, mask, mask)]
        inverse = np.linalg.pinv(slopes, rcond=len(slopes[0]) * np.finfo(float).eps)
        next_states[block] += (inverse @ move[block][..., None])[..., 0]
    return next_states


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
        next_states: Gives the states after one sample, from states of shape (n, states).
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
