"""The map F in time cells: from bounds of all signals in every cell to the bounds that follow in every cell.

Cell 0 begins at t = 0; the last cell contains all the time after the others. docs/vehicle_proofs.md has the
definitions.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from flint import arb

from dssc_jax.proofs.verifier.balls import Balls, Rejected, maximum, minimum, require_premise
from dssc_jax.proofs.verifier.impulse_responses import SUMMED
from dssc_jax.proofs.verifier.vehicle.cell_responses import OMEGAS, CellResponses, cell_responses
from dssc_jax.proofs.verifier.vehicle.certificate import CHANNELS, CellsProof, VehicleProof
from dssc_jax.proofs.verifier.vehicle.channels import EQUIVALENT, SignalBalls
from dssc_jax.proofs.verifier.vehicle.deviations import Deviations, deviations_in_regions, float_above
from dssc_jax.proofs.verifier.vehicle.implied import (
    REACH,
    Inputs,
    Vehicle,
    axis_factor,
    implied_bounds,
    inputs_under,
    sigmas_under,
    start_sizes,
)
from dssc_jax.proofs.verifier.vehicle.remainders import Remainders
from dssc_jax.proofs.verifier.vehicle.rotors import Rotors
from dssc_jax.proofs.verifier.vehicle.slopes import signal_slopes


def bounds_in_cells(proof: VehicleProof) -> list[SignalBalls]:
    """The bounds Y_j of all signals in each time cell of a proof, in order; a proof without cells has a single cell."""
    final = {name: {signal: arb(y) for signal, y in proof["channels"][name]["bounds"].items()} for name in CHANNELS}
    cells = proof["cells"]
    if cells is None:
        return [final]
    first_cells: list[SignalBalls] = []
    for j in range(number_of_cells(cells)):
        bounds = {}
        for name in CHANNELS:
            bounds[name] = {signal: arb(values[j]) for signal, values in cells["bounds"][name].items()}
        first_cells.append(bounds)
    return [*first_cells, final]


def number_of_cells(cells: CellsProof) -> int:
    """J, the number of time cells before the last one; every signal has as many bounds."""
    return len(cells["bounds"]["x"]["e"])


def cell_place(j: int, count: int) -> str:
    """The end of a message that names cell j; empty if there is only one cell.

    Args:
        j: Number of the cell.
        count: Number of all cells, including the last one.
    """
    if count == 1:
        return ""
    return " in the last cell" if j == count - 1 else f" in cell {j}"


def inputs_in_cells(vehicle: Vehicle, bounds: Sequence[SignalBalls]) -> list[Inputs]:
    """(V2, V3) Bounds of the inputs in each time cell, if in every cell the signals stay within the cell's bounds.

    Args:
        vehicle: The linear channels and their responses.
        bounds: Y_j, bounds of the signals in each cell, or of their deviation from the nominal flight.

    Raises:
        Rejected: The vehicle may leave the range of the theorem in a cell, which the message names.
    """
    sigmas = [sigmas_under(vehicle, y) for y in bounds]
    deviations = {}
    for name in CHANNELS:
        channel_sigmas = [signals[name] for signals in sigmas]
        deviations[name] = deviations_in_regions(vehicle.problem, name, vehicle.middles[name], channel_sigmas)
    inputs: list[Inputs] = []
    earlier = None
    for j, y in enumerate(bounds):
        cell_deviations = {name: deviations[name][j] for name in CHANNELS}
        try:
            earlier = inputs_under(vehicle, y, cell_deviations, earlier)
        except Rejected as rejected:
            raise Rejected(f"{rejected}{cell_place(j, len(bounds))}") from None
        inputs.append(earlier)
    return inputs


def responses_in_cells(vehicle: Vehicle, cells: CellsProof | None) -> dict[str, CellResponses]:
    """The responses of each channel in the time cells of a proof, by channel.

    Args:
        vehicle: The linear channels and their responses.
        cells: The time cells; None: the proof has none, and the result is empty.

    Raises:
        Rejected: The responses of a channel decay too slowly.
    """
    if cells is None:
        return {}
    count = number_of_cells(cells)
    responses = {}
    for name in CHANNELS:
        responses[name] = cell_responses(vehicle.problem, name, vehicle.observations[name], cells["samples"], count)
    return responses


def implied_in_cells(
    vehicle: Vehicle,
    bounds: Sequence[SignalBalls],
    inputs: Sequence[Inputs],
    responses: Mapping[str, CellResponses],
) -> list[dict[str, Balls]]:
    """F in each time cell: the bounds that follow from Y_j, by channel and signal.

    Args:
        vehicle: The linear channels and their responses.
        bounds: Y_j, bounds of the signals in each cell.
        inputs: Bounds of the inputs in each cell.
        responses: Responses of each channel, by :func:`responses_in_cells`; empty if there is only one cell.
    """
    if not responses:
        return [implied_bounds(vehicle, bounds[0], inputs[0], from_start=True)]
    implied: list[dict[str, Balls]] = [{} for _ in bounds]
    for name in CHANNELS:
        phase_bounds = bounds_at_phases(vehicle, name, bounds, inputs, responses[name])
        for j, y in enumerate(bounds):
            implied[j][name] = with_slopes(vehicle, name, y, inputs[j], responses[name].signals, phase_bounds[j])
    return implied


def bounds_at_phases(
    vehicle: Vehicle, name: str, bounds: Sequence[SignalBalls], inputs: Sequence[Inputs], responses: CellResponses
) -> np.ndarray:
    """The bounds of a channel's signals at the phases of a sample, in each time cell, shape (J + 1, rows).

    A bound is the sum of the responses to the start, to the constant, and to the inputs in this and all earlier cells.

    Args:
        vehicle: The linear channels and their responses.
        name: Name of the channel.
        bounds: Bounds of the signals in each cell.
        inputs: Bounds of the inputs in each cell.
        responses: Responses of the channel in the cells.
    """
    factors = np.array([float_above(axis_factor(name, signal).upper()) for signal in responses.signals])  # h
    sizes = np.array([input_sizes(name, cell_inputs, responses.remainders) for cell_inputs in inputs])
    constant = float_above(inputs[0].remainders.constant)
    _, _, q_deviation = start_sizes(vehicle, name)
    phase_bounds = responses.starts + factors * float_above(q_deviation) * responses.deviations
    phase_bounds = phase_bounds + constant * responses.constants
    last = len(bounds) - 1
    for j in range(last + 1):
        effects = effects_of(responses, sizes[: j + 1], is_last=j == last)
        phase_bounds[j] += factors * effects[:, :OMEGAS].sum(axis=1) + effects[:, OMEGAS:].sum(axis=1)
    return SUMMED * phase_bounds


def effects_of(responses: CellResponses, sizes: np.ndarray, is_last: bool) -> np.ndarray:
    """Bounds of the effects of the inputs in the time cells 0 to j on a channel's signals in cell j.

    The input's bound of cell 0 acts from t = 0 on. Each change of the bound between two cells acts from the later cell
    on: a rise is multiplied by an upper bound of the sum of effects, a fall by a lower bound.

    Args:
        responses: Responses of the channel in the cells.
        sizes: Bounds of the inputs in the cells 0 to j, shape (j + 1, inputs).
        is_last: Whether j is the last cell, which has all later samples.

    Returns:
        Shape (rows, inputs).
    """
    j = len(sizes) - 1
    first = sizes[0]
    # the last change first, since entry m of ``upper`` and ``lower`` belongs to a change m cells ago
    changes = np.flip(np.diff(sizes, axis=0), axis=0)
    rises = np.maximum(changes, 0.0)
    falls = np.maximum(-changes, 0.0)
    if is_last:
        increase = responses.total_sum * (first + SUMMED * rises.sum(axis=0))
    else:
        increase = responses.upper[j] * first + np.einsum("iru,iu->ru", responses.upper[:j], rises)
    decrease = np.einsum("iru,iu->ru", responses.lower[:j], falls)
    return SUMMED * increase - decrease / SUMMED


def input_sizes(name: str, inputs: Inputs, remainders: Sequence[str]) -> list[float]:
    """Bounds of a channel's inputs, rounded up: of omega_u and omega_r along one axis, then of the remainders.

    Args:
        name: Name of the channel.
        inputs: Bounds of the inputs in a time cell.
        remainders: Names of the channel's remainders, in the order of the result.
    """
    deviations = inputs.deviations[name]
    sigma = inputs.sigma[name]
    omegas = [deviations.of_command(sigma), deviations.of_integral(sigma)]
    remainder_sizes = [inputs.remainders.channels[name][remainder] for remainder in remainders]
    return [float_above(size) for size in (*omegas, *remainder_sizes)]


def with_slopes(
    vehicle: Vehicle, name: str, bounds: SignalBalls, inputs: Inputs, signals: Sequence[str], phase_bounds: np.ndarray
) -> Balls:
    """F of a channel's signals in a time cell, by name: the largest bound at the phases, plus T_s/8 times the slope.

    Every time is within T_s/8 of a phase. Only u_av has no slope, since it exists at the samples only.

    Args:
        vehicle: The linear channels and their responses.
        name: Name of the channel.
        bounds: Bounds of the signals in the cell.
        inputs: Bounds of the inputs in the cell.
        signals: Name of the signal of each row.
        phase_bounds: Bounds of the signals at the phases, shape (rows,).

    Raises:
        Rejected: A bound is not finite.
    """
    t = arb(vehicle.problem["sample_time"])
    slopes = signal_slopes(vehicle.problem, name, vehicle.dampings[name], bounds, inputs.remainders)
    largest_values: dict[str, float] = {}
    for signal, value in zip(signals, phase_bounds.tolist(), strict=True):
        require_premise(bool(np.isfinite(value)), f"V4: the bound of {name}.{signal} is not finite")
        largest_values[signal] = max(value, largest_values.get(signal, 0.0))
    implied = Balls()
    for signal, value in largest_values.items():
        growth = arb(0) if signal == EQUIVALENT else t / REACH * slopes[signal]  # u_av has no time between samples
        implied[signal] = (arb(value) + growth).upper()
    return implied


def largest_bounds(bounds: Sequence[SignalBalls]) -> dict[str, Balls]:
    """The largest bound of each signal over the time cells, by channel and signal."""
    largest = {}
    for name in CHANNELS:
        largest[name] = {signal: maximum(*[y[name][signal] for y in bounds]) for signal in bounds[0][name]}
    return largest


def largest_inputs(inputs: Sequence[Inputs]) -> Inputs:
    """Merge the inputs of all time cells into one: the smallest ``rotors.smallest``, and the largest of all others."""
    remainders = [cell.remainders for cell in inputs]
    largest_remainders = Remainders(
        channels=largest_bounds([cell.channels for cell in remainders]),
        constant=remainders[0].constant,
        tilt=maximum(*[cell.tilt for cell in remainders]),
        rotors=Rotors(
            smallest=minimum(*[cell.rotors.smallest for cell in remainders]),
            largest=maximum(*[cell.rotors.largest for cell in remainders]),
            difference=maximum(*[cell.rotors.difference for cell in remainders]),
            sum=maximum(*[cell.rotors.sum for cell in remainders]),
        ),
        shortfall=maximum(*[cell.shortfall for cell in remainders]),
    )
    deviations = {}
    for name in CHANNELS:
        deviations_by_cell = [cell.deviations[name] for cell in inputs]
        deviations[name] = Deviations(*map(maximum, *deviations_by_cell))  # entry by entry
    sigma = {name: maximum(*[cell.sigma[name] for cell in inputs]) for name in CHANNELS}
    return Inputs(largest_remainders, deviations, sigma)
