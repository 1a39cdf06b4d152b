"""Bounds in cells of time, for a vehicle that starts away from where it hovers, searched in floating point.

Cell after cell, the bounds are fixed points: what earlier cells still cause is known. docs/vehicle_proofs.md has the
theorem.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from dssc_jax.core.json_types import JsonObject
from dssc_jax.proofs.search.obstacles import Obstacle
from dssc_jax.proofs.search.vehicle.bounds import (
    VehicleBounds,
    axes_of,
    best_bounds,
    inflated_bound,
    input_sizes,
    is_stable,
    linear_channels,
    middle_of,
    proof_of,
    slides,
    vehicle_totals,
    with_slopes,
)
from dssc_jax.proofs.search.vehicle.channels import GRAVITY
from dssc_jax.proofs.search.vehicle.deviations import (
    ChannelDeviations,
    Slopes,
    best_slopes,
    deviations_of,
    points_of,
)
from dssc_jax.proofs.search.vehicle.nominal import Nominal, nominal_of
from dssc_jax.proofs.search.vehicle.remainders import OutOfRange, Rotors, Signals, remainders_of, slopes_of
from dssc_jax.proofs.search.vehicle.responses import ChannelResponse, ChannelSeries, channel_response, channel_series
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
    """Bounds in cells of time.

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


@dataclass(frozen=True)
class Kernels:
    """Sums of the effects that inputs of size 1 have on a channel if they act from the beginning of a cell on.

    Args:
        response: The channel's response without cells.
        upper: Entry k is the sum up to the last sample of the cell k cells later, (cells, rows, inputs).
        lower: Entry k is the sum before the first sample of the cell k cells later, (cells, rows, inputs).
        total_sum: The sum over all later samples, (rows, inputs).
        constant: Largest response to the constant in each cell and in the last, (cells, rows).
        starts: Largest responses in each cell: to the start with e and e', and to q_(-1), (cells, rows, 2).
    """

    response: ChannelResponse
    upper: np.ndarray
    lower: np.ndarray
    total_sum: np.ndarray
    constant: np.ndarray
    starts: np.ndarray


class DeviationTable:
    """The deviations of a channel's functions by the size of the region, on a grid."""

    def __init__(self, problem: VehicleProblem, name: str, slopes: Slopes) -> None:
        """An empty table."""
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


def cell_bounds(problem: VehicleProblem, room: float = 1.0) -> CellBounds | Obstacle:
    """Bounds in cells of time, or why there are none; ``room`` multiplies the room for the verifier."""
    settled = settled_bounds(problem, room)
    if isinstance(settled, Obstacle):
        return settled
    result: CellBounds | Obstacle = Obstacle.GAIN
    has_reference = problem.reference is not None
    for duration, horizon in MOVING_LAYOUTS if has_reference else LAYOUTS:
        samples = max(1, round(duration / problem.sample_time))
        for share, widening in MOVING_REGIONS if has_reference else REGIONS:
            slopes = {name: slopes_between(problem, name, settled.regions[name], share, widening) for name in CHANNELS}
            result = march(problem, settled, slopes, samples, round(horizon / duration), room)
            if not isinstance(result, Obstacle):
                return result
    return result


def slopes_between(problem: VehicleProblem, name: str, sigma: float, share: float, widening: float) -> Slopes:
    """The best slopes for a region between that of the settled vehicle and that of the start, or a wider one."""
    start_sigma = problem.first_sigma(name)
    region = sigma * (start_sigma / sigma) ** share if start_sigma > sigma else sigma
    return best_slopes(points_of(problem, name, widening * region), joint=problem.reference is not None)


def march(
    problem: VehicleProblem,
    settled: VehicleBounds,
    slopes: dict[str, Slopes],
    samples: int,
    count: int,
    room: float,
) -> CellBounds | Obstacle:
    """Bounds of ``count`` cells and of the time after them, with given slopes and damping of drag."""
    linear = linear_channels(problem, settled.damping)
    if not is_stable(problem, linear, slopes):
        return Obstacle.GAIN
    nominal = nominal_of(problem, linear, slopes, settled.damping[0])
    kernels = {}
    for name in CHANNELS:
        channel = problem.channels[name]
        start_offsets = None if nominal is None else nominal.starts[name]
        response = channel_response(problem, channel, linear[name], slopes[name], start_offsets)
        if response is None:
            return Obstacle.GAIN
        length = samples * (count + EXTRA_CELLS)
        series = channel_series(problem, channel, linear[name], slopes[name], length, start_offsets)
        kernels[name] = kernels_of(problem, name, response, series, samples, count)
    tables = {name: DeviationTable(problem, name, slopes[name]) for name in CHANNELS}
    cells: list[Signals] = []
    inputs: dict[str, list[np.ndarray]] = {name: [] for name in CHANNELS}
    rotors: Rotors | None = None
    y: Signals = {name: dict.fromkeys(kernels[name].response.names, 1e-9) for name in CHANNELS}
    for _ in range(count + 1):
        fixed_point = cell_fixed_point(
            problem, kernels, tables, inputs, settled.damping, nominal, y, rotors, room, final=len(cells) == count
        )
        if fixed_point is None:
            return Obstacle.GAIN
        y, sizes, rotors = fixed_point
        cells.append(y)
        for name in CHANNELS:
            inputs[name].append(sizes[name])
    if not slides_in_all_cells(problem, tables, cells, settled.damping, nominal):
        return Obstacle.SLIDING
    assert rotors is not None
    totals, _ = vehicle_totals(nominal, cells[-1])
    final = VehicleBounds(slopes, settled.damping, cells[-1], rotors, totals)
    return CellBounds(final, settled, samples, cells[:-1])


def cells_proof_of(problem: VehicleProblem, result: CellBounds) -> JsonObject:
    """The proof as a certificate holds it."""
    bounds = {
        name: {key: [cell[name][key] for cell in result.cells] for key in result.cells[0][name]} for name in CHANNELS
    }
    cells = {"samples": result.samples, "bounds": bounds}
    settled = None if problem.reference is not None else middle_of(problem, result.settled)
    return proof_of(problem, result.final) | {"cells": cells, "settled": settled}


def kernels_of(
    problem: VehicleProblem, name: str, response: ChannelResponse, series: ChannelSeries, samples: int, count: int
) -> Kernels:
    """The kernels of a channel, from its responses sample by sample."""
    e, speed = problem.channels[name].initial
    by_error = e * np.abs(series.starts[..., 0]) + speed * np.abs(series.starts[..., 1])
    starts = np.stack([by_error + series.known, np.abs(series.starts[..., 2])], axis=-1)
    sums = np.cumsum(series.effects, axis=0)
    axes = np.tile(axes_of(name, response), response.gains.shape[0])
    factors = np.ones((axes.size, sums.shape[-1]))
    factors[:, :2] = axes[:, None]  # the deviations of both axes as one vector
    by_start = with_last(in_cells(starts, samples), count)
    by_start[..., 1] *= axes
    constant = with_last(in_cells(np.abs(series.constant), samples), count)
    total_sum = response.gains.reshape(axes.size, -1) * factors
    upper = sums[samples - 1 :: samples] * factors
    lower = np.concatenate([sums[:1] * factors, upper[:-1]])
    return Kernels(response=response, upper=upper, lower=lower, total_sum=total_sum, constant=constant, starts=by_start)


def in_cells(values: np.ndarray, samples: int) -> np.ndarray:
    """The largest value in each cell."""
    return values.reshape(-1, samples, *values.shape[1:]).max(axis=1)


def with_last(values: np.ndarray, count: int) -> np.ndarray:
    """The values of the first cells, and the largest of all later ones."""
    return np.concatenate([values[:count], values[count:].max(axis=0)[None]])


def cell_fixed_point(
    problem: VehicleProblem,
    kernels: dict[str, Kernels],
    tables: dict[str, DeviationTable],
    inputs: dict[str, list[np.ndarray]],
    damping: tuple[float, float],
    nominal: Nominal | None,
    start: Signals,
    earlier: Rotors | None,
    room: float,
    *,
    final: bool,
) -> tuple[Signals, dict[str, np.ndarray], Rotors] | None:
    """Bounds of a cell that imply themselves, what they allow, and the rotors; None if there are none.

    The search for the fixed point begins at the bounds of the cell before: in the last cell, smaller bounds are not
    better ones, since earlier inputs exceed them by more.
    """
    base = {name: start_effects(problem, name, kernels[name], tables[name], len(inputs[name])) for name in CHANNELS}
    y = start
    for _ in range(ITERATIONS):
        totals, couplings = vehicle_totals(nominal, y)
        try:
            remainders, rotors = remainders_of(problem, totals, damping, earlier, couplings)
        except OutOfRange:
            return None
        slopes = slopes_of(problem, y, remainders, damping)
        sizes = {}
        implied = {}
        for name in CHANNELS:
            kernel = kernels[name]
            sigma = totals[name]["sigma"]
            sizes[name] = input_sizes(kernel.response, tables[name].at(sigma), sigma, remainders[name])
            rows = base[name] + input_effects(kernel, inputs[name], sizes[name], final=final)
            point_bounds = rows.reshape(kernel.response.gains.shape[:2])
            bounds = with_slopes(problem, kernel.response, point_bounds, slopes[name])
            implied[name] = {key: inflated_bound(key, bound, room) for key, bound in bounds.items()}
        changes = [abs(implied[name][key] / y[name][key] - 1.0) for name in CHANNELS for key in implied[name]]
        y = implied
        if max(changes) <= SETTLED:
            return y, sizes, rotors
    return None


def input_effects(kernel: Kernels, inputs: list[np.ndarray], current: np.ndarray, *, final: bool) -> np.ndarray:
    """Bounds of what the inputs of a cell and of earlier ones cause in the cell, (rows,).

    An input is that of the first cell from t = 0 on, plus its changes from cell to cell, from then on.
    """
    sizes = np.array([*inputs, current])
    changes = np.diff(sizes, axis=0)
    count = len(changes)
    if final:
        result = kernel.total_sum @ (sizes[0] + np.maximum(changes, 0.0).sum(axis=0))
    else:
        result = kernel.upper[count] @ sizes[0]
        result = result + np.einsum("cri,ci->r", kernel.upper[:count][::-1], np.maximum(changes, 0.0))
    return result - np.einsum("cri,ci->r", kernel.lower[:count][::-1], np.maximum(-changes, 0.0))


def start_effects(problem: VehicleProblem, name: str, kernel: Kernels, table: DeviationTable, cell: int) -> np.ndarray:
    """Bounds of the effects in a cell of the start and of the constant, (rows,)."""
    start_sigma = problem.first_sigma(name)
    deviation = table.at(start_sigma).of_start(problem.channels[name].start, start_sigma, problem.sample_time)
    result = kernel.starts[cell, :, 0] + deviation * kernel.starts[cell, :, 1]
    return result + problem.thrust_deviation * GRAVITY * kernel.constant[cell]


def slides_in_all_cells(
    problem: VehicleProblem,
    tables: dict[str, DeviationTable],
    cells: list[Signals],
    damping: tuple[float, float],
    nominal: Nominal | None,
) -> bool:
    """Whether the loop slides under the largest bounds of all cells."""
    largest = {name: {key: max(y[name][key] for y in cells) for key in cells[0][name]} for name in CHANNELS}
    totals, couplings = vehicle_totals(nominal, largest)
    try:
        remainders, _ = remainders_of(problem, totals, damping, couplings=couplings)
    except OutOfRange:
        return False
    deviations = {name: tables[name].at(totals[name]["sigma"]) for name in CHANNELS}
    return slides(problem, deviations, totals, remainders)


def settled_bounds(problem: VehicleProblem, room: float) -> VehicleBounds | Obstacle:
    """Bounds of the vehicle that starts at rest, or on the nominal flight, or why there are none."""
    resting = {name: replace(channel, initial=(0.0, 0.0)) for name, channel in problem.channels.items()}
    return best_bounds(replace(problem, channels=resting), room, from_start=False)
