"""The nominal flight of a moving reference: the periodic answer of the linear channels to sums of sines, in balls.

For every frequency f = 1/T_f a sampled channel has the answer Z_f e^(2 pi i f t_k) with (e^(2 pi i f T_s) - A) Z_f =
D_f, where D_f is what drives the channel within a sample. A signal at the time t_k + s is the real
part of X(s) e^(2 pi i f t_k).
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import NamedTuple

from flint import acb, acb_mat, arb, arb_mat

from dssc_jax.proofs.verifier.balls import Balls, Rejected, interval_ball, maximum, require_premise
from dssc_jax.proofs.verifier.vehicle.certificate import CHANNELS, MiddleProof, VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import ALONG_AXES, EQUIVALENT, Channel, SampledChannel
from dssc_jax.proofs.verifier.vehicle.ranges import GRAVITY
from dssc_jax.proofs.verifier.vehicle.waves import (
    Waves,
    angular,
    at_start,
    largest,
    multiple,
    rate,
    sine_wave,
    sum_of,
    times,
)

AXES = {"x": ("x", "y"), "z": ("z",), "psi": ("psi",)}
"""The axes of each channel."""
OUTPUT_RATE = "rate"
"""The rate of the output itself, beside e_dot, that of the error."""
Phasors = dict[str, list[acb]]
"""Phasors of signals, one for each phase."""


class Course(NamedTuple):
    """The inputs of an axis from which its nominal flight follows.

    Args:
        reference: y_m without its constant.
        known_remainders: The known parts of the remainders, by name.
        comparisons: By the name of a difference: the signal, and the sum of sines that is subtracted from it.
    """

    reference: Waves
    known_remainders: Mapping[str, Waves]
    comparisons: Mapping[str, tuple[str, Waves]]

    @property
    def frequencies(self) -> set[Fraction]:
        """All frequencies."""
        return {frequency for waves in (self.reference, *self.known_remainders.values()) for frequency in waves}


class ChannelFlight(NamedTuple):
    """The nominal flight in one channel.

    Args:
        bounds: Bounds of its signals, and of its differences.
        starts: What z_0 of the vehicle, without its box, differs by from that of the flight; a column for each axis.
    """

    bounds: Balls
    starts: list[arb_mat]


class Coupling(NamedTuple):
    """Bounds of what couples the channels of a vehicle whose reference moves.

    Args:
        alpha: G_alpha, of |alpha - alpha_0|.
        wanted: G_a, of |a_h - alpha_0|.
        lift: G_z, of |a_z - z_m''|.
        yaw: G_psi, of |psi' - psi_m'|.
        lift_known: A_m, of |z_m''|.
        yaw_known: Psi_m, of |psi_m'|.
    """

    alpha: arb
    wanted: arb
    lift: arb
    yaw: arb
    lift_known: arb
    yaw_known: arb


class Flight(NamedTuple):
    """The nominal flight: bounds of its signals by channel, and of |z_m''| and |psi_m'|."""

    bounds: Mapping[str, Balls]
    lift: arb
    yaw: arb


def total_bounds(flight: Flight | None, bounds: Mapping[str, Mapping[str, arb]]) -> Mapping[str, Mapping[str, arb]]:
    """Bounds of the vehicle's signals, from bounds of what they differ by from the nominal flight's."""
    if flight is None:
        return bounds
    result = {}
    for name in CHANNELS:
        nominal = flight.bounds[name]
        result[name] = {signal: (y + nominal.get(signal, arb(0))).upper() for signal, y in bounds[name].items()}
    return result


def body_bounds(flight: Flight | None, bounds: Mapping[str, Mapping[str, arb]]) -> Mapping[str, Mapping[str, arb]]:
    """Bounds of the vehicle's signals, where e_dot of z and psi stands for its vertical speed and its yaw rate."""
    totals = total_bounds(flight, bounds)
    if flight is None:
        return totals
    rates = {
        name: (bounds[name]["e_dot"] + flight.bounds[name][OUTPUT_RATE]).upper() for name in CHANNELS if name != "x"
    }
    return {name: {**signals, "e_dot": rates[name]} if name in rates else signals for name, signals in totals.items()}


def coupling_under(flight: Flight | None, bounds: Mapping[str, Mapping[str, arb]]) -> Coupling | None:
    """Bounds of the coupling of the channels, from bounds of the deviation; None without a reference."""
    if flight is None:
        return None
    return Coupling(
        alpha=(flight.bounds["x"]["alpha_gap"] + bounds["x"]["alpha"]).upper(),
        wanted=(flight.bounds["x"]["wanted_gap"] + bounds["x"]["wanted"]).upper(),
        lift=(flight.bounds["z"]["lift_gap"] + bounds["z"]["wanted"]).upper(),
        yaw=(flight.bounds["psi"]["yaw_gap"] + bounds["psi"]["e_dot"]).upper(),
        lift_known=flight.lift,
        yaw_known=flight.yaw,
    )


def courses_of(problem: VehicleProblem, name: str, damping: arb) -> list[Course]:
    """The inputs of each axis of a channel; ``damping`` is c of x."""
    sines = problem["reference"]
    assert sines is not None
    references = {axis: sine_wave(sines[axis]) for axis in sines}
    if name == "psi":
        return [Course(references["psi"], {}, {"yaw_gap": (OUTPUT_RATE, rate(references["psi"]))})]
    lift = rate(rate(references["z"]))
    if name == "z":
        return [Course(references["z"], {}, {"lift_gap": ("wanted", lift)})]
    yaw_rate = rate(references["psi"])
    alpha_0 = {axis: sum_of(rate(rate(references[axis])), multiple(rate(references[axis]), damping)) for axis in "xy"}
    quarter_turn = {"x": multiple(alpha_0["y"], arb(-1)), "y": alpha_0["x"]}
    courses = []
    for axis in "xy":
        force = multiple(times(lift, alpha_0[axis]), 1 / arb(GRAVITY))
        yaw_torque = multiple(times(yaw_rate, quarter_turn[axis]), arb(problem["damping"]))
        torque = sum_of(yaw_torque, multiple(force, -arb(problem["stiffness"])))
        comparisons = {"alpha_gap": ("alpha", alpha_0[axis]), "wanted_gap": ("wanted", alpha_0[axis])}
        courses.append(Course(references[axis], {"force": force, "torque": torque}, comparisons))
    return courses


def flight_of(problem: VehicleProblem, channels: Mapping[str, Balls]) -> Flight | None:
    """The nominal flight, from its channels; None without a reference."""
    sines = problem["reference"]
    if sines is None:
        return None
    lift = largest(rate(rate(sine_wave(sines["z"]))))
    return Flight(channels, lift, largest(rate(sine_wave(sines["psi"]))))


def channel_flight(
    problem: VehicleProblem,
    name: str,
    proof: MiddleProof,
    channel: Channel,
    sampled: SampledChannel,
    phases: Sequence[arb],
) -> ChannelFlight:
    """(V1) The nominal flight in a channel.

    Args:
        problem: The certificate's problem, with a reference.
        name: The channel.
        proof: Its proof.
        channel: The channel.
        sampled: The channel at its samples.
        phases: The times within a sample at which signals are seen; every time is at most T_s/8 from one.
    """
    courses = courses_of(problem, name, arb(proof["drag_damping"]))
    frequencies = sorted({frequency for course in courses for frequency in course.frequencies})
    bounds = Balls()
    flight_states = [arb_mat(sampled.a.nrows(), 1) for _ in courses]
    for frequency in frequencies:
        answers = [answer_of(problem, name, proof, channel, sampled, course, frequency, phases) for course in courses]
        for signal in answers[0].phasors:
            size_at_phases = size_of(signal, [answer.phasors[signal] for answer in answers])
            slope = size_of(signal, [[answer.slopes[signal]] for answer in answers])
            bound = (size_at_phases + arb(problem["sample_time"]) / 8 * slope).upper()
            bounds[signal] = (bounds.get(signal, arb(0)) + bound).upper()
        flight_states = [state + answer.state for state, answer in zip(flight_states, answers, strict=True)]
    first_states = [first_state(problem, name, proof, sampled, course) for course in courses]
    return ChannelFlight(bounds, [first_z - state for first_z, state in zip(first_states, flight_states, strict=True)])


class Answer(NamedTuple):
    """The answer to one frequency.

    Args:
        state: The real part of Z_f, (m, 1).
        phasors: X at the phases, by signal.
        slopes: A ball of the derivative of X over the whole sample, by signal.
    """

    state: arb_mat
    phasors: Phasors
    slopes: dict[str, acb]


def answer_of(
    problem: VehicleProblem,
    name: str,
    proof: MiddleProof,
    channel: Channel,
    sampled: SampledChannel,
    course: Course,
    frequency: Fraction,
    phases: Sequence[arb],
) -> Answer:
    """The answer of a channel to what drives an axis at one frequency."""
    controller = problem["channels"][name]
    t = arb(problem["sample_time"])
    l0 = arb(controller["l0"])
    slope_1, slope_2, slope_n = map(arb, proof["slopes"])
    i_omega = acb(0, angular(frequency))
    speed = i_omega * course.reference.get(frequency, acb(0))
    acceleration = i_omega * speed
    known_phasors = {remainder: waves.get(frequency, acb(0)) for remainder, waves in course.known_remainders.items()}
    n = channel.order
    forces = [-speed] + [acb(0)] * (n - 1)  # e' = y' - y_m'
    for remainder, phasor in known_phasors.items():
        column = channel.inputs[remainder].tolist()
        forces = [entry + phasor * b for entry, (b,) in zip(forces, column, strict=True)]
    by_integral = -t * slope_2 * speed  # of sigma = y' - y_m' + l_0 e
    by_command = (slope_1 + slope_n) * speed - by_integral
    if controller["nominal"] is not None:  # (l_0 - a_n) y_m' of sigma, and a_n y_m' + y_m'' of the control itself
        by_command = by_command + (l0 * speed + acceleration) / arb(controller["nominal"][1])
    generator = acb_mat(
        [[*map(acb, row), entry] for row, entry in zip(channel.generator.tolist(), forces, strict=True)]
        + [[acb(0)] * (n + 2), [acb(0)] * (n + 1) + [i_omega]]
    )
    transition = (generator * acb(t)).exp()
    drive = [transition[i, n] * sampled.fresh * by_command + transition[i, n + 1] for i in range(n)]
    memories = sampled.a.nrows() - n - 1
    drive += [by_command] * (memories > 0) + [acb(0)] * max(memories - 1, 0) + [by_integral]
    state = steady_state(sampled.a, (i_omega * acb(t)).exp(), drive, name)
    acting = total_product(sampled.acting, state) + sampled.fresh * by_command
    begin = acb_mat([[state[i, 0]] for i in range(n)] + [[acting], [acb(1)]])
    rows = {signal: [*map(acb, row.tolist()[0]), acb(0)] for signal, row in channel.signals.items()}
    rows[OUTPUT_RATE] = list(rows["e_dot"])
    for signal in ("e_dot", "sigma"):
        rows[signal][-1] = -speed
    rows["bend"][-1] = known_phasors.get("force", acb(0)) - acceleration - l0 * speed
    for gap, (signal, waves) in course.comparisons.items():
        rows[gap] = [*rows[signal][:-1], rows[signal][-1] - waves.get(frequency, acb(0))]
    states_at_phases = [(generator * acb(time)).exp() * begin for time in phases]
    slope = (generator * acb(t * interval_ball(0.0, 1.0))).exp() * (generator * begin)
    phasors = {signal: [(acb_mat([row]) * at)[0, 0] for at in states_at_phases] for signal, row in rows.items()}
    slopes = {signal: (acb_mat([row]) * slope)[0, 0] for signal, row in rows.items()}
    equivalent = total_product(sampled.equivalent, state) + by_integral - slope_1 * speed
    phasors[EQUIVALENT] = [equivalent]
    slopes[EQUIVALENT] = acb(0)
    return Answer(arb_mat([[state[i, 0].real] for i in range(state.nrows())]), phasors, slopes)


def steady_state(a: arb_mat, rotation: acb, drive: Sequence[acb], name: str) -> acb_mat:
    """Z_f with (rotation - A) Z_f = drive; raises Rejected if it cannot be enclosed."""
    m = a.nrows()
    matrix = acb_mat([[(rotation if i == j else acb(0)) - a[i, j] for j in range(m)] for i in range(m)])
    try:
        return matrix.solve(acb_mat([[entry] for entry in drive]))
    except ZeroDivisionError:
        raise Rejected(f"V1: the nominal flight of {name} cannot be enclosed") from None


def total_product(row: arb_mat, column: acb_mat) -> acb:
    """A row times a column."""
    return (acb_mat(row) * column)[0, 0]


def size_of(signal: str, axes: Sequence[Sequence[acb]]) -> arb:
    """A bound of a signal's size: along one axis the larger of both, of a vector the norm.

    The vector of Re(X w) and Re(Y w) with |w| = 1 is a sum of two that turn in opposite senses. Their lengths are
    |X + i Y|/2 and |X - i Y|/2.
    """
    largest_size = arb(0)
    for phasors in zip(*axes, strict=True):
        if len(phasors) == 1 or signal in ALONG_AXES:
            sizes = [abs(phasor).upper() for phasor in phasors]
            require_premise(all(x.is_finite() for x in sizes), f"V1: the nominal flight's {signal} is not finite")
            size = sizes[0] if len(sizes) == 1 else maximum(*sizes)
        else:
            x, y = phasors
            size = ((abs(x + acb(0, 1) * y) + abs(x - acb(0, 1) * y)) / 2).upper()
        require_premise(size.is_finite(), f"V1: the nominal flight's {signal} is not finite")
        largest_size = maximum(largest_size, size)
    return largest_size


def first_state(
    problem: VehicleProblem, name: str, proof: MiddleProof, sampled: SampledChannel, course: Course
) -> arb_mat:
    """z_0 of a vehicle that moves with its reference, but does not turn: psi' = 0, so that sigma_0 is -psi_m'."""
    speed = at_start(rate(course.reference))
    entries = [arb(0)] * sampled.a.nrows()
    if name == "psi":
        entries[-1] = start_ratio(problem, name, proof) * speed
    else:
        entries[1] = speed
    return arb_mat([[entry] for entry in entries])


def start_ratio(problem: VehicleProblem, name: str, proof: MiddleProof) -> arb:
    """-q_(-1)/sigma_0 of the straight lines."""
    slope_1, slope_2, _ = map(arb, proof["slopes"])
    midpoint = slope_1 + arb(problem["sample_time"]) * slope_2 / 2
    return {"zero": arb(0), "matched": slope_1, "midpoint": midpoint}[problem["channels"][name]["start"]]


def unknown_turn(problem: VehicleProblem, name: str) -> arb:
    """The increase of |sigma_0| by the reference: |psi_m'| at t = 0."""
    sines = problem["reference"]
    if sines is None or name != "psi":
        return arb(0)
    return abs(at_start(rate(sine_wave(sines["psi"])))).upper()
