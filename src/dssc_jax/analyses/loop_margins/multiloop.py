"""The disk margin of all loops at once: the command of every channel is perturbed by a separate factor.

G(z) is the response from signals added at all commands to the commands before the sums. With factors
f_i = (1 + delta_i/2)/(1 - delta_i/2) and Delta = diag(delta_i), the loop is singular where I - (G + I/2) Delta is. The
structured singular value mu of G + I/2 is the inverse of the size of the smallest such Delta. So the multiloop disk
margin alpha is the inverse of the largest mu over frequency.

Reference:
    P. Seiler, A. Packard, P. Gahinet, "An introduction to disk margins", IEEE Control Systems Magazine 40 (2020) 78-95.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.loop_margins.structured import balancing_log_scales, lower_bounds, scaled_norms, upper_bounds
from dssc_jax.closed_loop.break_points import BreakPoint, place_name, place_names
from dssc_jax.core.influences import closure
from dssc_jax.engine.linearisation.matrices import Operating, StateMatrices
from dssc_jax.engine.linearisation.response import grid_with_poles, loop_grids
from dssc_jax.engine.linearisation.roots_and_peaks import golden_section_peak

MOST_PEAKS = 8  # largest number of peaks of the balanced bound that are computed with the sharp bound
REFINED_PEAKS = 2  # number of these peaks around which the largest bound is searched

Bound = Callable[[np.ndarray], np.ndarray]
"""Matrices, shape (n, channels, channels) -> upper bounds of their structured singular values, shape (n,)."""


class MultiloopMargins(NamedTuple):
    """The disk margin alpha of all loops at once, for each draw; NaN for a draw without a stable loop.

    Args:
        channels: The channels whose commands have an effect.
        guaranteed: alpha that holds at all frequencies of the search, from an upper bound of mu, shape (draws,).
        attained: alpha of a perturbation that makes the loop singular, from a lower bound of mu, shape (draws,).
        frequency: Frequency at which that perturbation makes the loop singular [rad/s], shape (draws,).
        factors: Complex factor of each command in that perturbation, shape (draws, channels).
    """

    channels: tuple[str, ...]
    guaranteed: np.ndarray
    attained: np.ndarray
    frequency: np.ndarray
    factors: np.ndarray


class JointLoops(NamedTuple):
    """n closed loops x+ = A x + B w, v = C x, with an input w and an output v at each of several break points.

    Args:
        a: A, shape (n, states, states).
        b: B, shape (n, states, channels).
        c: C, shape (n, channels, states).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    def at(self, angles: np.ndarray) -> np.ndarray:
        """M = G + I/2 with G = C (z I - A)^-1 B and z = e^(j theta), shape (n, m, channels, channels).

        Args:
            angles: theta, shape (n, m).
        """
        identity = np.eye(self.a.shape[-1])
        responses = []
        for theta in angles.T:
            matrices = np.exp(1j * theta)[:, None, None] * identity - self.a
            responses.append(self.c @ np.linalg.solve(matrices, self.b))
        return np.stack(responses, axis=1) + 0.5 * np.eye(self.b.shape[-1])


class JointPlaces(NamedTuple):
    """The commands that are perturbed together, and the states through which they act on each other.

    Args:
        channels: Indices of the channels whose commands have an effect.
        points: Index of the break point of each of these commands, shape (channels,).
        states: Indices of the states that these commands influence and that influence them.
    """

    channels: list[int]
    points: np.ndarray
    states: np.ndarray


class JointMargins(NamedTuple):
    """The disk margin of each of n stable loops.

    The fields are those of :class:`MultiloopMargins` without ``channels``; their first dimension is n instead of draws.
    """

    guaranteed: np.ndarray
    attained: np.ndarray
    frequency: np.ndarray
    factors: np.ndarray


def joint_places(
    channels: Sequence[str], matrices: StateMatrices, has_operating_point: np.ndarray
) -> JointPlaces | None:
    """The commands that have an effect, and the states between them; None if fewer than two commands have one.

    A command has an effect if, in at least one draw, some state is influenced by the command and influences it.

    Args:
        channels: Names of the channels.
        matrices: Matrices of the loops of all draws.
        has_operating_point: Whether each draw has an operating point, shape (draws,).
    """
    names = place_names(channels)
    places = np.array([names.index(place_name(channel, BreakPoint.INPUT)) for channel in channels])
    is_coupled = np.any(matrices.a[has_operating_point] != 0.0, axis=0)
    is_driven = np.any(matrices.b[has_operating_point] != 0.0, axis=0)
    is_read = np.any(matrices.c[has_operating_point] != 0.0, axis=0)
    influenced = np.array([closure(is_driven[:, place], is_coupled.T) for place in places])  # shape (channels, states)
    influencing = np.array([closure(is_read[place], is_coupled) for place in places])
    effective = np.flatnonzero(np.any(influenced & influencing, axis=1))
    if len(effective) < 2:
        return None
    is_between = np.any(influenced[effective], axis=0) & np.any(influencing[effective], axis=0)
    return JointPlaces(effective.tolist(), places[effective], np.flatnonzero(is_between))


def multiloop_margins(channels: Sequence[str], operating: Operating, sample_time: float) -> MultiloopMargins | None:
    """Compute the disk margin of all loops at once, for each draw; None if fewer than two commands have an effect.

    Args:
        channels: Names of the channels.
        operating: Matrices of the loops of all draws at one operating point.
        sample_time: T_s [s].
    """
    matrices = operating.matrices
    has_operating_point = operating.reached
    joint = joint_places(channels, matrices, has_operating_point)
    if joint is None:
        return None
    reached_draws = np.flatnonzero(has_operating_point)
    poles = np.linalg.eigvals(matrices.a[np.ix_(reached_draws, joint.states, joint.states)])
    is_stable = np.max(np.abs(poles), axis=1) < 1.0
    stable = reached_draws[is_stable]
    draws = len(has_operating_point)
    margins = MultiloopMargins(
        channels=tuple(channels[i] for i in joint.channels),
        guaranteed=np.full(draws, np.nan),
        attained=np.full(draws, np.nan),
        frequency=np.full(draws, np.nan),
        factors=np.full((draws, len(joint.channels)), np.nan, complex),
    )
    if stable.size:
        loops = JointLoops(
            matrices.a[np.ix_(stable, joint.states, joint.states)],
            matrices.b[np.ix_(stable, joint.states, joint.points)],
            matrices.c[np.ix_(stable, joint.points, joint.states)],
        )
        stable_margins = joint_margins(loops, poles[is_stable], sample_time)
        for name, values in stable_margins._asdict().items():
            getattr(margins, name)[stable] = values
    return margins


def joint_margins(
    loops: JointLoops, poles: np.ndarray, sample_time: float, bound: Bound = upper_bounds
) -> JointMargins:
    """Compute the disk margins of n stable loops.

    Args:
        loops: The loops.
        poles: Eigenvalues of A, shape (n, states).
        sample_time: T_s [s].
        bound: Function that computes the upper bounds of mu, whose peak over frequency is searched.
    """
    angles = grid_with_poles(loop_grids(poles), poles)
    critical_angle, largest_mu = peak_bound(loops, angles, bound)
    critical_matrices = loops.at(critical_angle[:, None])[:, 0]
    lower_mu, deltas = lower_bounds(critical_matrices)
    factors = (1.0 + 0.5 * deltas) / (1.0 - 0.5 * deltas)
    return JointMargins(1.0 / largest_mu, 1.0 / lower_mu, critical_angle / sample_time, factors)


def balanced_bounds(matrices: np.ndarray) -> np.ndarray:
    """Upper bounds of mu(M), shape (n,): largest singular values of D M D^-1 with the diagonal D that balances M.

    These bounds take less time than those of :func:`upper_bounds`; for two channels both are equal.

    Args:
        matrices: M, shape (n, channels, channels).
    """
    norms, _ = scaled_norms(matrices, balancing_log_scales(matrices))
    return norms


def peak_bound(loops: JointLoops, angles: np.ndarray, bound: Bound = upper_bounds) -> tuple[np.ndarray, np.ndarray]:
    """The angle at which an upper bound of mu has its peak over frequency, and the bound there, shape (n,) each.

    The balanced bound, which is fast, shows the peaks on the grid. ``bound`` is computed at the highest of them only,
    and a golden-section search refines the angles of its own highest peaks.

    Args:
        loops: The loops.
        angles: Ascending angles of the grid, shape (n, m).
        bound: Function that computes the upper bounds of mu.
    """
    responses = loops.at(angles)
    count, columns, channels, _ = responses.shape
    peaks = highest_peaks(responses)
    peak_responses = np.take_along_axis(responses, peaks[:, :, None, None], 1).reshape(-1, channels, channels)
    sharp_bounds = bound(peak_responses).reshape(count, -1)
    order = np.argsort(-sharp_bounds, axis=1)[:, :REFINED_PEAKS]
    refined_peaks = np.take_along_axis(peaks, order, 1)
    tried_angles = [np.take_along_axis(angles, refined_peaks, 1)]
    tried_bounds = [np.take_along_axis(sharp_bounds, order, 1)]
    for peak in refined_peaks.T:
        column = peak[:, None]
        low = np.take_along_axis(angles, np.maximum(column - 1, 0), 1)
        high = np.take_along_axis(angles, np.minimum(column + 1, columns - 1), 1)
        angle, value = golden_section_peak(lambda theta: bound(loops.at(theta)[:, 0])[:, None], low, high)
        tried_angles.append(angle)
        tried_bounds.append(value)
    all_angles = np.concatenate(tried_angles, axis=1)
    all_bounds = np.concatenate(tried_bounds, axis=1)
    best = np.argmax(all_bounds, axis=1)[:, None]
    return np.take_along_axis(all_angles, best, 1)[:, 0], np.take_along_axis(all_bounds, best, 1)[:, 0]


def highest_peaks(responses: np.ndarray) -> np.ndarray:
    """Indices of the angles at the :data:`MOST_PEAKS` highest peaks of the balanced bound of mu, shape (n, peaks).

    The highest peak comes first.

    Args:
        responses: M = G + I/2 on a grid of angles, shape (n, m, channels, channels).
    """
    count, columns, channels, _ = responses.shape
    bounds = balanced_bounds(responses.reshape(-1, channels, channels)).reshape(count, columns)
    padded_bounds = np.pad(bounds, ((0, 0), (1, 1)), constant_values=-np.inf)
    left_neighbours = padded_bounds[:, :-2]
    right_neighbours = padded_bounds[:, 2:]
    is_peak = (bounds >= left_neighbours) & (bounds >= right_neighbours)
    return np.argsort(-np.where(is_peak, bounds, 0.0), axis=1)[:, :MOST_PEAKS]
