"""Bounds in cells of time, for a vehicle that starts away from where it hovers, searched in floating point.

While the effect of a start decays, one bound for all times is loose. So each cell of time has its own bounds; the last
cell is all the time after the others. The effect of earlier cells' inputs is known when a cell is searched, so the
cell's bounds are a fixed point by themselves. docs/vehicle_proofs.md has the theorem.
"""

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

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
from dssc_jax.proofs.search.vehicle.cell_responses import CellLayout, CellResponses, cell_responses
from dssc_jax.proofs.search.vehicle.channels import GRAVITY, Damping, StraightLines
from dssc_jax.proofs.search.vehicle.deviations import ChannelDeviations, best_lines, deviations_of, points_of
from dssc_jax.proofs.search.vehicle.nominal import Nominal, nominal_of
from dssc_jax.proofs.search.vehicle.remainders import remainders_of
from dssc_jax.proofs.search.vehicle.responses import channel_response, channel_series
from dssc_jax.proofs.search.vehicle.rotors import Rotors
from dssc_jax.proofs.search.vehicle.slopes import signal_slopes
from dssc_jax.proofs.vehicle_problem import CHANNELS, VehicleProblem

LAYOUTS = ((0.2, 10.0), (0.2, 20.0), (0.5, 60.0))
"""Duration of a cell and time at which the last cell begins [s]; the first layout that leads to bounds is taken."""
MOVING_LAYOUTS = LAYOUTS[2:]
"""The layouts for a moving reference: the vehicle starts far from the nominal flight, and its wind acts for long."""
REGION_SHARES = (0.3, 0.6, 0.9, 0.0)
"""Regions for which lines are tried: shares of the way from the settled |sigma| to the start's, in logarithms."""
REGIONS = tuple((share, 1.0) for share in REGION_SHARES)
"""Pairs of such a share and the factor 1, which does not widen the region."""
MOVING_REGIONS = ((0.3, 1.0), (0.3, 1.12), (0.3, 1.25))
"""Shares of the way, and widenings of the region, for which lines are tried if the reference moves."""
EXTRA_CELLS = 20
"""Length of the beginning of the last cell, in cells, in which the largest responses to the start are sought."""
ITERATIONS = 400
"""Largest number of times that the map F is applied in a cell."""
SETTLED = 1e-4
"""Relative change of the bounds below which they count as a fixed point."""
TABLE_RATIO = 1.005
"""Ratio of neighbouring regions for which the deviations are tabulated."""
SMALLEST_REGION = 1e-7
"""Smallest |sigma| in the table."""
FIRST_BOUND = 1e-9
"""Bound of every signal with which the search in the first cell begins."""


@dataclass(frozen=True)
class CellBounds:
    """Bounds of all signals in time cells that imply themselves.

    Args:
        final: The bounds of the last cell, with the straight lines and the damping by drag of all cells.
        settled: The bounds of the vehicle that starts at rest, with the lines and the damping for the upper limits.
        samples: Number of samples of a cell other than the last.
        cells: Bounds of the signals in each cell other than the last.
    """

    final: VehicleBounds
    settled: VehicleBounds
    samples: int
    cells: list[Signals]


class DeviationTable:
    """Bounds of a channel's functions' deviations from straight lines, for a geometric grid of regions of |sigma|.

    An entry is computed at its first use and then kept, since the search uses the same regions often.

    Args:
        problem: The vehicle.
        name: Name of the channel.
        lines: The straight lines.
    """

    def __init__(self, problem: VehicleProblem, name: str, lines: StraightLines) -> None:
        """Store the arguments, and begin with an empty table."""
        self.problem = problem
        self.name = name
        self.lines = lines
        self.entries: dict[int, ChannelDeviations] = {}

    def at(self, sigma: float) -> ChannelDeviations:
        """Return the deviations in the smallest region of the grid that contains all |sigma| up to ``sigma``."""
        step = math.ceil(math.log(max(sigma, SMALLEST_REGION)) / math.log(TABLE_RATIO))
        if step not in self.entries:
            region = TABLE_RATIO**step
            self.entries[step] = deviations_of(points_of(self.problem, self.name, region), self.lines)
        return self.entries[step]


@dataclass(frozen=True)
class CellSearch:
    """The data that the search uses in all time cells.

    Args:
        problem: The vehicle.
        damping: Damping by drag.
        nominal: The nominal flight, from which the vehicle's deviation is bounded. None: the vehicle hovers.
        responses: Responses of each channel in time cells.
        tables: Bounds of the deviations of each channel's functions from straight lines.
        inflation_factor: Multiple of the usual widening of bounds, which lets the verifier confirm them.
    """

    problem: VehicleProblem
    damping: Damping
    nominal: Nominal | None
    responses: dict[str, CellResponses]
    tables: dict[str, DeviationTable]
    inflation_factor: float


def cell_bounds(problem: VehicleProblem, inflation_factor: float) -> CellBounds | Obstacle:
    """Search for bounds in time cells: try several layouts of cells and straight lines until one choice succeeds.

    Args:
        problem: The vehicle.
        inflation_factor: Multiple of the usual widening of bounds, which lets the verifier confirm them.

    Returns:
        The bounds, or why there are none: the obstacle of the settled vehicle or of the last choice.
    """
    settled = settled_bounds(problem, inflation_factor)
    if isinstance(settled, Obstacle):
        return settled
    is_moving = problem.reference is not None
    layouts = MOVING_LAYOUTS if is_moving else LAYOUTS
    regions = MOVING_REGIONS if is_moving else REGIONS
    result: CellBounds | Obstacle = Obstacle.GAIN
    for (duration, last_begin), (share, widening) in product(layouts, regions):
        layout = CellLayout(
            samples=max(1, round(duration / problem.sample_time)),
            earlier_cells=round(last_begin / duration),
        )
        lines = {name: lines_between(problem, name, settled.regions[name], share, widening) for name in CHANNELS}
        result = bounds_cell_by_cell(problem, settled, lines, layout, inflation_factor)
        if not isinstance(result, Obstacle):
            return result
    return result


def settled_bounds(problem: VehicleProblem, inflation_factor: float) -> VehicleBounds | Obstacle:
    """Search for bounds of the vehicle that starts at rest, or on the nominal flight; return them or the obstacle."""
    resting = {name: replace(channel, initial=(0.0, 0.0)) for name, channel in problem.channels.items()}
    return best_bounds(replace(problem, channels=resting), inflation_factor, from_start=False)


def lines_between(problem: VehicleProblem, name: str, sigma: float, share: float, widening: float) -> StraightLines:
    """Find the best straight lines of a channel for a region of |sigma| between the settled vehicle's and the start's.

    Args:
        problem: The vehicle.
        name: Name of the channel.
        sigma: Bound of |sigma| of the settled vehicle [m/s; rad/s in psi].
        share: Share of the way from this bound to the bound at the start, in logarithms.
        widening: Factor that widens the region.
    """
    start_sigma = problem.first_sigma(name)
    region = sigma * (start_sigma / sigma) ** share if start_sigma > sigma else sigma
    return best_lines(points_of(problem, name, widening * region), joint=problem.reference is not None)


def bounds_cell_by_cell(
    problem: VehicleProblem,
    settled: VehicleBounds,
    lines: dict[str, StraightLines],
    layout: CellLayout,
    inflation_factor: float,
) -> CellBounds | Obstacle:
    """Search for bounds that imply themselves in one cell after the other, the last one included.

    Args:
        problem: The vehicle.
        settled: Bounds of the settled vehicle, whose damping by drag is used in all cells.
        lines: The straight lines of each channel.
        layout: The division of time into cells.
        inflation_factor: Multiple of the usual widening of bounds, which lets the verifier confirm them.
    """
    search = cell_search(problem, settled.damping, lines, layout, inflation_factor)
    if search is None:
        return Obstacle.GAIN
    cells: list[Signals] = []
    inputs: dict[str, list[np.ndarray]] = {name: [] for name in CHANNELS}
    rotors: Rotors | None = None
    y: Signals = {name: dict.fromkeys(search.responses[name].response.names, FIRST_BOUND) for name in CHANNELS}
    for cell in range(layout.earlier_cells + 1):
        fixed_point = cell_fixed_point(search, inputs, y, rotors, is_last=cell == layout.earlier_cells)
        if fixed_point is None:
            return Obstacle.GAIN
        y = fixed_point.bounds
        rotors = fixed_point.rotors
        cells.append(y)
        for name in CHANNELS:
            inputs[name].append(fixed_point.inputs[name])
    if not slides_in_all_cells(search, cells):
        return Obstacle.SLIDING
    assert rotors is not None
    totals, _ = vehicle_totals(search.nominal, cells[-1])
    final = VehicleBounds(lines=lines, damping=settled.damping, bounds=cells[-1], rotors=rotors, totals=totals)
    return CellBounds(final=final, settled=settled, samples=layout.samples, cells=cells[:-1])


def cell_search(
    problem: VehicleProblem,
    damping: Damping,
    lines: dict[str, StraightLines],
    layout: CellLayout,
    inflation_factor: float,
) -> CellSearch | None:
    """Compute the data for the search in all cells; None if a channel is unstable or its responses last too long.

    Args:
        problem: The vehicle.
        damping: Damping by drag in all cells.
        lines: The straight lines of each channel.
        layout: The division of time into cells.
        inflation_factor: Multiple of the usual widening of bounds, which lets the verifier confirm them.
    """
    linear = linear_channels(problem, damping)
    if not is_stable(problem, linear, lines):
        return None
    nominal = nominal_of(problem, linear, lines, damping.plane)
    length = layout.samples * (layout.earlier_cells + EXTRA_CELLS)
    responses = {}
    for name in CHANNELS:
        channel = problem.channels[name]
        start_offsets = None if nominal is None else nominal.starts[name]
        response = channel_response(problem, channel, linear[name], lines[name], start_offsets)
        if response is None:
            return None
        series = channel_series(problem, channel, linear[name], lines[name], length, start_offsets)
        responses[name] = cell_responses(problem, name, response, series, layout)
    tables = {name: DeviationTable(problem, name, lines[name]) for name in CHANNELS}
    return CellSearch(problem, damping, nominal, responses, tables, inflation_factor)


def cells_proof_of(problem: VehicleProblem, result: CellBounds) -> JsonObject:
    """Make a certificate's proof from bounds in time cells.

    The upper limits use the linear channels of the settled vehicle; with a moving reference those of the cells (M0).
    """
    bounds = {}
    for name in CHANNELS:
        bounds[name] = {key: [cell[name][key] for cell in result.cells] for key in result.cells[0][name]}
    cells = {"samples": result.samples, "bounds": bounds}
    settled = None if problem.reference is not None else linear_channel_proofs(problem, result.settled)
    return proof_of(problem, result.final) | {"cells": cells, "settled": settled}


class CellFixedPoint(NamedTuple):
    """Bounds in one cell that imply themselves.

    Args:
        bounds: Bounds of the signals.
        inputs: Bounds of each channel's inputs while the signals are within ``bounds``, shape (inputs,) each.
        rotors: Bounds of the rotors.
    """

    bounds: Signals
    inputs: dict[str, np.ndarray]
    rotors: Rotors


def cell_fixed_point(
    search: CellSearch,
    inputs: dict[str, list[np.ndarray]],
    start: Signals,
    earlier: Rotors | None,
    *,
    is_last: bool,
) -> CellFixedPoint | None:
    """Search for bounds in one cell that imply themselves; None if there are none.

    The search begins at the bounds of the cell before. In the last cell smaller bounds are no better beginning, since
    earlier inputs then exceed those of the cell by more.

    Args:
        search: The data for the search in all cells.
        inputs: Bounds of each channel's inputs in the cells before, shape (inputs,) each.
        start: Bounds of the signals to begin with.
        earlier: Bounds of the rotors in the cells before; None in the first one.
        is_last: Whether the cell is the last one.
    """
    problem = search.problem
    from_start = {name: start_effects(search, name, cell=len(inputs[name])) for name in CHANNELS}
    y = start
    for _ in range(ITERATIONS):
        totals, couplings = vehicle_totals(search.nominal, y)
        try:
            remainders = remainders_of(problem, totals, search.damping, earlier, couplings)
        except OutOfRange:
            return None
        slopes = signal_slopes(problem, y, remainders.channels, search.damping)
        sizes = {}
        implied = {}
        for name in CHANNELS:
            responses = search.responses[name]
            sigma = totals[name]["sigma"]
            sizes[name] = input_sizes(
                responses.response, search.tables[name].at(sigma), sigma, remainders.channels[name]
            )
            rows = from_start[name] + input_effects(responses, inputs[name], sizes[name], is_last=is_last)
            point_bounds = rows.reshape(responses.response.gains.shape[:2])  # (points, signals)
            bounds = with_slopes(problem, responses.response, point_bounds, slopes[name])
            implied[name] = {key: inflated_bound(key, bound, search.inflation_factor) for key, bound in bounds.items()}
        change = largest_change(y, implied)
        y = implied
        if change <= SETTLED:
            return CellFixedPoint(y, sizes, remainders.rotors)
    return None


def largest_change(before: Signals, after: Signals) -> float:
    """Compute the largest relative change of a bound, over all signals."""
    changes = []
    for name in CHANNELS:
        changes += [abs(bound / before[name][key] - 1.0) for key, bound in after[name].items()]
    return max(changes)


def input_effects(
    responses: CellResponses, inputs: list[np.ndarray], current: np.ndarray, *, is_last: bool
) -> np.ndarray:
    """Bound the effects of a channel's inputs up to a cell on the channel's signals in this cell, shape (rows,).

    The input's bound of the first cell acts from t = 0 on; each change between two cells acts from the later cell on. A
    rise is multiplied by an upper bound of the sum of effects, a fall by a lower bound.

    Args:
        responses: Responses of the channel in time cells.
        inputs: Bounds of the channel's inputs in the cells before, shape (inputs,) each.
        current: Bounds of the channel's inputs in the cell, shape (inputs,).
        is_last: Whether the cell is the last one.
    """
    sizes = np.array([*inputs, current])
    first = sizes[0]
    changes = np.diff(sizes, axis=0)  # at the beginning of cells 1 to the current one
    rises = np.maximum(changes, 0.0)
    falls = np.maximum(-changes, 0.0)
    count = len(changes)
    # entry k of ``upper`` and ``lower`` belongs to a change k cells ago: the last change has entry 0
    upper = np.flip(responses.upper[:count], axis=0)
    lower = np.flip(responses.lower[:count], axis=0)
    if is_last:
        effects = responses.total_sum @ (first + rises.sum(axis=0))
    else:
        effects = responses.upper[count] @ first
        effects = effects + np.einsum("cri,ci->r", upper, rises)
    return effects - np.einsum("cri,ci->r", lower, falls)


def start_effects(search: CellSearch, name: str, cell: int) -> np.ndarray:
    """Bound the effects of the start and of the constant |o| <= k g on a channel's signals in one cell, shape (rows,).

    Args:
        search: The data for the search in all cells.
        name: Name of the channel.
        cell: Number of the cell.
    """
    problem = search.problem
    responses = search.responses[name]
    start_sigma = problem.first_sigma(name)
    deviations = search.tables[name].at(start_sigma)
    q_deviation = deviations.of_start(problem.channels[name].start, start_sigma, problem.sample_time)
    by_error, by_q = np.moveaxis(responses.starts[cell], -1, 0)  # ``by_error`` contains the factors E_0 and V_0
    effects = by_error + q_deviation * by_q
    return effects + problem.thrust_deviation * GRAVITY * responses.constant[cell]


def slides_in_all_cells(search: CellSearch, cells: list[Signals]) -> bool:
    """Whether every channel keeps sliding (V5) under the largest bounds of all cells."""
    largest: Signals = {}
    for name in CHANNELS:
        largest[name] = {key: max(cell[name][key] for cell in cells) for key in cells[0][name]}
    totals, couplings = vehicle_totals(search.nominal, largest)
    try:
        remainders = remainders_of(search.problem, totals, search.damping, couplings=couplings)
    except OutOfRange:
        return False
    deviations = {name: search.tables[name].at(totals[name]["sigma"]) for name in CHANNELS}
    return slides(search.problem, deviations, totals, remainders.channels)
