"""Bounds in cells of time, for a vehicle that starts away from where it hovers, searched in floating point.

Cell after cell, the bounds are fixed points: what earlier cells still cause is known. docs/vehicle_proofs.md has the
theorem.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from dssc_jax.core.json_types import JsonObject
from dssc_jax.proofs.search.obstacles import Obstacle
from dssc_jax.proofs.search.vehicle.attitude import OutOfRange, Signals
from dssc_jax.proofs.search.vehicle.bounds import (
    VehicleBounds,
    best_bounds,
    inflated_bound,
    linear_channel_proofs,
    proof_of,
)
from dssc_jax.proofs.search.vehicle.bounds_map import (
    input_sizes,
    is_stable,
    linear_channels,
    slides,
    vehicle_totals,
    with_slopes,
)
from dssc_jax.proofs.search.vehicle.cell_responses import CellResponses, cell_responses
from dssc_jax.proofs.search.vehicle.channels import GRAVITY
from dssc_jax.proofs.search.vehicle.deviations import (
    ChannelDeviations,
    Slopes,
    best_slopes,
    deviations_of,
    points_of,
)
from dssc_jax.proofs.search.vehicle.nominal import Nominal, nominal_of
from dssc_jax.proofs.search.vehicle.remainders import remainders_of
from dssc_jax.proofs.search.vehicle.responses import channel_response, channel_series
from dssc_jax.proofs.search.vehicle.rotors import Rotors
from dssc_jax.proofs.search.vehicle.slopes import signal_slopes
from dssc_jax.proofs.vehicle_problem import CHANNELS, VehicleProblem

LAYOUTS = ((0.2, 10.0), (0.2, 20.0), (0.5, 60.0))
"""Durations of a cell, and times at which the last one begins [s]; the first layout that closes is taken."""
MOVING_LAYOUTS = LAYOUTS[2:]
"""Those ``LAYOUTS`` that are tried where the reference moves. The vehicle then starts far from the nominal flight, and
its wind acts for long."""
REGION_SHARES = (0.3, 0.6, 0.9, 0.0)
"""Regions for which slopes are tried: shares of the way from the settled |sigma| to the start's, in logarithms."""
REGIONS = tuple((share, 1.0) for share in REGION_SHARES)
MOVING_REGIONS = ((0.3, 1.0), (0.3, 1.12), (0.3, 1.25))
"""Shares of the way, and widenings of the region, for the slopes of a vehicle whose reference moves."""
EXTRA_CELLS = 20
"""Cells beyond the first ones over which what they cause in the last cell is compared."""
ITERATIONS = 400
SETTLED = 1e-4
TABLE_RATIO = 1.005
"""Ratio of the regions at which the deviations are tabulated."""
SMALLEST_REGION = 1e-7


@dataclass(frozen=True)
class CellBounds:
    """Bounds of all signals in time cells that imply themselves.

    Args:
        final: The bounds of the last cell, which is all the time after the others, with slopes and damping.
        settled: The bounds of the vehicle that starts at rest, with slopes and damping for the upper limits.
        samples: Number of samples of a cell other than the last.
        cells: Bounds of the signals in each cell other than the last.
    """

    final: VehicleBounds
    settled: VehicleBounds
    samples: int
    cells: list[Signals]


class DeviationTable:
    """The deviations of a channel's functions from straight lines by the size of the region, on a grid.

    They are computed when they are first asked for.
    """

    def __init__(self, problem: VehicleProblem, name: str, slopes: Slopes) -> None:
        """An empty table for the channel ``name``."""
        self.problem = problem
        self.name = name
        self.slopes = slopes
        self.entries: dict[int, ChannelDeviations] = {}

    def at(self, sigma: float) -> ChannelDeviations:
        """The deviations in the smallest tabulated region that holds |sigma|."""
        step = math.ceil(math.log(max(sigma, SMALLEST_REGION)) / math.log(TABLE_RATIO))
        if step not in self.entries:
            region = TABLE_RATIO**step
            self.entries[step] = deviations_of(points_of(self.problem, self.name, region), self.slopes)
        return self.entries[step]


@dataclass(frozen=True)
class CellSearch:
    """The data that the search has in common for all time cells.

    Args:
        problem: The vehicle.
        damping: Damping of drag in the plane and along z [1/s].
        nominal: The nominal flight, from which the bounds count; None: the vehicle hovers.
        responses: Responses of each channel.
        tables: Deviations of each channel's functions.
        room_factor: Factor of the room that is left for the verifier.
    """

    problem: VehicleProblem
    damping: tuple[float, float]
    nominal: Nominal | None
    responses: dict[str, CellResponses]
    tables: dict[str, DeviationTable]
    room_factor: float


def cell_bounds(problem: VehicleProblem, room_factor: float) -> CellBounds | Obstacle:
    """Search bounds in time cells, with several cells and slopes until one choice succeeds.

    Args:
        problem: The vehicle.
        room_factor: Factor of the room that is left for the verifier.

    Returns:
        The bounds, or why there are none.
    """
    settled = settled_bounds(problem, room_factor)
    if isinstance(settled, Obstacle):
        return settled
    result: CellBounds | Obstacle = Obstacle.GAIN
    has_reference = problem.reference is not None
    for duration, horizon in MOVING_LAYOUTS if has_reference else LAYOUTS:
        samples = max(1, round(duration / problem.sample_time))
        for share, widening in MOVING_REGIONS if has_reference else REGIONS:
            slopes = {name: slopes_between(problem, name, settled.regions[name], share, widening) for name in CHANNELS}
            result = bounds_cell_by_cell(problem, settled, slopes, samples, round(horizon / duration), room_factor)
            if not isinstance(result, Obstacle):
                return result
    return result


def settled_bounds(problem: VehicleProblem, room_factor: float) -> VehicleBounds | Obstacle:
    """Bounds of the vehicle that starts at rest, or on the nominal flight; or why there are none."""
    resting = {name: replace(channel, initial=(0.0, 0.0)) for name, channel in problem.channels.items()}
    return best_bounds(replace(problem, channels=resting), room_factor, from_start=False)


def slopes_between(problem: VehicleProblem, name: str, sigma: float, share: float, widening: float) -> Slopes:
    """The best slopes for a region between that of the settled vehicle and that of the start, or a wider one.

    Args:
        problem: The vehicle.
        name: The channel.
        sigma: Bound of |sigma| of the settled vehicle.
        share: Share of the way from it to the start's, in logarithms.
        widening: Factor on the region.
    """
    start_sigma = problem.first_sigma(name)
    region = sigma * (start_sigma / sigma) ** share if start_sigma > sigma else sigma
    return best_slopes(points_of(problem, name, widening * region), joint=problem.reference is not None)


def bounds_cell_by_cell(
    problem: VehicleProblem,
    settled: VehicleBounds,
    slopes: dict[str, Slopes],
    samples: int,
    count: int,
    room_factor: float,
) -> CellBounds | Obstacle:
    """Search bounds in cell after cell, and in the time after them.

    Args:
        problem: The vehicle.
        settled: Bounds of the settled vehicle, whose damping of drag is taken.
        slopes: Slopes of the straight lines in place of each channel's functions.
        samples: Number of samples of a cell.
        count: Number of cells before the last one.
        room_factor: Factor of the room that is left for the verifier.
    """
    search = cell_search(problem, settled.damping, slopes, samples, count, room_factor)
    if search is None:
        return Obstacle.GAIN
    cells: list[Signals] = []
    inputs: dict[str, list[np.ndarray]] = {name: [] for name in CHANNELS}
    rotors: Rotors | None = None
    y: Signals = {name: dict.fromkeys(search.responses[name].response.names, 1e-9) for name in CHANNELS}
    for _ in range(count + 1):
        fixed_point = cell_fixed_point(search, inputs, y, rotors, final=len(cells) == count)
        if fixed_point is None:
            return Obstacle.GAIN
        y, sizes, rotors = fixed_point
        cells.append(y)
        for name in CHANNELS:
            inputs[name].append(sizes[name])
    if not slides_in_all_cells(search, cells):
        return Obstacle.SLIDING
    assert rotors is not None
    totals, _ = vehicle_totals(search.nominal, cells[-1])
    final = VehicleBounds(slopes, settled.damping, cells[-1], rotors, totals)
    return CellBounds(final, settled, samples, cells[:-1])


def cell_search(
    problem: VehicleProblem,
    damping: tuple[float, float],
    slopes: dict[str, Slopes],
    samples: int,
    count: int,
    room_factor: float,
) -> CellSearch | None:
    """The data of the search; None if a channel is not stable, or its responses last too long."""
    linear = linear_channels(problem, damping)
    if not is_stable(problem, linear, slopes):
        return None
    nominal = nominal_of(problem, linear, slopes, damping[0])
    responses = {}
    for name in CHANNELS:
        channel = problem.channels[name]
        start_offsets = None if nominal is None else nominal.starts[name]
        response = channel_response(problem, channel, linear[name], slopes[name], start_offsets)
        if response is None:
            return None
        length = samples * (count + EXTRA_CELLS)
        series = channel_series(problem, channel, linear[name], slopes[name], length, start_offsets)
        responses[name] = cell_responses(problem, name, response, series, samples, count)
    tables = {name: DeviationTable(problem, name, slopes[name]) for name in CHANNELS}
    return CellSearch(problem, damping, nominal, responses, tables, room_factor)


def cells_proof_of(problem: VehicleProblem, result: CellBounds) -> JsonObject:
    """The proof with time cells, as a certificate holds it."""
    bounds = {}
    for name in CHANNELS:
        bounds[name] = {key: [cell[name][key] for cell in result.cells] for key in result.cells[0][name]}
    cells = {"samples": result.samples, "bounds": bounds}
    settled = None if problem.reference is not None else linear_channel_proofs(problem, result.settled)
    return proof_of(problem, result.final) | {"cells": cells, "settled": settled}


def cell_fixed_point(
    search: CellSearch,
    inputs: dict[str, list[np.ndarray]],
    start: Signals,
    earlier: Rotors | None,
    *,
    final: bool,
) -> tuple[Signals, dict[str, np.ndarray], Rotors] | None:
    """Bounds of a cell that imply themselves, bounds of the inputs that they allow, and the rotors.

    The search for the fixed point begins at the bounds of the cell before: in the last cell, smaller bounds are not
    better ones, since earlier inputs exceed them by more.

    Args:
        search: The data of the search.
        inputs: Bounds of each channel's inputs in the cells before.
        start: Bounds of the signals to begin with.
        earlier: The rotors in the cells before; None in the first one.
        final: Whether the cell is the last one.

    Returns:
        None if there are no such bounds.
    """
    problem = search.problem
    base = {name: start_effects(search, name, len(inputs[name])) for name in CHANNELS}
    y = start
    for _ in range(ITERATIONS):
        totals, couplings = vehicle_totals(search.nominal, y)
        try:
            remainders, rotors = remainders_of(problem, totals, search.damping, earlier, couplings)
        except OutOfRange:
            return None
        slopes = signal_slopes(problem, y, remainders, search.damping)
        sizes = {}
        implied = {}
        for name in CHANNELS:
            responses = search.responses[name]
            sigma = totals[name]["sigma"]
            sizes[name] = input_sizes(responses.response, search.tables[name].at(sigma), sigma, remainders[name])
            rows = base[name] + input_effects(responses, inputs[name], sizes[name], final=final)
            point_bounds = rows.reshape(responses.response.gains.shape[:2])
            bounds = with_slopes(problem, responses.response, point_bounds, slopes[name])
            implied[name] = {key: inflated_bound(key, bound, search.room_factor) for key, bound in bounds.items()}
        changes = [abs(implied[name][key] / y[name][key] - 1.0) for name in CHANNELS for key in implied[name]]
        y = implied
        if max(changes) <= SETTLED:
            return y, sizes, rotors
    return None


def input_effects(
    responses: CellResponses, inputs: list[np.ndarray], current: np.ndarray, *, final: bool
) -> np.ndarray:
    """Bounds of what a channel's inputs in a cell and in those before cause in the cell, (rows,).

    An input is that of the first cell from t = 0 on, plus its changes from cell to cell, from then on.

    Args:
        responses: Responses of the channel.
        inputs: Bounds of its inputs in the cells before, (inputs,) each.
        current: Bounds of its inputs in the cell, (inputs,).
        final: Whether the cell is the last one.
    """
    sizes = np.array([*inputs, current])
    changes = np.diff(sizes, axis=0)
    count = len(changes)
    if final:
        result = responses.total_sum @ (sizes[0] + np.maximum(changes, 0.0).sum(axis=0))
    else:
        result = responses.upper[count] @ sizes[0]
        result = result + np.einsum("cri,ci->r", responses.upper[:count][::-1], np.maximum(changes, 0.0))
    return result - np.einsum("cri,ci->r", responses.lower[:count][::-1], np.maximum(-changes, 0.0))


def start_effects(search: CellSearch, name: str, cell: int) -> np.ndarray:
    """Bounds of what the start and the constant of a channel cause in a cell, (rows,)."""
    problem = search.problem
    responses = search.responses[name]
    start_sigma = problem.first_sigma(name)
    deviations = search.tables[name].at(start_sigma)
    deviation = deviations.of_start(problem.channels[name].start, start_sigma, problem.sample_time)
    result = responses.starts[cell, :, 0] + deviation * responses.starts[cell, :, 1]
    return result + problem.thrust_deviation * GRAVITY * responses.constant[cell]


def slides_in_all_cells(search: CellSearch, cells: list[Signals]) -> bool:
    """Whether every channel slides under the largest bounds of all cells."""
    largest: Signals = {}
    for name in CHANNELS:
        largest[name] = {key: max(cell[name][key] for cell in cells) for key in cells[0][name]}
    totals, couplings = vehicle_totals(search.nominal, largest)
    try:
        remainders, _ = remainders_of(search.problem, totals, search.damping, couplings=couplings)
    except OutOfRange:
        return False
    deviations = {name: search.tables[name].at(totals[name]["sigma"]) for name in CHANNELS}
    return slides(search.problem, deviations, totals, remainders)
