"""What the inputs of each time cell and the start do to a channel's signals in each cell, in floating point."""

from dataclasses import dataclass

import numpy as np

from dssc_jax.proofs.search.vehicle.responses import ChannelResponse, ChannelSeries, axes_of
from dssc_jax.proofs.vehicle_problem import VehicleProblem


@dataclass(frozen=True)
class CellResponses:
    """Responses of a channel in time cells; each row is a point of a sample and a signal.

    ``upper``, ``lower`` and ``total_sum`` are sums of the effects of inputs of size 1 that act from the beginning of a
    cell on.

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


def cell_responses(
    problem: VehicleProblem, name: str, response: ChannelResponse, series: ChannelSeries, samples: int, count: int
) -> CellResponses:
    """The responses of a channel in time cells.

    Args:
        problem: The vehicle.
        name: The channel.
        response: Its responses without cells.
        series: Its responses sample by sample.
        samples: Number of samples of a cell.
        count: Number of cells before the last one.
    """
    e, speed = problem.channels[name].initial
    by_error = e * np.abs(series.starts[..., 0]) + speed * np.abs(series.starts[..., 1])
    starts = np.stack([by_error + series.start_offset, np.abs(series.starts[..., 2])], axis=-1)
    sums = np.cumsum(series.effects, axis=0)
    axes = np.tile(axes_of(name, response), response.gains.shape[0])
    factors = np.ones((axes.size, sums.shape[-1]))
    factors[:, :2] = axes[:, None]  # the deviations of both axes as one vector
    starts_in_cells = with_last(in_cells(starts, samples), count)
    starts_in_cells[..., 1] *= axes
    upper = sums[samples - 1 :: samples] * factors
    return CellResponses(
        response=response,
        upper=upper,
        lower=np.concatenate([sums[:1] * factors, upper[:-1]]),
        total_sum=response.gains.reshape(axes.size, -1) * factors,
        constant=with_last(in_cells(np.abs(series.constant), samples), count),
        starts=starts_in_cells,
    )


def in_cells(values: np.ndarray, samples: int) -> np.ndarray:
    """The largest value in each cell of ``samples`` samples, (samples in all, ...) -> (cells, ...)."""
    return values.reshape(-1, samples, *values.shape[1:]).max(axis=1)


def with_last(values: np.ndarray, count: int) -> np.ndarray:
    """The values of the first ``count`` cells, and the largest of all later ones, (count + 1, ...)."""
    return np.concatenate([values[:count], values[count:].max(axis=0)[None]])
