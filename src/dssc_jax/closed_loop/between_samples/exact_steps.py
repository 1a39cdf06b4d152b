"""Exact steps between two samples for a plant with a linear part, by matrix exponentials.

The matrices of the exact solution are computed once for a draw. Disturbances that vary within the sample, and the
nonlinear remainder of a plant, are added by an exponential Runge-Kutta method of order 4.

Reference:
    S. Krogstad, J. Comput. Phys. 203 (2005) 72-88: the method ETDRK4-B.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax

from dssc_jax.closed_loop.between_samples.held_parts import (
    Advance,
    DriveAt,
    HeldParts,
    States,
    apply_movers,
    make_movers,
    polynomial_terms,
    repeat_substeps,
    term_count,
)
from dssc_jax.core.adapters import quiet_inputs
from dssc_jax.core.contracts import LinearDynamics, Moments, Plant, Variation
from dssc_jax.core.integrators import Integrator
from dssc_jax.core.numerics import as_arrays, dot, is_zero
from dssc_jax.core.sampled_linear import (
    Column,
    Forcing,
    HeldSystem,
    LinearSystem,
    Rows,
    hold,
    one_entry,
    scale_column,
)
from dssc_jax.core.signals import Measurements, Params, PlantInput, Scalar, Signals, State

CONSTANT = 1  # terms of an input that is constant over a step
VARYING = 3  # terms of an input that varies within a step: a parabola through its values at start, middle and end

SignalsAt = Callable[[Sequence[Scalar], float], list[Scalar]]
"""``(state of the linear system, fraction of the step) -> signals that vary within the step``, at that stage."""


def advance_exactly(parts: HeldParts, dynamics: LinearDynamics, params: Params, unmodelled: States) -> Advance:
    """Return the function that advances a plant with a linear part over one sample.

    The linear part moves by its exact solution. Where disturbances or a nonlinear remainder vary within the sample,
    ETDRK4-B adds their effect, in ``parts.substeps`` steps.

    Args:
        parts: The models and the clock.
        dynamics: The plant's linear part.
        params: The plant's parameters.
        unmodelled: Parameters of the unmodelled dynamics of each channel.
    """
    assembly = assemble(parts, dynamics, unmodelled)
    remainder_rows = find_remainder_rows(parts.plant, params, len(parts.unmodelled))
    forcings = list(assembly.inputs)
    for row in remainder_rows:
        forcings.append(Forcing(one_entry(1.0, row, len(assembly.a)), VARYING))
    is_constant = all(forcing.terms == CONSTANT for forcing in forcings)
    count = 1 if is_constant else parts.substeps  # with constant inputs one step over the sample is exact
    h = parts.sample_time / count
    held_system = hold(assembly.a, forcings, h)
    movers = make_movers(parts, unmodelled, h)

    def advance(drive_at: DriveAt, plant: State, states: States, commands: Signals, t: Scalar) -> tuple[State, States]:
        """The states of plant and unmodelled dynamics after a sample; see :data:`Advance`."""

        def substep(index: Scalar, carry: tuple[State, States]) -> tuple[State, States]:
            """The states of plant and unmodelled dynamics after the substep with this index.

            Args:
                index: Index of the substep in the sample.
                carry: Both states before the substep.
            """
            plant, states = carry
            states, lines = apply_movers(movers, states, commands)

            def varying_signals(x: Sequence[Scalar], fraction: float) -> list[Scalar]:
                """Disturbances, named inputs and the remainder's rates of change, at one time in the substep.

                Args:
                    x: State of the linear system at that time, length n.
                    fraction: The time, as a fraction of the substep from 0 to 1.
                """
                time = t + (index + fraction) * h
                at_plant, at_states = scatter_state(assembly, x, plant, states)
                drive = drive_at(at_plant, actuation_at(assembly, at_states, lines, fraction), time)
                signals = [*drive.disturbance, *drive.inputs]
                if parts.plant.remainder is not None:
                    rates = jax.tree.leaves(parts.plant.remainder(params, at_plant, drive, time))
                    signals += [rates[row] for row in remainder_rows]
                return signals

            inputs = [polynomial_terms(model, line) for model, line in zip(parts.unmodelled, lines, strict=True)]
            x = gather_state(assembly, plant, states)
            if is_constant or parts.integrator == Integrator.EULER:
                held_signals = [(signal,) for signal in varying_signals(x, 0.0)]  # as at the start of the step
                x = held_system.full.apply(x, [*inputs, *held_signals])
            else:
                x = etd_step(held_system, parts, x, inputs, forcings, varying_signals)
            plant, states = scatter_state(assembly, x, plant, states)
            return parts.plant.project(params, plant), states

        return repeat_substeps(substep, (plant, states), count)

    return advance


class Assembly(NamedTuple):
    """A plant's linear part in series with the linear unmodelled dynamics of each channel, as one linear system.

    The state x of the system has the plant's states first, then the states of the linear unmodelled dynamics, channel
    by channel.

    Args:
        a: State matrix, shape (n, n).
        inputs: The command of each channel, in the order of the channels, then each disturbance.
        offsets: Index in x of the first state of each channel's unmodelled dynamics; None where they are not linear.
        systems: Unmodelled dynamics of each channel; None where they are not linear.
    """

    a: Rows
    inputs: tuple[Forcing, ...]
    offsets: tuple[int | None, ...]
    systems: tuple[LinearSystem | None, ...]


def assemble(parts: HeldParts, dynamics: LinearDynamics, unmodelled: States) -> Assembly:
    """Combine a plant's linear part and the linear unmodelled dynamics before it into one linear system.

    A channel's unmodelled dynamics z' = A z + b u, y = c z + d u drive the plant by their output y. So the plant's
    column g of the command becomes the block g c of the state matrix, and the command itself enters through g d and b.

    Args:
        parts: The models and the clock.
        dynamics: The plant's linear part.
        unmodelled: Parameters of the unmodelled dynamics of each channel.
    """
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
    no_effect = (0.0,) * (size - order)  # on the states behind the plant's
    inputs = []
    for plant_column, system, offset, model in zip(dynamics.command, systems, offsets, parts.unmodelled, strict=True):
        command_column = [*plant_column, *no_effect]
        if system is not None and offset is not None:
            insert_system(matrix, command_column, plant_column, system, offset)
        inputs.append(Forcing(tuple(command_column), term_count(model)))
    disturbance_columns = (*dynamics.disturbance, *dynamics.inputs)
    for column, variation in zip(disturbance_columns, parts.variations, strict=True):
        terms = CONSTANT if variation == Variation.HELD else VARYING
        inputs.append(Forcing((*column, *no_effect), terms))
    return Assembly(tuple(map(tuple, matrix)), tuple(inputs), tuple(offsets), tuple(systems))


def insert_system(
    matrix: list[list[Scalar]],
    command_column: list[Scalar],
    plant_column: Column,
    system: LinearSystem,
    offset: int,
) -> None:
    """Put the unmodelled dynamics of one channel between its command and the plant; changes the arguments in place.

    Args:
        matrix: State matrix of the assembly, shape (n, n). The blocks A and g c are written into it.
        command_column: Column of the channel's command, shape (n,), with the plant's column g in the plant's rows.
            These rows become g d, and the rows of the unmodelled dynamics become b.
        plant_column: The plant's column g of the command, shape (states of the plant,).
        system: The unmodelled dynamics, with A, b, c and d.
        offset: Index of the first state of the unmodelled dynamics.
    """
    end = offset + len(system.a)
    for state, weight in enumerate(system.c):
        for row, entry in enumerate(scale_column(plant_column, weight)):
            matrix[row][offset + state] = entry
    for row, entries in enumerate(system.a):
        matrix[offset + row][offset:end] = entries
    command_column[: len(plant_column)] = scale_column(plant_column, system.d)
    command_column[offset:end] = system.b


def find_remainder_rows(plant: Plant[Measurements, Signals], params: Params, channels: int) -> tuple[int, ...]:
    """Indices of the plant's states whose derivatives have a nonlinear remainder; empty for a linear plant.

    The remainder is traced once. In the trace, the entries of all states without a remainder are plain zeros.

    Args:
        plant: The plant.
        params: Parameters of the plant.
        channels: Number of channels.
    """
    if plant.remainder is None:
        return ()
    remainder = plant.remainder
    zeros: Signals = (0.0,) * channels
    is_zero_entry: list[bool] = []

    def record_zeros(state: State) -> State:
        """The remainder in a state of the plant.

        While JAX traces this function, it appends to ``is_zero_entry`` whether each entry is a plain zero.
        """
        drive: PlantInput[Signals] = PlantInput(zeros, zeros, wind=None, inputs=quiet_inputs(plant, params))
        slope = remainder(params, state, drive, 0.0)
        is_zero_entry.extend(is_zero(entry) for entry in jax.tree.leaves(slope))
        return slope

    jax.eval_shape(record_zeros, as_arrays(plant.init(params)))
    return tuple(row for row, is_zero_row in enumerate(is_zero_entry) if not is_zero_row)


def gather_state(assembly: Assembly, plant: State, states: States) -> list[Scalar]:
    """The state x of the assembled linear system, length n.

    The numbers of the plant's state come first, then the numbers of each channel's linear unmodelled dynamics.

    Args:
        assembly: The assembled system.
        plant: State of the plant.
        states: State of each channel's unmodelled dynamics; nonlinear dynamics are not a part of x.
    """
    x = jax.tree.leaves(plant)
    for offset, state in zip(assembly.offsets, states, strict=True):
        if offset is not None:  # linear: a part of x
            x.extend(jax.tree.leaves(state))
    return x


def scatter_state(assembly: Assembly, x: Sequence[Scalar], plant: State, states: States) -> tuple[State, States]:
    """The states of plant and unmodelled dynamics with the numbers of x, the inverse of :func:`gather_state`.

    Args:
        assembly: The linear system.
        x: State of the linear system, length n.
        plant: A state of the plant, which gives the structure.
        states: States of the unmodelled dynamics. Linear ones give their structure; all others are returned as they
            are, because x does not contain them.
    """
    leaves, structure = jax.tree.flatten(plant)
    scattered = []
    for offset, state in zip(assembly.offsets, states, strict=True):
        if offset is not None:
            state_leaves, state_structure = jax.tree.flatten(state)
            state = state_structure.unflatten(x[offset : offset + len(state_leaves)])
        scattered.append(state)
    return structure.unflatten(x[: len(leaves)]), tuple(scattered)


def etd_step(
    held_system: HeldSystem,
    parts: HeldParts,
    x: Sequence[Scalar],
    inputs: Sequence[Sequence[Scalar]],
    forcings: Sequence[Forcing],
    varying_signals: SignalsAt,
) -> tuple[Scalar, ...]:
    """The state of the linear system after one step of ETDRK4-B, length n.

    Four stages evaluate the varying signals: at the start, twice in the middle, and at the end of the step. Each stage
    moves the state by the exact solution for a polynomial through the values so far.

    Args:
        held_system: The exact solution over the step and over half the step.
        parts: The models.
        x: State of the linear system, length n.
        inputs: For each channel the terms of its command, a polynomial in time over the step.
        forcings: All inputs of the linear system: commands, then disturbances and remainder.
        varying_signals: Returns disturbances and remainder at a stage.
    """

    def all_inputs(polynomials: Sequence[Sequence[Scalar]]) -> list[Sequence[Scalar]]:
        """The input terms of the whole system: those of the commands, then those of the varying signals.

        Each polynomial is cut to as many terms as the forcing of its signal has.
        """
        terms_of_inputs = list(inputs)
        for polynomial, forcing in zip(polynomials, forcings[len(inputs) :], strict=True):
            terms_of_inputs.append(polynomial[: forcing.terms])
        return terms_of_inputs

    depends_on_time_alone = parts.plant.remainder is None and Variation.STATE not in parts.variations
    start = varying_signals(x, 0.0)
    middle = varying_signals(held_system.half.apply(x, all_inputs([(a,) for a in start])), 0.5)
    corrected_middle = middle
    if not depends_on_time_alone:
        # a line from the start whose mean over the half step is the value in the middle
        lines = [(a, 4.0 * (b - a)) for a, b in zip(start, middle, strict=True)]
        corrected_middle = varying_signals(held_system.half.apply(x, all_inputs(lines)), 0.5)
    # a line from the start through the value in the middle
    lines = [(a, 2.0 * (b - a)) for a, b in zip(start, corrected_middle, strict=True)]
    end = varying_signals(held_system.full.apply(x, all_inputs(lines)), 1.0)
    parabolas = []  # through the start a, the mean of both middle values b and c, and the end d
    for a, b, c, d in zip(start, middle, corrected_middle, end, strict=True):
        double_sum = 2.0 * (b + c)
        parabolas.append((a, double_sum - 3.0 * a - d, 4.0 * (a + d) - 2.0 * double_sum))
    return held_system.full.apply(x, all_inputs(parabolas))


def actuation_at(assembly: Assembly, states: States, lines: tuple[Moments, ...], fraction: float) -> Signals:
    """The command of each channel that reaches the plant at a fraction of a step.

    Args:
        assembly: The linear system.
        states: States of the unmodelled dynamics at that stage.
        lines: For each channel mean and rise, over the step, of the signal before its linear unmodelled dynamics.
        fraction: Fraction of the step, 0 to 1.
    """
    reaching = []
    for system, state, line in zip(assembly.systems, states, lines, strict=True):
        value = line.mean if is_zero(line.rise) else line.mean + (fraction - 0.5) * line.rise
        if system is not None:  # y = c z + d u
            value = dot((*system.c, system.d), (*jax.tree.leaves(state), value))
        reaching.append(value)
    return tuple(reaching)
