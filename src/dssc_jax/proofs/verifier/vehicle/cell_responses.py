"""Upper bounds of what the inputs of each time cell do in each time cell; docs/vehicle_proofs.md has the definitions.

All is summed in float64 from samples with bounds of their errors. The terms are not negative. ``SUMMED`` covers the
rounding of a sum.
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
"""The inputs omega_u and omega_r, before the remainders."""
SMALL = 1e-6
"""Share of a response's peak at which the rest of it no longer counts in the last cell."""


class CellResponses(NamedTuple):
    """Bounds of a channel's responses in J time cells and the last one; inputs: omega_u, omega_r and the remainders.

    Args:
        signals: Name of the signal of each row.
        remainders: The names of the inputs after omega_u and omega_r.
        upper: Bounds of G_(c m + c - 1) for m < J, (J, rows, inputs).
        lower: G_(c m - 1), or eps_0 for m = 0, of the same eps_l, from below, (J, rows, inputs).
        total_sum: Bound of the limit of G, (rows, inputs).
        starts: E_0 |response to e = 1| + V_0 |response to e' = 1| + the size of that to the known offset of the start,
            the largest in each cell, (J + 1, rows).
        deviations: The largest response to a deviation 1 of the first sum q, (J + 1, rows).
        constants: The largest response to a constant 1 from t = 0 on, (J + 1, rows).
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
        name: The channel.
        observation: Its signals and inputs at the samples.
        samples: Number c of samples of a cell.
        count: Number J of cells before the last one, at least 1.

    Raises:
        Rejected: The responses decay too slowly.
    """
    t = arb(problem["sample_time"])
    initial = np.array([float(value) for value in problem["channels"][name]["initial"]])
    along = np.array([phase_signal.name in ALONG_AXES for phase_signal in observation.phase_signals])
    weights = input_weights(observation, t)
    q = observation.inputs.ncols()
    offset_middles = middles(observation.offsets)
    offset_errors = ROUNDED * magnitudes(observation.offsets)
    tail_factor = float_above((2 / observation.decay).upper())
    direct = direct_effects(observation, t)
    # sums of eps_l over l from c m to c m + c - 1, and over all l behind
    effect_sums = np.zeros((count + 1, *direct.shape))
    effect_sums[0] = direct
    peaks = np.zeros((count + 1, len(observation.phase_signals), 3))
    sample_count = 0
    columns = side_by_side(observation.inputs, observation.starts)
    for block in response_blocks(observation.sampled.a, observation.rows, columns, observation.p):
        sizes = np.abs(block.response[..., :q]) + (block.error + block.radius_effect)[:, :q]
        sizes = sizes @ weights
        next_sample = sample_count + 1  # to which the first eps of the block belongs
        later_cells, later_places = cells_of(next_sample, len(sizes), samples, count)
        effect_sums[later_cells] += np.add.reduceat(sizes, later_places, axis=0)
        cells, places = cells_of(sample_count, len(sizes), samples, count)
        sizes = np.abs(block.response[..., q:] + offset_middles)
        sizes = sizes + (block.error + block.radius_effect)[:, q:] + offset_errors
        cell_peaks = np.maximum.reduceat(start_responses(sizes, initial, along), places, axis=0)
        peaks[cells] = np.maximum(peaks[cells], cell_peaks)
        sample_count += len(sizes)
        tail = (block.tail[:, :q] * tail_factor) @ weights
        tail_peaks = start_responses(block.tail[:, q:] + np.abs(offset_middles) + offset_errors, initial, along)
        decaying = start_responses(block.tail[:, q:], initial, along)
        ends = np.all(tail <= TAIL_SHARE * effect_sums.sum(axis=0))
        negligible = np.maximum(SMALL * peaks.max(axis=0), UNDERFLOW)
        negligible[:, :2] = np.maximum(negligible[:, :2], peaks[-1, :, :2])
        if sample_count > samples * (count + 1) and ends and np.all(decaying <= negligible):
            peaks[-1] = np.maximum(peaks[-1], tail_peaks)
            sums = np.concatenate([direct[None], np.cumsum(effect_sums[:-1], axis=0)])
            total_sum = SUMMED * (sums[-1] + effect_sums[-1] + tail)
            starts, deviations, constants = [SUMMED * part for part in np.moveaxis(peaks, 2, 0)]
            return CellResponses(
                signals=[phase_signal.name for phase_signal in observation.phase_signals],
                remainders=list(observation.curves),
                upper=SUMMED * sums[1:],
                lower=sums[:-1] / SUMMED,
                total_sum=total_sum,
                starts=starts,
                deviations=deviations,
                constants=constants,
            )
    raise Rejected(f"V1: the responses of {name} decay too slowly")


def start_responses(sizes: np.ndarray, initial: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Responses to the start, to a deviation of the first sum q and to the constant, (..., rows, 3).

    Args:
        sizes: Responses to each column of the starts, (..., rows, 4 + axes).
        initial: Bounds of |e| and |e'| at t = 0.
        along: Whether a signal counts along an axis, (rows,): then the larger of its known offsets counts, else the
            norm.
    """
    axes = sizes[..., FIRST_OFFSET:]
    known_sizes = np.where(along, axes.max(axis=-1, initial=0.0), np.sqrt((axes**2).sum(axis=-1)))
    return np.stack([sizes[..., :2] @ initial + known_sizes, sizes[..., 2], sizes[..., 3]], axis=-1)


def cells_of(earlier_count: int, length: int, samples: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The cells in which successive samples lie, and the place of each cell's first sample among them.

    Args:
        earlier_count: Number of samples before these.
        length: Number of the samples.
        samples: Number of samples of a cell.
        count: Number of cells before the last one, which has all later samples.
    """
    cells = np.minimum((earlier_count + np.arange(length)) // samples, count)
    places = np.flatnonzero(np.diff(cells, prepend=-1))
    return cells[places], places


def input_weights(observation: ChannelObservation, t: arb) -> np.ndarray:
    """Weights with which the columns of ``observation.inputs`` make up the inputs, rounded up, (columns, inputs).

    The integral of |row e^(A_c r) b| over a sample is at most that of straight lines between the points plus that of
    the bend. ``t`` is T_s.
    """
    pieces = next(iter(observation.curves.values())).pieces
    columns = pieces + 2
    weights = np.zeros((observation.inputs.ncols(), OMEGAS + len(observation.curves)))
    weights[:OMEGAS, :OMEGAS] = np.eye(OMEGAS)
    piece = t / pieces
    bend = (pieces * piece**3 / 12).upper()
    for place, curve in enumerate(observation.curves.values()):
        of_points = np.full(pieces + 1, float_above(piece.upper()))
        of_points[[0, -1]] = float_above((piece / 2).upper())
        start = OMEGAS + columns * place
        weights[start : start + columns, OMEGAS + place] = [*of_points, float_above(bend)]
        radii = [float_above((bend * radius).upper()) for radius in curve.radii]
        weights[OMEGAS + columns * len(observation.curves) :, OMEGAS + place] = radii
    return weights


def direct_effects(observation: ChannelObservation, t: arb) -> np.ndarray:
    """eps_0: what the inputs do in the same sample, rounded up, (rows, inputs)."""
    rows = []
    for phase_signal in observation.phase_signals:
        within = [integral_within(observation.channel, phase_signal, curve) for curve in observation.curves.values()]
        effects = [phase_signal.command_effect, phase_signal.integral_effect, *within]
        rows.append([float_above(effect.upper()) for effect in effects])
    return np.array(rows)
