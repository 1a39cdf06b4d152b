"""Responses of a sampled linear channel's signals to inputs, a constant and starts of size 1, in floating point.

Signals are bounded at four points of a sample. The inputs are omega_u and omega_r, which are held over a sample, and
the remainders, which may be any function of time, so that their effect in a sample is an integral.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from dssc_jax.proofs.search.impulse_responses import responses, spectral_radius
from dssc_jax.proofs.search.vehicle.channels import (
    LinearChannel,
    SampledChannel,
    StraightLines,
    flow,
    sampled_channel,
)
from dssc_jax.proofs.vehicle_problem import ChannelProblem, VehicleProblem

POINTS = (0.125, 0.375, 0.625, 0.875)
"""Times within a sample at which signals are bounded, in T_s; every time is within T_s/8 of one of them."""
PIECES = 4
"""Number of pieces, in integrals by the trapezoidal rule, of a sample or of half of the rotor lag's time constant."""
MOST_PIECES = 32
"""Largest number of pieces of a sample."""
ONE_AXIS = ("e", "e_dot", "sigma", "bend", "u_av")
"""Signals of the plane's channel that are bounded along each axis; the others are norms of vectors."""
MOST_PEAK_SAMPLES = 40_000
"""Number of samples after which the largest response to a start or a constant is no longer sought."""
PEAK_SETTLED = 1e-4
"""Share of its first size at which a state counts as settled."""


@dataclass(frozen=True)
class ChannelResponse:
    """Largest responses of a channel's signals at the points of a sample to inputs and starts of size 1.

    Args:
        names: Names of the signals.
        remainders: Names of the remainders.
        gains: Sums of the absolute responses to the inputs omega_u, omega_r and the remainders, in this order, shape
            (points, signals, inputs).
        constant: Peak of the response to a constant force 1, shape (points, signals).
        starts: Peaks of the responses to a start with e = 1, with e' = 1 and with q_(-1) = 1, shape (points, signals,
            3).
        start_offset: Peak of the response to the known part of z_0 less the nominal flight's z_0; 0 without a nominal
            flight; shape (points, signals).
    """

    names: tuple[str, ...]
    remainders: tuple[str, ...]
    gains: np.ndarray
    constant: np.ndarray
    starts: np.ndarray
    start_offset: np.ndarray


@dataclass(frozen=True)
class ChannelObservation:
    """A sampled channel, its signals at the points of a sample, and the columns of its inputs.

    Args:
        step: One sample.
        names: Names of the signals.
        rows: C_s, each signal at each point as a row over z, shape (points signals, n).
        direct: Bounds of the effects of inputs of size 1 in the same sample, shape (points, signals, inputs).
        columns: Columns b_u of omega_u and b_q of omega_r; then, for each end of the pieces of a sample, the columns of
            the remainders that act at this time before the next sample; shape (n, 2 + (pieces + 1) remainders).
        pieces: Number of pieces of a sample.
        force_column: The part of z that a constant force 1 causes in a sample, shape (n,).
        force_within: The effect of a constant force 1 on the signals in the same sample, shape (points signals,).
    """

    step: SampledChannel
    names: tuple[str, ...]
    rows: np.ndarray
    direct: np.ndarray
    columns: np.ndarray
    pieces: int
    force_column: np.ndarray
    force_within: np.ndarray


def pieces_of(problem: VehicleProblem) -> int:
    """Number of pieces of a sample in integrals by the trapezoidal rule; a short rotor lag needs more."""
    if not problem.rotor_lag:
        return PIECES
    half_lags = np.ceil(2.0 * problem.sample_time / problem.rotor_lag)  # in a sample
    return int(min(PIECES * half_lags, MOST_PIECES))


def observe_channel(
    problem: VehicleProblem, channel: ChannelProblem, linear: LinearChannel, lines: StraightLines
) -> ChannelObservation:
    """Build a channel at its samples, with its signals at the points of a sample and the columns of its inputs.

    Args:
        problem: The vehicle.
        channel: The controller of the channel.
        linear: The channel between the samples.
        lines: The straight lines in place of the controller's functions, and the share s_q.
    """
    step = sampled_channel(problem, channel, linear, lines)
    t = problem.sample_time
    pieces = pieces_of(problem)
    m = linear.control.size
    n = step.a.shape[0]
    names = (*linear.signals, "u_av")
    rows = np.zeros((len(POINTS), len(names), n))
    direct = np.zeros((len(POINTS), len(names), 2 + len(linear.remainders)))
    force_within = np.zeros((len(POINTS), len(names)))
    force = linear.remainders.get("force", np.zeros(m))
    for place, point in enumerate(POINTS):
        time = point * t
        phi, gamma = flow(linear, time)
        columns_within = remainder_effects(linear, time * np.linspace(0.0, 1.0, pieces + 1))
        force_effect = forced_response(linear, force, time)
        for i, (c, d) in enumerate(linear.signals.values()):
            by_command = c @ gamma + d
            rows[place, i, :m] = c @ phi
            rows[place, i] += by_command * step.acting
            # omega_u adds to the command, and T_s omega_q through the sum q
            direct[place, i, :2] = abs(by_command * step.fresh) * np.array([abs(1.0 + t * lines.share), t])
            direct[place, i, 2:] = time * trapezoid([np.abs(c @ columns) for columns in columns_within])
            force_within[place, i] = c @ force_effect
        rows[place, -1] = step.equivalent
        direct[place, -1, :2] = [abs(t * lines.share), t]
    columns = np.zeros((n, 2 + (pieces + 1) * len(linear.remainders)))
    columns[:, 0] = step.by_command
    columns[:, 1] = step.by_integral
    columns_before = remainder_effects(linear, t * np.arange(pieces + 1) / pieces)
    columns[:m, 2:] = np.concatenate(columns_before, axis=1)
    return ChannelObservation(
        step=step,
        names=names,
        rows=rows.reshape(-1, n),
        direct=direct,
        columns=columns,
        pieces=pieces,
        force_column=np.append(forced_response(linear, force, t), np.zeros(n - m)),
        force_within=force_within.ravel(),
    )


def remainder_effects(linear: LinearChannel, times: np.ndarray) -> list[np.ndarray]:
    """The state chi after a unit impulse of each remainder at each of some times [s], shape (m, remainders) each."""
    columns = np.stack(list(linear.remainders.values()), axis=1)
    return [flow(linear, time).phi @ columns for time in times]


def integrated_effects(effects: np.ndarray, pieces: int, sample_time: float) -> np.ndarray:
    """Effects of omega_u, of omega_r and of each remainder throughout a sample, shape (..., inputs).

    The effect of a remainder is the integral over the sample, by the trapezoidal rule.

    Args:
        effects: Effects of the columns of :class:`ChannelObservation`, shape (..., columns).
        pieces: Number of pieces of a sample.
        sample_time: T_s [s].
    """
    at_ends = effects[..., 2:].reshape(*effects.shape[:-1], pieces + 1, -1)
    integrals = sample_time * trapezoid([at_ends[..., i, :] for i in range(pieces + 1)])
    return np.concatenate([effects[..., :2], integrals], axis=-1)


def channel_response(
    problem: VehicleProblem,
    channel: ChannelProblem,
    linear: LinearChannel,
    lines: StraightLines,
    start_offsets: np.ndarray | None,
) -> ChannelResponse | None:
    """The largest responses of a channel's signals; None if the channel is not stable or they last too long.

    Args:
        problem: The vehicle.
        channel: The controller of the channel.
        linear: The channel between the samples.
        lines: The straight lines in place of the controller's functions, and the share s_q.
        start_offsets: Known part of z_0 less the nominal flight's, shape (n, axes); None: there is none.
    """
    observation = observe_channel(problem, channel, linear, lines)
    a = observation.step.a
    rows = observation.rows
    if spectral_radius(a) >= 1.0:
        return None
    no_starts = np.zeros((a.shape[0], 0))
    input_responses = responses(a, rows, observation.columns, no_starts)
    if input_responses is None:
        return None
    shape = (len(POINTS), len(observation.names))
    later_effects = integrated_effects(input_responses.sums, observation.pieces, problem.sample_time)
    gains = later_effects.reshape(*shape, -1) + observation.direct
    force_peaks = np.zeros(rows.shape[0])
    if problem.thrust_deviation and channel is problem.channels["z"]:
        # the response to a constant is that of the equilibrium, minus the decay of its distance
        equilibrium = np.linalg.solve(np.eye(a.shape[0]) - a, observation.force_column)
        force_peaks = largest_values(a, rows, -equilibrium, rows @ equilibrium + observation.force_within)
    start_peaks = np.zeros((rows.shape[0], 3))
    if any(channel.initial):
        starts = start_columns(problem, channel, a.shape[0], lines)
        start_peaks = np.stack([largest_values(a, rows, start, np.zeros(rows.shape[0])) for start in starts], axis=-1)
    offset_peaks = np.zeros(shape)
    if start_offsets is not None:
        columns = [largest_values(a, rows, start, np.zeros(rows.shape[0])) for start in start_offsets.T]
        offset_peaks = size_over_axes(np.stack(columns, axis=-1).reshape(*shape, -1), observation.names)
    return ChannelResponse(
        names=observation.names,
        remainders=tuple(linear.remainders),
        gains=gains,
        constant=force_peaks.reshape(shape),
        starts=start_peaks.reshape(*shape, 3),
        start_offset=offset_peaks,
    )


def size_over_axes(sizes: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Bounds of a channel's signals from bounds along each axis: the maximum, or the norm if the signal is a vector.

    Args:
        sizes: Bounds along each axis, shape (..., signals, axes).
        names: Names of the signals.

    Returns:
        Shape (..., signals).
    """
    is_along_axes = np.isin(names, ONE_AXIS)
    return np.where(is_along_axes, sizes.max(axis=-1), np.sqrt((sizes**2).sum(axis=-1)))


def axis_factors(name: str, response: ChannelResponse) -> np.ndarray:
    """h, the factor of the bounds of omega_u and omega_r in each signal, shape (signals,).

    The omegas are bounded along each axis, so their vector in the plane is up to 2^(1/2) times as long. So h is 2^(1/2)
    for signals that are norms of the plane, otherwise 1.

    Args:
        name: Name of the channel.
        response: The channel's responses, which state the names of the signals.
    """
    is_norm = [name == "x" and key not in ONE_AXIS for key in response.names]
    return np.where(is_norm, math.sqrt(2.0), 1.0)


@dataclass(frozen=True)
class ChannelSeries:
    """Responses of a channel's signals sample by sample. A row is one point of a sample and one signal.

    Args:
        effects: eps_l, bounds of the effects of inputs of size 1 in a sample l samples later, shape (samples, rows,
            inputs).
        constant: Response to a constant force 1 from t = 0 on, shape (samples, rows).
        starts: Responses to a start with e = 1, with e' = 1 and with q_(-1) = 1, shape (samples, rows, 3).
        start_offset: Magnitudes of the response to the known part of z_0 less the nominal flight's, shape (samples,
            rows).
    """

    effects: np.ndarray
    constant: np.ndarray
    starts: np.ndarray
    start_offset: np.ndarray


def channel_series(
    problem: VehicleProblem,
    channel: ChannelProblem,
    linear: LinearChannel,
    lines: StraightLines,
    length: int,
    start_offsets: np.ndarray | None,
) -> ChannelSeries:
    """The responses of a channel's signals, sample by sample. Only the channel of z has a constant force.

    Args:
        problem: The vehicle.
        channel: The controller of the channel.
        linear: The channel between the samples.
        lines: The straight lines in place of the controller's functions, and the share s_q.
        length: Number of samples.
        start_offsets: Known part of z_0 less the nominal flight's, shape (n, axes); None: there is none.
    """
    observation = observe_channel(problem, channel, linear, lines)
    a = observation.step.a
    n = a.shape[0]
    rows = observation.rows.shape[0]
    equilibrium = np.linalg.solve(np.eye(n) - a, observation.force_column)
    starts = start_columns(problem, channel, n, lines)
    z_offsets = np.zeros((n, 1)) if start_offsets is None else start_offsets
    columns = np.column_stack([observation.columns, -equilibrium, *starts, z_offsets])
    responses_by_sample = np.zeros((length, rows, columns.shape[1]))
    for k in range(length):
        responses_by_sample[k] = observation.rows @ columns
        columns = a @ columns
    inputs = observation.columns.shape[1]
    ends = [inputs, inputs + 1, inputs + 1 + len(starts)]  # of the inputs, of the constant and of the starts
    of_inputs, of_constant, of_starts, of_offsets = np.split(responses_by_sample, ends, axis=-1)
    effects = np.zeros((length, rows, 2 + len(linear.remainders)))
    effects[0] = observation.direct.reshape(rows, -1)
    effects[1:] = integrated_effects(np.abs(of_inputs[:-1]), observation.pieces, problem.sample_time)
    constant = np.zeros((length, rows))
    if channel is problem.channels["z"]:
        constant = of_constant[..., 0] + observation.rows @ equilibrium + observation.force_within
    along_axes = np.abs(of_offsets).reshape(length, len(POINTS), len(observation.names), -1)
    offset_effects = size_over_axes(along_axes, observation.names).reshape(length, -1)
    return ChannelSeries(effects=effects, constant=constant, starts=of_starts, start_offset=offset_effects)


def trapezoid(values: list[np.ndarray]) -> np.ndarray:
    """The mean of a function over an interval by the trapezoidal rule, from its values at equally spaced points."""
    return (0.5 * (values[0] + values[-1]) + sum(values[1:-1])) / (len(values) - 1)


def forced_response(linear: LinearChannel, column: np.ndarray, time: float) -> np.ndarray:
    """The part of chi that a constant input 1 through a column, shape (m,), causes within a time [s], shape (m,)."""
    driven = replace(linear, control=column)  # the column in place of the command's
    return flow(driven, time).gamma


def start_columns(problem: VehicleProblem, channel: ChannelProblem, n: int, lines: StraightLines) -> list[np.ndarray]:
    """z_0 for a start with e = 1, for one with e' = 1 and for one with q_(-1) = 1, shape (n,) each.

    With straight lines q_(-1) is a multiple of sigma_0 = e' + l_0 e, so that the first two starts have a q_(-1), too.

    Args:
        problem: The vehicle.
        channel: The controller of the channel.
        n: Length of z.
        lines: The straight lines in place of the controller's functions.
    """
    share = start_share(problem, channel, lines)
    e, e_dot, *_, q = np.eye(n)
    return [e - share * channel.l0 * q, e_dot - share * q, q]


def start_share(problem: VehicleProblem, channel: ChannelProblem, lines: StraightLines) -> float:
    """-q_(-1)/sigma_0, where q_(-1) is the sum before the first sample, with straight lines for the functions.

    q_(-1) is 0 for the start ``zero`` and -phi_1(sigma_0) for ``matched``; for ``midpoint`` it is lower than the latter
    by (T_s/2) phi_2(sigma_0).
    """
    midpoint_share = lines.k_1 + 0.5 * problem.sample_time * lines.k_2
    return {"zero": 0.0, "matched": lines.k_1, "midpoint": midpoint_share}[channel.start]


def largest_values(a: np.ndarray, rows: np.ndarray, z: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """The largest |offset + row A^k z| for each row, over the samples k until z has settled, shape (rows,).

    Args:
        a: A, shape (n, n).
        rows: Rows of the signals, shape (rows, n).
        z: The first state, shape (n,).
        offset: Constant of each signal, shape (rows,).
    """
    peaks = np.abs(offset + rows @ z)
    initial_size = np.max(np.abs(z), initial=1e-300)
    for _ in range(MOST_PEAK_SAMPLES):
        z = a @ z
        peaks = np.maximum(peaks, np.abs(offset + rows @ z))
        if np.max(np.abs(z)) < PEAK_SETTLED * initial_size:
            break
    return peaks
