"""The nominal flight of a moving reference: the steady response of the linear channels to sums of sines, in balls.

At every frequency f a sampled channel has the steady response Z_f e^(2 pi i f t_k) with (e^(2 pi i f T_s) - A) Z_f =
D_f, where D_f is what drives the channel within a sample. A signal at the time t_k + s is the real part of
X(s) e^(2 pi i f t_k).
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import NamedTuple

from flint import acb, acb_mat, arb, arb_mat

from dssc_jax.proofs.verifier.balls import Balls, Rejected, interval_ball, maximum, require_premise
from dssc_jax.proofs.verifier.vehicle.certificate import MiddleProof, VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import ALONG_AXES, EQUIVALENT, Channel, SampledChannel
from dssc_jax.proofs.verifier.vehicle.ranges import GRAVITY
from dssc_jax.proofs.verifier.vehicle.waves import (
    Waves,
    angular,
    at_start,
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


class AxisInputs(NamedTuple):
    """Sums of sines that drive the linear loop of an axis, and others with which its signals are compared.

    Args:
        reference: The reference y_m without its constant.
        known_remainders: The known parts of the remainders, by name.
        comparisons: By the name of a difference: the signal, and the sum of sines that is subtracted from it.
    """

    reference: Waves
    known_remainders: Mapping[str, Waves]
    comparisons: Mapping[str, tuple[str, Waves]]

    @property
    def frequencies(self) -> set[Fraction]:
        """The frequencies of all inputs [Hz]."""
        return {frequency for waves in (self.reference, *self.known_remainders.values()) for frequency in waves}


class ChannelFlight(NamedTuple):
    """The nominal flight in one channel.

    Args:
        bounds: Bounds of the flight's signals and of its differences, by name.
        starts: Known difference of the vehicle's state z_0 from that of the flight, (m, 1) for each axis. The problem's
            bounds of |e| and |e'| at the start count besides.
    """

    bounds: Balls
    starts: list[arb_mat]


def axis_inputs_of(problem: VehicleProblem, name: str, damping: arb) -> list[AxisInputs]:
    """The inputs of each axis of a channel.

    Args:
        problem: The certificate's problem, with a reference.
        name: The channel.
        damping: Damping of drag c in the linear channel of x [1/s].
    """
    sines = problem["reference"]
    assert sines is not None
    references = {axis: sine_wave(sines[axis]) for axis in sines}
    if name == "psi":
        return [AxisInputs(references["psi"], {}, {"yaw_gap": (OUTPUT_RATE, rate(references["psi"]))})]
    lift = rate(rate(references["z"]))
    if name == "z":
        return [AxisInputs(references["z"], {}, {"lift_gap": ("wanted", lift)})]
    yaw_rate = rate(references["psi"])
    alpha_0 = {axis: sum_of(rate(rate(references[axis])), multiple(rate(references[axis]), damping)) for axis in "xy"}
    quarter_turn = {"x": multiple(alpha_0["y"], arb(-1)), "y": alpha_0["x"]}
    axes = []
    for axis in "xy":
        force = multiple(times(lift, alpha_0[axis]), 1 / arb(GRAVITY))
        yaw_torque = multiple(times(yaw_rate, quarter_turn[axis]), arb(problem["damping"]))
        torque = sum_of(yaw_torque, multiple(force, -arb(problem["stiffness"])))
        comparisons = {"alpha_gap": ("alpha", alpha_0[axis]), "wanted_gap": ("wanted", alpha_0[axis])}
        axes.append(AxisInputs(references[axis], {"force": force, "torque": torque}, comparisons))
    return axes


def channel_flight(
    problem: VehicleProblem,
    name: str,
    proof: MiddleProof,
    channel: Channel,
    sampled: SampledChannel,
    phases: Sequence[arb],
) -> ChannelFlight:
    """(V1) The nominal flight in a channel: the sum of the steady responses to all frequencies.

    Args:
        problem: The certificate's problem, with a reference.
        name: The channel.
        proof: Its proof, with the slopes of its functions.
        channel: Its linear channel.
        sampled: The channel at its samples.
        phases: The times within a sample at which signals are seen [s]; every time is at most T_s/8 from one.
    """
    axes = axis_inputs_of(problem, name, arb(proof["drag_damping"]))
    frequencies = sorted({frequency for inputs in axes for frequency in inputs.frequencies})
    eighth = arb(problem["sample_time"]) / 8
    bounds = Balls()
    starts = [first_state(problem, name, proof, sampled, inputs) for inputs in axes]
    flight_states = [arb_mat(sampled.a.nrows(), 1) for _ in axes]
    for frequency in frequencies:
        responses = []
        for inputs in axes:
            responses.append(steady_response(problem, name, proof, channel, sampled, inputs, frequency, phases))
        for signal in responses[0].phasors:
            size_at_phases = size_of(signal, [response.phasors[signal] for response in responses])
            slope = size_of(signal, [[response.slopes[signal]] for response in responses])
            bound = (size_at_phases + eighth * slope).upper()
            bounds[signal] = (bounds.get(signal, arb(0)) + bound).upper()
        flight_states = [state + response.state for state, response in zip(flight_states, responses, strict=True)]
    return ChannelFlight(bounds, [start - state for start, state in zip(starts, flight_states, strict=True)])


class SteadyResponse(NamedTuple):
    """The response of a channel to what drives an axis at one frequency; see the module's text.

    Args:
        state: The real part of Z_f, that of z at t = 0, (m, 1).
        phasors: X at the phases, by signal.
        slopes: A ball of the derivative of X over the whole sample, by signal.
    """

    state: arb_mat
    phasors: Phasors
    slopes: dict[str, acb]


class InputPhasors(NamedTuple):
    """Phasors at one frequency of what drives an axis.

    Args:
        speed: That of y_m'.
        acceleration: That of y_m''.
        known_remainders: Those of the known parts of the remainders, by name.
    """

    speed: acb
    acceleration: acb
    known_remainders: Mapping[str, acb]


def input_phasors(inputs: AxisInputs, frequency: Fraction) -> InputPhasors:
    """The phasors at one frequency [Hz] of an axis's inputs."""
    i_omega = acb(0, angular(frequency))
    speed = i_omega * inputs.reference.get(frequency, acb(0))
    known_remainders = {name: waves.get(frequency, acb(0)) for name, waves in inputs.known_remainders.items()}
    return InputPhasors(speed, i_omega * speed, known_remainders)


def driven_generator(channel: Channel, phasors: InputPhasors, i_omega: acb) -> acb_mat:
    """The generator of (chi, U, e^(i omega t)) within a sample: the last entry drives chi."""
    n = channel.order
    forces = [-phasors.speed] + [acb(0)] * (n - 1)  # e' = y' - y_m'
    for remainder, phasor in phasors.known_remainders.items():
        column = channel.inputs[remainder].tolist()
        forces = [entry + phasor * b for entry, (b,) in zip(forces, column, strict=True)]
    rows = [[*map(acb, row), force] for row, force in zip(channel.generator.tolist(), forces, strict=True)]
    held_command = [acb(0)] * (n + 2)
    rotation = [acb(0)] * (n + 1) + [i_omega]
    return acb_mat([*rows, held_command, rotation])


def signal_rows(
    channel: Channel, inputs: AxisInputs, phasors: InputPhasors, l0: arb, frequency: Fraction
) -> dict[str, list[acb]]:
    """Rows over (chi, U, e^(i omega t)) of the signals without u_av, of the output's rate and of the differences."""
    rows = {signal: [*map(acb, row.tolist()[0]), acb(0)] for signal, row in channel.signals.items()}
    rows[OUTPUT_RATE] = list(rows["e_dot"])
    for signal in ("e_dot", "sigma"):
        rows[signal][-1] = -phasors.speed
    force = phasors.known_remainders.get("force", acb(0))
    rows["bend"][-1] = force - phasors.acceleration - l0 * phasors.speed
    for gap, (signal, waves) in inputs.comparisons.items():
        rows[gap] = [*rows[signal][:-1], rows[signal][-1] - waves.get(frequency, acb(0))]
    return rows


def steady_response(
    problem: VehicleProblem,
    name: str,
    proof: MiddleProof,
    channel: Channel,
    sampled: SampledChannel,
    inputs: AxisInputs,
    frequency: Fraction,
    phases: Sequence[arb],
) -> SteadyResponse:
    """The steady response of a channel to what drives an axis at one frequency.

    Args:
        problem: The certificate's problem, with a reference.
        name: The channel.
        proof: Its proof, with the slopes of its functions.
        channel: Its linear channel.
        sampled: The channel at its samples.
        inputs: The inputs of an axis of the channel.
        frequency: The frequency [Hz].
        phases: The times within a sample at which signals are seen [s].

    Raises:
        Rejected: The response cannot be enclosed.
    """
    controller = problem["channels"][name]
    t = arb(problem["sample_time"])
    l0 = arb(controller["l0"])
    slope_1, slope_2, slope_n = map(arb, proof["slopes"])
    i_omega = acb(0, angular(frequency))
    drive = input_phasors(inputs, frequency)
    integral_input = -t * slope_2 * drive.speed  # of sigma = y' - y_m' + l_0 e
    command_input = (slope_1 + slope_n) * drive.speed - integral_input
    if controller["nominal"] is not None:  # (l_0 - a_n) y_m' of sigma, and a_n y_m' + y_m'' of the control itself
        command_input = command_input + (l0 * drive.speed + drive.acceleration) / arb(controller["nominal"][1])
    n = channel.order
    generator = driven_generator(channel, drive, i_omega)
    transition = (generator * acb(t)).exp()
    sample_input = [transition[i, n] * sampled.fresh * command_input + transition[i, n + 1] for i in range(n)]
    memories = sampled.a.nrows() - n - 1
    sample_input += [command_input] * (memories > 0) + [acb(0)] * max(memories - 1, 0) + [integral_input]
    state = steady_state(sampled.a, (i_omega * acb(t)).exp(), sample_input, name)
    acting_command = row_product(sampled.acting, state) + sampled.fresh * command_input
    begin = acb_mat([[state[i, 0]] for i in range(n)] + [[acting_command], [acb(1)]])
    rows = signal_rows(channel, inputs, drive, l0, frequency)
    states_at_phases = [(generator * acb(time)).exp() * begin for time in phases]
    state_slope = (generator * acb(t * interval_ball(0.0, 1.0))).exp() * (generator * begin)
    phasors = Phasors()
    slopes = {}
    for signal, row in rows.items():
        phasors[signal] = [(acb_mat([row]) * phase_state)[0, 0] for phase_state in states_at_phases]
        slopes[signal] = (acb_mat([row]) * state_slope)[0, 0]
    phasors[EQUIVALENT] = [row_product(sampled.equivalent, state) + integral_input - slope_1 * drive.speed]
    slopes[EQUIVALENT] = acb(0)
    return SteadyResponse(arb_mat([[state[i, 0].real] for i in range(state.nrows())]), phasors, slopes)


def steady_state(a: arb_mat, rotation: acb, drive: Sequence[acb], name: str) -> acb_mat:
    """Z_f with (rotation - A) Z_f = drive, (m, 1): the state of the channel ``name`` at t = 0 in its steady response.

    Raises:
        Rejected: The equation's solution cannot be enclosed.
    """
    m = a.nrows()
    matrix = acb_mat([[(rotation if i == j else acb(0)) - a[i, j] for j in range(m)] for i in range(m)])
    try:
        return matrix.solve(acb_mat([[entry] for entry in drive]))
    except ZeroDivisionError:
        raise Rejected(f"V1: the nominal flight of {name} cannot be enclosed") from None


def row_product(row: arb_mat, column: acb_mat) -> acb:
    """The product of a row and a column."""
    return (acb_mat(row) * column)[0, 0]


def size_of(signal: str, axes: Sequence[Sequence[acb]]) -> arb:
    """A bound of a signal at some phases, from its phasors along each axis.

    Of a signal along an axis it is the larger amplitude, of a vector of the plane the largest norm. The vector of
    Re(X w) and Re(Y w) with |w| = 1 is a sum of two that turn in opposite senses. Their lengths are |X + i Y|/2 and
    |X - i Y|/2.

    Args:
        signal: The signal's name.
        axes: Phasors at the phases, for each axis.

    Raises:
        Rejected: A phasor is not finite.
    """
    largest_size = arb(0)
    for phasors in zip(*axes, strict=True):
        if len(phasors) == 1 or signal in ALONG_AXES:
            sizes = [abs(phasor).upper() for phasor in phasors]
        else:
            x, y = phasors
            sizes = [((abs(x + acb(0, 1) * y) + abs(x - acb(0, 1) * y)) / 2).upper()]
        require_premise(all(size.is_finite() for size in sizes), f"V1: the nominal flight's {signal} is not finite")
        largest_size = maximum(largest_size, *sizes)
    return largest_size


def first_state(
    problem: VehicleProblem, name: str, proof: MiddleProof, sampled: SampledChannel, inputs: AxisInputs
) -> arb_mat:
    """The known part of the vehicle's z_0 on an axis, (m, 1).

    The vehicle moves with its reference, but does not turn: psi' = 0, so that sigma_0 of psi is -psi_m'.
    """
    speed = at_start(rate(inputs.reference))
    entries = [arb(0)] * sampled.a.nrows()
    if name == "psi":
        ratio = start_ratio(proof, problem["channels"][name]["start"], arb(problem["sample_time"]))
        entries[-1] = ratio * speed
    else:
        entries[1] = speed
    return arb_mat([[entry] for entry in entries])


def start_ratio(proof: MiddleProof, start: str, t: arb) -> arb:
    """-q_(-1)/sigma_0, what the first sum q takes from sigma_0, where straight lines replace the functions.

    Args:
        proof: The proof of a channel, with the slopes of the lines.
        start: Start of the predictor: ``zero``, ``matched`` or ``midpoint``.
        t: T_s [s].
    """
    slope_1, slope_2, _ = map(arb, proof["slopes"])
    return {"zero": arb(0), "matched": slope_1, "midpoint": slope_1 + t * slope_2 / 2}[start]
