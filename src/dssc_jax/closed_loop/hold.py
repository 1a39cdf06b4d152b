"""Plant and unmodelled dynamics between two samples, with the commands held (zero-order hold).

What is linear is advanced by its exact solution, whose matrices are computed once for a draw: the plant where it
declares its linear part, and linear unmodelled dynamics. Disturbances that vary within the sample, and the nonlinear
remainder of a plant, are added by an exponential Runge-Kutta method of order 4. A plant without a linear part is
integrated by the loop's fixed-step method; the output of the unmodelled dynamics then enters as the straight line with
its mean and its first moment over the step. Thus a lag that is much faster than the sample acts as no lag does.

Reference:
    S. Krogstad, J. Comput. Phys. 203 (2005) 72-88: the method ETDRK4-B.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax

from dssc_jax.closed_loop.averaged import Averaged, average_output
from dssc_jax.core.adapters import quiet_inputs
from dssc_jax.core.contracts import LinearDynamics, Moments, Mover, Plant, Unmodelled, Variation
from dssc_jax.core.integrators import INTEGRATORS, ORDERS, Integrator
from dssc_jax.core.numerics import as_arrays, dot, is_zero
from dssc_jax.core.onboard import Onboard, ticks_in_sample
from dssc_jax.core.sampled_linear import Forcing, HeldSystem, LinearSystem, Rows, hold, scale_column
from dssc_jax.core.signals import Measurements, Params, PlantInput, Scalar, Signals, State

UNROLLED = 2  # substeps at most that are traced one by one
VARYING = 3  # terms of an input that varies within a step: it is interpolated at start, middle and end

DriveAt = Callable[[State, Signals, Scalar], PlantInput[Signals]]
"""``(plant's state, commands that reach it, t) -> input`` at a stage of the integrator: adds disturbances and wind."""

States = tuple[State, ...]
Advance = Callable[[DriveAt, State, States, Signals, Scalar], tuple[State, States]]
"""``(drive, plant's state, states of the unmodelled dynamics, commands, t)`` -> both states after the sample."""


Observer = Callable[[State, PlantInput[Signals], State], None]
"""``(plant's state before a tick of software on board, input of the sample, state after it)``, while tracing."""


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


def is_exact(parts: HeldParts) -> bool:
    """Whether everything between the samples is held exactly, so that the number of substeps does not matter."""
    if any(variation != Variation.HELD for variation in parts.variations):
        return False
    if parts.plant.advance is not None:  # whatever error its steps have is the plant's own
        return all(model.held and model.linear is None for model in parts.unmodelled)
    linear = parts.plant.linear is not None and parts.plant.remainder is None
    return linear and all(input_terms(model) == 1 for model in parts.unmodelled)


def order_between_samples(parts: HeldParts) -> int:
    """Order of the error of what is not held exactly, in the length of a substep."""
    integrator = Integrator.EULER if parts.plant.advance is not None else parts.integrator  # it holds its input
    return min([ORDERS[integrator], *(model.order for model in parts.unmodelled if model.order is not None)])


def input_terms(model: Unmodelled) -> int:
    """Terms of what enters the linear part of unmodelled dynamics, or the plant: 1 where it is constant, else 2."""
    return 1 if model.held or (model.linear is not None and model.advance is None) else 2


def between_samples(parts: HeldParts, plant: Params, unmodelled: tuple[Params, ...]) -> Advance:
    """The function that advances plant and unmodelled dynamics of one draw by a sample.

    Call it before the time loop: what it computes from the parameters alone is then computed once for a draw.

    Args:
        parts: The models and the clock.
        plant: The plant's parameters.
        unmodelled: Parameters of the unmodelled dynamics of each channel.
    """
    if parts.plant.linear is not None:
        return advance_exactly(parts, parts.plant.linear(plant), plant, unmodelled)
    return advance_by_steps(parts, plant, unmodelled)


def repeat_substeps(
    substep: Callable[[Scalar, tuple[State, States]], tuple[State, States]], begin: tuple[State, States], count: int
) -> tuple[State, States]:
    """The states after ``count`` substeps; many are traced once, to keep compilation short."""
    if count > UNROLLED:
        return jax.lax.fori_loop(0, count, lambda i, carry: as_arrays(substep(i, carry)), as_arrays(begin))
    for index in range(count):
        begin = substep(index, begin)
    return begin


class Assembly(NamedTuple):
    """The linear plant with its linear unmodelled dynamics as one system.

    Args:
        a: Its matrix, shape (n, n).
        inputs: Input of each channel's command, in the order of the channels, then of each disturbance.
        offsets: Place of the state of each channel's unmodelled dynamics; None where they are not linear.
        systems: Linear unmodelled dynamics of each channel.
    """

    a: Rows
    inputs: tuple[Forcing, ...]
    offsets: tuple[int | None, ...]
    systems: tuple[LinearSystem | None, ...]


def assemble(parts: HeldParts, dynamics: LinearDynamics, unmodelled: States) -> Assembly:
    """The plant's linear part in series with the linear unmodelled dynamics of each channel."""
    order = len(dynamics.a)
    systems: list[LinearSystem | None] = []
    offsets: list[int | None] = []
    size = order
    for model, params in zip(parts.unmodelled, unmodelled, strict=True):
        system = None if model.linear is None else model.linear(params)
        systems.append(system)
        offsets.append(None if system is None else size)
        size += 0 if system is None else len(system.a)
    matrix: list[list[Scalar]] = [[0.0] * size for _ in range(size)]
    for row, entries in enumerate(dynamics.a):
        matrix[row][:order] = entries
    inputs = []
    for column, system, offset, model in zip(dynamics.command, systems, offsets, parts.unmodelled, strict=True):
        reaching = [*column, *(0.0,) * (size - order)]
        if system is None or offset is None:
            inputs.append(Forcing(tuple(reaching), input_terms(model)))
            continue
        for state, weight in enumerate(system.c):
            for row, entry in enumerate(scale_column(column, weight)):
                matrix[row][offset + state] = entry
        for row, entries in enumerate(system.a):
            matrix[offset + row][offset : offset + len(system.a)] = entries
        reaching[:order] = scale_column(column, system.d)
        reaching[offset : offset + len(system.a)] = system.b
        inputs.append(Forcing(tuple(reaching), input_terms(model)))
    for column, variation in zip((*dynamics.disturbance, *dynamics.inputs), parts.variations, strict=True):
        terms = 1 if variation == Variation.HELD else VARYING
        inputs.append(Forcing((*column, *(0.0,) * (size - order)), terms))
    return Assembly(tuple(map(tuple, matrix)), tuple(inputs), tuple(offsets), tuple(systems))


def remainder_rows(plant: Plant[Measurements, Signals], params: Params, channels: int) -> tuple[int, ...]:
    """Rows of the state to which a plant's nonlinear remainder adds something."""
    if plant.remainder is None:
        return ()
    remainder = plant.remainder
    zeros = (0.0,) * channels
    is_zero_entry: list[bool] = []

    def record_zeros(state: State) -> State:
        slope = remainder(params, state, PlantInput(zeros, zeros, None, quiet_inputs(plant, params)), 0.0)
        is_zero_entry.extend(is_zero(entry) for entry in jax.tree.leaves(slope))
        return slope

    jax.eval_shape(record_zeros, as_arrays(plant.init(params)))
    return tuple(row for row, is_zero_row in enumerate(is_zero_entry) if not is_zero_row)


def gather_state(assembly: Assembly, plant: State, states: States) -> list[Scalar]:
    """The state of the linear system: the leaves of the plant's state, then those of linear unmodelled dynamics."""
    x = jax.tree.leaves(plant)
    for offset, state in zip(assembly.offsets, states, strict=True):
        if offset is not None:
            x.extend(jax.tree.leaves(state))
    return x


def scatter_state(assembly: Assembly, x: Sequence[Scalar], plant: State, states: States) -> tuple[State, States]:
    """The inverse of :func:`gather_state`; states of other unmodelled dynamics are those of ``states``."""
    leaves, structure = jax.tree.flatten(plant)
    scattered = []
    for offset, state in zip(assembly.offsets, states, strict=True):
        if offset is not None:
            state_leaves, kind = jax.tree.flatten(state)
            state = kind.unflatten(x[offset : offset + len(state_leaves)])
        scattered.append(state)
    return structure.unflatten(x[: len(leaves)]), tuple(scattered)


def advance_exactly(parts: HeldParts, dynamics: LinearDynamics, params: Params, unmodelled: States) -> Advance:
    """Advance a plant with a linear part: exactly what is linear, by ETDRK4-B what else varies within the sample."""
    assembly = assemble(parts, dynamics, unmodelled)
    rows = remainder_rows(parts.plant, params, len(parts.unmodelled))
    forcings = list(assembly.inputs)
    for row in rows:
        column = tuple(1.0 if i == row else 0.0 for i in range(len(assembly.a)))
        forcings.append(Forcing(column, VARYING))
    is_constant = all(forcing.terms == 1 for forcing in forcings)
    count = 1 if is_constant else parts.substeps
    h = parts.sample_time / count
    held_system = hold(assembly.a, forcings, h)
    movers = movers_of(parts, unmodelled, h)

    def advance(drive_at: DriveAt, plant: State, states: States, commands: Signals, t: Scalar) -> tuple[State, States]:
        def substep(index: Scalar, carry: tuple[State, States]) -> tuple[State, States]:
            plant, states = carry
            states, lines = apply_movers(movers, states, commands)

            def signals(x: Sequence[Scalar], fraction: float) -> list[Scalar]:
                """Disturbances and remainder at a stage."""
                time = t + (index + fraction) * h
                at_plant, at_states = scatter_state(assembly, x, plant, states)
                drive = drive_at(at_plant, actuation_at(assembly, at_states, lines, fraction), time)
                slopes = []
                if parts.plant.remainder is not None:
                    slope = jax.tree.leaves(parts.plant.remainder(params, at_plant, drive, time))
                    slopes = [slope[row] for row in rows]
                return [*drive.disturbance, *drive.inputs, *slopes]

            inputs = [terms_of(model, line) for model, line in zip(parts.unmodelled, lines, strict=True)]
            x = gather_state(assembly, plant, states)
            if is_constant or parts.integrator == Integrator.EULER:
                x = held_system.full.apply(x, [*inputs, *((signal,) for signal in signals(x, 0.0))])
            else:
                x = etd_step(held_system, parts, x, inputs, forcings, signals)
            plant, states = scatter_state(assembly, x, plant, states)
            return parts.plant.project(params, plant), states

        return repeat_substeps(substep, (plant, states), count)

    return advance


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


def etd_step(
    held_system: HeldSystem,
    parts: HeldParts,
    x: Sequence[Scalar],
    inputs: Sequence[Sequence[Scalar]],
    forcings: Sequence[Forcing],
    signals: Callable[[Sequence[Scalar], float], list[Scalar]],
) -> tuple[Scalar, ...]:
    """One step of ETDRK4-B.

    Args:
        held_system: The exact solution over the step and over half of it.
        parts: The models.
        x: State of the linear system, length n.
        inputs: Terms of the input of each channel's command.
        forcings: All inputs of the linear system: commands, then disturbances and remainder.
        signals: ``(state, share of the step) -> disturbances and remainder`` at a stage.
    """

    def forced(polynomials: Sequence[Sequence[Scalar]]) -> list[Sequence[Scalar]]:
        varying = zip(polynomials, forcings[len(inputs) :], strict=True)
        return [*inputs, *(terms[: forcing.terms] for terms, forcing in varying)]

    depends_on_time_alone = parts.plant.remainder is None and Variation.STATE not in parts.variations
    start = signals(x, 0.0)
    middle = signals(held_system.half.apply(x, forced([(a,) for a in start])), 0.5)
    corrected_middle = middle
    if not depends_on_time_alone:
        pairs = zip(start, middle, strict=True)
        corrected_middle = signals(held_system.half.apply(x, forced([(a, 4.0 * (b - a)) for a, b in pairs])), 0.5)
    pairs = zip(start, corrected_middle, strict=True)
    end = signals(held_system.full.apply(x, forced([(a, 2.0 * (b - a)) for a, b in pairs])), 1.0)
    polynomials = []
    for a, b, c, d in zip(start, middle, corrected_middle, end, strict=True):
        double_sum = 2.0 * (b + c)
        polynomials.append((a, double_sum - 3.0 * a - d, 4.0 * (a + d) - 2.0 * double_sum))
    return held_system.full.apply(x, forced(polynomials))


def actuation_at(assembly: Assembly, states: States, lines: tuple[Moments, ...], fraction: float) -> Signals:
    """The commands that reach the plant at a share of the step: of linear dynamics from their state at that stage."""
    reaching = []
    for system, state, line in zip(assembly.systems, states, lines, strict=True):
        value = line.mean if is_zero(line.rise) else line.mean + (fraction - 0.5) * line.rise
        if system is not None:
            value = dot((*system.c, system.d), (*jax.tree.leaves(state), value))
        reaching.append(value)
    return tuple(reaching)


def advance_by_steps(parts: HeldParts, params: Params, unmodelled: States, observe: Observer | None = None) -> Advance:
    """Advance a plant by its own steps or the loop's fixed-step method; ``observe`` sees each tick on board."""
    h = parts.sample_time / parts.substeps
    integrate = INTEGRATORS[parts.integrator]
    systems: list[Averaged | None] = []
    for model, p in zip(parts.unmodelled, unmodelled, strict=True):
        systems.append(None if model.linear is None else average_output(model.linear(p), input_terms(model), h))
    movers = movers_of(parts, unmodelled, h)
    software = parts.plant.software
    period = None if software is None else software.period(params)
    ticks = 1 if period is None else ticks_in_sample(period, parts.sample_time, parts.substeps)
    steps_per_tick = parts.substeps // ticks

    def advance(drive_at: DriveAt, plant: State, states: States, commands: Signals, t: Scalar) -> tuple[State, States]:
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
                    next_states[i], lines[i] = system.over(states[i], terms_of(model, lines[i]))

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

        if software is None or period is None:
            return repeat_substeps(substep, (plant, states), parts.substeps)

        on_board: Onboard = software
        tick_time: float = period
        channels = zip(parts.unmodelled, unmodelled, states, commands, strict=True)
        drive = drive_at(plant, tuple(model.output(p, z, u) for model, p, z, u in channels), t)

        def between_ticks(tick: Scalar, at: tuple[State, States]) -> tuple[State, States]:
            previous_plant, states = at
            ticked = on_board.tick(params, previous_plant, tick_time)
            if observe is not None:
                observe(previous_plant, drive, ticked)
            first = tick * steps_per_tick
            plant, states = repeat_substeps(lambda i, at: substep(first + i, at), (ticked, states), steps_per_tick)
            return on_board.holding(plant, on_board.held(ticked)), states  # to the bit: x + 0 changes the sign of -0

        carry = (software.sample(params, plant, drive, parts.sample_time), states)
        if observe is None:
            return repeat_substeps(between_ticks, carry, ticks)
        for tick in range(ticks):
            carry = between_ticks(tick, carry)
        return carry

    return advance
