"""The nominal flight of a moving reference: the steady response of the linear channels to sums of sines, in balls.

The motion of the reference is known. So the theorem subtracts the nominal flight, and its bounds Y are bounds of the
deviation from this flight. At every frequency f a sampled channel has the steady response Z_f e^(2 pi i f t_k) with
(e^(2 pi i f T_s) - A) Z_f = D_f, where D_f is the phasor of the effect of all known inputs over a sample. A signal at
the time t_k + s is the real part of X(s) e^(2 pi i f t_k).
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import NamedTuple

from flint import acb, acb_mat, arb, arb_mat

from dssc_jax.proofs.verifier.balls import Balls, Rejected, interval_ball, maximum, require_premise
from dssc_jax.proofs.verifier.vehicle.certificate import ChannelProblem, MiddleProof, VehicleProblem
from dssc_jax.proofs.verifier.vehicle.channels import ALONG_AXES, EQUIVALENT, Channel, SampledChannel
from dssc_jax.proofs.verifier.vehicle.ranges import GRAVITY
from dssc_jax.proofs.verifier.vehicle.waves import (
    Waves,
    angular_frequency,
    derivative,
    multiple,
    product,
    sine_wave,
    value_at_start,
    wave_sum,
)

AXES = {"x": ("x", "y"), "z": ("z",), "psi": ("psi",)}
"""The axes that each channel stands for."""
OUTPUT_RATE = "rate"
"""Name of the rate of the output itself, besides ``e_dot``, the rate of the error."""
Phasors = dict[str, list[acb]]
"""Phasors of signals by name, one for each phase of a sample."""


class AxisInputs(NamedTuple):
    """The known motion along one axis, as sums of sines.

    Args:
        reference: The reference y_m without its constant.
        known_remainders: The known parts of the remainders, by name, which also drive the linear loop.
        comparisons: Differences that are to be bounded, by name: the name of a signal, and the sum of sines that is
            subtracted from this signal.
    """

    reference: Waves
    known_remainders: Mapping[str, Waves]
    comparisons: Mapping[str, tuple[str, Waves]]

    @property
    def frequencies(self) -> set[Fraction]:
        """The frequencies [Hz] of the reference and of the known remainders."""
        return {frequency for waves in (self.reference, *self.known_remainders.values()) for frequency in waves}


class ChannelFlight(NamedTuple):
    """The nominal flight in one channel.

    Args:
        bounds: N, bounds of the flight's signals and of the differences in :class:`AxisInputs`, by name.
        starts: For each axis, the known part of the vehicle's z_0 less the flight's z_0, shape (m, 1). E_0 and V_0
            bound the unknown part of the vehicle's z_0.
    """

    bounds: Balls
    starts: list[arb_mat]


def axis_inputs_of(problem: VehicleProblem, name: str, damping: arb) -> list[AxisInputs]:
    """The known motion along each axis of a channel, which a moving reference causes.

    With alpha_0 = y_m'' + c y_m', the remainders of x and y have the known parts force = z_m'' alpha_0/g and torque =
    a_1 psi_m' K alpha_0 - a_0 z_m'' alpha_0/g, where K is a quarter turn of the plane.

    Args:
        problem: The certificate's problem, with a reference.
        name: Name of the channel.
        damping: c, the damping by drag in the linear channel of x [1/s]; unused for z and psi.
    """
    sines = problem["reference"]
    assert sines is not None
    references = {axis: sine_wave(sines[axis]) for axis in sines}
    if name == "psi":
        comparisons = {"yaw_gap": (OUTPUT_RATE, derivative(references["psi"]))}
        return [AxisInputs(references["psi"], known_remainders={}, comparisons=comparisons)]
    lift = derivative(derivative(references["z"]))  # z_m''
    if name == "z":
        return [AxisInputs(references["z"], known_remainders={}, comparisons={"lift_gap": ("wanted", lift)})]
    yaw_rate = derivative(references["psi"])
    alpha_0 = {}
    for axis in "xy":
        speed = derivative(references[axis])
        alpha_0[axis] = wave_sum(derivative(speed), multiple(speed, damping))
    quarter_turn = {"x": multiple(alpha_0["y"], arb(-1)), "y": alpha_0["x"]}
    axes = []
    for axis in "xy":
        force = multiple(product(lift, alpha_0[axis]), 1 / arb(GRAVITY))
        yaw_torque = multiple(product(yaw_rate, quarter_turn[axis]), arb(problem["damping"]))
        torque = wave_sum(yaw_torque, multiple(force, -arb(problem["stiffness"])))
        comparisons = {"alpha_gap": ("alpha", alpha_0[axis]), "wanted_gap": ("wanted", alpha_0[axis])}
        axes.append(AxisInputs(references[axis], {"force": force, "torque": torque}, comparisons))
    return axes


class DrivenChannel(NamedTuple):
    """A channel with its controller, which a moving reference drives.

    Args:
        name: Name of the channel.
        controller: The channel's controller.
        proof: The channel's proof, with the slopes of the straight lines.
        channel: The linear channel.
        sampled: The channel at its samples.
        sample_time: T_s [s].
        phases: Times within a sample at which signals are bounded [s]; every time is within T_s/8 of one of them.
    """

    name: str
    controller: ChannelProblem
    proof: MiddleProof
    channel: Channel
    sampled: SampledChannel
    sample_time: arb
    phases: Sequence[arb]


def channel_flight(problem: VehicleProblem, driven: DrivenChannel) -> ChannelFlight:
    """(V1) Bounds of the nominal flight in a channel, the sum of the steady responses to all frequencies.

    Each frequency adds the largest size of a signal at the phases, plus T_s/8 times the largest slope.

    Args:
        problem: The certificate's problem, with a reference.
        driven: The channel.
    """
    axes = axis_inputs_of(problem, driven.name, arb(driven.proof["drag_damping"]))
    frequencies = sorted({frequency for inputs in axes for frequency in inputs.frequencies})
    eighth = driven.sample_time / 8
    bounds = Balls()
    starts = [first_state(driven, inputs) for inputs in axes]
    flight_states = [arb_mat(driven.sampled.a.nrows(), 1) for _ in axes]
    for frequency in frequencies:
        responses = [steady_response(driven, inputs, frequency) for inputs in axes]
        for signal in responses[0].phasors:
            size_at_phases = size_of(signal, [response.phasors[signal] for response in responses])
            slope = size_of(signal, [[response.slopes[signal]] for response in responses])
            bound = (size_at_phases + eighth * slope).upper()
            bounds[signal] = (bounds.get(signal, arb(0)) + bound).upper()
        flight_states = [state + response.state for state, response in zip(flight_states, responses, strict=True)]
    return ChannelFlight(bounds, [start - state for start, state in zip(starts, flight_states, strict=True)])


class SteadyResponse(NamedTuple):
    """The steady response of a channel to the known motion along one of its axes, at one frequency.

    Args:
        state: The real part of Z_f, the flight's z at t = 0, shape (m, 1).
        phasors: X(s) of each signal at the phases, by name.
        slopes: A ball that contains the derivative of X(s) throughout a sample, by signal.
    """

    state: arb_mat
    phasors: Phasors
    slopes: dict[str, acb]


class InputPhasors(NamedTuple):
    """Phasors, at one frequency, of the known motion along an axis.

    Args:
        speed: Phasor of y_m'.
        acceleration: Phasor of y_m''.
        known_remainders: Phasors of the known parts of the remainders, by name.
    """

    speed: acb
    acceleration: acb
    known_remainders: Mapping[str, acb]


def input_phasors(inputs: AxisInputs, frequency: Fraction) -> InputPhasors:
    """The phasors of the known motion along an axis at one frequency [Hz]; 0 for a motion without this frequency."""
    i_omega = acb(0, angular_frequency(frequency))
    speed = i_omega * inputs.reference.get(frequency, acb(0))
    known_remainders = {name: waves.get(frequency, acb(0)) for name, waves in inputs.known_remainders.items()}
    return InputPhasors(speed, i_omega * speed, known_remainders)


def driven_generator(channel: Channel, phasors: InputPhasors, i_omega: acb) -> acb_mat:
    """The generator of (chi, U, e^(i omega t)) within a sample, shape (n + 2, n + 2).

    U is held. The last entry is a wave that drives chi: through -y_m' in e' = v - y_m', where v is the rate of the
    output, and through the known remainders.

    Args:
        channel: The linear channel.
        phasors: Phasors of the known motion along the axis.
        i_omega: i times the angular frequency [1/s].
    """
    n = channel.order
    forces = [-phasors.speed] + [acb(0)] * (n - 1)  # of e' and the other states
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
    """Rows over (chi, U, e^(i omega t)) of all signals but u_av, of the output's rate and of the differences, by name.

    In the channel of a moving reference the state e' is the output's own rate v, so that e' = v - y_m'.

    Args:
        channel: The linear channel.
        inputs: The known motion along the axis.
        phasors: Phasors of this motion at the frequency.
        l0: Error pole [1/s].
        frequency: The frequency [Hz].
    """
    rows = {signal: [*map(acb, row.tolist()[0]), acb(0)] for signal, row in channel.signals.items()}
    rows[OUTPUT_RATE] = list(rows["e_dot"])
    for signal in ("e_dot", "sigma"):
        rows[signal][-1] = -phasors.speed
    force = phasors.known_remainders.get("force", acb(0))
    # sigma' = v' - y_m'' + l_0 (v - y_m'), where v' contains the known force
    rows["bend"][-1] = force - phasors.acceleration - l0 * phasors.speed
    for gap, (signal, waves) in inputs.comparisons.items():
        rows[gap] = [*rows[signal][:-1], rows[signal][-1] - waves.get(frequency, acb(0))]
    return rows


def steady_response(driven: DrivenChannel, inputs: AxisInputs, frequency: Fraction) -> SteadyResponse:
    """The steady response of a channel to the known motion along one of its axes, at one frequency f.

    Args:
        driven: The channel.
        inputs: The known motion along the axis.
        frequency: f [Hz].

    Raises:
        Rejected: The response cannot be enclosed.
    """
    controller = driven.controller
    channel = driven.channel
    sampled = driven.sampled
    t = driven.sample_time
    l0 = arb(controller["l0"])
    k_1, k_2, k_3 = map(arb, driven.proof["slopes"])
    i_omega = acb(0, angular_frequency(frequency))
    drive = input_phasors(inputs, frequency)
    integral_input = -t * k_2 * drive.speed  # into q, by -y_m' in sigma
    command_input = (k_1 + k_3) * drive.speed - integral_input
    if controller["nominal"] is not None:  # (l_0 - a_n) y_m' of sigma, and a_n y_m' + y_m'' of the control itself
        command_input = command_input + (l0 * drive.speed + drive.acceleration) / arb(controller["nominal"][1])
    n = channel.order
    generator = driven_generator(channel, drive, i_omega)
    transition = (generator * acb(t)).exp()
    sample_input = [transition[i, n] * sampled.fresh * command_input + transition[i, n + 1] for i in range(n)]  # D_f
    memory_inputs = [acb(0)] * (sampled.a.nrows() - n - 1)  # of the earlier commands in z
    if memory_inputs:
        memory_inputs[0] = command_input
    sample_input += [*memory_inputs, integral_input]
    state = steady_state(sampled.a, (i_omega * acb(t)).exp(), sample_input, driven.name)  # Z_f
    acting_command = row_product(sampled.acting, state) + sampled.fresh * command_input
    begin = acb_mat([[state[i, 0]] for i in range(n)] + [[acting_command], [acb(1)]])  # (chi, U, wave)
    rows = signal_rows(channel, inputs, drive, l0, frequency)
    states_at_phases = [(generator * acb(time)).exp() * begin for time in driven.phases]
    over_sample = acb(t * interval_ball(0.0, 1.0))  # all times within a sample
    state_slope = (generator * over_sample).exp() * (generator * begin)
    phasors = Phasors()
    slopes = {}
    for signal, row in rows.items():
        phasors[signal] = [(acb_mat([row]) * phase_state)[0, 0] for phase_state in states_at_phases]
        slopes[signal] = (acb_mat([row]) * state_slope)[0, 0]
    phasors[EQUIVALENT] = [row_product(sampled.equivalent, state) + integral_input - k_1 * drive.speed]
    slopes[EQUIVALENT] = acb(0)  # it exists at the samples only
    first_values = arb_mat([[state[i, 0].real] for i in range(state.nrows())])
    return SteadyResponse(state=first_values, phasors=phasors, slopes=slopes)


def steady_state(a: arb_mat, rotation: acb, drive: Sequence[acb], name: str) -> acb_mat:
    """Solve (rotation I - A) Z_f = drive for Z_f, shape (m, 1).

    Args:
        a: A, shape (m, m).
        rotation: e^(2 pi i f T_s).
        drive: D_f, the phasor that is added to each of the m entries of z in a sample.
        name: Name of the channel, for the message.

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
    """The product of a real row and a complex column."""
    return (acb_mat(row) * column)[0, 0]


def size_of(signal: str, axes: Sequence[Sequence[acb]]) -> arb:
    """A bound of a signal at all phases, from its phasors along each axis.

    For a signal along an axis the bound is the larger amplitude, for a vector of the plane the largest norm. The vector
    of Re(X w) and Re(Y w) with |w| = 1 is the sum of two vectors that turn in opposite senses, with the lengths
    |X + i Y|/2 and |X - i Y|/2.

    Args:
        signal: Name of the signal.
        axes: For each axis, the signal's phasors at the phases.

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


def first_state(driven: DrivenChannel, inputs: AxisInputs) -> arb_mat:
    """The known part of the vehicle's z_0 on an axis, shape (m, 1).

    Along x, y and z the vehicle starts with the velocity of its reference. In psi it starts without a turn, so that
    sigma_0 = -psi_m' sets the sum q_(-1).
    """
    speed = value_at_start(derivative(inputs.reference))
    entries = [arb(0)] * driven.sampled.a.nrows()
    if driven.name == "psi":
        ratio = start_ratio(driven.proof, driven.controller["start"], driven.sample_time)
        entries[-1] = ratio * speed
    else:
        entries[1] = speed
    return arb_mat([[entry] for entry in entries])


def start_ratio(proof: MiddleProof, start: str, t: arb) -> arb:
    """-q_(-1)/sigma_0, where q_(-1) is the sum before the first sample, with straight lines for the functions.

    Args:
        proof: The proof of a channel, with the slopes of the lines.
        start: Start of the predictor: ``zero``, ``matched`` or ``midpoint``.
        t: T_s [s].
    """
    k_1, k_2, _ = map(arb, proof["slopes"])
    return {"zero": arb(0), "matched": k_1, "midpoint": k_1 + t * k_2 / 2}[start]
