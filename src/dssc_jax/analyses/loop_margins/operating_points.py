"""Operating points of an analysis: the equilibrium of every draw, or times of its flight."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.break_points import place_names, sample_map, start_state
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic
from dssc_jax.engine.linearisation.equilibria import RestingLoop, require_derivative
from dssc_jax.engine.linearisation.matrices import Operating
from dssc_jax.engine.linearisation.operating_points import EQUILIBRIUM, Linearisation, corner_notes, lane_loop
from dssc_jax.engine.linearisation.part_slopes import examination
from dssc_jax.engine.linearisation.smooth_parts import Finding, LoopPart, declared_places, substitute_notes
from dssc_jax.engine.plain import plain_options
from dssc_jax.engine.sampling import Arrays, draw, draw_key
from dssc_jax.study import Study

AT_REST = 1  # index of a sample at rest; only the first sample, 0, may differ from all others


class OperatingPoints(NamedTuple):
    """The loops of all draws, linearised at each operating point.

    Args:
        points: The matrices of all draws, by the name of the operating point.
        notes: Sentences on the substitutes for parts that are smooth nowhere.
    """

    points: dict[str, Operating]
    notes: tuple[str, ...]


def operating_points(study: Study, times: tuple[float, ...]) -> OperatingPoints:
    """Linearise the loop of every draw at its equilibrium, or at times of its flight.

    Args:
        study: The study, without a sweep.
        times: Times of the flight [s]; empty: the equilibrium.

    Raises:
        ConfigError: A part does not declare where it is smooth or has no derivative there; no draw has an equilibrium;
            or a time is outside the flight.
    """
    parts = declared_places(study, moving=bool(times))
    if times:
        points = operating_points_in_flight(study, times, parts)
    else:
        operating, _ = equilibria(RestingLoop(study, parts), study.config.draws)
        points = {EQUILIBRIUM: operating}
    return OperatingPoints(points, tuple(substitute_notes(parts)))


def equilibria(resting: RestingLoop, draws: int) -> tuple[Operating, np.ndarray]:
    """Linearise the loop of every draw at its equilibrium, found by Newton's method from the initial state.

    A state on which no signal of the loop depends, such as an integrator with the gain 0, need not be at rest.

    Args:
        resting: The undisturbed loop of a study.
        draws: Number of draws.

    Returns:
        The matrices of all draws, and findings, shape (draws, parts): the
        :class:`~dssc_jax.engine.linearisation.smooth_parts.Finding` on each part at each draw's equilibrium.

    Raises:
        ConfigError: No draw has an equilibrium, or the loop is not smooth there.
    """
    study = resting.study
    parts = resting.places
    indices = np.arange(draws)
    values = draw(study, indices)
    states, matrices, is_settled, signal_states = resting.settle(values, indices)
    if not is_settled.any():
        raise ConfigError(
            study.source, "no draw has an equilibrium at a constant reference; linearise along the flight"
        )
    examine = examination(lane_loop(study, parts, is_resting=True), parts)
    raw_findings = examine(values, indices, states, AT_REST)
    findings = resting.linearise.resolve_open_loops(values, indices, states, AT_REST, raw_findings)
    notes = corner_notes(study, parts, findings[is_settled], EQUILIBRIUM)
    is_smooth = is_settled & ~np.any((raw_findings == Finding.CORNER) | (raw_findings == Finding.DEFECT), axis=1)
    has_corner = np.any(findings == Finding.CORNER, axis=1)

    def next_states(pushed: np.ndarray) -> np.ndarray:
        """The states of all draws one sample after the states ``pushed``, shape (draws, states) both."""
        return resting.linearise.next_states(values, indices, pushed, AT_REST, resting.smooth(draws))

    if is_smooth.any():
        require_derivative(study, next_states, states, matrices, is_smooth, signal_states)
    if has_corner.any():
        matrices = resting.linearise(values, indices, states, AT_REST, findings)
    is_limited = np.any(findings == Finding.BEYOND, axis=1)
    return Operating(matrices, is_settled, is_limited, notes), findings


def operating_points_in_flight(
    study: Study, times: tuple[float, ...], parts: tuple[LoopPart, ...]
) -> dict[str, Operating]:
    """Linearise the loop of every draw about the states of its flight at some times.

    Args:
        study: The study, without a sweep.
        times: The times [s], ascending.
        parts: The parts of the loop with their declarations of where they are smooth.

    Returns:
        The matrices of all draws, by the name of the operating point, ``t = 1.5 s``.

    Raises:
        ConfigError: A time is outside the flight, or the times do not ascend.
    """
    samples = tuple(round(t / study.config.loop.sample_time) for t in times)
    is_ascending = list(samples) == sorted(set(samples))
    if not is_ascending or samples[0] < 0 or samples[-1] >= study.loop.steps:
        listed_times = ", ".join(f"{t:g}" for t in times)
        raise ConfigError("times", f"must ascend within [0, {study.config.loop.duration:g}) s, got {listed_times}")
    indices = np.arange(study.config.draws)
    values = draw(study, indices)
    flight_states = states_in_flight(study, values, indices, samples)
    linearise = Linearisation(study, parts, is_resting=False)
    examine = examination(lane_loop(study, parts, is_resting=False), parts)
    operating = {}
    for t, k, states in zip(times, samples, flight_states, strict=True):
        findings = examine(values, indices, states, k)
        findings = linearise.resolve_open_loops(values, indices, states, k, findings)
        matrices = linearise(values, indices, states, k, findings)
        is_finite = np.all(np.isfinite(states), axis=1) & np.all(np.isfinite(matrices.a), axis=(1, 2))
        is_limited = np.any(findings == Finding.BEYOND, axis=1)
        name = f"t = {t:g} s"
        notes = corner_notes(study, parts, findings[is_finite], name)
        operating[name] = Operating(matrices, is_finite, is_limited, notes)
    return operating


def states_in_flight(study: Study, values: Arrays, indices: np.ndarray, samples: tuple[int, ...]) -> list[np.ndarray]:
    """The states of n draws before some samples of their flights, an array of shape (n, states) for each sample.

    Before sample 0 a controller may not have begun, so sample 0 gets the state before sample 1. The time loop runs in
    Python, because compiling the whole time loop of a vehicle takes minutes, while compiling and calling a single step
    takes seconds.

    Args:
        study: The study, without a sweep.
        values: Value of each uncertain number, shape (n,) each.
        indices: Indices of the draws, shape (n,).
        samples: Indices of the samples, ascending.
    """

    def start(values: dict[str, jax.Array], index: jax.Array) -> jax.Array:
        """The state of one draw before sample 1 as a vector, shape (states,); traced."""
        return start_state(study.loop, study.params(values), draw_key(study.config.seed, index))

    def advance(values: dict[str, jax.Array], index: jax.Array, state: jax.Array, k: jax.Array) -> jax.Array:
        """The state of one draw after sample k, from its state before sample k, shape (states,) both; traced."""
        sample = sample_map(study.loop, study.params(values), draw_key(study.config.seed, index), k)
        nothing_added = jnp.zeros(len(place_names(study.loop.channels)), state.dtype)
        next_state, _ = sample(state, nothing_added)
        return next_state

    recorded = []
    with arithmetic():
        states = jax.jit(jax.vmap(start), compiler_options=plain_options())(values, indices)
        over_draws = (0, 0, 0, None)  # axes of the arguments; k is the same for all draws
        advance_all = jax.jit(jax.vmap(advance, in_axes=over_draws), compiler_options=plain_options())
        for k in range(samples[-1] + 1):
            if k > 1:
                states = advance_all(values, indices, states, k - 1)
            if k in samples:
                recorded.append(np.asarray(states))
    return recorded
