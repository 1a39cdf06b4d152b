"""Upper bounds of what the inputs of a channel do to its signals: sums and integrals of responses, and their peaks.

A signal is seen at the times ``PHASES`` of each sample. With f(r) = C_s A^k e^(A_c r) b the integral of |f| over a time
h is at most h/2 (|f(0)| + |f(h)|) + h^3/12 sup |f''|: the magnitude of the straight line between the ends is convex,
and f is apart from this line. A sample is cut into pieces. f'' has the column e^(A_c r) A_c^2 b, which is enclosed
over the sample as a middle column plus a radius in each unit column.
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
    maximum,
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
    ALONG_AXES,
    EQUIVALENT,
    Channel,
    SampledChannel,
    channel_of,
    first_columns,
    flow,
    forced_response,
    row_at,
    sampled_channel,
    with_zeros,
)
from dssc_jax.proofs.verifier.vehicle.nominal import channel_flight, start_ratio

PIECES = 4
"""Pieces of each half of the rotors' lag, or of a shorter sample; a straight line replaces a response over each."""
MOST_PIECES = 32
"""Largest number of pieces of a sample."""
PHASES = (Fraction(1, 8), Fraction(3, 8), Fraction(5, 8), Fraction(7, 8))
"""Times within a sample at which the signals are seen, over T_s."""


class SignalResponse(NamedTuple):
    """Upper bounds of a signal at one phase of the samples, for inputs and starts of size 1.

    Args:
        command: For |omega_u| <= 1, what the command deviates by.
        integral: For |omega_r| <= 1, what the sum q deviates by besides.
        remainders: For each remainder |r_j| <= 1, by name.
        constant: For a constant 1 in place of o, from t = 0 on.
        settled_constant: For that constant as time grows.
        starts: For e = 1 and for e' = 1 at t = 0, and for a deviation 1 of the first sum q.
        start_offset: For the known difference of the start from the nominal flight's; 0 without a reference.
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
        row: Row of the signal over the state z_k at the sample, (1, m).
        command_effect: Bound of the signal for |omega_u| <= 1 in the same sample.
        integral_effect: Bound of the signal for |omega_r| <= 1 in the same sample.
    """

    name: str
    time: arb
    row: arb_mat
    command_effect: arb
    integral_effect: arb


class ChannelObservation(NamedTuple):
    """A sampled channel whose V falls, its signals, and the columns of its inputs and starts.

    Args:
        channel: The linear channel.
        sampled: The channel at its samples.
        p: P of V, (m, m).
        decay: T_s lambda, the share of V that is lost in a sample.
        phase_signals: The signals at their phases.
        rows: Rows of these signals, (phase signals, m).
        curves: The columns of the remainders within a sample, by name.
        inputs: Columns of omega_u and omega_r, points and bend of each remainder, and the unit columns of chi,
            (m, inputs).
        starts: Columns of e, e', the first sum q, the constant, and the known offset along each axis, (m, 4 + axes).
        offsets: Constants that are added to the responses to the starts, (phase signals, 4 + axes).
        flight: Bounds of the nominal flight's signals; empty without a reference.
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


FIRST_OFFSET = 4
"""Place of the first known offset among the columns of the starts."""


def observe_channel(problem: VehicleProblem, name: str, proof: MiddleProof) -> ChannelObservation:
    """(V1) A linear channel at its samples, of which it is shown that V = z'Pz falls.

    Args:
        problem: The certificate's problem.
        name: The channel.
        proof: Its proof, with slopes, damping, lambda and P.

    Raises:
        Rejected: V does not fall.
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
        flight, start_offsets = channel_flight(problem, name, proof, channel, sampled, phases)
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
        name: The channel.
        observation: Its signals and inputs at the samples.

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
    result: dict[str, list[SignalResponse]] = {}
    for i, phase_signal in enumerate(observation.phase_signals):
        response = response_of(i, phase_signal, observation.channel, observation.curves, bounds, observation.offsets, t)
        result.setdefault(phase_signal.name, []).append(response)
    return result


def phase_signals_of(channel: Channel, sampled: SampledChannel, t: arb, share: arb) -> list[PhaseSignal]:
    """Every signal at every phase, and u_av at the samples.

    Args:
        channel: The linear channel.
        sampled: The channel at its samples.
        t: T_s [s].
        share: Share of omega_u in omega_q, the deviation of the sum q.
    """
    phase_signals = []
    both_effects = abs(1 + t * share)
    for phase in PHASES:
        time = t * phase.numerator / phase.denominator
        transition = flow(channel, time)
        for signal in channel.signals:
            row, direct = row_at(channel, sampled, signal, transition)
            phase_signals.append(PhaseSignal(signal, time, row, abs(direct) * both_effects, t * abs(direct)))
    return [*phase_signals, PhaseSignal(EQUIVALENT, arb(0), sampled.equivalent, abs(t * share), t)]


class CurvedColumn(NamedTuple):
    """The column e^(A_c r) b of a remainder for times r within a sample.

    Args:
        points: The column at the ends of all pieces of the sample, (n, 1) each.
        bend: Middle of the column's second derivative over the sample, (n, 1).
        radii: Radii about this middle, for each state.
    """

    points: list[arb_mat]
    bend: arb_mat
    radii: list[arb]

    @property
    def pieces(self) -> int:
        """Number of pieces."""
        return len(self.points) - 1


def pieces_of(problem: VehicleProblem) -> int:
    """Number of pieces of a sample, each of which a straight line replaces; more pieces give a smaller bound."""
    lag = problem["rotor_lag"]
    if lag <= 0:
        return PIECES
    return min(PIECES * math.ceil(min(2.0 * problem["sample_time"] / lag, MOST_PIECES)), MOST_PIECES)


def curved_columns(channel: Channel, t: arb, pieces: int) -> dict[str, CurvedColumn]:
    """The columns of the remainders within a sample of the duration ``t`` [s], by name."""
    f = channel.dynamics
    over_sample = (f * (t * interval_ball(0.0, 1.0))).exp()
    result = {}
    for name, b in channel.inputs.items():
        second_derivative = over_sample * (f * (f * b))
        radii = [entry.rad() for (entry,) in second_derivative.tolist()]
        points = [(f * (t * piece / pieces)).exp() * b for piece in range(pieces + 1)]
        result[name] = CurvedColumn(points, second_derivative.mid(), radii)
    return result


def extended_column(column_block: arb_mat, sampled: SampledChannel) -> arb_mat:
    """A column over the states chi, extended by zeros to one over z, (m, 1)."""
    remainder = sampled.a.nrows() - column_block.nrows()
    return stack([column_block, arb_mat(remainder, 1)])


def start_columns(
    channel: Channel,
    sampled: SampledChannel,
    proof: MiddleProof,
    start: str,
    t: arb,
    phase_signals: Sequence[PhaseSignal],
) -> tuple[arb_mat, arb_mat]:
    """Columns z_0 of the starts, (m, 4), and constants that are added to the responses to them, (phase signals, 4).

    The starts are e = 1, e' = 1, a first sum q = 1, and a constant force 1 from t = 0 on. The constant leads to the
    equilibrium z*, so that z_k = z* + A^k (0 - z*). The signal at s has the integral of C e^(A_c r) b up to s besides.

    Args:
        channel: The linear channel.
        sampled: The channel at its samples.
        proof: Its proof, with the slopes of its functions.
        start: Start of the predictor.
        t: T_s [s].
        phase_signals: The signals at their phases.

    Raises:
        Rejected: The equilibrium cannot be enclosed.
    """
    m = sampled.a.nrows()
    ratio = start_ratio(proof, start, t)
    units = identity(m)
    end = column(units, m - 1)
    columns = []
    for place in range(2):  # of sigma_0 = e' + l_0 e
        columns.append(column(units, place) - end * (ratio * sampled.sigma[0, place]))
    columns.append(end)
    offsets = arb_mat(len(phase_signals), 4)
    b = channel.constant
    if b is None:
        return side_by_side(*columns, arb_mat(m, 1)), offsets
    try:
        equilibrium = (units - sampled.a).solve(extended_column(forced_response(channel, b, t), sampled))
    except ZeroDivisionError:
        raise Rejected("V1: the response to the constant cannot be enclosed") from None
    for i, phase_signal in enumerate(phase_signals):
        offsets[i, 3] = (phase_signal.row * equilibrium)[0, 0]
        if phase_signal.name != EQUIVALENT:
            within = with_zeros(channel.signals[phase_signal.name], channel.order, channel.order)
            offsets[i, 3] = offsets[i, 3] + (within * forced_response(channel, b, phase_signal.time))[0, 0]
    return side_by_side(*columns, -equilibrium), offsets


def response_of(
    i: int,
    phase_signal: PhaseSignal,
    channel: Channel,
    curves: dict[str, CurvedColumn],
    bounds: ResponseBounds,
    offsets: arb_mat,
    t: arb,
) -> SignalResponse:
    """The response of one signal at one phase, from the sums and peaks of its row.

    Args:
        i: Row of the signal.
        phase_signal: The signal at its phase.
        channel: The linear channel.
        curves: The columns of the remainders within a sample.
        bounds: Sums and peaks of the responses.
        offsets: Constants that are added to the responses to the starts.
        t: T_s [s].
    """
    command, integral, *sums = [arb(float(value)) for value in bounds.sums[i]]
    pieces = next(iter(curves.values())).pieces
    count = pieces + 2
    units = sums[count * len(curves) :]
    piece = t / pieces
    remainders = Balls()
    for place, (name, curve) in enumerate(curves.items()):
        start, *inner, end, middle = sums[count * place : count * (place + 1)]
        curvature = middle + total([radius * unit for radius, unit in zip(curve.radii, units, strict=True)])
        lines = piece * ((start + end) / 2 + total(inner)) + pieces * piece**3 / 12 * curvature
        remainders[name] = (lines + integral_within(channel, phase_signal, curve)).upper()
    peaks = [arb(float(value)) for value in bounds.peaks[i]]
    return SignalResponse(
        command=(command + phase_signal.command_effect).upper(),
        integral=(integral + phase_signal.integral_effect).upper(),
        remainders=remainders,
        constant=peaks[3],
        settled_constant=abs(offsets[i, 3]).upper(),
        starts=(peaks[0], peaks[1], peaks[2]),
        start_offset=size_over_axes(phase_signal.name, peaks[FIRST_OFFSET:]),
    )


def size_over_axes(signal: str, axes: Sequence[arb]) -> arb:
    """A bound of a signal from those on each axis: of a signal along an axis the larger one, of a vector the norm."""
    if not axes:
        return arb(0)
    if len(axes) == 1 or signal in ALONG_AXES:
        return maximum(*axes)
    return total([size * size for size in axes]).sqrt().upper()


def integral_within(channel: Channel, phase_signal: PhaseSignal, curve: CurvedColumn) -> arb:
    """Bound of the integral of |C e^(A_c r) b| from the sample to a signal's phase, in as many pieces as a sample has.

    It is what a remainder of size 1 does to the signal in the same sample.
    """
    if phase_signal.name == EQUIVALENT:
        return arb(0)
    b = curve.points[0]
    pieces = curve.pieces
    f = channel.dynamics
    row = first_columns(channel.signals[phase_signal.name], channel.order)
    over_time = (f * (phase_signal.time * interval_ball(0.0, 1.0))).exp()
    curvature = abs((row * over_time * (f * (f * b)))[0, 0])
    piece = phase_signal.time / pieces
    start, *inner, end = [abs((row * (f * (piece * i)).exp() * b)[0, 0]) for i in range(pieces + 1)]
    return (piece * ((start + end) / 2 + total(inner)) + pieces * piece**3 / 12 * curvature).upper()
