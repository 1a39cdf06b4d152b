"""Effects of each time cell's inputs, of the constant and of the start on a channel's signals in every cell.

An input whose bound changes from cell to cell is split up: the bound of the first cell acts from t = 0 on, and each
change from the first sample of its cell on. So the responses here are sums of the effects of an input that acts from
some sample on, G_l in docs/vehicle_proofs.md. All numbers are in floating point.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dssc_jax.proofs.search.vehicle.responses import ChannelResponse, ChannelSeries, axis_factors
from dssc_jax.proofs.vehicle_problem import VehicleProblem


class CellLayout(NamedTuple):
    """The division of time into cells.

    Args:
        samples: Number of samples of a cell other than the last.
        earlier_cells: Number of cells before the last one, which has no end.
    """

    samples: int
    earlier_cells: int


@dataclass(frozen=True)
class CellResponses:
    """Responses of a channel in time cells. A row is one point of a sample and one signal.

    ``upper``, ``lower`` and ``total_sum`` belong to inputs of size 1 that act from the first sample of a cell on.

    Args:
        response: The channel's responses without cells.
        upper: Entry k is the sum of the effects up to the last sample of the cell k cells after the input's; shape
            (cells, rows, inputs).
        lower: Entry k is the sum of the effects up to the last sample before the same cell or, for k = 0, the effect in
            the same sample; shape (cells, rows, inputs).
        total_sum: The sum of the effects over all samples, shape (rows, inputs).
        constant: Largest response to the constant in each cell, the last one included, shape (cells + 1, rows).
        starts: Largest responses in each cell, the last one included: to e and e' at the start together, with the known
            offset from the nominal flight, and to a q_(-1) of 1; shape (cells + 1, rows, 2).
    """

    response: ChannelResponse
    upper: np.ndarray
    lower: np.ndarray
    total_sum: np.ndarray
    constant: np.ndarray
    starts: np.ndarray


def cell_responses(
    problem: VehicleProblem, name: str, response: ChannelResponse, series: ChannelSeries, layout: CellLayout
) -> CellResponses:
    """Gather the responses of a channel, sample by sample, into time cells.

    Args:
        problem: The vehicle.
        name: Name of the channel.
        response: The channel's responses without cells.
        series: The channel's responses sample by sample.
        layout: The division of time into cells.
    """
    e, e_dot = problem.channels[name].initial
    by_e, by_e_dot, by_q = np.moveaxis(np.abs(series.starts), -1, 0)
    starts = np.stack([e * by_e + e_dot * by_e_dot + series.start_offset, by_q], axis=-1)
    sums = np.cumsum(series.effects, axis=0)  # G_l
    row_factors = np.tile(axis_factors(name, response), response.gains.shape[0])  # h of each row
    factors = np.ones((row_factors.size, sums.shape[-1]))
    factors[:, :2] = row_factors[:, None]  # omega_u and omega_r of both axes are one vector
    starts_in_cells = largest_in_cells(starts, layout)
    starts_in_cells[..., 1] *= row_factors
    upper = sums[layout.samples - 1 :: layout.samples] * factors  # at the last sample of each cell
    return CellResponses(
        response=response,
        upper=upper,
        lower=np.concatenate([sums[:1] * factors, upper[:-1]]),
        total_sum=response.gains.reshape(row_factors.size, -1) * factors,
        constant=largest_in_cells(np.abs(series.constant), layout),
        starts=starts_in_cells,
    )


def largest_in_cells(values: np.ndarray, layout: CellLayout) -> np.ndarray:
    """The largest value in each cell, then in the last cell, which has all later samples.

    Args:
        values: Values at the samples, shape (samples, ...); their number is a multiple of a cell's.
        layout: The division of time into cells.

    Returns:
        Shape (cells + 1, ...).
    """
    largest = values.reshape(-1, layout.samples, *values.shape[1:]).max(axis=1)
    largest_in_last = largest[layout.earlier_cells :].max(axis=0)
    return np.concatenate([largest[: layout.earlier_cells], largest_in_last[None]])
