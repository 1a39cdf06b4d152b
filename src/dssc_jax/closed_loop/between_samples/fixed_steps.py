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
    make_movers,
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
"""``(plant's state before a tick of software on board, input of the sample, state after the tick)``.

It is called while the loop is traced, to record what the software reads and computes.
"""

SubstepAt = Callable[[DriveAt, Signals, Scalar], Substep]
"""``(drive, commands, time of the sample [s]) -> function of one substep``."""


def advance_by_steps(parts: HeldParts, params: Params, unmodelled: States, observe: Observer | None = None) -> Advance:
    """Return the function that advances a plant over one sample in fixed steps.

    A plant with its own solver makes the steps itself; any other plant is integrated by the loop's method. Software on
    board, if the plant has any, runs between the steps.

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
        """The states of plant and unmodelled dynamics after a sample; see :data:`Advance`."""
        return repeat_substeps(substep_for(drive_at, commands, t), (plant, states), parts.substeps)

    return advance


def advance_with_software(
    parts: HeldParts, params: Params, unmodelled: States, software: Onboard, period: float, observe: Observer | None
) -> Advance:
    """Return the function that advances a plant over one sample, with ticks of its software on board between the steps.

    At the start of the sample the software receives the plant's input. After each tick the software's results are held
    over an equal share of the substeps.

    Args:
        parts: The models and the clock.
        params: The plant's parameters.
        unmodelled: Parameters of the unmodelled dynamics of each channel.
        software: The software on board.
        period: Time between two ticks of the software [s].
        observe: Called at each tick, which is then traced separately. None: no call, and one trace serves all ticks.
    """
    substep_for = fixed_substeps(parts, params, unmodelled)
    ticks = ticks_in_sample(period, parts.sample_time, parts.substeps)
    steps_per_tick = parts.substeps // ticks

    def advance(drive_at: DriveAt, plant: State, states: States, commands: Signals, t: Scalar) -> tuple[State, States]:
        """The states of plant and unmodelled dynamics after a sample with its ticks; see :data:`Advance`."""
        substep = substep_for(drive_at, commands, t)
        outputs = []
        for model, p, state, command in zip(parts.unmodelled, unmodelled, states, commands, strict=True):
            outputs.append(model.output(p, state, command))
        drive = drive_at(plant, tuple(outputs), t)

        def tick_and_move(tick: Scalar, at: tuple[State, States]) -> tuple[State, States]:
            """Both states just before the next tick: the software runs, then the plant moves up to that tick."""
            previous_plant, states = at
            ticked = software.tick(params, previous_plant, period)
            if observe is not None:
                observe(previous_plant, drive, ticked)
            first_substep = tick * steps_per_tick
            plant, states = repeat_substeps(
                lambda i, at: substep(first_substep + i, at), (ticked, states), steps_per_tick
            )
            # the integrator adds 0 to the software's state, which would turn -0 into 0
            return software.holding(plant, software.held(ticked)), states

        carry = (software.sample(params, plant, drive, parts.sample_time), states)
        if observe is None:
            return repeat_substeps(tick_and_move, carry, ticks)
        for tick in range(ticks):
            carry = tick_and_move(tick, carry)
        return carry

    return advance


def fixed_substeps(parts: HeldParts, params: Params, unmodelled: States) -> SubstepAt:
    """Return a function that makes, for each sample, the function of one substep of a plant without exact solution.

    In a substep, linear unmodelled dynamics move by their exact solution. The plant receives their output as the
    straight line with the same mean and rise (:class:`~dssc_jax.core.sampled_linear.Moments`).

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
    movers = make_movers(parts, unmodelled, h)

    def substep_for(drive_at: DriveAt, commands: Signals, t: Scalar) -> Substep:
        """The function of one substep in one sample.

        Args:
            drive_at: Returns the plant's input for a state, the commands that reach the plant, and a time.
            commands: The command of each channel, held over the sample.
            t: Time at which the sample begins [s].
        """

        @jax.jit  # traced once for all stages of the integrator
        def rate(plant: State, time: Scalar, actuation: Signals) -> State:
            """The derivative of the plant's state.

            Args:
                plant: State of the plant.
                time: Time [s].
                actuation: The command of each channel that reaches the plant.
            """
            return parts.plant.derivative(params, plant, drive_at(plant, actuation, time), time)

        def substep(index: Scalar, carry: tuple[State, States]) -> tuple[State, States]:
            """The states of plant and unmodelled dynamics after the substep with this index.

            Args:
                index: Index of the substep in the sample.
                carry: Both states before the substep.
            """
            plant, states = carry
            states, input_lines = apply_movers(movers, states, commands)
            next_states = list(states)
            lines = list(input_lines)
            for i, (model, system) in enumerate(zip(parts.unmodelled, systems, strict=True)):
                if system is not None:
                    next_states[i], lines[i] = system.step(states[i], polynomial_terms(model, lines[i]))

            def derivative(plant: State, half_steps: int) -> State:
                """The derivative of the plant's state at a stage of the integrator.

                Euler's method has one stage, and gets the mean of each line. Any other method gets the line's value at
                the stage.

                Args:
                    plant: State of the plant at the stage.
                    half_steps: Time from the start of the substep to the stage, in half substeps: 0, 1 or 2.
                """
                fraction = 0.5 * half_steps
                share = 0.0 if parts.integrator == Integrator.EULER else fraction - 0.5  # of the rise
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
    """The exact step of a linear system, which also gives mean and rise of its output over the step.

    Args:
        solution: The exact solution of the system with two further states: at the end of a step from 0, q is the mean
            of the output, and r is the mean of q over the step. See :func:`averaged_system`.
    """

    solution: HeldSystem

    def step(self, state: State, terms: tuple[Scalar, ...]) -> tuple[State, Moments]:
        """The state after a step, and mean and rise of the output over the step.

        The output counts as the straight line with the same q and r. A line with mean q and rise b has r = q/2 - b/12,
        hence the rise b = 6 q - 12 r.

        Args:
            state: The state before the step.
            terms: Terms of the input, a polynomial in time over the step.
        """
        leaves, structure = jax.tree.flatten(state)
        *next_leaves, q, r = self.solution.full.apply((*leaves, 0.0, 0.0), (terms,))  # q and r start at 0
        return structure.unflatten(next_leaves), Moments(mean=q, rise=6.0 * q - 12.0 * r)


def averaged_system(system: LinearSystem, terms: int, h: float) -> AveragedSystem:
    """Add two states to a linear system that integrate its output y over a step: q' = y/h and r' = q/h.

    Args:
        system: The linear system x' = A x + b u, y = c x + d u.
        terms: Number of terms of its input u, a polynomial in time over a step.
        h: Length of the step [s].
    """
    rate = 1.0 / h
    rows = [(*row, 0.0, 0.0) for row in system.a]  # the columns of q and r are the last two
    rows.append((*scale_column(system.c, rate), 0.0, 0.0))  # q' = (c x + d u)/h
    rows.append((*(0.0,) * len(system.a), rate, 0.0))  # r' = q/h
    column = (*system.b, *scale_column((system.d,), rate), 0.0)
    return AveragedSystem(hold(tuple(rows), (Forcing(column, terms),), h))
