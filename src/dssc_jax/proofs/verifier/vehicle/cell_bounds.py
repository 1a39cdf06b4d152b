"""The map F in time cells: the bounds of all signals in every cell that bounds in every cell imply."""

from collections.abc import Mapping, Sequence

import numpy as np
from flint import arb

from dssc_jax.proofs.verifier.balls import Balls, Rejected, maximum, require_premise
from dssc_jax.proofs.verifier.impulse_responses import SUMMED
from dssc_jax.proofs.verifier.vehicle.cell_responses import OMEGAS, CellResponses, cell_responses
from dssc_jax.proofs.verifier.vehicle.certificate import CHANNELS, CellsProof, VehicleProof
from dssc_jax.proofs.verifier.vehicle.channels import EQUIVALENT
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
from dssc_jax.proofs.verifier.vehicle.remainders import Remainders, Rotors, SignalBalls
from dssc_jax.proofs.verifier.vehicle.slopes import signal_slopes


def bounds_in_cells(proof: VehicleProof) -> list[SignalBalls]:
    """The bounds of all signals in each cell; the last cell is the only one of a proof without cells."""
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
    """Number J of the cells before the last one."""
    return len(next(iter(cells["bounds"][CHANNELS[0]].values())))


def cell_place(j: int, count: int) -> str:
    """Where a premise fails, of ``count`` cells; empty if there is one only."""
    if count == 1:
        return ""
    return " in the last cell" if j == count - 1 else f" in cell {j}"


def inputs_in_cells(vehicle: Vehicle, bounds: Sequence[SignalBalls]) -> list[Inputs]:
    """(V2, V3) What the bounds of each cell allow."""
    sigmas = [sigmas_under(vehicle, y) for y in bounds]
    deviations = {
        name: deviations_in_regions(vehicle.problem, name, vehicle.middles[name], [signals[name] for signals in sigmas])
        for name in CHANNELS
    }
    result: list[Inputs] = []
    for j, y in enumerate(bounds):
        laws = {name: deviations[name][j] for name in CHANNELS}
        try:
            result.append(inputs_under(vehicle, y, laws, result[-1] if result else None))
        except Rejected as rejected:
            raise Rejected(f"{rejected}{cell_place(j, len(bounds))}") from None
    return result


def responses_in_cells(vehicle: Vehicle, cells: CellsProof | None) -> dict[str, CellResponses]:
    """The responses of the channels in cells; empty without cells."""
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
    """F of bounds of the signals in each cell.

    Args:
        vehicle: The channels.
        bounds: Bounds of the signals in each cell.
        inputs: What they allow in each cell.
        responses: The responses by :func:`responses_in_cells`.
    """
    if not responses:
        return [implied_bounds(vehicle, bounds[0], inputs[0], from_start=True)]
    result: list[dict[str, Balls]] = [{} for _ in bounds]
    for name in CHANNELS:
        answers = answers_in_cells(vehicle, name, bounds, inputs, responses[name])
        for j, y in enumerate(bounds):
            result[j][name] = with_slopes(vehicle, name, y, inputs[j], responses[name].signals, answers[j])
    return result


def answers_in_cells(
    vehicle: Vehicle, name: str, bounds: Sequence[SignalBalls], inputs: Sequence[Inputs], responses: CellResponses
) -> np.ndarray:
    """The bounds at the phases in each cell, (J + 1, rows)."""
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
    """Bounds of what the inputs of all cells up to one do to the signals in it, (rows, inputs).

    An input is that of the first cell from t = 0 on, plus its changes from cell to cell, each from then on.

    Args:
        responses: The responses of the channel.
        sizes: Bounds of the inputs in the cells 0 to j, (j + 1, inputs).
        is_last: Whether j is the last cell.
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
    """Bounds of omega_u and omega_r along one axis, and of the remainders, rounded up."""
    law = inputs.deviations[name]
    sigma = inputs.sigma[name]
    remainder_bounds = inputs.remainders.channels[name]
    sizes = [law.of_command(sigma), law.of_integral(sigma), *[remainder_bounds[remainder] for remainder in remainders]]
    return [float_above(size) for size in sizes]


def with_slopes(
    vehicle: Vehicle, name: str, bounds: SignalBalls, inputs: Inputs, signals: Sequence[str], answers: np.ndarray
) -> Balls:
    """F of the signals of a channel in a cell, from the bounds of each signal at its phases."""
    t = arb(vehicle.problem["sample_time"])
    slopes = signal_slopes(vehicle.problem, name, vehicle.dampings[name], bounds, inputs.remainders)
    largest_values: dict[str, float] = {}
    for signal, value in zip(signals, answers.tolist(), strict=True):
        require_premise(bool(np.isfinite(value)), f"V4: the bound of {name}.{signal} is not finite")
        largest_values[signal] = max(value, largest_values.get(signal, 0.0))
    result = Balls()
    for signal, value in largest_values.items():
        growth = arb(0) if signal == EQUIVALENT else t / REACH * slopes[signal]
        result[signal] = (arb(value) + growth).upper()
    return result


def largest_bounds(bounds: Sequence[SignalBalls]) -> dict[str, Balls]:
    """The largest of each signal over the cells."""
    return {
        name: {signal: maximum(*[y[name][signal] for y in bounds]) for signal in bounds[0][name]} for name in CHANNELS
    }


def largest_inputs(inputs: Sequence[Inputs]) -> Inputs:
    """The largest deviations, remainders and tilt, and the farthest thrusts, over the cells."""
    rests = [cell.remainders for cell in inputs]
    channels = {
        name: {
            remainder: maximum(*[cell.channels[name][remainder] for cell in rests])
            for remainder in rests[0].channels[name]
        }
        for name in CHANNELS
    }
    rotors = Rotors(
        -maximum(*[-cell.rotors.smallest for cell in rests]),
        maximum(*[cell.rotors.largest for cell in rests]),
        maximum(*[cell.rotors.difference for cell in rests]),
        maximum(*[cell.rotors.sum for cell in rests]),
    )
    tilt = maximum(*[cell.tilt for cell in rests])
    behind_by = maximum(*[cell.behind_by for cell in rests])
    laws = {name: Deviations(*map(maximum, *[cell.deviations[name] for cell in inputs])) for name in CHANNELS}
    sigma = {name: maximum(*[cell.sigma[name] for cell in inputs]) for name in CHANNELS}
    return Inputs(Remainders(channels, rests[0].constant, tilt, rotors, behind_by), laws, sigma)
