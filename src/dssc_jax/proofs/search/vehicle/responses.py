"""Responses of a sampled linear channel's signals to inputs and starts of size 1, in floating point."""

import math
from dataclasses import dataclass

import numpy as np

from dssc_jax.proofs.search.impulse_responses import responses, spectral_radius
from dssc_jax.proofs.search.vehicle.channels import LinearChannel, SampledChannel, flow, sampled_channel
from dssc_jax.proofs.vehicle_problem import ChannelProblem, VehicleProblem

POINTS = (0.125, 0.375, 0.625, 0.875)
"""Times within a sample at which signals are bounded, in T_s; every time is within T_s/8 of one."""
PIECES = 4
"""Pieces of each half of the rotors' lag, or of a shorter sample, in integrals by the trapezoidal rule."""
MOST_PIECES = 32
"""Largest number of pieces of a sample."""
ONE_AXIS = ("e", "e_dot", "sigma", "bend", "u_av")
"""Signals of the plane's channel that are bounded along each axis; the others are norms of vectors."""
MOST_CONSTANT_SAMPLES = 40_000
CONSTANT_SETTLED = 1e-4
"""Share of a response to a constant at which it counts as settled."""


@dataclass(frozen=True)
class ChannelResponse:
    """Largest responses of a channel's signals at points of a sample to inputs and starts of size 1.

    Args:
        names: Names of the signals.
        remainders: Names of the remainders.
        gains: Sums of the absolute responses to the inputs, (points, signals, inputs); the first two inputs are omega_u
            and omega_q, the others the remainders.
        constant: Peak of the response to a constant force 1, (points, signals).
        starts: Peaks of the responses to e, e' and q_(-1), (points, signals, 3).
        start_offset: Peak of the response to the known difference of z_0 from the nominal flight's, (points, signals).
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
        rows: Row of each point and signal over z, (points * signals, n).
        direct: Bounds of what inputs of size 1 do in the same sample, (points, signals, inputs).
        columns: Columns of omega_u, omega_q, and of the remainders at the ends of the pieces of a sample, (n, inputs).
        pieces: Number of these pieces.
        force_column: Column of a constant force, (n,).
        force_within: What a constant force 1 does in the same sample, (points * signals,).
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
    """Number of pieces of a sample in integrals by the trapezoidal rule; a short lag needs more."""
    if not problem.rotor_lag:
        return PIECES
    return int(min(PIECES * np.ceil(2.0 * problem.sample_time / problem.rotor_lag), MOST_PIECES))


def observe_channel(
    problem: VehicleProblem, channel: ChannelProblem, linear: LinearChannel, slopes: tuple[float, ...]
) -> ChannelObservation:
    """A channel at its samples, with straight lines in place of its functions.

    Args:
        problem: The vehicle.
        channel: The controller of the channel.
        linear: Its linear channel.
        slopes: Slopes k_1, k_2, k_3 of the lines, and the share of omega_u in omega_q.
    """
    step = sampled_channel(problem, channel, linear, slopes)
    t = problem.sample_time
    pieces = pieces_of(problem)
    m, n = linear.g.size, step.a.shape[0]
    names = (*linear.signals, "u_av")
    rows = np.zeros((len(POINTS), len(names), n))
    direct = np.zeros((len(POINTS), len(names), 2 + len(linear.b)))
    force_within = np.zeros((len(POINTS), len(names)))
    forces = np.stack(list(linear.b.values()), axis=1)
    force = linear.b.get("force", np.zeros(m))
    for place, share in enumerate(POINTS):
        phi, gamma = flow(linear, share * t)
        inner = [flow(linear, share * t * fraction)[0] @ forces for fraction in np.linspace(0.0, 1.0, pieces + 1)]
        force_effect = forced_response(linear, force, share * t)
        for row, (c, d) in enumerate(linear.signals.values()):
            command_effect = c @ gamma + d
            rows[place, row, :m] = c @ phi
            rows[place, row] += command_effect * step.acting
            direct[place, row, :2] = abs(command_effect * step.direct) * np.array([abs(1.0 + t * slopes[3]), t])
            direct[place, row, 2:] = share * t * trapezoid([np.abs(c @ columns) for columns in inner])
            force_within[place, row] = c @ force_effect
        rows[place, -1] = step.u_av
        direct[place, -1, :2] = [abs(t * slopes[3]), t]
    columns = np.zeros((n, 2 + (pieces + 1) * forces.shape[1]))
    columns[:, 0] = step.u
    columns[:, 1] = step.q
    forces_at_pieces = [flow(linear, t * fraction / pieces)[0] @ forces for fraction in range(pieces + 1)]
    columns[:m, 2:] = np.concatenate(forces_at_pieces, axis=1)
    force_column = np.append(forced_response(linear, force, t), np.zeros(n - m))
    return ChannelObservation(
        step=step,
        names=names,
        rows=rows.reshape(-1, n),
        direct=direct,
        columns=columns,
        pieces=pieces,
        force_column=force_column,
        force_within=force_within.ravel(),
    )


def integrated_effects(effects: np.ndarray, pieces: int, sample_time: float) -> np.ndarray:
    """Effects of omega_u, omega_q and each remainder, (..., inputs): those of a remainder are integrals over a sample.

    Args:
        effects: Effects of omega_u, omega_q, and of each remainder at the ends of the pieces, (..., columns).
        pieces: Number of pieces.
        sample_time: T_s [s].
    """
    times = effects[..., 2:].reshape(*effects.shape[:-1], pieces + 1, -1)
    integrals = sample_time * trapezoid([times[..., i, :] for i in range(pieces + 1)])
    return np.concatenate([effects[..., :2], integrals], axis=-1)


def channel_response(
    problem: VehicleProblem,
    channel: ChannelProblem,
    linear: LinearChannel,
    slopes: tuple[float, ...],
    start_offsets: np.ndarray | None,
) -> ChannelResponse | None:
    """The largest responses of a channel's signals; None if it is not stable or they last too long.

    Args:
        problem: The vehicle.
        channel: The controller of the channel.
        linear: Its linear channel.
        slopes: Slopes of the straight lines in place of its functions.
        start_offsets: Known difference of z_0 from that of the nominal flight, (n, axes); None: there is none.
    """
    observation = observe_channel(problem, channel, linear, slopes)
    a, rows = observation.step.a, observation.rows
    if spectral_radius(a) >= 1.0:
        return None
    input_responses = responses(a, rows, observation.columns, np.zeros((a.shape[0], 0)))
    if input_responses is None:
        return None
    shape = (len(POINTS), len(observation.names))
    gains = (
        integrated_effects(input_responses.sums, observation.pieces, problem.sample_time).reshape(*shape, -1)
        + observation.direct
    )
    force_peaks = np.zeros(rows.shape[0])
    if problem.thrust_deviation and channel is problem.channels["z"]:
        equilibrium = np.linalg.solve(np.eye(a.shape[0]) - a, observation.force_column)
        force_peaks = constant_peaks(a, rows, -equilibrium, rows @ equilibrium + observation.force_within)
    start_peaks = np.zeros((rows.shape[0], 3))
    if any(channel.initial):
        starts = start_columns(problem, channel, a.shape[0], slopes)
        start_peaks = np.stack([constant_peaks(a, rows, start, np.zeros(rows.shape[0])) for start in starts], axis=-1)
    offset_peaks = np.zeros(shape)
    if start_offsets is not None:
        columns = [constant_peaks(a, rows, start, np.zeros(rows.shape[0])) for start in start_offsets.T]
        offset_peaks = size_over_axes(np.stack(columns, axis=-1).reshape(*shape, -1), observation.names)
    return ChannelResponse(
        names=observation.names,
        remainders=tuple(linear.b),
        gains=gains,
        constant=force_peaks.reshape(shape),
        starts=start_peaks.reshape(*shape, 3),
        start_offset=offset_peaks,
    )


def size_over_axes(sizes: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Bounds of signals from those on each axis, (..., signals, axes) -> (..., signals).

    Of a signal along an axis it is the larger one, of a vector of the plane the norm.
    """
    along_axes = np.isin(names, ONE_AXIS)
    return np.where(along_axes, sizes.max(axis=-1), np.sqrt((sizes**2).sum(axis=-1)))


def axes_of(name: str, response: ChannelResponse) -> np.ndarray:
    """The ratio of a vector of two axes' deviations to each, (signals,): 2^(1/2) in vectors of the plane, else 1."""
    in_plane = [name == "x" and key not in ONE_AXIS for key in response.names]
    return np.where(in_plane, math.sqrt(2.0), 1.0)


@dataclass(frozen=True)
class ChannelSeries:
    """Responses of a channel's signals sample by sample; each row is a point of a sample and a signal.

    Args:
        effects: Magnitudes of what inputs of size 1 in a sample cause k samples later, (samples, rows, inputs).
        constant: Response to a constant force 1 from t = 0 on, (samples, rows).
        starts: Responses to e, e' and q_(-1), (samples, rows, 3).
        start_offset: Magnitudes of the response to the known difference of z_0 from the nominal flight's, (samples,
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
    slopes: tuple[float, ...],
    length: int,
    start_offsets: np.ndarray | None,
) -> ChannelSeries:
    """The responses of a channel's signals, sample by sample. Only the channel of z has a constant force.

    Args:
        problem: The vehicle.
        channel: The controller of the channel.
        linear: Its linear channel.
        slopes: Slopes of the straight lines in place of its functions.
        length: Number of samples.
        start_offsets: Known difference of z_0 from that of the nominal flight, (n, axes); None: there is none.
    """
    observation = observe_channel(problem, channel, linear, slopes)
    a = observation.step.a
    n = a.shape[0]
    rows = observation.rows.shape[0]
    equilibrium = np.linalg.solve(np.eye(n) - a, observation.force_column)
    starts = start_columns(problem, channel, n, slopes)
    z_offsets = np.zeros((n, 1)) if start_offsets is None else start_offsets

    columns = np.column_stack([observation.columns, -equilibrium, *starts, z_offsets])
    responses_by_sample = np.zeros((length, rows, columns.shape[1]))
    for k in range(length):
        responses_by_sample[k] = observation.rows @ columns
        columns = a @ columns
    inputs = observation.columns.shape[1]
    of_inputs, of_constant, of_starts, of_offsets = np.split(
        responses_by_sample, [inputs, inputs + 1, inputs + 1 + len(starts)], axis=-1
    )

    effects = np.zeros((length, rows, 2 + len(linear.b)))
    effects[0] = observation.direct.reshape(rows, -1)
    effects[1:] = integrated_effects(np.abs(of_inputs[:-1]), observation.pieces, problem.sample_time)
    constant = np.zeros((length, rows))
    if channel is problem.channels["z"]:
        constant = of_constant[..., 0] + observation.rows @ equilibrium + observation.force_within
    along_axes = np.abs(of_offsets).reshape(length, len(POINTS), len(observation.names), -1)
    offset_effects = size_over_axes(along_axes, observation.names).reshape(length, -1)
    return ChannelSeries(effects, constant, of_starts, offset_effects)


def trapezoid(values: list[np.ndarray]) -> np.ndarray:
    """The mean of equally spaced values by the trapezoidal rule."""
    return (0.5 * (values[0] + values[-1]) + sum(values[1:-1])) / (len(values) - 1)


def forced_response(linear: LinearChannel, column: np.ndarray, time: float) -> np.ndarray:
    """The change of chi that a constant input 1 through a column causes within a time [s], (m,)."""
    return flow(LinearChannel(linear.f, column, linear.b, linear.signals), time)[1]


def start_columns(
    problem: VehicleProblem, channel: ChannelProblem, n: int, slopes: tuple[float, ...]
) -> list[np.ndarray]:
    """z_0 for a start with e = 1, with e' = 1 and with q_(-1) = 1, (n,) each."""
    share = start_share(problem, channel, slopes)
    unit = np.eye(n)
    return [unit[0] - share * channel.l0 * unit[n - 1], unit[1] - share * unit[n - 1], unit[n - 1]]


def start_share(problem: VehicleProblem, channel: ChannelProblem, slopes: tuple[float, ...]) -> float:
    """-q_(-1)/sigma_0, what the first sum q takes from sigma_0, where straight lines replace the functions."""
    k_1, k_2 = slopes[:2]
    return {"zero": 0.0, "matched": k_1, "midpoint": k_1 + 0.5 * problem.sample_time * k_2}[channel.start]


def constant_peaks(a: np.ndarray, rows: np.ndarray, z: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """The largest |offset + row A^k z| over k for each row, (rows,)."""
    peaks = np.abs(offset + rows @ z)
    initial_size = np.max(np.abs(z), initial=1e-300)
    for _ in range(MOST_CONSTANT_SAMPLES):
        z = a @ z
        peaks = np.maximum(peaks, np.abs(offset + rows @ z))
        if np.max(np.abs(z)) < CONSTANT_SETTLED * initial_size:
            break
    return peaks
