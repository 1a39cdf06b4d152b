"""Upper bounds of the effects of inputs and starts of size 1 on a channel's signals: sums and peaks of responses.

Signals are bounded at the times ``PHASES`` of each sample. A remainder acts through f(r) = C_s A^k e^(A_c r) b at all
times r of a sample, so its effect is the integral of |f|. A sample is cut into pieces. Over a piece of length h the
integral is at most h/2 (|f(0)| + |f(h)|), as for the straight line between the ends, plus h^3/12 sup |f''| for the
distance of f from this line. The column of f'' is e^(A_c r) A_c^2 b, which is enclosed over the sample as a middle
column plus a radius in each unit column.
"""

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import (
    Balls,
    Rejected,
    column,
    identity,
    interval_ball,
    positive_definite,
    require_premise,
    side_by_side,
    stack,
    symmetric_matrix,
    total,
)
from dssc_jax.proofs.verifier.impulse_responses import ResponseBounds, response_bounds
from dssc_jax.proofs.verifier.vehicle.certificate import MiddleProof, VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import (
    EQUIVALENT,
    Channel,
    SampledChannel,
    channel_of,
    first_columns,
    flow,
    forced_response,
    sampled_channel,
    signal_within,
    size_over_axes,
)
from dssc_jax.proofs.verifier.vehicle.nominal import DrivenChannel, channel_flight, start_ratio

PIECES = 4
"""Number of pieces of a sample or, with a rotor lag, of half of the lag's time constant."""
MOST_PIECES = 32
"""Largest number of pieces of a sample."""
PHASES = (Fraction(1, 8), Fraction(3, 8), Fraction(5, 8), Fraction(7, 8))
"""Times within a sample at which the signals are bounded, over T_s."""
CONSTANT_PLACE = 3
"""Place of the constant among the columns of the starts, after e, e' and q_(-1)."""
FIRST_OFFSET = 4
"""Place of the first known offset among these columns, after the constant."""


class SignalResponse(NamedTuple):
    """Upper bounds of a signal at one phase of the samples, for inputs and starts of size 1.

    Args:
        command: Bound for |omega_u| <= 1, where omega_u is the command's deviation.
        integral: Bound for |omega_r| <= 1, where omega_r is the own deviation of the sum q.
        remainders: Bounds for each remainder |r_j| <= 1, by name.
        constant: Bound for a constant 1 in place of o, from t = 0 on.
        settled_constant: Limit of the bound for this constant as time grows.
        starts: Bounds for e = 1 at t = 0, for e' = 1, and for a deviation 1 of q_(-1).
        start_offset: Bound for the known part of z_0 less the nominal flight's z_0; 0 if the vehicle hovers.
    """

    command: arb
    integral: arb
    remainders: Balls
    constant: arb
    settled_constant: arb
    starts: tuple[arb, arb, arb]
    start_offset: arb


class PhaseSignal(NamedTuple):
    """A signal at one phase, a time within every sample.

    Args:
        name: Name of the signal.
        time: Time since the sample [s].
        row: C_s, the signal as a row over the state z_k at the sample, shape (1, m).
        command_effect: Bound of the signal for |omega_u| <= 1 in the same sample.
        integral_effect: Bound of the signal for |omega_r| <= 1 in the same sample.
    """

    name: str
    time: arb
    row: arb_mat
    command_effect: arb
    integral_effect: arb


class ChannelObservation(NamedTuple):
    """A sampled channel for which V = z'Pz falls, its signals, and the columns of its inputs and starts.

    Args:
        channel: The linear channel.
        sampled: The channel at its samples.
        p: P of V = z'Pz, shape (m, m).
        decay: T_s lambda, the share of V that is lost in a sample.
        phase_signals: The signals at their phases.
        rows: Rows of these signals, shape (phase signals, m).
        curves: The columns of the remainders within a sample, by name.
        inputs: Columns b_u and b_q of omega_u and omega_r; then, for each remainder, its column at the points of a
            sample and the middle of its bend; then the unit columns of chi. Shape (m, inputs).
        starts: Columns of e = 1, of e' = 1, of q_(-1) = 1, of the constant, and of the known offset along each axis,
            shape (m, 4 + axes).
        offsets: Constants that are added to the responses to the starts, shape (phase signals, 4 + axes).
        flight: N, bounds of the nominal flight's signals; empty if the vehicle hovers.
    """

    channel: Channel
    sampled: SampledChannel
    p: arb_mat
    decay: arb
    phase_signals: list[PhaseSignal]
    rows: arb_mat
    curves: dict[str, "CurvedColumn"]
    inputs: arb_mat
    starts: arb_mat
    offsets: arb_mat
    flight: Balls


def observe_channel(problem: VehicleProblem, name: str, proof: MiddleProof) -> ChannelObservation:
    """(V1) Build a channel at its samples, with its signals and inputs, and show that V = z'Pz falls.

    Args:
        problem: The certificate's problem.
        name: Name of the channel.
        proof: The channel's proof, with slopes, share, damping, lambda and P.

    Raises:
        Rejected: lambda is out of range, P is not positive definite, V does not fall, or a response cannot be enclosed.
    """
    controller = problem["channels"][name]
    t = arb(problem["sample_time"])
    decay = t * arb(proof["rate"])
    require_premise(bool(decay > 0) and bool(decay < 1), f"V1: lambda of {name} is not in (0, 1/T_s)")
    channel = channel_of(problem, name, proof["drag_damping"])
    sampled = sampled_channel(channel, controller, proof, problem["sample_time"], problem["delay"])
    p = symmetric_matrix(proof["p"])
    require_premise(positive_definite(p), f"V1: P of {name} is not positive definite")
    decrease = p * (1 - decay) - sampled.a.transpose() * p * sampled.a
    require_premise(positive_definite(decrease), f"V1: V of {name} does not fall")
    phase_signals = phase_signals_of(channel, sampled, t, arb(proof["share"]))
    curves = curved_columns(channel, t, pieces_of(problem))
    starts, offsets = start_columns(channel, sampled, proof, controller["start"], t, phase_signals)
    flight = Balls()
    if problem["reference"] is not None:
        phases = [t * phase.numerator / phase.denominator for phase in PHASES]
        driven_channel = DrivenChannel(name, controller, proof, channel, sampled, t, phases)
        flight, start_offsets = channel_flight(problem, driven_channel)
        starts = side_by_side(starts, *start_offsets)
        offsets = side_by_side(offsets, arb_mat(len(phase_signals), len(start_offsets)))
    columns = [sampled.by_command, sampled.by_integral]
    for curve in curves.values():
        columns += [extended_column(column_block, sampled) for column_block in (*curve.points, curve.bend)]
    inputs = side_by_side(*columns, first_columns(identity(sampled.a.nrows()), channel.order))
    rows = stack([phase_signal.row for phase_signal in phase_signals])
    return ChannelObservation(
        channel=channel,
        sampled=sampled,
        p=p,
        decay=decay,
        phase_signals=phase_signals,
        rows=rows,
        curves=curves,
        inputs=inputs,
        starts=starts,
        offsets=offsets,
        flight=flight,
    )


def channel_responses(
    problem: VehicleProblem, name: str, observation: ChannelObservation
) -> dict[str, list[SignalResponse]]:
    """(V1) The responses of a channel's signals, by name and for each phase.

    Args:
        problem: The certificate's problem.
        name: Name of the channel.
        observation: The channel's signals and inputs at the samples.

    Raises:
        Rejected: The responses decay too slowly.
    """
    t = arb(problem["sample_time"])
    bounds = response_bounds(
        observation.sampled.a,
        observation.rows,
        observation.inputs,
        observation.starts,
        observation.p,
        observation.decay,
        observation.offsets,
    )
    if bounds is None:
        raise Rejected(f"V1: the responses of {name} decay too slowly")
    responses: dict[str, list[SignalResponse]] = {}
    for i, phase_signal in enumerate(observation.phase_signals):
        responses.setdefault(phase_signal.name, []).append(response_of(i, observation, bounds, t))
    return responses


def phase_signals_of(channel: Channel, sampled: SampledChannel, t: arb, share: arb) -> list[PhaseSignal]:
    """Every signal at every phase, and u_av at the samples.

    Args:
        channel: The linear channel.
        sampled: The channel at its samples.
        t: T_s [s].
        share: s_q, the share of omega_u in omega_q.
    """
    phase_signals = []
    both_effects = abs(1 + t * share)  # of omega_u on the command: directly, and through T_s omega_q in the sum q
    for phase in PHASES:
        time = t * phase.numerator / phase.denominator
        transition = flow(channel, time)
        for signal in channel.signals:
            row, by_fresh = signal_within(channel, sampled, signal, transition)
            command_effect = abs(by_fresh) * both_effects
            phase_signals.append(PhaseSignal(signal, time, row, command_effect, integral_effect=t * abs(by_fresh)))
    return [*phase_signals, PhaseSignal(EQUIVALENT, arb(0), sampled.equivalent, abs(t * share), t)]


class CurvedColumn(NamedTuple):
    """An enclosure of the column e^(A_c r) b of a remainder, for all times r within a sample.

    Args:
        points: The column at the ends of all pieces of the sample, shape (n, 1) each.
        bend: Middle of the ball of the column's second derivative over the sample, shape (n, 1).
        radii: Radius of this ball in each of the n states.
    """

    points: list[arb_mat]
    bend: arb_mat
    radii: list[arb]

    @property
    def pieces(self) -> int:
        """Number of pieces."""
        return len(self.points) - 1


def pieces_of(problem: VehicleProblem) -> int:
    """Number of pieces of a sample for integrals; every number gives a valid bound, a short rotor lag needs more."""
    lag = problem["rotor_lag"]
    if lag <= 0:
        return PIECES
    half_lags = math.ceil(min(2.0 * problem["sample_time"] / lag, MOST_PIECES))  # in a sample
    return min(PIECES * half_lags, MOST_PIECES)


def curved_columns(channel: Channel, t: arb, pieces: int) -> dict[str, CurvedColumn]:
    """The columns e^(A_c r) b of the remainders for r within a sample of the duration t [s], by name."""
    a_c = channel.dynamics
    over_sample = (a_c * (t * interval_ball(0.0, 1.0))).exp()  # e^(A_c r) for all r
    curves = {}
    for name, b in channel.inputs.items():
        second_derivative = over_sample * (a_c * (a_c * b))
        radii = [entry.rad() for (entry,) in second_derivative.tolist()]
        points = [(a_c * (t * piece / pieces)).exp() * b for piece in range(pieces + 1)]
        curves[name] = CurvedColumn(points=points, bend=second_derivative.mid(), radii=radii)
    return curves


def extended_column(column_block: arb_mat, sampled: SampledChannel) -> arb_mat:
    """Extend a column over chi by zeros to a column over z, shape (m, 1)."""
    zero_count = sampled.a.nrows() - column_block.nrows()
    return stack([column_block, arb_mat(zero_count, 1)])


class Starts(NamedTuple):
    """The states z_0 for the starts e = 1, e' = 1, q_(-1) = 1 and for the constant, with offsets of the responses.

    Args:
        columns: Columns z_0, shape (m, 4).
        offsets: Constants that are added to the responses, shape (phase signals, 4); only the constant has some.
    """

    columns: arb_mat
    offsets: arb_mat


def start_columns(
    channel: Channel,
    sampled: SampledChannel,
    proof: MiddleProof,
    start: str,
    t: arb,
    phase_signals: Sequence[PhaseSignal],
) -> Starts:
    """The starts of a channel without those of a nominal flight.

    The starts are e = 1, e' = 1, q_(-1) = 1, and a constant force 1 from t = 0 on. The constant leads to the
    equilibrium z*, so that z_k = z* + A^k (0 - z*). To the signal at the time s since the sample it also adds the
    integral of C e^(A_c r) b over r from 0 to s.

    Args:
        channel: The linear channel.
        sampled: The channel at its samples.
        proof: The channel's proof, with the slopes of the straight lines.
        start: Start of the predictor: ``zero``, ``matched`` or ``midpoint``.
        t: T_s [s].
        phase_signals: The signals at their phases.

    Raises:
        Rejected: The equilibrium cannot be enclosed.
    """
    m = sampled.a.nrows()
    ratio = start_ratio(proof, start, t)  # -q_(-1)/sigma_0
    units = identity(m)
    e = column(units, 0)
    e_dot = column(units, 1)
    q = column(units, m - 1)
    columns = [
        e - q * (ratio * sampled.sigma[0, 0]),  # sigma_0 = e' + l_0 e sets q_(-1), too
        e_dot - q * (ratio * sampled.sigma[0, 1]),
        q,
    ]
    offsets = arb_mat(len(phase_signals), 4)
    b = channel.constant
    if b is None:
        return Starts(side_by_side(*columns, arb_mat(m, 1)), offsets)
    try:
        equilibrium = (units - sampled.a).solve(extended_column(forced_response(channel, b, t), sampled))
    except ZeroDivisionError:
        raise Rejected("V1: the response to the constant cannot be enclosed") from None
    for i, phase_signal in enumerate(phase_signals):
        offset = (phase_signal.row * equilibrium)[0, 0]
        if phase_signal.name != EQUIVALENT:
            row = first_columns(channel.signals[phase_signal.name], channel.order)  # C
            offset = offset + (row * forced_response(channel, b, phase_signal.time))[0, 0]
        offsets[i, CONSTANT_PLACE] = offset
    return Starts(side_by_side(*columns, -equilibrium), offsets)


def response_of(i: int, observation: ChannelObservation, bounds: ResponseBounds, t: arb) -> SignalResponse:
    """The response of one signal at one phase, from the sums and peaks of the responses of its row.

    Args:
        i: Number of the signal's row.
        observation: The channel's signals and inputs at the samples.
        bounds: Sums and peaks of the responses.
        t: T_s [s].
    """
    phase_signal = observation.phase_signals[i]
    curves = observation.curves
    command, integral, *sums = [arb(float(value)) for value in bounds.sums[i]]  # of the columns of ``inputs``
    pieces = next(iter(curves.values())).pieces  # the same for all remainders
    columns_of_curve = pieces + 2  # the points, and the middle of the bend
    units = sums[columns_of_curve * len(curves) :]
    piece = t / pieces
    remainders = Balls()
    for place, (name, curve) in enumerate(curves.items()):
        start, *inner, end, middle = sums[columns_of_curve * place : columns_of_curve * (place + 1)]
        lines = piece * ((start + end) / 2 + total(inner))
        curvature = middle + total([radius * unit for radius, unit in zip(curve.radii, units, strict=True)])
        later_effect = lines + pieces * piece**3 / 12 * curvature
        remainders[name] = (later_effect + integral_within(observation.channel, phase_signal, curve)).upper()
    e, e_dot, q, constant, *start_offsets = [arb(float(value)) for value in bounds.peaks[i]]
    return SignalResponse(
        command=(command + phase_signal.command_effect).upper(),
        integral=(integral + phase_signal.integral_effect).upper(),
        remainders=remainders,
        constant=constant,
        settled_constant=abs(observation.offsets[i, CONSTANT_PLACE]).upper(),  # at the constant's equilibrium
        starts=(e, e_dot, q),
        start_offset=size_over_axes(phase_signal.name, start_offsets),
    )


def integral_within(channel: Channel, phase_signal: PhaseSignal, curve: CurvedColumn) -> arb:
    """Bound of the effect of a remainder of size 1 on a signal in the same sample; 0 for u_av, taken at its beginning.

    The bound is that of the integral of |C e^(A_c r) b| over r from 0 to the signal's phase.

    Args:
        channel: The linear channel.
        phase_signal: The signal at its phase.
        curve: The column of the remainder; the time up to the phase is cut into as many pieces as the curve has.
    """
    if phase_signal.name == EQUIVALENT:
        return arb(0)
    b = curve.points[0]
    pieces = curve.pieces
    a_c = channel.dynamics
    row = first_columns(channel.signals[phase_signal.name], channel.order)  # C
    over_time = (a_c * (phase_signal.time * interval_ball(0.0, 1.0))).exp()
    curvature = abs((row * over_time * (a_c * (a_c * b)))[0, 0])
    piece = phase_signal.time / pieces
    start, *inner, end = [abs((row * (a_c * (piece * i)).exp() * b)[0, 0]) for i in range(pieces + 1)]
    return (piece * ((start + end) / 2 + total(inner)) + pieces * piece**3 / 12 * curvature).upper()
