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
    movers_of,
    polynomial_terms,
    repeat_substeps,
    term_count,
)
from dssc_jax.core.adapters import quiet_inputs
from dssc_jax.core.contracts import LinearDynamics, Moments, Plant, Variation
from dssc_jax.core.integrators import Integrator
from dssc_jax.core.numerics import as_arrays, dot, is_zero
from dssc_jax.core.sampled_linear import Forcing, HeldSystem, LinearSystem, Rows, hold, scale_column
from dssc_jax.core.signals import Measurements, Params, PlantInput, Scalar, Signals, State

VARYING = 3  # terms of an input that varies within a step: it is interpolated at start, middle and end


def advance_exactly(parts: HeldParts, dynamics: LinearDynamics, params: Params, unmodelled: States) -> Advance:
    """The function that advances a plant with a linear part over a sample.

    The linear part has an exact solution; ETDRK4-B adds disturbances and a remainder that vary within the sample.

    Args:
        parts: The models and the clock.
        dynamics: The plant's linear part.
        params: The plant's parameters.
        unmodelled: Parameters of the unmodelled dynamics of each channel.
    """
    assembly = assemble(parts, dynamics, unmodelled)
    rows = remainder_rows(parts.plant, params, len(parts.unmodelled))
    forcings = list(assembly.inputs)
    for row in rows:
        column = [0.0] * len(assembly.a)
        column[row] = 1.0
        forcings.append(Forcing(tuple(column), VARYING))
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
                """Disturbances, inputs and the remainder's rates of change, at a fraction of the substep."""
                time = t + (index + fraction) * h
                at_plant, at_states = scatter_state(assembly, x, plant, states)
                drive = drive_at(at_plant, actuation_at(assembly, at_states, lines, fraction), time)
                remainder_rates = []
                if parts.plant.remainder is not None:
                    rates = jax.tree.leaves(parts.plant.remainder(params, at_plant, drive, time))
                    remainder_rates = [rates[row] for row in rows]
                return [*drive.disturbance, *drive.inputs, *remainder_rates]

            inputs = [polynomial_terms(model, line) for model, line in zip(parts.unmodelled, lines, strict=True)]
            x = gather_state(assembly, plant, states)
            if is_constant or parts.integrator == Integrator.EULER:
                x = held_system.full.apply(x, [*inputs, *((signal,) for signal in signals(x, 0.0))])
            else:
                x = etd_step(held_system, parts, x, inputs, forcings, signals)
            plant, states = scatter_state(assembly, x, plant, states)
            return parts.plant.project(params, plant), states

        return repeat_substeps(substep, (plant, states), count)

    return advance


class Assembly(NamedTuple):
    """The plant's linear part in series with the linear unmodelled dynamics of each channel, as one linear system.

    Args:
        a: State matrix, shape (n, n).
        inputs: The command of each channel, in the order of the channels, then each disturbance.
        offsets: Index of the first state of each channel's unmodelled dynamics; None where they are not linear.
        systems: Unmodelled dynamics of each channel; None where they are not linear.
    """

    a: Rows
    inputs: tuple[Forcing, ...]
    offsets: tuple[int | None, ...]
    systems: tuple[LinearSystem | None, ...]


def assemble(parts: HeldParts, dynamics: LinearDynamics, unmodelled: States) -> Assembly:
    """The :class:`Assembly` of a plant's linear part, with the parameters of its unmodelled dynamics."""
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
            inputs.append(Forcing(tuple(reaching), term_count(model)))
            continue
        for state, weight in enumerate(system.c):
            for row, entry in enumerate(scale_column(column, weight)):
                matrix[row][offset + state] = entry
        for row, entries in enumerate(system.a):
            matrix[offset + row][offset : offset + len(system.a)] = entries
        reaching[:order] = scale_column(column, system.d)
        reaching[offset : offset + len(system.a)] = system.b
        inputs.append(Forcing(tuple(reaching), term_count(model)))
    for column, variation in zip((*dynamics.disturbance, *dynamics.inputs), parts.variations, strict=True):
        terms = 1 if variation == Variation.HELD else VARYING
        inputs.append(Forcing((*column, *(0.0,) * (size - order)), terms))
    return Assembly(tuple(map(tuple, matrix)), tuple(inputs), tuple(offsets), tuple(systems))


def remainder_rows(plant: Plant[Measurements, Signals], params: Params, channels: int) -> tuple[int, ...]:
    """Indices of the states whose derivatives have a nonlinear remainder; entries that are plain zeros have none."""
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


def etd_step(
    held_system: HeldSystem,
    parts: HeldParts,
    x: Sequence[Scalar],
    inputs: Sequence[Sequence[Scalar]],
    forcings: Sequence[Forcing],
    signals: Callable[[Sequence[Scalar], float], list[Scalar]],
) -> tuple[Scalar, ...]:
    """The state of the linear system after one step of ETDRK4-B, shape (n,).

    Args:
        held_system: The exact solution over the step and over half of it.
        parts: The models.
        x: State of the linear system, shape (n,).
        inputs: For each channel the terms of its command, a polynomial in time over the step.
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
    """The commands that reach the plant at a fraction of a step.

    Args:
        assembly: The linear system.
        states: States of the unmodelled dynamics at that stage.
        lines: Mean and rise over the step of the output of each channel's nonlinear unmodelled dynamics.
        fraction: Fraction of the step, 0 to 1.
    """
    reaching = []
    for system, state, line in zip(assembly.systems, states, lines, strict=True):
        value = line.mean if is_zero(line.rise) else line.mean + (fraction - 0.5) * line.rise
        if system is not None:
            value = dot((*system.c, system.d), (*jax.tree.leaves(state), value))
        reaching.append(value)
    return tuple(reaching)
