"""The map F in time cells, from bounds of all signals in every cell to the bounds that follow from them."""

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
    implied_bounds,
    inputs_under,
    sigmas_under,
    start_sizes,
    vector_share,
)
from dssc_jax.proofs.verifier.vehicle.remainders import Remainders
from dssc_jax.proofs.verifier.vehicle.rotors import Rotors
from dssc_jax.proofs.verifier.vehicle.slopes import signal_slopes


def bounds_in_cells(proof: VehicleProof) -> list[SignalBalls]:
    """The bounds of all signals in each time cell of a proof, the last cell's last; a proof without cells has one."""
    final = {name: {signal: arb(y) for signal, y in proof["channels"][name]["bounds"].items()} for name in CHANNELS}
    cells = proof["cells"]
    if cells is None:
        return [final]
    count = number_of_cells(cells)
    bound_lists = cells["bounds"]
    first_cells = [
        {name: {signal: arb(values[j]) for signal, values in bound_lists[name].items()} for name in CHANNELS}
        for j in range(count)
    ]
    return [*first_cells, final]


def number_of_cells(cells: CellsProof) -> int:
    """Number J of the time cells before the last one."""
    return len(next(iter(cells["bounds"][CHANNELS[0]].values())))


def cell_place(j: int, count: int) -> str:
    """The words for cell ``j`` of ``count``, after the name of a failing premise; empty if there is only one cell."""
    if count == 1:
        return ""
    return " in the last cell" if j == count - 1 else f" in cell {j}"


def inputs_in_cells(vehicle: Vehicle, bounds: Sequence[SignalBalls]) -> list[Inputs]:
    """(V2, V3) Bounds of the inputs in each time cell, under the bounds of the signals there.

    Raises:
        Rejected: The vehicle may leave the range of the theorem in a cell, which the message names.
    """
    sigmas = [sigmas_under(vehicle, y) for y in bounds]
    deviations = {
        name: deviations_in_regions(vehicle.problem, name, vehicle.middles[name], [signals[name] for signals in sigmas])
        for name in CHANNELS
    }
    result: list[Inputs] = []
    for j, y in enumerate(bounds):
        cell_deviations = {name: deviations[name][j] for name in CHANNELS}
        try:
            result.append(inputs_under(vehicle, y, cell_deviations, result[-1] if result else None))
        except Rejected as rejected:
            raise Rejected(f"{rejected}{cell_place(j, len(bounds))}") from None
    return result


def responses_in_cells(vehicle: Vehicle, cells: CellsProof | None) -> dict[str, CellResponses]:
    """The responses of each channel in the time cells of a proof; empty if it has none."""
    if cells is None:
        return {}
    count = number_of_cells(cells)
    return {
        name: cell_responses(vehicle.problem, name, vehicle.observations[name], cells["samples"], count)
        for name in CHANNELS
    }


def implied_in_cells(
    vehicle: Vehicle,
    bounds: Sequence[SignalBalls],
    inputs: Sequence[Inputs],
    responses: Mapping[str, CellResponses],
) -> list[dict[str, Balls]]:
    """F of bounds of the signals in each time cell: the bounds that follow from them there, by channel and signal.

    Args:
        vehicle: The data of F.
        bounds: Bounds of the signals in each cell.
        inputs: Bounds of the inputs in each cell.
        responses: Responses of each channel, by :func:`responses_in_cells`.
    """
    if not responses:
        return [implied_bounds(vehicle, bounds[0], inputs[0], from_start=True)]
    result: list[dict[str, Balls]] = [{} for _ in bounds]
    for name in CHANNELS:
        phase_bounds = bounds_at_phases(vehicle, name, bounds, inputs, responses[name])
        for j, y in enumerate(bounds):
            result[j][name] = with_slopes(vehicle, name, y, inputs[j], responses[name].signals, phase_bounds[j])
    return result


def bounds_at_phases(
    vehicle: Vehicle, name: str, bounds: Sequence[SignalBalls], inputs: Sequence[Inputs], responses: CellResponses
) -> np.ndarray:
    """The bounds of a channel's signals at the phases, in each time cell, (J + 1, rows)."""
    final = len(bounds) - 1
    shares = np.array([float_above(vector_share(name, signal).upper()) for signal in responses.signals])
    sizes = np.array([input_sizes(name, inputs[j], responses.remainders) for j in range(final + 1)])
    constant = float_above(inputs[0].remainders.constant)
    deviation = float_above(start_sizes(vehicle, name)[2])
    result = responses.starts + shares * deviation * responses.deviations + constant * responses.constants
    for j in range(final + 1):
        effects = effects_of(responses, sizes[: j + 1], j == final)
        result[j] += shares * effects[:, :OMEGAS].sum(axis=1) + effects[:, OMEGAS:].sum(axis=1)
    return SUMMED * result


def effects_of(responses: CellResponses, sizes: np.ndarray, is_last: bool) -> np.ndarray:
    """Bounds of what the inputs in the time cells 0 to j do to a channel's signals in cell j, (rows, inputs).

    An input is that of the first cell from t = 0 on, plus its changes from cell to cell, each from then on.

    Args:
        responses: Responses of the channel.
        sizes: Bounds of the inputs in the cells 0 to j, (j + 1, inputs).
        is_last: Whether j is the last cell, which has all later samples.
    """
    j = len(sizes) - 1
    changes = np.diff(sizes, axis=0)[::-1]
    rises = np.maximum(changes, 0.0)
    falls = np.maximum(-changes, 0.0)
    if is_last:
        increase = responses.total_sum * (sizes[0] + SUMMED * rises.sum(axis=0))
    else:
        increase = responses.upper[j] * sizes[0] + np.einsum("iru,iu->ru", responses.upper[:j], rises)
    decrease = np.einsum("iru,iu->ru", responses.lower[:j], falls)
    return SUMMED * increase - decrease / SUMMED


def input_sizes(name: str, inputs: Inputs, remainders: Sequence[str]) -> list[float]:
    """Bounds of omega_u and omega_r along one axis, and of the remainders of these names, rounded up."""
    deviations = inputs.deviations[name]
    sigma = inputs.sigma[name]
    remainder_bounds = inputs.remainders.channels[name]
    sizes = [
        deviations.of_command(sigma),
        deviations.of_integral(sigma),
        *[remainder_bounds[remainder] for remainder in remainders],
    ]
    return [float_above(size) for size in sizes]


def with_slopes(
    vehicle: Vehicle, name: str, bounds: SignalBalls, inputs: Inputs, signals: Sequence[str], phase_bounds: np.ndarray
) -> Balls:
    """F of the signals of a channel in a time cell: the bounds at the phases plus what the slopes add between them.

    Args:
        vehicle: The data of F.
        name: The channel.
        bounds: Bounds of the signals in the cell.
        inputs: Bounds of the inputs in the cell.
        signals: Name of the signal of each row.
        phase_bounds: Bounds of the signals at the phases, (rows,).

    Raises:
        Rejected: A bound is not finite.
    """
    t = arb(vehicle.problem["sample_time"])
    slopes = signal_slopes(vehicle.problem, name, vehicle.dampings[name], bounds, inputs.remainders)
    largest_values: dict[str, float] = {}
    for signal, value in zip(signals, phase_bounds.tolist(), strict=True):
        require_premise(bool(np.isfinite(value)), f"V4: the bound of {name}.{signal} is not finite")
        largest_values[signal] = max(value, largest_values.get(signal, 0.0))
    result = Balls()
    for signal, value in largest_values.items():
        growth = arb(0) if signal == EQUIVALENT else t / REACH * slopes[signal]
        result[signal] = (arb(value) + growth).upper()
    return result


def largest_bounds(bounds: Sequence[SignalBalls]) -> dict[str, Balls]:
    """The largest bound of each signal over the time cells, by channel and signal."""
    return {
        name: {signal: maximum(*[y[name][signal] for y in bounds]) for signal in bounds[0][name]} for name in CHANNELS
    }


def largest_inputs(inputs: Sequence[Inputs]) -> Inputs:
    """The largest deviations, remainders, tilt and |sigma|, and the extreme thrusts, over the time cells."""
    remainders = [cell.remainders for cell in inputs]
    channels: dict[str, Balls] = {}
    for name in CHANNELS:
        channels[name] = {
            remainder: maximum(*[cell.channels[name][remainder] for cell in remainders])
            for remainder in remainders[0].channels[name]
        }
    largest_remainders = Remainders(
        channels=channels,
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
    deviations = {name: Deviations(*map(maximum, *[cell.deviations[name] for cell in inputs])) for name in CHANNELS}
    sigma = {name: maximum(*[cell.sigma[name] for cell in inputs]) for name in CHANNELS}
    return Inputs(largest_remainders, deviations, sigma)
