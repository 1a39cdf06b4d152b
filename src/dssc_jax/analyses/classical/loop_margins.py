"""Compute classical margins of every draw's linearised loop, at its equilibrium or along its flight."""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.analyses.classical.break_points import (
    break_points,
    sample_map,
    start_state,
    undisturbed,
)
from dssc_jax.analyses.classical.response import (
    ClassicalMargins,
    classical_margins,
    common_grid,
    own_grid,
    response_of,
)
from dssc_jax.analyses.classical.result import EQUILIBRIUM, LoopAnswer, LoopMargins, Status, margins_dataset
from dssc_jax.analyses.theory.linearised import require_smooth
from dssc_jax.backend.plain import plain_options
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import Arrays, drawn
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.engine.sampling import draw_key
from dssc_jax.study import Study

LANES_TOGETHER = 2048  # derivatives that are computed at once
NEWTON_STEPS_OF_REST, AT_REST = 30, 1e-9  # largest change of the state by a sample, relative to 1 + |state|
PUSH, SMOOTH_WITHIN = 1e-7, 0.2  # size of a test of smoothness, and the largest relative deviation from the derivative
NO_EFFECT = 1e-12  # response of a break point without effect


class StateMatrices(NamedTuple):
    """x+ = A x + B w, v = C x of n draws; one column of B and one row of C for each break point.

    Args:
        after: The state after one sample, shape (n, states).
        a: Shape (n, states, states).
        b: Shape (n, states, break points).
        c: Shape (n, break points, states).
    """

    after: np.ndarray
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray


Linearisation = Callable[[Arrays, np.ndarray, np.ndarray, int], StateMatrices]
"""(laws' values, draw indices, states of shape (n, states), sample) -> matrices with a leading axis of n draws."""


class Operating(NamedTuple):
    """Matrices of all draws at one operating point, and which draws have one."""

    matrices: StateMatrices
    reached: np.ndarray


def loop_margins(study: Study, *, times: Sequence[float] = (), progress: ProgressCallback | None = None) -> LoopMargins:
    """Compute gain, phase, delay and disk margins, peak sensitivities, crossover and bandwidth of every draw.

    The loop is linearised as it is sampled and simulated: one step of the simulation is differentiated. It is broken at
    the command of each channel (``input``), and at each measurement alone (``output``, ``rate``), while all other loops
    stay closed. DSSC is linearised in sliding, with the values of its functions at the operating point; at an
    equilibrium these are the values at sigma = 0.

    Args:
        study: The study; its own sweep is ignored. Draws have to be independent.
        times: Times of the flight at which the loop is linearised about the state of the draw, with the draw's own
            reference, wind and disturbance [s]. Empty: at the equilibrium without these; a vehicle hovers.
        progress: Called with the linearised draws, and their total.

    Raises:
        ConfigError: the controller switches, so that there is no linearisation; draws are not independent; the sensor
            has its own sampling period; no draw has an equilibrium; or a time is outside the flight.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/motor.toml").override({"draws": 100})
        >>> loop = dj.loop_margins(study)
        >>> 0.5 < loop.summary()["loops"]["input"]["phase"]["median"] < 1.6
        True
    """
    require_independent(study, "a tolerance limit")
    require_smooth(study)
    require_one_rate(study)
    study, began = study.without_sweep(), time.perf_counter()
    study_at = along(study, tuple(times)) if times else {EQUILIBRIUM: equilibrium(study)}
    sample_time, answers = study.config.loop.sample_time, {}
    parts = {name: parts_of(study, operating) for name, operating in study_at.items()}
    common = common_grid(np.concatenate([part.poles.ravel() for own in parts.values() for part in own.values()]))
    for count, (name, own) in enumerate(parts.items(), start=1):
        own_answers = {
            point: answer_of(part, study_at[name].reached, common, sample_time) for point, part in own.items()
        }
        answers[name] = {point: answer for point, answer in own_answers.items() if answer is not None}
        if progress:
            progress(count * study.config.draws, len(parts) * study.config.draws)
    dataset = margins_dataset(study, answers, common / sample_time)
    return LoopMargins(study, dataset, tuple(map(float, times)), time.perf_counter() - began)


def require_one_rate(study: Study) -> None:
    """Require that every sensor reads at every sample.

    Raises:
        ConfigError: one has its own sampling period, so that the loop is periodic and has no frequency response.
    """
    for params in study.template.sensor:
        if getattr(params, "period_samples", 1.0) != 1.0:
            rule = f"must be 1 for a frequency response, got {params.period_samples:g}: the loop is periodic otherwise"
            raise ConfigError(f"{study.source}: sensor.period_samples", rule)


def at_origin(study: Study) -> Study:
    """The study of one channel with the plant's initial state at zero; a vehicle is unchanged."""
    initial = study.table["plant"].get("initial")
    if len(study.loop.channels) > 1 or not isinstance(initial, list):
        return study
    return study.override({"plant.initial": [0.0] * len(initial)})


def linearisation(study: Study, rest: bool) -> Linearisation:
    """The compiled linearisation of a study; without disturbances for a loop at rest.

    A lane is one draw and one direction: one derivative a lane compiles and runs far faster than all in one.
    """
    points = len(break_points(study.loop))

    def one(
        values: dict[str, jax.Array], index: jax.Array, state: jax.Array, direction: jax.Array, k: jax.Array
    ) -> tuple[tuple[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
        loop, params, key = study.loop, study.params(values), draw_key(study.config.seed, index)
        if rest:
            loop, params = undisturbed(loop, params)
        sample = sample_map(loop, params, key, k)
        at = (state, jnp.zeros(points, state.dtype))
        return jax.jvp(sample, at, (direction[:-points], direction[-points:]))

    program = jax.jit(jax.vmap(one, in_axes=(0, 0, 0, 0, None)), compiler_options=plain_options())

    def of(values: Arrays, indices: np.ndarray, states: np.ndarray, k: int) -> StateMatrices:
        (count, order), directions = states.shape, np.eye(states.shape[1] + points)
        size = len(directions)
        parts = []
        for first in range(0, count * size, LANES_TOGETHER):
            lane = np.minimum(np.arange(first, first + LANES_TOGETHER), count * size - 1)
            draw, direction = np.divmod(lane, size)
            own = {name: column[draw] for name, column in values.items()}
            with arithmetic():
                (after, _), slopes = program(own, indices[draw], states[draw], directions[direction], k)
                parts.append([np.asarray(part) for part in (after, *slopes)])
        after, state_slopes, signal_slopes = (np.concatenate(each)[: count * size] for each in zip(*parts, strict=True))
        a = state_slopes.reshape(count, size, order).swapaxes(1, 2)
        c = signal_slopes.reshape(count, size, points).swapaxes(1, 2)
        return StateMatrices(after.reshape(count, size, order)[:, 0], a[..., :order], a[..., order:], c[..., :order])

    return of


def resting_starts(study: Study, values: Arrays, indices: np.ndarray) -> np.ndarray:
    """The state at t = 0 of every draw of the undisturbed loop, shape (n, states)."""

    def one(lane: tuple[dict[str, jax.Array], jax.Array]) -> jax.Array:
        loop, params = undisturbed(study.loop, study.params(lane[0]))
        return start_state(loop, params, draw_key(study.config.seed, lane[1]))

    with arithmetic():
        return np.asarray(jax.jit(jax.vmap(one), compiler_options=plain_options())((values, indices)))


def equilibrium(study: Study) -> Operating:
    """Every draw's matrices at its equilibrium, own_answers by Newton's method from the initial state.

    A state that no signal of the loop depends on, as an integrator whose gain is 0, need not be at rest.

    Raises:
        ConfigError: no draw has an equilibrium, or the loop is not smooth there.
    """
    study = at_origin(study)
    indices, values = np.arange(study.config.draws), drawn(study, slice(0, study.config.draws))
    of = linearisation(study, rest=True)
    states = resting_starts(study, values, indices)
    trial = 0
    while True:
        matrices = of(values, indices, states, 1)
        move = matrices.after - states
        finite = np.all(np.isfinite(matrices.a), axis=(1, 2)) & np.all(np.isfinite(move), axis=1)
        felt = closure(np.any(matrices.c[finite], axis=(0, 1)), np.any(matrices.a[finite], axis=0))
        still = np.max(np.abs(move) * felt / (1.0 + np.abs(states)), axis=1) <= AT_REST
        wrong = finite & ~still
        if not wrong.any() or trial == NEWTON_STEPS_OF_REST:
            break
        trial += 1
        own = np.ix_(wrong, felt, felt)
        slopes = np.eye(int(np.count_nonzero(felt))) - matrices.a[own]
        moves = [np.linalg.lstsq(m, r)[0] for m, r in zip(slopes, move[np.ix_(wrong, felt)], strict=True)]
        states = states.copy()
        states[np.ix_(wrong, felt)] += np.stack(moves)
    if not still.any():
        raise ConfigError(
            study.source, "no draw has an equilibrium at a constant reference; linearise along the flight"
        )
    require_derivative(study, lambda at: of(values, indices, at, 1).after, states, matrices, still, felt)
    return Operating(matrices, still)


def closure(begin: np.ndarray, influences: np.ndarray) -> np.ndarray:
    """The states in ``begin`` and those that influence them, directly or not.

    Args:
        begin: Mask of states, shape (states,).
        influences: Whether the state of each row depends on that of each column, shape (states, states).
    """
    reached = begin
    for _ in range(len(begin)):
        reached = reached | reached @ influences
    return reached


def require_derivative(
    study: Study,
    after: Callable[[np.ndarray], np.ndarray],
    states: np.ndarray,
    matrices: StateMatrices,
    still: np.ndarray,
    felt: np.ndarray,
) -> None:
    """Require that a small push of the equilibrium has the effect that the derivative predicts.

    Args:
        study: The study.
        after: (states of shape (n, states)) -> the states after one sample.
        states: The equilibria, shape (n, states).
        matrices: Their derivatives.
        still: Which draws have an equilibrium, shape (n,).
        felt: The states on which the loop's signals depend, which alone are pushed and compared; shape (states,).

    Raises:
        ConfigError: it has not: the loop switches, or its gain is infinite there.
    """
    push = PUSH * felt * np.random.default_rng(0).choice([-1.0, 1.0], states.shape)
    for side in (push, -push):
        predicted = np.einsum("nij,nj->ni", matrices.a, side)
        actual = after(states + side) - matrices.after
        excess = np.max(np.abs(actual - predicted) * felt, axis=1) / np.max(np.abs(predicted), axis=1, initial=PUSH)
        worst = np.max(excess[still])
        if not worst <= SMOOTH_WITHIN:
            raise ConfigError(
                study.source,
                f"has no linearisation at its equilibrium: the effect of a deviation of {PUSH:g} differs by "
                f"{100.0 * worst:.3g} % from that of the derivative, as where a controller switches or its gain is "
                "infinite there; describing functions (dssc-jax theory) cover such loops",
            )


def along(study: Study, times: tuple[float, ...]) -> dict[str, Operating]:
    """Every draw's matrices at the states of its flight at the given times, by name.

    Raises:
        ConfigError: a time is outside the flight, or they do not ascend.
    """
    samples = tuple(round(t / study.config.loop.sample_time) for t in times)
    if sorted(set(samples)) != list(samples) or samples[0] < 0 or samples[-1] >= study.loop.steps:
        rule = f"must ascend within [0, {study.config.loop.duration:g}) s, got {', '.join(f'{t:g}' for t in times)}"
        raise ConfigError("times", rule)
    indices, values = np.arange(study.config.draws), drawn(study, slice(0, study.config.draws))
    flown = states_before(study, values, indices, samples)
    of, operating = linearisation(study, rest=False), {}
    for place, (t, k) in enumerate(zip(times, samples, strict=True)):
        matrices = of(values, indices, flown[place], k)
        finite = np.all(np.isfinite(flown[place]), axis=1) & np.all(np.isfinite(matrices.a), axis=(1, 2))
        operating[f"t = {t:g} s"] = Operating(matrices, finite)
    return operating


def states_before(study: Study, values: Arrays, indices: np.ndarray, samples: tuple[int, ...]) -> list[np.ndarray]:
    """The states of all draws before the given samples, each of shape (n, states).

    The time loop runs on the host: compiling one of a vehicle takes minutes, and its steps take seconds.
    """

    def start(values: dict[str, jax.Array], index: jax.Array) -> jax.Array:
        return start_state(study.loop, study.params(values), draw_key(study.config.seed, index))

    def advance(values: dict[str, jax.Array], index: jax.Array, state: jax.Array, k: jax.Array) -> jax.Array:
        sample = sample_map(study.loop, study.params(values), draw_key(study.config.seed, index), k)
        return sample(state, jnp.zeros(len(break_points(study.loop)), state.dtype))[0]

    states = []
    with arithmetic():
        at = jax.jit(jax.vmap(start), compiler_options=plain_options())(values, indices)
        program = jax.jit(jax.vmap(advance, in_axes=(0, 0, 0, None)), compiler_options=plain_options())
        for k in range(samples[-1] + 1):
            if k in samples:
                states.append(np.asarray(at))
            at = program(values, indices, at, k)
    return states


def in_loop(matrices: StateMatrices, reached: np.ndarray, point: int) -> np.ndarray:
    """Indices of the states that a break point's input reaches and its output depends on, in any draw."""
    influences = np.any(matrices.a[reached] != 0.0, axis=0)
    forward = closure(np.any(matrices.b[reached, :, point] != 0.0, axis=0), influences.T)
    backward = closure(np.any(matrices.c[reached, point] != 0.0, axis=0), influences)
    return np.flatnonzero(forward & backward)


class Part(NamedTuple):
    """The states of a broken loop of the draws that have an operating point; the loop is closed.

    Args:
        a: Shape (n, states, states).
        b: Shape (n, states).
        c: Shape (n, states).
        poles: Eigenvalues of a, shape (n, states).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    poles: np.ndarray


def parts_of(study: Study, operating: Operating) -> dict[str, Part]:
    """The part of the loop that matters at each break point; one without effect is left out."""
    matrices, reached = operating
    parts = {}
    for point, name in enumerate(break_points(study.loop)):
        kept = in_loop(matrices, reached, point)
        if kept.size:
            a = matrices.a[np.ix_(reached, kept, kept)]
            b, c = matrices.b[reached][:, kept, point], matrices.c[reached][:, point, kept]
            parts[name] = Part(a, b, c, np.linalg.eigvals(a))
    return parts


def answer_of(part: Part, reached: np.ndarray, common: np.ndarray, sample_time: float) -> LoopAnswer | None:
    """Margins and frequency response at one break point; None if the signal there has no effect.

    Args:
        part: The broken loop of the draws that have an operating point.
        reached: Which draws these are, shape (draws,).
        common: Angles of the frequency response, shape (frequencies,).
        sample_time: T_s [s].
    """
    a, b, c, poles = part
    g = np.full((len(reached), common.size), np.nan, complex)
    g[reached] = response_of(a, b, c)(np.broadcast_to(common, (len(a), common.size)))
    if np.nanmax(np.abs(g)) < NO_EFFECT:
        return None
    stable = np.max(np.abs(poles), axis=1) < 1.0
    status = np.full(len(reached), Status.NO_OPERATING_POINT.value)
    status[reached] = np.where(stable, Status.STABLE.value, Status.UNSTABLE.value)
    columns = {field: np.full(len(reached), np.nan) for field in ClassicalMargins._fields}
    if stable.any():
        opened = np.linalg.eigvals(a - b[:, :, None] * c[:, None, :])
        own = own_grid(common, np.concatenate([poles, opened], axis=1)[stable])
        margins = classical_margins(response_of(a[stable], b[stable], c[stable]), own, sample_time)
        for field, values in margins._asdict().items():
            columns[field][status == Status.STABLE] = values
    return LoopAnswer(columns, status, g)
