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

UNROLLED = 2  # most substeps that are traced one by one; more are a loop

DriveAt = Callable[[State, Signals, Scalar], PlantInput[Signals]]
"""``(plant's state, commands that reach it, t) -> its input``, with disturbances and wind, at an integrator's stage."""

States = tuple[State, ...]
"""State, or parameters, of the unmodelled dynamics of each channel."""

Advance = Callable[[DriveAt, State, States, Signals, Scalar], tuple[State, States]]
"""``(drive_at, plant, states, commands, t)`` -> states of plant and unmodelled dynamics after the sample.

The sample begins at the time t [s], at which the plant has the state ``plant``, and the unmodelled dynamics have
``states``. The command of each channel is held over it. ``drive_at`` returns the plant's input.
"""

Substep = Callable[[Scalar, tuple[State, States]], tuple[State, States]]
"""``(index of the substep, both states)`` -> both states after the substep."""


class HeldParts(NamedTuple):
    """The parts of a loop that move between the samples, and how time is divided.

    Args:
        plant: The plant, with one command and one measurement for each channel.
        unmodelled: Unmodelled dynamics of each channel.
        variations: How the disturbance of each channel, then of each named input, varies within a sample.
        integrator: Method of integration of the nonlinear parts.
        sample_time: Sample time T_s [s].
        substeps: Number of steps in a sample for parts without an exact solution.
    """

    plant: Plant[Measurements, Signals]
    unmodelled: tuple[Unmodelled, ...]
    variations: tuple[Variation, ...]
    integrator: Integrator
    sample_time: float
    substeps: int


def term_count(model: Unmodelled) -> int:
    """Number of terms, in time over a step, of the signal of :func:`make_mover`: 1 for a constant, 2 for a line.

    The signal enters the linear part of the unmodelled dynamics, or the plant if they have no linear part.
    """
    gets_held_command = model.linear is not None and model.advance is None  # nothing stands before the linear part
    return 1 if model.held or gets_held_command else 2


def polynomial_terms(model: Unmodelled, line: Moments) -> tuple[Scalar, ...]:
    """The terms of the signal that :func:`make_mover` gives, as a polynomial in time over a step.

    Args:
        model: The unmodelled dynamics.
        line: Mean and rise of the signal over the step.

    Returns:
        The value at the start of the step and the rise; for a signal that is constant, its value alone.
    """
    if term_count(model) == 1:
        return (line.mean,)
    return line.mean - 0.5 * line.rise, line.rise


def make_movers(parts: HeldParts, unmodelled: States, h: float) -> list[Mover]:
    """The functions of :func:`make_mover` for the unmodelled dynamics of each channel.

    Args:
        parts: The models and the clock.
        unmodelled: Parameters of the unmodelled dynamics of each channel.
        h: Length of a step [s].
    """
    return [make_mover(model, params, h) for model, params in zip(parts.unmodelled, unmodelled, strict=True)]


def make_mover(model: Unmodelled, params: Params, h: float) -> Mover:
    """Return the function that advances the part of unmodelled dynamics that is not linear, over one step.

    The returned function takes the state and the command. Its results are the next state, and mean and rise over the
    step of the signal that enters the linear part, or the plant if there is no linear part. If the model does not state
    mean and rise, they follow from its output at three times, by Simpson's rule.

    Args:
        model: The unmodelled dynamics.
        params: Parameters of the dynamics.
        h: Length of the step [s].
    """
    if model.advance is not None:
        return model.advance(params, h)

    def move(state: State, command: Scalar) -> tuple[State, Moments]:
        """The state after the step, and mean and rise over the step of the signal that leaves the nonlinear part.

        Args:
            state: State of the dynamics before the step.
            command: The command, held over the step.
        """
        if model.linear is not None:  # the held command enters the linear part
            return state, Moments(command, rise=0.0)
        next_state = model.step(params, state, command, h)
        if model.held:
            return next_state, Moments(model.output(params, state, command), rise=0.0)
        if model.moments is not None:
            return next_state, model.moments(params, state, command, h)
        middle_state = model.step(params, state, command, 0.5 * h)
        end_state = model.step(params, middle_state, command, 0.5 * h)
        start = model.output(params, state, command)
        middle = model.output(params, middle_state, command)
        end = model.output(params, end_state, command)
        # the mean by Simpson's rule
        return next_state, Moments(mean=(start + 4.0 * middle + end) / 6.0, rise=end - start)

    return move


def apply_movers(movers: Sequence[Mover], states: States, commands: Signals) -> tuple[States, tuple[Moments, ...]]:
    """The next state of each channel's unmodelled dynamics, and mean and rise of their output over the step.

    Args:
        movers: Result of :func:`make_movers`.
        states: States of the unmodelled dynamics before the step.
        commands: The command of each channel, held over the step.
    """
    next_states = []
    lines = []
    for move, state, command in zip(movers, states, commands, strict=True):
        state, line = move(state, command)
        next_states.append(state)
        lines.append(line)
    return tuple(next_states), tuple(lines)


def repeat_substeps(substep: Substep, begin: tuple[State, States], count: int) -> tuple[State, States]:
    """The states of plant and unmodelled dynamics after ``count`` substeps.

    More than :data:`UNROLLED` substeps become a loop, whose body is traced once, to keep compilation short.

    Args:
        substep: Takes the index of a substep and both states; returns both states after the substep.
        begin: Both states before the first substep.
        count: Number of substeps.
    """
    if count > UNROLLED:
        return jax.lax.fori_loop(0, count, lambda i, carry: as_arrays(substep(i, carry)), as_arrays(begin))
    for index in range(count):
        begin = substep(index, begin)
    return begin
