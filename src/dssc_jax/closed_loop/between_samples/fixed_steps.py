"""Fixed steps between two samples: by the plant's own method or the loop's, with software on board between them."""

from collections.abc import Callable
from typing import NamedTuple

import jax

from dssc_jax.closed_loop.between_samples.held_parts import (
    Advance,
    DriveAt,
    HeldParts,
    States,
    Substep,
    apply_movers,
    movers_of,
    polynomial_terms,
    repeat_substeps,
    term_count,
)
from dssc_jax.core.contracts import Moments
from dssc_jax.core.integrators import INTEGRATORS, Integrator
from dssc_jax.core.onboard import Onboard, ticks_in_sample
from dssc_jax.core.sampled_linear import Forcing, HeldSystem, LinearSystem, hold, scale_column
from dssc_jax.core.signals import Params, PlantInput, Scalar, Signals, State

Observer = Callable[[State, PlantInput[Signals], State], None]
"""``(plant's state before a tick of software on board, input of the sample, state after it)``, called while tracing."""


def advance_by_steps(parts: HeldParts, params: Params, unmodelled: States, observe: Observer | None = None) -> Advance:
    """The function that advances a plant over a sample by its own steps or the loop's fixed-step method.

    Args:
        parts: The models and the clock.
        params: The plant's parameters.
        unmodelled: Parameters of the unmodelled dynamics of each channel.
        observe: Called at each tick of software on board; None: no call.
    """
    software = parts.plant.software
    period = None if software is None else software.period(params)
    if software is not None and period is not None:
        return advance_with_software(parts, params, unmodelled, software, period, observe)
    substep_for = fixed_substeps(parts, params, unmodelled)

    def advance(drive_at: DriveAt, plant: State, states: States, commands: Signals, t: Scalar) -> tuple[State, States]:
        return repeat_substeps(substep_for(drive_at, commands, t), (plant, states), parts.substeps)

    return advance


def advance_with_software(
    parts: HeldParts, params: Params, unmodelled: States, software: Onboard, period: float, observe: Observer | None
) -> Advance:
    """The function that advances a plant over a sample, with ticks of its software on board between the substeps.

    Args:
        parts: The models and the clock.
        params: The plant's parameters.
        unmodelled: Parameters of the unmodelled dynamics of each channel.
        software: The software, which receives the plant's input once a sample.
        period: Time between two of its ticks [s].
        observe: Called at each tick, which is then traced one by one; None: all ticks are traced once.
    """
    substep_for = fixed_substeps(parts, params, unmodelled)
    ticks = ticks_in_sample(period, parts.sample_time, parts.substeps)
    steps_per_tick = parts.substeps // ticks

    def advance(drive_at: DriveAt, plant: State, states: States, commands: Signals, t: Scalar) -> tuple[State, States]:
        substep = substep_for(drive_at, commands, t)
        outputs = []
        for model, p, state, command in zip(parts.unmodelled, unmodelled, states, commands, strict=True):
            outputs.append(model.output(p, state, command))
        drive = drive_at(plant, tuple(outputs), t)

        def between_ticks(tick: Scalar, at: tuple[State, States]) -> tuple[State, States]:
            previous_plant, states = at
            ticked = software.tick(params, previous_plant, period)
            if observe is not None:
                observe(previous_plant, drive, ticked)
            first = tick * steps_per_tick
            plant, states = repeat_substeps(lambda i, at: substep(first + i, at), (ticked, states), steps_per_tick)
            # the integrator adds 0 to the software's state, which would turn -0 into 0
            return software.holding(plant, software.held(ticked)), states

        carry = (software.sample(params, plant, drive, parts.sample_time), states)
        if observe is None:
            return repeat_substeps(between_ticks, carry, ticks)
        for tick in range(ticks):
            carry = between_ticks(tick, carry)
        return carry

    return advance


def fixed_substeps(
    parts: HeldParts, params: Params, unmodelled: States
) -> Callable[[DriveAt, Signals, Scalar], Substep]:
    """The substep of a plant without an exact solution: ``(drive, commands, time of the sample) -> substep``.

    Linear unmodelled dynamics are advanced exactly; the mean of their output and its rise reach the plant.

    Args:
        parts: The models and the clock.
        params: The plant's parameters.
        unmodelled: Parameters of the unmodelled dynamics of each channel.
    """
    h = parts.sample_time / parts.substeps
    integrate = INTEGRATORS[parts.integrator]
    systems: list[AveragedSystem | None] = []
    for model, p in zip(parts.unmodelled, unmodelled, strict=True):
        systems.append(None if model.linear is None else averaged_system(model.linear(p), term_count(model), h))
    movers = movers_of(parts, unmodelled, h)

    def substep_for(drive_at: DriveAt, commands: Signals, t: Scalar) -> Substep:
        @jax.jit  # traced once for all stages of the integrator
        def rate(plant: State, time: Scalar, actuation: Signals) -> State:
            return parts.plant.derivative(params, plant, drive_at(plant, actuation, time), time)

        def substep(index: Scalar, carry: tuple[State, States]) -> tuple[State, States]:
            plant, states = carry
            states, input_lines = apply_movers(movers, states, commands)
            next_states = list(states)
            lines = list(input_lines)
            for i, (model, system) in enumerate(zip(parts.unmodelled, systems, strict=True)):
                if system is not None:
                    next_states[i], lines[i] = system.step(states[i], polynomial_terms(model, lines[i]))

            def derivative(plant: State, half_steps: int) -> State:
                fraction = 0.5 * half_steps
                share = 0.0 if parts.integrator == Integrator.EULER else fraction - 0.5
                actuation = tuple(line.mean + share * line.rise for line in lines)
                return rate(plant, t + (index + fraction) * h, actuation)

            if parts.plant.advance is not None:
                start = t + index * h
                drive = drive_at(plant, tuple(line.mean for line in lines), start)
                return parts.plant.advance(params, plant, drive, start, h), tuple(next_states)
            plant = integrate(derivative, plant, h, parts.plant.velocities)
            return parts.plant.project(params, plant), tuple(next_states)

        return substep

    return substep_for


class AveragedSystem(NamedTuple):
    """A linear system with the integrals of its output over a step; see :func:`averaged_system`.

    Args:
        solution: Its exact solution over the step, whose last two states are the mean q and the double integral r.
    """

    solution: HeldSystem

    def step(self, state: State, terms: tuple[Scalar, ...]) -> tuple[State, Moments]:
        """The state after a step, and the mean and rise of the output over it.

        Args:
            state: The state before the step.
            terms: Terms of the input, a polynomial in time over the step.
        """
        leaves, structure = jax.tree.flatten(state)
        *next_leaves, mean, double = self.solution.full.apply((*leaves, 0.0, 0.0), (terms,))
        return structure.unflatten(next_leaves), Moments(mean, 6.0 * mean - 12.0 * double)


def averaged_system(system: LinearSystem, terms: int, h: float) -> AveragedSystem:
    """A linear system with two further states: q' = y/h, after a step the mean of its output y, and r' = q/h.

    Args:
        system: The linear system.
        terms: Number of terms of its input, a polynomial in time over a step.
        h: Length of the step [s].
    """
    rate = 1.0 / h
    rows = [(*row, 0.0, 0.0) for row in system.a]
    rows.append((*scale_column(system.c, rate), 0.0, 0.0))
    rows.append((*(0.0,) * len(system.a), rate, 0.0))
    column = (*system.b, *scale_column((system.d,), rate), 0.0)
    return AveragedSystem(hold(tuple(rows), (Forcing(column, terms),), h))
