"""The nominal flight: the steady response of the linear channels to a moving reference, in floating point.

The motion of the reference is known. So the proof subtracts the nominal flight, and its bounds Y are bounds of the
vehicle's deviation from this flight. The reference and the known parts of the remainders are sums of sines, and so is
the steady response of a sampled linear channel. docs/vehicle_proofs.md has the theorem.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from scipy.linalg import expm

from dssc_jax.proofs.search.vehicle.attitude import Signals
from dssc_jax.proofs.search.vehicle.channels import (
    GRAVITY,
    LinearChannel,
    StraightLines,
    sampled_channel,
)
from dssc_jax.proofs.search.vehicle.remainders import Couplings
from dssc_jax.proofs.search.vehicle.responses import ONE_AXIS, POINTS, start_share
from dssc_jax.proofs.search.vehicle.waves import (
    Waves,
    angular_frequency,
    derivative,
    largest_magnitude,
    multiple,
    product,
    reference_waves,
    wave_sum,
)
from dssc_jax.proofs.vehicle_problem import CHANNELS, VehicleProblem

ROOM = 1.0 + 1e-4
"""Factor that widens the flight's bounds, since the verifier's balls make its bounds larger."""
SLOPE_ROOM = 1.1
"""Factor that widens slopes within a sample, since the verifier's balls make its slopes larger."""
SLOPE_TIMES = (0.0, 0.5, 1.0)
"""Times within a sample at which slopes are compared, in T_s."""
AXES_OF = {"x": ("x", "y"), "z": ("z",), "psi": ("psi",)}
"""The axes that each channel stands for."""


@dataclass(frozen=True)
class Nominal:
    """Bounds of the nominal flight of a vehicle whose reference moves.

    Args:
        bounds: N, bounds of the flight's signals, by channel and name. Further entries are ``rate``, for the rate of
            the output itself, and bounds of differences: ``alpha_gap`` of alpha - alpha_0, ``wanted_gap`` of a_h -
            alpha_0, ``lift_gap`` of a_z - z_m'', ``yaw_gap`` of psi' - psi_m'.
        lift: A_m, bound of |z_m''| [m/s^2].
        yaw: Psi_m, bound of |psi_m'| [rad/s].
        starts: Known part of the vehicle's z_0 less the flight's z_0, by channel, shape (n, axes) each.
    """

    bounds: Signals
    lift: float
    yaw: float
    starts: dict[str, np.ndarray]

    def totals(self, y: Signals) -> Signals:
        """Bounds N + Y of the vehicle's own signals, from bounds Y of its deviation from the flight.

        In z and psi, ``e_dot`` bounds the rate of the output itself in place of the error's rate, since drag and the
        body's turn depend on it.
        """
        totals = {}
        for name in CHANNELS:
            nominal = self.bounds[name]
            totals[name] = {key: value + nominal.get(key, 0.0) for key, value in y[name].items()}
        for name in ("z", "psi"):
            totals[name]["e_dot"] = y[name]["e_dot"] + self.bounds[name]["rate"]
        return totals

    def couplings(self, y: Signals) -> Couplings:
        """Bounds of the vehicle's distances from the motion its reference needs, from bounds Y of its deviation."""
        return Couplings(
            alpha_gap=self.bounds["x"]["alpha_gap"] + y["x"]["alpha"],
            wanted_gap=self.bounds["x"]["wanted_gap"] + y["x"]["wanted"],
            lift_gap=self.bounds["z"]["lift_gap"] + y["z"]["wanted"],
            yaw_gap=self.bounds["psi"]["yaw_gap"] + y["psi"]["e_dot"],
            lift=self.lift,
            yaw=self.yaw,
        )


@dataclass(frozen=True)
class AxisInputs:
    """The known motion along one axis, as sums of sines.

    Args:
        reference: The reference y_m without its constant.
        known_remainders: The known parts of the remainders, by name, which also drive the linear loop.
        comparisons: Differences that are to be bounded, by name: the name of a signal, and the sum of sines that is
            subtracted from this signal.
    """

    reference: Waves
    known_remainders: dict[str, Waves]
    comparisons: dict[str, tuple[str, Waves]]

    @property
    def frequencies(self) -> set[Fraction]:
        """The frequencies [Hz] of the reference and of the known remainders."""
        return {frequency for waves in (self.reference, *self.known_remainders.values()) for frequency in waves}


@dataclass(frozen=True)
class SteadyResponse:
    """The steady response of a channel to the known motion along one of its axes, at one frequency, in phasors.

    Args:
        state: Z_f, phasor of z at the samples, shape (n,).
        signals: X(s), phasors of each signal at the points of a sample, shape (points,).
        slopes: Phasors of each signal's derivative at ``SLOPE_TIMES`` of a sample, shape (times,).
    """

    state: np.ndarray
    signals: dict[str, np.ndarray]
    slopes: dict[str, np.ndarray]


def nominal_of(
    problem: VehicleProblem, linear: dict[str, LinearChannel], lines: dict[str, StraightLines], damping: float
) -> Nominal | None:
    """Bounds of the nominal flight, the sum of the steady responses to all frequencies; None if the vehicle hovers.

    Args:
        problem: The vehicle.
        linear: The linear channels.
        lines: The straight lines of each channel.
        damping: c, the damping by drag in the plane [1/s].
    """
    if problem.reference is None:
        return None
    axis_inputs = axis_inputs_of(problem, damping)
    bounds: Signals = {}
    starts = {}
    for name in CHANNELS:
        axis_responses = []
        start_columns = []
        for axis in AXES_OF[name]:
            inputs = axis_inputs[axis]
            responses = {}
            for frequency in inputs.frequencies:
                responses[frequency] = steady_response(problem, name, linear[name], lines[name], inputs, frequency)
            axis_responses.append(responses)
            flight_start = np.sum([np.real(response.state) for response in responses.values()], axis=0)  # z_n(0)
            vehicle_start = first_state(problem, name, lines[name], inputs, flight_start.size)
            start_columns.append(vehicle_start - flight_start)
        bounds[name] = bounds_of(problem, axis_responses)
        starts[name] = np.stack(start_columns, axis=-1)
    lift = largest_magnitude(derivative(derivative(axis_inputs["z"].reference)))  # of z_m''
    yaw = largest_magnitude(derivative(axis_inputs["psi"].reference))  # of psi_m'
    return Nominal(bounds=bounds, lift=ROOM * lift, yaw=ROOM * yaw, starts=starts)


def axis_inputs_of(problem: VehicleProblem, damping: float) -> dict[str, AxisInputs]:
    """The known motion along each axis, by the axis's name.

    With alpha_0 = y_m'' + c y_m', the remainders of x and y have the known parts force = z_m'' alpha_0/g and torque =
    a_1 psi_m' K alpha_0 - a_0 z_m'' alpha_0/g, where K is a quarter turn of the plane.

    Args:
        problem: The vehicle.
        damping: c, the damping by drag in the plane [1/s].
    """
    references = reference_waves(problem)
    speeds = {axis: derivative(waves) for axis, waves in references.items()}
    accelerations = {axis: derivative(waves) for axis, waves in speeds.items()}
    alpha_0 = {axis: wave_sum(accelerations[axis], multiple(speeds[axis], damping)) for axis in ("x", "y")}
    quarter_turn = {"x": multiple(alpha_0["y"], -1.0), "y": alpha_0["x"]}
    axes = {
        "psi": AxisInputs(references["psi"], known_remainders={}, comparisons={"yaw_gap": ("rate", speeds["psi"])}),
        "z": AxisInputs(references["z"], known_remainders={}, comparisons={"lift_gap": ("wanted", accelerations["z"])}),
    }
    for axis in ("x", "y"):
        force = product(accelerations["z"], alpha_0[axis], 1.0 / GRAVITY)
        yaw_torque = product(speeds["psi"], quarter_turn[axis], problem.damping)
        torque = wave_sum(yaw_torque, multiple(force, -problem.stiffness))
        axes[axis] = AxisInputs(
            reference=references[axis],
            known_remainders={"force": force, "torque": torque},
            comparisons={"alpha_gap": ("alpha", alpha_0[axis]), "wanted_gap": ("wanted", alpha_0[axis])},
        )
    return axes


@dataclass(frozen=True)
class InputPhasors:
    """Phasors, at one frequency, of the known motion along an axis.

    Args:
        speed: Phasor of y_m'.
        acceleration: Phasor of y_m''.
        known_remainders: Phasors of the known parts of the remainders, by name.
    """

    speed: complex
    acceleration: complex
    known_remainders: dict[str, complex]


def input_phasors(inputs: AxisInputs, frequency: Fraction) -> InputPhasors:
    """The phasors of the known motion along an axis at one frequency [Hz]; 0 for a motion without this frequency."""
    i_omega = 1j * angular_frequency(frequency)
    speed = i_omega * inputs.reference.get(frequency, 0.0)
    known_remainders = {key: waves.get(frequency, 0.0) for key, waves in inputs.known_remainders.items()}
    return InputPhasors(speed, i_omega * speed, known_remainders)


def driven_generator(linear: LinearChannel, phasors: InputPhasors, rate: float) -> np.ndarray:
    """The generator of (chi, U, e^(i rate t)) within a sample, shape (m + 2, m + 2).

    U is held. The last entry is a wave that drives chi: through -y_m' in e' = v - y_m', where v is the rate of the
    output, and through the known remainders.

    Args:
        linear: The linear channel.
        phasors: Phasors of the known motion along the axis.
        rate: Angular frequency [rad/s].
    """
    m = linear.control.size
    known_forces = sum(phasor * linear.remainders[key] for key, phasor in phasors.known_remainders.items())
    generator = np.zeros((m + 2, m + 2), complex)
    generator[:m, :m] = linear.dynamics
    generator[:m, m] = linear.control
    generator[:m, m + 1] = -phasors.speed * np.eye(m)[0] + known_forces
    generator[m + 1, m + 1] = 1j * rate
    return generator


def signal_rows(
    linear: LinearChannel, inputs: AxisInputs, phasors: InputPhasors, l0: float, frequency: Fraction
) -> dict[str, np.ndarray]:
    """Rows over (chi, U, e^(i rate t)) of all signals but u_av, of the output's rate and of the differences, by name.

    In the channel of a moving reference the state e' is the output's own rate v, so that e' = v - y_m'.

    Args:
        linear: The linear channel.
        inputs: The known motion along the axis.
        phasors: Phasors of this motion at the frequency.
        l0: Error pole [1/s].
        frequency: The frequency [Hz].
    """
    rows = {key: np.array([*c, d, 0.0], complex) for key, (c, d) in linear.signals.items()}
    rows["rate"] = np.array([*linear.signals["e_dot"].row, 0.0, 0.0], complex)
    rows["e_dot"][-1] = -phasors.speed
    rows["sigma"][-1] = -phasors.speed
    # sigma' = v' - y_m'' + l_0 (v - y_m'), where v' contains the known force
    rows["bend"][-1] = phasors.known_remainders.get("force", 0.0) - phasors.acceleration - l0 * phasors.speed
    for gap, (key, waves) in inputs.comparisons.items():
        rows[gap] = np.array(rows[key])
        rows[gap][-1] -= waves.get(frequency, 0.0)
    return rows


def steady_response(
    problem: VehicleProblem,
    name: str,
    linear: LinearChannel,
    lines: StraightLines,
    inputs: AxisInputs,
    frequency: Fraction,
) -> SteadyResponse:
    """The steady response of a channel to the known motion along one of its axes, at one frequency f.

    At the samples (e^(2 pi i f T_s) - A) Z_f = D_f, where D_f is the phasor of the known motion's effect on z in a
    sample.

    Args:
        problem: The vehicle.
        name: Name of the channel.
        linear: The linear channel.
        lines: The straight lines in place of the controller's functions, and the share s_q.
        inputs: The known motion along the axis.
        frequency: f [Hz].
    """
    channel = problem.channels[name]
    step = sampled_channel(problem, channel, linear, lines)
    k_1, k_2, k_3, _ = lines
    t = problem.sample_time
    rate = angular_frequency(frequency)
    m = linear.control.size
    n = step.a.shape[0]
    drive = input_phasors(inputs, frequency)
    # -y_m' in sigma adds to the sum q and to the command; the nominal control has its feed-forward besides
    integral_input = -t * k_2 * drive.speed
    command_input = (k_1 + k_3) * drive.speed - integral_input
    if channel.nominal:
        command_input = command_input + (channel.l0 * drive.speed + drive.acceleration) / channel.nominal.k
    generator = driven_generator(linear, drive, rate)
    exponential = expm(generator * t)
    sample_input = np.zeros(n, complex)  # D_f
    sample_input[:m] = exponential[:m, m] * step.fresh * command_input + exponential[:m, m + 1]
    has_memory = n > m + 1  # of the last commands, for a delay
    if has_memory:
        sample_input[m] = command_input
    sample_input[n - 1] = integral_input
    state = np.linalg.solve(np.exp(1j * rate * t) * np.eye(n) - step.a, sample_input)  # Z_f
    acting_command = step.acting @ state + step.fresh * command_input
    begin = np.concatenate([state[:m], [acting_command, 1.0]])  # (chi, U, wave) at the sample
    rows = signal_rows(linear, inputs, drive, channel.l0, frequency)
    table = np.stack(list(rows.values()))
    values = np.stack([table @ expm(generator * share * t) @ begin for share in POINTS], axis=-1)
    slope = np.stack([table @ expm(generator * share * t) @ generator @ begin for share in SLOPE_TIMES], axis=-1)
    signals = dict(zip(rows, values, strict=True))
    signals["u_av"] = np.full(len(POINTS), step.equivalent @ state + integral_input - k_1 * drive.speed)
    return SteadyResponse(state, signals, slopes=dict(zip(rows, slope, strict=True)))


def first_state(problem: VehicleProblem, name: str, lines: StraightLines, inputs: AxisInputs, n: int) -> np.ndarray:
    """The known part of the vehicle's z_0 on an axis, shape (n,).

    Along x, y and z the vehicle starts with the velocity of its reference. In psi it starts without a turn, so that
    sigma_0 = -psi_m' sets the sum q_(-1).

    Args:
        problem: The vehicle.
        name: Name of the channel.
        lines: The straight lines in place of the controller's functions.
        inputs: The known motion along the axis.
        n: Length of z.
    """
    reference_speed = sum(phasor.real for phasor in derivative(inputs.reference).values())  # at t = 0
    z_0 = np.zeros(n)
    if name == "psi":
        z_0[-1] = start_share(problem, problem.channels[name], lines) * reference_speed
    else:
        z_0[1] = reference_speed
    return z_0


def bounds_of(problem: VehicleProblem, axes: list[dict[Fraction, SteadyResponse]]) -> dict[str, float]:
    """Bounds N of all signals of the nominal flight in a channel, by name.

    Each frequency adds the largest phasor at the points of a sample, plus T_s/8 times the largest slope.

    Args:
        problem: The vehicle.
        axes: Steady responses of each axis of the channel, by frequency.
    """
    eighth = problem.sample_time / 8.0
    frequencies = set().union(*axes)
    first_response = next(iter(axes[0].values()))
    bounds = {}
    for key in first_response.signals:
        size_by_axis = np.zeros(len(axes))
        norm = 0.0  # of the vector (x, y)
        for frequency in frequencies:
            responses = [axis.get(frequency) for axis in axes]
            phasors = [signal_phasors(response, key) for response in responses]
            slopes = [slope_phasors(response, key) for response in responses]
            for i, (values, slope) in enumerate(zip(phasors, slopes, strict=True)):
                size_by_axis[i] += np.max(np.abs(values)) + eighth * SLOPE_ROOM * np.max(np.abs(slope))
            if len(axes) == 2:
                norm += np.max(vector_norm(*phasors)) + eighth * SLOPE_ROOM * np.max(vector_norm(*slopes))
        is_along_axes = len(axes) == 1 or key in ONE_AXIS
        bounds[key] = ROOM * float(np.max(size_by_axis) if is_along_axes else norm)
    return bounds


def signal_phasors(response: SteadyResponse | None, signal: str) -> np.ndarray:
    """Phasors of a signal at the points of a sample, shape (points,); zero without a response."""
    return np.zeros(len(POINTS)) if response is None else response.signals[signal]


def slope_phasors(response: SteadyResponse | None, signal: str) -> np.ndarray:
    """Phasors of a signal's derivative within a sample, shape (times,); one zero without a response, and for u_av."""
    if response is None or signal == "u_av":  # u_av does not change within a sample
        return np.zeros(1)
    return response.slopes[signal]


def vector_norm(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The largest norm of the vector of Re(x w) and Re(y w) over |w| = 1, for phasors x and y of the plane's axes."""
    return 0.5 * (np.abs(x + 1j * y) + np.abs(x - 1j * y))
