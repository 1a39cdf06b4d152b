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
    flow,
    forced_response,
    row_at,
    sampled_channel,
    with_zeros,
)
from dssc_jax.proofs.verifier.vehicle.nominal import channel_flight

ONE_AXIS = 1
PIECES = 4
"""Pieces of each half of the rotors' lag, or of a shorter sample; a straight line replaces a response over each."""
MOST_PIECES = 32
"""Largest number of pieces of a sample."""
PHASES = (Fraction(1, 8), Fraction(3, 8), Fraction(5, 8), Fraction(7, 8))
"""Times within a sample at which the signals are seen, over T_s."""


class SignalResponse(NamedTuple):
    """Upper bounds of the responses of a signal at one time within the samples.

    Args:
        command: Response to |omega_u| <= 1.
        integral: Response to |omega_r| <= 1.
        remainders: Response to each |r_j| <= 1.
        constant: Response to a constant 1 in place of o, from t = 0 on.
        settled_constant: Response to that constant as time grows.
        starts: Responses to e = 1 and to e' = 1 at t = 0, and to a deviation 1 of the first sum q.
        known: Response to what is known of the start, with a moving reference.
    """

    command: arb
    integral: arb
    remainders: Balls
    constant: arb
    settled_constant: arb
    starts: tuple[arb, arb, arb]
    known: arb


class Sight(NamedTuple):
    """A signal at one time within the samples.

    Args:
        signal: The signal's name.
        time: Time since the sample [s].
        row: Its row over z_k, (1, m).
        direct: Its direct effect of omega_u of the same sample.
        direct_integral: Its direct effect of omega_r of the same sample.
    """

    signal: str
    time: arb
    row: arb_mat
    direct: arb
    direct_integral: arb


class ChannelObservation(NamedTuple):
    """A sampled channel whose V falls, and what is seen of it.

    Args:
        channel: The channel.
        sampled: The channel at its samples.
        p: P of V, (m, m).
        decay: T_s lambda.
        sights: The signals at their times.
        rows: Rows of these signals, (sights, m).
        curves: The columns of the remainders within a sample.
        inputs: omega_u, omega_r, points and bend of each remainder, and the unit columns of chi, (m, inputs).
        starts: e, e', the first sum q, the constant, and what is known of the start along each axis, (m, 4 + axes).
        offsets: What is added to the responses to the starts, (sights, 4 + axes).
        flight: Bounds of the nominal flight's signals; empty without a reference.
    """

    channel: Channel
    sampled: SampledChannel
    p: arb_mat
    decay: arb
    sights: list[Sight]
    rows: arb_mat
    curves: dict[str, "CurvedColumn"]
    inputs: arb_mat
    starts: arb_mat
    offsets: arb_mat
    flight: Balls


KNOWN = 4
"""Place of the first column of what is known of the start."""


def observe_channel(problem: VehicleProblem, name: str, proof: MiddleProof) -> ChannelObservation:
    """(V1) A channel at its samples.

    Args:
        problem: The certificate's problem.
        name: The channel.
        proof: Its proof.
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
    sights = signal_sights(channel, sampled, t, arb(proof["share"]))
    curves = curved_columns(channel, t, pieces_of(problem))
    starts, offsets = start_columns(channel, sampled, proof, controller["start"], t, sights)
    flight = Balls()
    if problem["reference"] is not None:
        phases = [t * phase.numerator / phase.denominator for phase in PHASES]
        flight, known_starts = channel_flight(problem, name, proof, channel, sampled, phases)
        starts = side_by_side(starts, *known_starts)
        offsets = side_by_side(offsets, arb_mat(len(sights), len(known_starts)))
    columns = [sampled.by_command, sampled.by_integral]
    for curve in curves.values():
        columns += [extended_column(column_block, sampled) for column_block in (*curve.points, curve.bend)]
    inputs = side_by_side(*columns, first_columns(identity(sampled.a.nrows()), channel.order))
    rows = stack([sight.row for sight in sights])
    return ChannelObservation(
        channel=channel,
        sampled=sampled,
        p=p,
        decay=decay,
        sights=sights,
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
    """(V1) The responses of a channel's signals, at each phase.

    Args:
        problem: The certificate's problem.
        name: The channel.
        observation: Its signals and inputs at the samples.
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
    require_premise(bounds is not None, f"V1: the responses of {name} decay too slowly")
    assert bounds is not None
    result: dict[str, list[SignalResponse]] = {}
    for i, sight in enumerate(observation.sights):
        response = response_of(i, sight, observation.channel, observation.curves, bounds, observation.offsets, t)
        result.setdefault(sight.signal, []).append(response)
    return result


def signal_sights(channel: Channel, sampled: SampledChannel, t: arb, share: arb) -> list[Sight]:
    """Every signal at every phase; u_av at the samples. ``share`` is that of omega_u in omega_q."""
    sights = []
    by_both = abs(1 + t * share)
    for phase in PHASES:
        time = t * phase.numerator / phase.denominator
        transition = flow(channel, time)
        for signal in channel.signals:
            row, direct = row_at(channel, sampled, signal, transition)
            sights.append(Sight(signal, time, row, abs(direct) * by_both, t * abs(direct)))
    return [*sights, Sight(EQUIVALENT, arb(0), sampled.equivalent, abs(t * share), t)]


class CurvedColumn(NamedTuple):
    """e^(A_c r) b at the ends of all pieces, and its second derivative: a middle column and the radii about it."""

    points: list[arb_mat]
    bend: arb_mat
    radii: list[arb]

    @property
    def pieces(self) -> int:
        """Number of pieces."""
        return len(self.points) - 1


def pieces_of(problem: VehicleProblem) -> int:
    """Number of pieces of a sample; any number gives a bound, and more pieces a smaller one."""
    lag = problem["rotor_lag"]
    if lag <= 0:
        return PIECES
    return min(PIECES * math.ceil(min(2.0 * problem["sample_time"] / lag, MOST_PIECES)), MOST_PIECES)


def curved_columns(channel: Channel, t: arb, pieces: int) -> dict[str, CurvedColumn]:
    """The columns of the remainders within a sample."""
    f = dynamics(channel)
    over_sample = (f * (t * interval_ball(0.0, 1.0))).exp()
    result = {}
    for name, b in channel.inputs.items():
        second_derivative = over_sample * (f * (f * b))
        radii = [entry.rad() for (entry,) in second_derivative.tolist()]
        points = [(f * (t * piece / pieces)).exp() * b for piece in range(pieces + 1)]
        result[name] = CurvedColumn(points, second_derivative.mid(), radii)
    return result


def dynamics(channel: Channel) -> arb_mat:
    """A_c, (n, n)."""
    return first_columns(channel.generator, channel.order)


def first_columns(matrix: arb_mat, count: int) -> arb_mat:
    """The first columns of a matrix."""
    return arb_mat([row[:count] for row in matrix.tolist()])


def extended_column(column_block: arb_mat, sampled: SampledChannel) -> arb_mat:
    """A column over chi as one over z, (m, 1)."""
    remainder = sampled.a.nrows() - column_block.nrows()
    return stack([column_block, arb_mat(remainder, 1)])


def start_columns(
    channel: Channel, sampled: SampledChannel, proof: MiddleProof, start: str, t: arb, sights: Sequence[Sight]
) -> tuple[arb_mat, arb_mat]:
    """The starts z_0 of e, of e' and of the first sum q, and -z* of the constant; and the offsets of their responses.

    To the constant, z_k = z* + A^k (0 - z*), and the signal at s has the integral of C e^(A_c r) b up to s besides.
    """
    m = sampled.a.nrows()
    slope_1, slope_2, _ = map(arb, proof["slopes"])
    ratio = {"zero": arb(0), "matched": slope_1, "midpoint": slope_1 + t * slope_2 / 2}[start]
    units = identity(m)
    end = column(units, m - 1)
    columns = []
    for place in range(2):  # of sigma_0 = e' + l_0 e
        columns.append(column(units, place) - end * (ratio * sampled.sigma[0, place]))
    columns.append(end)
    offsets = arb_mat(len(sights), 4)
    b = channel.constant
    if b is None:
        return side_by_side(*columns, arb_mat(m, 1)), offsets
    try:
        remainder = (units - sampled.a).solve(extended_column(forced_response(channel, b, t), sampled))
    except ZeroDivisionError:
        raise Rejected("V1: the response to the constant cannot be enclosed") from None
    for i, sight in enumerate(sights):
        offsets[i, 3] = (sight.row * remainder)[0, 0]
        if sight.signal != EQUIVALENT:
            within = with_zeros(channel.signals[sight.signal], channel.order, channel.order)
            offsets[i, 3] = offsets[i, 3] + (within * forced_response(channel, b, sight.time))[0, 0]
    return side_by_side(*columns, -remainder), offsets


def response_of(
    i: int,
    sight: Sight,
    channel: Channel,
    curves: dict[str, CurvedColumn],
    bounds: ResponseBounds,
    offsets: arb_mat,
    t: arb,
) -> SignalResponse:
    """The response of one signal at one phase, which is row ``i`` of the sums."""
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
        remainders[name] = (lines + integral_within(channel, sight, curve)).upper()
    peaks = [arb(float(value)) for value in bounds.peaks[i]]
    known = known_size(sight.signal, peaks[KNOWN:])
    return SignalResponse(
        command=(command + sight.direct).upper(),
        integral=(integral + sight.direct_integral).upper(),
        remainders=remainders,
        constant=peaks[3],
        settled_constant=abs(offsets[i, 3]).upper(),
        starts=(peaks[0], peaks[1], peaks[2]),
        known=known,
    )


def known_size(signal: str, axes: Sequence[arb]) -> arb:
    """A bound of a signal from those along each axis: the larger one along an axis, the norm of a vector."""
    if len(axes) == ONE_AXIS:
        return axes[0]
    if signal in ALONG_AXES:
        return maximum(*axes) if axes else arb(0)
    return total([size * size for size in axes]).sqrt().upper()


def integral_within(channel: Channel, sight: Sight, curve: CurvedColumn) -> arb:
    """Bound of the integral of |C e^(A_c r) b| since the sample, in as many pieces as a whole one."""
    if sight.signal == EQUIVALENT:
        return arb(0)
    b = curve.points[0]
    pieces = curve.pieces
    f = dynamics(channel)
    row = first_columns(channel.signals[sight.signal], channel.order)
    over_time = (f * (sight.time * interval_ball(0.0, 1.0))).exp()
    curvature = abs((row * over_time * (f * (f * b)))[0, 0])
    piece = sight.time / pieces
    start, *inner, end = [abs((row * (f * (piece * i)).exp() * b)[0, 0]) for i in range(pieces + 1)]
    return (piece * ((start + end) / 2 + total(inner)) + pieces * piece**3 / 12 * curvature).upper()
