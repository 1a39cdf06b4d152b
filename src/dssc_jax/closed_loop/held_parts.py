"""What of a loop moves between two samples, and how its unmodelled dynamics advance over a step.

The output of unmodelled dynamics over a step counts as the straight line with its mean and its first moment. Thus a lag
that is much faster than the sample acts as no lag does.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax

from dssc_jax.core.contracts import Moments, Mover, Plant, Unmodelled, Variation
from dssc_jax.core.integrators import Integrator
from dssc_jax.core.numerics import as_arrays
from dssc_jax.core.signals import Measurements, Params, PlantInput, Scalar, Signals, State

UNROLLED = 2  # substeps at most that are traced one by one

DriveAt = Callable[[State, Signals, Scalar], PlantInput[Signals]]
"""``(plant's state, commands that reach it, t) -> input`` at a stage of the integrator: adds disturbances and wind."""

States = tuple[State, ...]
Advance = Callable[[DriveAt, State, States, Signals, Scalar], tuple[State, States]]
"""``(drive, plant's state, states of the unmodelled dynamics, commands, t)`` -> both states after the sample."""

Substep = Callable[[Scalar, tuple[State, States]], tuple[State, States]]
"""``(index of the substep, both states)`` -> both states after the substep."""


class HeldParts(NamedTuple):
    """The parts of a loop that move between the samples, and how time is divided.

    Args:
        plant: The plant, with tuples as signals.
        unmodelled: Unmodelled dynamics of each channel.
        variations: What the disturbance of each channel, then of each named input, varies with within a sample.
        integrator: Method for what is not linear.
        sample_time: T_s [s].
        substeps: Steps within a sample for what is not held exactly.
    """

    plant: Plant[Measurements, Signals]
    unmodelled: tuple[Unmodelled, ...]
    variations: tuple[Variation, ...]
    integrator: Integrator
    sample_time: float
    substeps: int


def input_terms(model: Unmodelled) -> int:
    """Terms of what enters the linear part of unmodelled dynamics, or the plant: 1 where it is constant, else 2."""
    return 1 if model.held or (model.linear is not None and model.advance is None) else 2


def terms_of(model: Unmodelled, line: Moments) -> tuple[Scalar, ...]:
    """Terms of what enters the linear part of unmodelled dynamics, or the plant, as a polynomial over a step."""
    return (line.mean,) if input_terms(model) == 1 else (line.mean - 0.5 * line.rise, line.rise)


def movers_of(parts: HeldParts, unmodelled: States, h: float) -> list[Mover]:
    """The functions that advance each channel's unmodelled dynamics over a step, but for their linear part."""
    return [mover(model, params, h) for model, params in zip(parts.unmodelled, unmodelled, strict=True)]


def mover(model: Unmodelled, params: Params, h: float) -> Mover:
    """The function that advances unmodelled dynamics over a step, but for their linear part, and gives its input.

    If they do not give moments, those of their output follow by Simpson's rule.
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
    """Apply the movers of all channels: their next states, and the moments of their outputs."""
    next_states = []
    lines = []
    for move, state, command in zip(movers, states, commands, strict=True):
        state, line = move(state, command)
        next_states.append(state)
        lines.append(line)
    return tuple(next_states), tuple(lines)


def repeat_substeps(substep: Substep, begin: tuple[State, States], count: int) -> tuple[State, States]:
    """The states after ``count`` substeps; many are traced once, to keep compilation short."""
    if count > UNROLLED:
        return jax.lax.fori_loop(0, count, lambda i, carry: as_arrays(substep(i, carry)), as_arrays(begin))
    for index in range(count):
        begin = substep(index, begin)
    return begin
