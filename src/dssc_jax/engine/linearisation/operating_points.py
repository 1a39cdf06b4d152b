"""Linearise every draw's sampled loop at an operating point, and find its equilibrium."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.closed_loop.break_points import break_points, sample_map, undisturbed
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.sample import initial_state
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
NEWTON_STEPS = 30  # towards an equilibrium
STALLED = 1e-6  # relative change of a move below which a step brought nothing
MOST_STALLS = 3  # such steps in a row
EQUILIBRIUM_TOLERANCE = 1e-9  # largest change of the state by a sample, relative to 1 + |state|
PUSH = 1e-7  # size of a test of smoothness
PUSH_TOLERANCE = 0.2  # largest deviation of its effect from that of the derivative, relative to the latter

LoopWithParams = tuple[Loop, LoopParams]


def lane_loop(study: Study, places: tuple[LoopPart, ...], resting: bool) -> LaneLoop:
    """The loop of a draw as :func:`linearised_loop` gives it, with the draw's random key."""
    return lambda values, index: (*linearised_loop(study, values, places, resting), draw_key(study.config.seed, index))


def linearised_loop(
    study: Study, values: dict[str, jax.Array], places: tuple[LoopPart, ...], resting: bool
) -> LoopWithParams:
    """The loop of one draw as it is linearised: without disturbances at rest, with the substitutes of its parts."""
    loop = study.loop
    params = study.params(values)
    if resting:
        loop, params = undisturbed(loop, params)
    return substituted(loop, params, places)


def at_origin(study: Study) -> Study:
    """The study of one channel with the plant's initial state at zero; a vehicle is unchanged."""
    initial = study.table["plant"].get("initial")
    if len(study.loop.channels) > 1 or not isinstance(initial, list):
        return study
    return replace(study.override({"plant.initial": [0.0] * len(initial)}), loop=study.loop)


class Linearisation:
    """The compiled linearisation of a study.

    A lane is one draw and one direction: one derivative a lane compiles and runs far faster than all in one.

    Args:
        study: The study.
        places: Its parts.
        resting: Whether the loop is at rest, without disturbances.
    """

    def __init__(self, study: Study, places: tuple[LoopPart, ...], resting: bool) -> None:
        self.places = places
        self.points = len(break_points(study.loop))

        def derivative(numbers: Values, vectors: Values, index: jax.Array) -> tuple[jax.Array, ...]:
            state = vectors["state"]
            direction = jnp.where(jnp.arange(len(state) + self.points) == vectors["direction"], 1.0, 0.0)
            loop, params = linearised_loop(study, numbers, places, resting)
            loop, params = with_inner_sides(loop, params, places, vectors["findings"])
            k = vectors["sample"][0].astype(jnp.int32)
            sample = sample_map(loop, params, draw_key(study.config.seed, index), k)
            at = (state, jnp.zeros(self.points))
            (after, _), slopes = jax.jvp(sample, at, (direction[: len(state)], direction[len(state) :]))
            return after, *slopes

        self.program = LaneProgram(derivative)

    def __call__(
        self, values: Arrays, indices: np.ndarray, states: np.ndarray, k: int, findings: np.ndarray
    ) -> StateMatrices:
        """The matrices of n draws.

        Args:
            values: Of the uncertain numbers, each of shape (n,).
            indices: Draw indices, shape (n,).
            states: Shape (n, states).
            k: Index of the sample.
            findings: Shape (n, parts).
        """
        count, order = states.shape
        size = order + self.points
        draw, direction = np.divmod(np.arange(count * size), size)
        after, state_slopes, signal_slopes = self._derivatives(values, indices, states, k, findings, draw, direction)
        a = state_slopes.reshape(count, size, order).swapaxes(1, 2)
        c = signal_slopes.reshape(count, size, self.points).swapaxes(1, 2)
        return StateMatrices(after.reshape(count, size, order)[:, 0], a[..., :order], a[..., order:], c[..., :order])

    def after(
        self, values: Arrays, indices: np.ndarray, states: np.ndarray, k: int, findings: np.ndarray
    ) -> np.ndarray:
        """The states of n draws after one sample, shape (n, states); arguments as for a call."""
        draw = np.arange(len(states))
        return self._derivatives(values, indices, states, k, findings, draw, np.zeros_like(draw))[0]

    def with_opened(
        self, values: Arrays, indices: np.ndarray, states: np.ndarray, k: int, findings: np.ndarray
    ) -> np.ndarray:
        """The findings in which a part on its boundary counts as beyond it where another part opens the loop.

        There the derivative of the part does not matter: so it is where an actuator has the limit of its controller.
        Arguments as for a call.
        """
        inner = np.array([place.inner for place in self.places])
        doubtful = (findings == Finding.DEFECT) & inner & np.any(findings == Finding.BEYOND, axis=1)[:, None]
        lanes = np.flatnonzero(np.any(doubtful, axis=1))
        if not len(lanes):
            return findings
        passing = np.where(doubtful, Finding.CORNER.value, findings)[lanes]
        numbers = {name: column[lanes] for name, column in values.items()}
        matrices = self(numbers, indices[lanes], states[lanes], k, passing)
        opened = lanes[matrices.opened()]
        findings = findings.copy()
        findings[opened] = np.where(doubtful[opened], Finding.BEYOND.value, findings[opened])
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
        """The next states of some draws, and the derivatives of states and signals along one direction of each."""
        numbers = {name: column[draw] for name, column in values.items()}
        vectors = {
            "state": states[draw],
            "findings": findings[draw],
            "direction": direction[:, None],
            "sample": np.full((len(draw), 1), k),
        }
        return self.program(numbers, vectors, indices[draw])


def corner_notes(study: Study, places: tuple[LoopPart, ...], findings: np.ndarray, point: str) -> tuple[str, ...]:
    """Notes on the parts that lie at a corner, whose substitutes are taken.

    Args:
        study: The study.
        places: The parts.
        findings: At the operating points, shape (n, parts).
        point: Name of the operating point.

    Raises:
        ConfigError: a part has no derivative at one of them.
    """
    notes = require_smooth_at(study, places, findings)
    return tuple(f"{text} ({point}: {count} of {len(findings)} draws)" for text, count in notes.items())


class Resting(NamedTuple):
    """Equilibria of the undisturbed loop, and the matrices there.

    Args:
        states: Shape (n, states).
        matrices: Of the loop without substitutes for corners.
        settled: Which states are at rest, shape (n,).
        felt: States on which the loop's signals depend, there or with all parts within their boundaries, shape
            (n, states); others need not be at rest.
    """

    states: np.ndarray
    matrices: StateMatrices
    settled: np.ndarray
    felt: np.ndarray


def with_better(found: Resting, later: Resting) -> Resting:
    """What was found, with what was found later where nothing had settled, or only an open loop had."""
    better = later.settled & (~found.settled | (found.matrices.opened() & ~later.matrices.opened()))

    def chosen(early: np.ndarray, late: np.ndarray) -> np.ndarray:
        return np.where(better.reshape(-1, *[1] * (early.ndim - 1)), late, early)

    return jax.tree.map(chosen, found, later)


class RestingLoop:
    """The undisturbed loop of a study as compiled programs, for any values of its uncertain numbers.

    Args:
        study: The study, without a sweep.
        places: Its parts.
    """

    def __init__(self, study: Study, places: tuple[LoopPart, ...]) -> None:
        self.study = at_origin(study)
        self.places = places
        self.linearise = Linearisation(self.study, places, resting=True)
        self.initial = LaneProgram(self._initial)
        self.flown = LaneProgram(self._flown)

    def _initial(self, numbers: Values, vectors: Values, index: jax.Array) -> tuple[jax.Array]:
        loop, params = linearised_loop(self.study, numbers, self.places, resting=True)
        return (ravel_pytree(initial_state(loop, params, draw_key(self.study.config.seed, index)))[0],)

    def _flown(self, numbers: Values, vectors: Values, index: jax.Array) -> tuple[jax.Array]:
        """The state after as many samples as the study has, at a constant reference."""
        loop, params = linearised_loop(self.study, numbers, self.places, resting=True)
        sample = sample_map(loop, params, draw_key(self.study.config.seed, index), jnp.asarray(1))
        quiet = jnp.zeros(len(break_points(loop)))
        steps = self.study.loop.steps
        return (jax.lax.fori_loop(0, steps, lambda _, at: sample(at, quiet)[0], vectors["state"]),)

    def start(self, values: Arrays, indices: np.ndarray) -> np.ndarray:
        """The states after the first sample, shape (n, states): a controller may treat it unlike the others."""
        (begin,) = self.initial(values, {}, indices)
        return self.linearise.after(values, indices, begin, 0, self.smooth(len(indices)))

    def inner_dependence(self, values: Arrays, indices: np.ndarray, states: np.ndarray) -> np.ndarray:
        """States on which the loop's signals depend where every part is within its boundaries, shape (n, states).

        Beyond a limit no signal depends on the state of what drives it, such as an integrator that still moves.
        """
        if not any(place.inner for place in self.places):
            return np.zeros(states.shape, bool)
        matrices = self.linearise(values, indices, states, 1, self.within(len(indices)))
        return closure(np.any(matrices.c, axis=1), matrices.a != 0.0)

    def smooth(self, count: int) -> np.ndarray:
        """Findings of a loop whose parts are all smooth, shape (count, parts)."""
        return np.full((count, len(self.places)), Finding.SMOOTH.value)

    def within(self, count: int) -> np.ndarray:
        """Findings by which every part is taken as within its boundaries, shape (count, parts)."""
        return np.full((count, len(self.places)), Finding.CORNER.value)

    def settle(self, values: Arrays, indices: np.ndarray) -> Resting:
        """Find the equilibria by Newton's method, from the states after the first sample.

        Where the first command is at a limit, it does not depend on the states, and Newton's method leads nowhere, or
        to where the plant rests at that command. It starts again from the equilibrium of the loop without limits, and
        then from the state after a simulation at the constant reference, by which a stable loop has left the limit.

        Args:
            values: Of the uncertain numbers, each of shape (n,).
            indices: Draw indices, shape (n,).
        """
        begin = self.start(values, indices)
        found = self.settled_from(begin, values, indices, self.smooth(len(indices)))
        limited = any(place.inner for place in self.places)
        if limited and np.any(~found.settled | found.matrices.opened()):
            unlimited = self.settled_from(begin, values, indices, self.within(len(indices))).states
            found = with_better(found, self.settled_from(unlimited, values, indices, self.smooth(len(indices))))
        if not found.settled.all():
            (flown,) = self.flown(values, {"state": begin}, indices)
            found = with_better(found, self.settled_from(flown, values, indices, self.smooth(len(indices))))
        return found

    def settled_from(self, states: np.ndarray, values: Arrays, indices: np.ndarray, findings: np.ndarray) -> Resting:
        """The equilibria to which Newton's method leads from some states, shape (n, states).

        It ends where steps no longer change how far the states move: there a command is at a limit.
        """
        trial = 0
        stalls = np.zeros(len(indices), int)
        last = np.full(states.shape, np.inf)
        inner = self.inner_dependence(values, indices, states)
        matrices = self.linearise(values, indices, states, 1, findings)
        while True:
            move = matrices.after - states
            finite = np.all(np.isfinite(matrices.a), axis=(1, 2)) & np.all(np.isfinite(move), axis=1)
            felt = inner | closure(np.any(matrices.c, axis=1), matrices.a != 0.0)
            settled = finite & (np.max(np.abs(move) * felt / (1.0 + np.abs(states)), axis=1) <= EQUILIBRIUM_TOLERANCE)
            same = np.max(np.abs(move - last), axis=1) <= STALLED * np.max(np.abs(move), axis=1)
            stalls = np.where(same, stalls + 1, 0)
            last = move
            moving = finite & ~settled & (stalls < MOST_STALLS)
            if not moving.any() or trial == NEWTON_STEPS:
                return Resting(states, matrices, settled, felt)
            trial += 1
            states = states.copy()
            for kept in np.unique(felt[moving], axis=0):
                draws = np.flatnonzero(moving & np.all(felt == kept, axis=1))
                slopes = np.eye(int(np.count_nonzero(kept))) - matrices.a[np.ix_(draws, kept, kept)]
                inverse = np.linalg.pinv(slopes, rcond=len(slopes[0]) * np.finfo(float).eps)
                states[np.ix_(draws, kept)] += (inverse @ move[np.ix_(draws, kept)][..., None])[..., 0]
            lanes = np.flatnonzero(moving)
            moved = {name: column[lanes] for name, column in values.items()}
            fresh = self.linearise(moved, indices[lanes], states[lanes], 1, findings[lanes])
            for array, rows in zip(matrices, fresh, strict=True):
                array[lanes] = rows


def require_derivative(
    study: Study,
    after: Callable[[np.ndarray], np.ndarray],
    states: np.ndarray,
    matrices: StateMatrices,
    plain: np.ndarray,
    felt: np.ndarray,
) -> None:
    """Require that a small push of the equilibrium has the effect that the derivative predicts.

    Args:
        study: The study.
        after: (states of shape (n, states)) -> the states after one sample.
        states: The equilibria, shape (n, states).
        matrices: Their derivatives.
        plain: Which draws have an equilibrium and no part at a corner, shape (n,).
        felt: The states on which the loop's signals depend, which alone are pushed and compared; shape (n, states).

    Raises:
        ConfigError: it has not: the loop switches, or its gain is infinite there.
    """
    push = PUSH * felt * np.random.default_rng(0).choice([-1.0, 1.0], states.shape)
    for side in (push, -push):
        predicted = np.einsum("nij,nj->ni", matrices.a, side)
        actual = after(states + side) - matrices.after
        excess = np.max(np.abs(actual - predicted) * felt, axis=1) / np.max(np.abs(predicted), axis=1, initial=PUSH)
        worst = np.max(excess[plain])
        if not worst <= PUSH_TOLERANCE:
            raise ConfigError(
                study.source,
                f"has no linearisation at its equilibrium: the effect of a deviation of {PUSH:g} differs by "
                f"{100.0 * worst:.3g} % from that of the derivative, as where a controller switches or its gain is "
                "infinite there; describing functions (dssc-jax theory) cover such loops",
            )
