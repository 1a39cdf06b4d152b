"""Bounds of the effects of a time cell's inputs in each later cell; docs/vehicle_proofs.md has the definitions.

eps_l bounds the effect of an input 1 in one sample on a signal l samples later, and G_l is the sum of eps_0 to eps_l.
All sums are taken in float64, from samples with bounds of their errors. The terms are not negative, so that the factor
``SUMMED`` covers the rounding of a sum.
"""

from typing import NamedTuple

import numpy as np
from flint import arb

from dssc_jax.proofs.verifier.balls import Rejected, side_by_side
from dssc_jax.proofs.verifier.impulse_responses import (
    ROUNDED,
    SUMMED,
    TAIL_SHARE,
    UNDERFLOW,
    magnitudes,
    middles,
    response_blocks,
)
from dssc_jax.proofs.verifier.vehicle.certificate import VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import ALONG_AXES
from dssc_jax.proofs.verifier.vehicle.deviations import float_above
from dssc_jax.proofs.verifier.vehicle.responses import FIRST_OFFSET, ChannelObservation, integral_within

OMEGAS = 2
"""Number of the inputs omega_u and omega_r, which stand before the remainders."""
SMALL = 1e-6
"""Share of a response's peak below which the rest of the response is negligible, and the computation may end."""


class CellResponses(NamedTuple):
    """Bounds of a channel's responses in J time cells of c samples and in the last one.

    The inputs are omega_u, omega_r and the remainders. A row is one signal at one phase of a sample.

    Args:
        signals: Name of the signal of each row.
        remainders: Names of the inputs after omega_u and omega_r.
        upper: Entry m < J is an upper bound of G at the last sample of the cell m cells after the input's,
            G_(c m + c - 1); shape (J, rows, inputs).
        lower: Entry m < J is a lower bound of G at the last sample before the same cell, G_(c m - 1), or of eps_0 for
            m = 0; shape (J, rows, inputs).
        total_sum: Upper bound of the limit of G_l, shape (rows, inputs).
        starts: The largest response in each cell to a start within E_0 and V_0, including the start's known offset from
            the nominal flight; shape (J + 1, rows).
        deviations: The largest response in each cell to a deviation 1 of q_(-1), shape (J + 1, rows).
        constants: The largest response in each cell to a constant 1 from t = 0 on, shape (J + 1, rows).
    """

    signals: list[str]
    remainders: list[str]
    upper: np.ndarray
    lower: np.ndarray
    total_sum: np.ndarray
    starts: np.ndarray
    deviations: np.ndarray
    constants: np.ndarray


def cell_responses(
    problem: VehicleProblem, name: str, observation: ChannelObservation, samples: int, count: int
) -> CellResponses:
    """(V1) The responses of a channel in time cells.

    Args:
        problem: The certificate's problem.
        name: Name of the channel.
        observation: The channel's signals and inputs at the samples.
        samples: c, number of samples of a cell.
        count: J, number of cells before the last one, at least 1.

    Raises:
        Rejected: The responses decay too slowly.
    """
    t = arb(problem["sample_time"])
    initial = np.array([float(value) for value in problem["channels"][name]["initial"]])  # E_0 and V_0
    is_along_axes = np.array([phase_signal.name in ALONG_AXES for phase_signal in observation.phase_signals])
    weights = input_weights(observation, t)
    q = observation.inputs.ncols()
    offset_middles = middles(observation.offsets)
    offset_errors = ROUNDED * magnitudes(observation.offsets)
    tail_factor = float_above((2 / observation.decay).upper())
    direct = direct_effects(observation, t)  # eps_0
    # of cell m, the sum of eps_l over l from c m to c m + c - 1; the last entry is the sum over all later l
    effect_sums = np.zeros((count + 1, *direct.shape))
    effect_sums[0] = direct
    peaks = np.zeros((count + 1, len(observation.phase_signals), 3))  # of start, deviation of q_(-1) and constant
    sample_count = 0
    columns = side_by_side(observation.inputs, observation.starts)
    for block in response_blocks(observation.sampled.a, observation.rows, columns, observation.p):
        sample_errors = block.error + block.radius_effect
        effects = (np.abs(block.response[..., :q]) + sample_errors[:, :q]) @ weights
        # the response at sample k after an input is eps_(k + 1), the effect one sample later than eps_k
        effect_places = cells_of(sample_count + 1, len(effects), samples, count)
        effect_sums[effect_places.cells] += np.add.reduceat(effects, effect_places.first_places, axis=0)
        values = np.abs(block.response[..., q:] + offset_middles) + sample_errors[:, q:] + offset_errors
        places = cells_of(sample_count, len(values), samples, count)
        responses = start_responses(values, initial, is_along_axes)
        cell_peaks = np.maximum.reduceat(responses, places.first_places, axis=0)
        peaks[places.cells] = np.maximum(peaks[places.cells], cell_peaks)
        sample_count += len(values)
        tail = (block.tail[:, :q] * tail_factor) @ weights
        decaying = start_responses(block.tail[:, q:], initial, is_along_axes)
        sums_end = np.all(tail <= TAIL_SHARE * effect_sums.sum(axis=0))
        if sample_count > samples * (count + 1) and sums_end and np.all(decaying <= negligible_responses(peaks)):
            last_values = block.tail[:, q:] + np.abs(offset_middles) + offset_errors
            peaks[-1] = np.maximum(peaks[-1], start_responses(last_values, initial, is_along_axes))
            sums = np.concatenate([direct[None], np.cumsum(effect_sums[:-1], axis=0)])  # G at the ends of the cells
            starts, deviations, constants = np.moveaxis(SUMMED * peaks, 2, 0)
            return CellResponses(
                signals=[phase_signal.name for phase_signal in observation.phase_signals],
                remainders=list(observation.curves),
                upper=SUMMED * sums[1:],
                lower=sums[:-1] / SUMMED,
                total_sum=SUMMED * (sums[-1] + effect_sums[-1] + tail),
                starts=starts,
                deviations=deviations,
                constants=constants,
            )
    raise Rejected(f"V1: the responses of {name} decay too slowly")


def negligible_responses(peaks: np.ndarray) -> np.ndarray:
    """Sizes below which the rest of the responses to start, deviation and constant may end them, shape (rows, 3).

    The responses to the start and to a deviation of q_(-1) may also end once their rest is below their own peak in the
    last cell, which it then cannot raise.

    Args:
        peaks: Largest responses so far in each cell, shape (J + 1, rows, 3).
    """
    negligible = np.maximum(SMALL * peaks.max(axis=0), UNDERFLOW)
    negligible[:, :2] = np.maximum(negligible[:, :2], peaks[-1, :, :2])
    return negligible


def start_responses(sizes: np.ndarray, initial: np.ndarray, is_along_axes: np.ndarray) -> np.ndarray:
    """Combine responses to the columns of the starts: to the whole start, to a deviation of q_(-1), to the constant.

    Args:
        sizes: Magnitudes of the responses to each column of the starts, shape (..., rows, 4 + axes).
        initial: E_0 and V_0.
        is_along_axes: Whether the signal of a row is bounded along each axis, shape (rows,). If so, the larger of its
            known offsets counts; otherwise their norm does.

    Returns:
        Shape (..., rows, 3).
    """
    by_error = sizes[..., :2] @ initial
    by_q = sizes[..., 2]
    by_constant = sizes[..., 3]
    offsets = sizes[..., FIRST_OFFSET:]
    by_offset = np.where(is_along_axes, offsets.max(axis=-1, initial=0.0), np.sqrt((offsets**2).sum(axis=-1)))
    return np.stack([by_error + by_offset, by_q, by_constant], axis=-1)


class CellPlaces(NamedTuple):
    """The time cells in which the samples of a block lie.

    Args:
        cells: Numbers of the cells, in rising order, shape (cells,).
        first_places: Place of each cell's first sample among the samples, shape (cells,).
    """

    cells: np.ndarray
    first_places: np.ndarray


def cells_of(earlier_count: int, length: int, samples: int, count: int) -> CellPlaces:
    """Find the time cells in which the samples of a block lie.

    Args:
        earlier_count: Number of samples before the block.
        length: Number of samples of the block.
        samples: Number of samples of a cell.
        count: Number of cells before the last one, which has all later samples.
    """
    cell_of_sample = np.minimum((earlier_count + np.arange(length)) // samples, count)
    first_places = np.flatnonzero(np.diff(cell_of_sample, prepend=-1))  # where the cell changes
    return CellPlaces(cell_of_sample[first_places], first_places)


def input_weights(observation: ChannelObservation, t: arb) -> np.ndarray:
    """Weights that turn the effects of the columns of ``observation.inputs`` into those of the inputs, rounded up.

    omega_u and omega_r have a column each. A remainder acts by the integral of |row e^(A_c r) b| over a sample, which
    is at most the trapezoidal rule over the column's points plus the share of the column's second derivative.

    Args:
        observation: The channel's signals and inputs at the samples.
        t: T_s [s].

    Returns:
        Shape (columns, inputs).
    """
    pieces = next(iter(observation.curves.values())).pieces  # the same for all remainders
    columns_of_curve = pieces + 2  # the points, and the middle of the bend
    first_unit_column = OMEGAS + columns_of_curve * len(observation.curves)
    weights = np.zeros((observation.inputs.ncols(), OMEGAS + len(observation.curves)))
    weights[:OMEGAS, :OMEGAS] = np.eye(OMEGAS)
    piece = t / pieces
    bend = (pieces * piece**3 / 12).upper()
    for place, curve in enumerate(observation.curves.values()):
        of_points = np.full(pieces + 1, float_above(piece.upper()))
        of_points[[0, -1]] = float_above((piece / 2).upper())
        start = OMEGAS + columns_of_curve * place
        weights[start : start + columns_of_curve, OMEGAS + place] = [*of_points, float_above(bend)]
        radii = [float_above((bend * radius).upper()) for radius in curve.radii]
        weights[first_unit_column:, OMEGAS + place] = radii
    return weights


def direct_effects(observation: ChannelObservation, t: arb) -> np.ndarray:
    """eps_0, bounds of the effects of inputs of size 1 on the signals in the same sample, shape (rows, inputs)."""
    rows = []
    for phase_signal in observation.phase_signals:
        within = [integral_within(observation.channel, phase_signal, curve) for curve in observation.curves.values()]
        effects = [phase_signal.command_effect, phase_signal.integral_effect, *within]
        rows.append([float_above(effect.upper()) for effect in effects])
    return np.array(rows)
