"""The nominal flight of a moving reference: the steady response of the linear channels to it, in floating point.

The reference and the known parts of the remainders are sums of sines, and so is the steady response of a sampled linear
channel. docs/vehicle_proofs.md has the theorem.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from scipy.linalg import expm

from dssc_jax.proofs.search.vehicle.attitude import Signals
from dssc_jax.proofs.search.vehicle.channels import GRAVITY, LinearChannel, sampled_channel
from dssc_jax.proofs.search.vehicle.remainders import Couplings
from dssc_jax.proofs.search.vehicle.responses import ONE_AXIS, POINTS, start_share
from dssc_jax.proofs.search.vehicle.waves import (
    Waves,
    derivative,
    multiple,
    product,
    rate_of,
    reference_waves,
    size,
    total,
)
from dssc_jax.proofs.vehicle_problem import CHANNELS, VehicleProblem

ROOM = 1.0 + 1e-4
"""Widening of the flight's bounds, for what the verifier's balls add."""
SLOPE_ROOM = 1.1
"""Widening of slopes within a sample, for what the verifier's balls add."""
AXES_OF = {"x": ("x", "y"), "z": ("z",), "psi": ("psi",)}
"""The axes whose loops each channel has."""


@dataclass(frozen=True)
class Nominal:
    """The nominal flight of a vehicle whose reference moves.

    Args:
        bounds: Bounds of its signals, by channel and name, besides those of some differences: ``alpha_gap`` and
            ``wanted_gap`` of alpha and a_h to alpha_0, ``lift_gap`` of a_z to z_m'', ``yaw_gap`` of psi' to psi_m'.
            ``rate`` of z and psi is that of the output itself.
        lift: Bound of |z_m''| [m/s^2].
        yaw: Bound of |psi_m'| [rad/s].
        starts: Known difference of the vehicle's z_0 from that of the flight, by channel, (n, axes).
    """

    bounds: Signals
    lift: float
    yaw: float
    starts: dict[str, np.ndarray]

    def totals(self, y: Signals) -> Signals:
        """Bounds of the vehicle's signals, from bounds ``y`` of its deviation from the flight.

        e_dot of z and psi is then the rate of the output in place of the error's.
        """
        result = {}
        for name in CHANNELS:
            nominal = self.bounds[name]
            result[name] = {key: value + nominal.get(key, 0.0) for key, value in y[name].items()}
            if name != "x":
                result[name]["e_dot"] = y[name]["e_dot"] + nominal["rate"]
        return result

    def couplings(self, y: Signals) -> Couplings:
        """Bounds of the signals that couple the channels, from bounds ``y`` of the vehicle's deviation."""
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
    """Sums of sines that drive the linear loop of an axis, and others with which its signals are compared.

    Args:
        reference: The reference y_m without its constant.
        known_remainders: The known parts of the remainders, by name.
        comparisons: By the name of a difference: the signal, and the sum of sines that is subtracted from it.
    """

    reference: Waves
    known_remainders: dict[str, Waves]
    comparisons: dict[str, tuple[str, Waves]]

    @property
    def frequencies(self) -> set[Fraction]:
        """The frequencies of all inputs [Hz]."""
        return {frequency for waves in (self.reference, *self.known_remainders.values()) for frequency in waves}


@dataclass(frozen=True)
class SteadyResponse:
    """The steady response of a channel to what drives an axis at one frequency.

    Args:
        state: Phasor of z at the samples, (n,).
        signals: Phasors of each signal at the points of a sample, (points,).
        slopes: Phasors of each signal's slope within the sample, at some times, (times,).
    """

    state: np.ndarray
    signals: dict[str, np.ndarray]
    slopes: dict[str, np.ndarray]


def nominal_of(
    problem: VehicleProblem, linear: dict[str, LinearChannel], slopes: dict[str, tuple[float, ...]], damping: float
) -> Nominal | None:
    """The nominal flight: the sum of the steady responses to all frequencies. None without a reference.

    Args:
        problem: The vehicle.
        linear: The linear channels.
        slopes: Slopes of the straight lines in place of each channel's functions.
        damping: Damping of drag in the plane [1/s].
    """
    if problem.reference is None:
        return None
    axes = axis_inputs_of(problem, damping)
    bounds: Signals = {}
    starts = {}
    for name in CHANNELS:
        axis_responses = []
        start_columns = []
        for axis in AXES_OF[name]:
            inputs = axes[axis]
            responses = {
                f: steady_response(problem, name, linear[name], slopes[name], inputs, f) for f in inputs.frequencies
            }
            axis_responses.append(responses)
            flight_state = np.sum([np.real(response.state) for response in responses.values()], axis=0)
            start = first_state(problem, name, slopes[name], inputs, len(flight_state))
            start_columns.append(start - flight_state)
        bounds[name] = bounds_of(problem, axis_responses)
        starts[name] = np.stack(start_columns, axis=-1)
    lift = size(derivative(derivative(axes["z"].reference)))
    return Nominal(bounds, ROOM * lift, ROOM * size(derivative(axes["psi"].reference)), starts)


def axis_inputs_of(problem: VehicleProblem, damping: float) -> dict[str, AxisInputs]:
    """The inputs of each axis, by its name; ``damping`` is that of drag in the plane [1/s]."""
    references = reference_waves(problem)
    speeds = {axis: derivative(waves) for axis, waves in references.items()}
    accelerations = {axis: derivative(waves) for axis, waves in speeds.items()}
    alpha_0 = {axis: total(accelerations[axis], multiple(speeds[axis], damping)) for axis in ("x", "y")}
    quarter_turn = {"x": multiple(alpha_0["y"], -1.0), "y": alpha_0["x"]}
    axes = {
        "psi": AxisInputs(references["psi"], {}, {"yaw_gap": ("rate", speeds["psi"])}),
        "z": AxisInputs(references["z"], {}, {"lift_gap": ("wanted", accelerations["z"])}),
    }
    for axis in ("x", "y"):
        force = product(accelerations["z"], alpha_0[axis], 1.0 / GRAVITY)
        yaw_torque = product(speeds["psi"], quarter_turn[axis], problem.damping)
        torque = total(yaw_torque, multiple(force, -problem.stiffness))
        comparisons = {"alpha_gap": ("alpha", alpha_0[axis]), "wanted_gap": ("wanted", alpha_0[axis])}
        axes[axis] = AxisInputs(references[axis], {"force": force, "torque": torque}, comparisons)
    return axes


@dataclass(frozen=True)
class InputPhasors:
    """Phasors at one frequency of what drives an axis.

    Args:
        speed: That of y_m'.
        acceleration: That of y_m''.
        known_remainders: Those of the known parts of the remainders, by name.
    """

    speed: complex
    acceleration: complex
    known_remainders: dict[str, complex]


def input_phasors(inputs: AxisInputs, frequency: Fraction) -> InputPhasors:
    """The phasors at one frequency [Hz] of an axis's inputs."""
    i_omega = 1j * rate_of(frequency)
    speed = i_omega * inputs.reference.get(frequency, 0.0)
    known_remainders = {key: waves.get(frequency, 0.0) for key, waves in inputs.known_remainders.items()}
    return InputPhasors(speed, i_omega * speed, known_remainders)


def driven_generator(linear: LinearChannel, phasors: InputPhasors, rate: float) -> np.ndarray:
    """The generator of (chi, U, e^(i rate t)) within a sample: the last entry drives chi, (m + 2, m + 2)."""
    m = linear.g.size
    known_forces = sum(phasor * linear.b[key] for key, phasor in phasors.known_remainders.items())
    generator = np.zeros((m + 2, m + 2), complex)
    generator[:m, :m] = linear.f
    generator[:m, m] = linear.g
    generator[:m, m + 1] = -phasors.speed * np.eye(m)[0] + known_forces
    generator[m + 1, m + 1] = 1j * rate
    return generator


def signal_rows(
    linear: LinearChannel, inputs: AxisInputs, phasors: InputPhasors, l0: float, frequency: Fraction
) -> dict[str, np.ndarray]:
    """Rows over (chi, U, e^(i rate t)) of the signals without u_av, of the output's rate and of the differences."""
    rows = {key: np.array([*c, d, 0.0], complex) for key, (c, d) in linear.signals.items()}
    rows["rate"] = np.array([*linear.signals["e_dot"][0], 0.0, 0.0], complex)
    rows["e_dot"][-1] = -phasors.speed
    rows["sigma"][-1] = -phasors.speed
    rows["bend"][-1] = phasors.known_remainders.get("force", 0.0) - phasors.acceleration - l0 * phasors.speed
    for gap, (key, waves) in inputs.comparisons.items():
        rows[gap] = np.array(rows[key])
        rows[gap][-1] -= waves.get(frequency, 0.0)
    return rows


def steady_response(
    problem: VehicleProblem,
    name: str,
    linear: LinearChannel,
    slopes: tuple[float, ...],
    inputs: AxisInputs,
    frequency: Fraction,
) -> SteadyResponse:
    """The steady response of a channel to what drives an axis at one frequency.

    Args:
        problem: The vehicle.
        name: The channel.
        linear: Its linear channel.
        slopes: Slopes of the straight lines in place of its functions.
        inputs: The inputs of an axis of the channel.
        frequency: The frequency [Hz].
    """
    channel = problem.channels[name]
    step = sampled_channel(problem, channel, linear, slopes)
    k_1, k_2, k_3, _ = slopes
    t = problem.sample_time
    rate = rate_of(frequency)
    m, n = linear.g.size, step.a.shape[0]
    drive = input_phasors(inputs, frequency)
    integral_input = -t * k_2 * drive.speed
    command_input = (k_1 + k_3) * drive.speed - integral_input
    if channel.nominal:
        command_input = command_input + (channel.l0 * drive.speed + drive.acceleration) / channel.nominal.k
    generator = driven_generator(linear, drive, rate)
    exponential = expm(generator * t)
    sample_input = np.zeros(n, complex)
    sample_input[:m] = exponential[:m, m] * step.direct * command_input + exponential[:m, m + 1]
    if n > m + 1:
        sample_input[m] = command_input
    sample_input[n - 1] = integral_input
    state = np.linalg.solve(np.exp(1j * rate * t) * np.eye(n) - step.a, sample_input)
    begin = np.concatenate([state[:m], [step.acting @ state + step.direct * command_input, 1.0]])
    rows = signal_rows(linear, inputs, drive, channel.l0, frequency)
    table = np.stack(list(rows.values()))
    phasors_at_points = np.stack([table @ expm(generator * share * t) @ begin for share in POINTS], axis=-1)
    slope = np.stack([table @ expm(generator * share * t) @ generator @ begin for share in (0.0, 0.5, 1.0)], axis=-1)
    signals = dict(zip(rows, phasors_at_points, strict=True))
    signals["u_av"] = np.full(len(POINTS), step.u_av @ state + integral_input - k_1 * drive.speed)
    return SteadyResponse(state, signals, dict(zip(rows, slope, strict=True)))


def first_state(
    problem: VehicleProblem, name: str, slopes: tuple[float, ...], inputs: AxisInputs, n: int
) -> np.ndarray:
    """The known part of the vehicle's z_0 on an axis, (n,): it moves with the reference, but does not turn."""
    channel = problem.channels[name]
    speed = sum(phasor.real for phasor in derivative(inputs.reference).values())
    result = np.zeros(n)
    if name == "psi":
        result[-1] = start_share(problem, channel, slopes) * speed
    else:
        result[1] = speed
    return result


def bounds_of(problem: VehicleProblem, axes: list[dict[Fraction, SteadyResponse]]) -> dict[str, float]:
    """Bounds of all signals of a channel, by name.

    Args:
        problem: The vehicle.
        axes: Steady responses of each axis of the channel, by frequency.
    """
    eighth = problem.sample_time / 8.0
    frequencies = set().union(*axes)
    first_response = next(iter(axes[0].values()))
    result = {}
    for key in first_response.signals:
        largest = np.zeros(len(axes))
        norm = 0.0
        for f in frequencies:
            phasors = [responses[f].signals[key] if f in responses else np.zeros(len(POINTS)) for responses in axes]
            slopes = [slope_phasors(responses.get(f), key) for responses in axes]
            growth = [eighth * SLOPE_ROOM * np.max(np.abs(slope)) for slope in slopes]
            largest += [np.max(np.abs(values)) + increment for values, increment in zip(phasors, growth, strict=True)]
            if len(axes) == 2:
                norm += np.max(vector_norm(*phasors)) + eighth * SLOPE_ROOM * np.max(vector_norm(*slopes))
        along_axes = len(axes) == 1 or key in ONE_AXIS
        result[key] = ROOM * float(np.max(largest) if along_axes else norm)
    return result


def slope_phasors(response: SteadyResponse | None, signal: str) -> np.ndarray:
    """Phasors of a signal's slope at some times, (times,); zero without a response, and of u_av, which is constant."""
    if response is None or signal == "u_av":
        return np.zeros(1)
    return response.slopes[signal]


def vector_norm(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The largest norm of the vector of Re(x w) and Re(y w) over |w| = 1, for phasors x and y of the plane's axes."""
    return 0.5 * (np.abs(x + 1j * y) + np.abs(x - 1j * y))
