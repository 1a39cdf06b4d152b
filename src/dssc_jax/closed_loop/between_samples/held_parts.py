"""The parts of a loop that move between two samples, and the steps of its unmodelled dynamics.

A step replaces the output of unmodelled dynamics by the straight line with the same mean and first moment. So a lag
much faster than the sample acts as if there were none.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax

from dssc_jax.core.contracts import Moments, Mover, Plant, Unmodelled, Variation
from dssc_jax.core.integrators import Integrator
from dssc_jax.core.numerics import as_arrays
from dssc_jax.core.signals import Measurements, Params, PlantInput, Scalar, Signals, State

UNROLLED = 2  # most substeps that are traced one by one

DriveAt = Callable[[State, Signals, Scalar], PlantInput[Signals]]
"""``(plant's state, commands that reach it, t) -> its input``, with disturbances and wind, at an integrator's stage."""

States = tuple[State, ...]
Advance = Callable[[DriveAt, State, States, Signals, Scalar], tuple[State, States]]
"""``(drive, plant's state, states of the unmodelled dynamics, commands, t)`` -> both states after the sample."""

Substep = Callable[[Scalar, tuple[State, States]], tuple[State, States]]
"""``(index of the substep, both states)`` -> both states after the substep."""


class HeldParts(NamedTuple):
    """The parts of a loop that move between the samples, and how time is divided.

    Args:
        plant: The plant, with one command and one measurement for each channel.
        unmodelled: Unmodelled dynamics of each channel.
        variations: How the disturbance of each channel, then of each named input, varies within a sample.
        integrator: Method of integration of the nonlinear parts.
        sample_time: T_s [s].
        substeps: Number of steps in a sample for parts without an exact solution.
    """

    plant: Plant[Measurements, Signals]
    unmodelled: tuple[Unmodelled, ...]
    variations: tuple[Variation, ...]
    integrator: Integrator
    sample_time: float
    substeps: int


def term_count(model: Unmodelled) -> int:
    """Number of terms, in time over a step, of the signal behind unmodelled dynamics: 1 if it is constant, else 2.

    The signal enters the linear part of the unmodelled dynamics, or the plant if they have no linear part.
    """
    return 1 if model.held or (model.linear is not None and model.advance is None) else 2


def polynomial_terms(model: Unmodelled, line: Moments) -> tuple[Scalar, ...]:
    """The terms that :func:`term_count` counts: value at the start of the step, and rise unless it is constant."""
    if term_count(model) == 1:
        return (line.mean,)
    return line.mean - 0.5 * line.rise, line.rise


def movers_of(parts: HeldParts, unmodelled: States, h: float) -> list[Mover]:
    """The :func:`mover` of each channel, for steps of length h [s]."""
    return [mover(model, params, h) for model, params in zip(parts.unmodelled, unmodelled, strict=True)]


def mover(model: Unmodelled, params: Params, h: float) -> Mover:
    """The function that advances unmodelled dynamics, apart from their linear part, over a step of length h [s].

    It returns the state and the mean and rise of the output, which is the input of the linear part. Where the model
    does not state these moments, Simpson's rule estimates them.
    """
    if model.advance is not None:
        return model.advance(params, h)

    def move(state: State, command: Scalar) -> tuple[State, Moments]:
        if model.linear is not None:
            return state, Moments(command, 0.0)
        next_state = model.step(params, state, command, h)
        if model.held:
            return next_state, Moments(model.output(params, state, command), 0.0)
        if model.moments is not None:
            return next_state, model.moments(params, state, command, h)
        middle = model.step(params, state, command, 0.5 * h)
        end = model.step(params, middle, command, 0.5 * h)
        start, half, final = (model.output(params, z, command) for z in (state, middle, end))
        return next_state, Moments((start + 4.0 * half + final) / 6.0, final - start)

    return move


def apply_movers(movers: Sequence[Mover], states: States, commands: Signals) -> tuple[States, tuple[Moments, ...]]:
    """The next state of each channel's unmodelled dynamics, and the mean and rise of their output over the step."""
    next_states = []
    lines = []
    for move, state, command in zip(movers, states, commands, strict=True):
        state, line = move(state, command)
        next_states.append(state)
        lines.append(line)
    return tuple(next_states), tuple(lines)


def repeat_substeps(substep: Substep, begin: tuple[State, States], count: int) -> tuple[State, States]:
    """The states after ``count`` substeps; more than :data:`UNROLLED` are traced once, to keep compilation short."""
    if count > UNROLLED:
        return jax.lax.fori_loop(0, count, lambda i, carry: as_arrays(substep(i, carry)), as_arrays(begin))
    for index in range(count):
        begin = substep(index, begin)
    return begin
