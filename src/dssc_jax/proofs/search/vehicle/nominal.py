"""The nominal flight of a moving reference: the steady answer of the linear channels to it, in floating point.

The reference and the known parts of the remainders are sums of sines, and so is the answer of a sampled linear channel.
docs/vehicle_proofs.md has the theorem.
"""

from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from scipy.linalg import expm

from dssc_jax.proofs.search.vehicle.channels import GRAVITY, LinearChannel, sampled_channel
from dssc_jax.proofs.search.vehicle.remainders import Couplings, Signals
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
    """What is known of the nominal flight.

    Args:
        bounds: Bounds of its signals, by channel, besides those of some differences: ``alpha_gap`` and ``wanted_gap``
            of alpha and a_h to alpha_0, ``lift_gap`` of a_z to z_m'', ``yaw_gap`` of psi' to psi_m'. ``rate`` of z and
            psi is that of the output itself.
        lift: Bound of |z_m''|.
        yaw: Bound of |psi_m'|.
        starts: What the vehicle's z_0 differs by from that of the flight, by channel, (n, axes).
    """

    bounds: Signals
    lift: float
    yaw: float
    starts: dict[str, np.ndarray]

    def totals(self, y: Signals) -> Signals:
        """Bounds of the vehicle's signals from those of its deviation; e_dot of z and psi is the output's rate."""
        result = {}
        for name in CHANNELS:
            nominal = self.bounds[name]
            result[name] = {key: value + nominal.get(key, 0.0) for key, value in y[name].items()}
            if name != "x":
                result[name]["e_dot"] = y[name]["e_dot"] + nominal["rate"]
        return result

    def couplings(self, y: Signals) -> Couplings:
        """Bounds of the signals that couple the channels, from the bounds of the deviation."""
        return Couplings(
            alpha_gap=self.bounds["x"]["alpha_gap"] + y["x"]["alpha"],
            wanted_gap=self.bounds["x"]["wanted_gap"] + y["x"]["wanted"],
            lift_gap=self.bounds["z"]["lift_gap"] + y["z"]["wanted"],
            yaw_gap=self.bounds["psi"]["yaw_gap"] + y["psi"]["e_dot"],
            lift=self.lift,
            yaw=self.yaw,
        )


@dataclass(frozen=True)
class Drive:
    """Inputs of the loop of an axis: the reference, and the known parts of its remainders.

    Args:
        reference: y_m without its constant.
        inputs: The known parts, by remainder.
        comparisons: Sums of sines with which a signal is compared: the signal, by the name of the difference.
    """

    reference: Waves
    inputs: dict[str, Waves] = field(default_factory=dict)
    comparisons: dict[str, tuple[str, Waves]] = field(default_factory=dict)

    @property
    def frequencies(self) -> set[Fraction]:
        """All frequencies."""
        return {frequency for waves in (self.reference, *self.inputs.values()) for frequency in waves}


@dataclass(frozen=True)
class Answer:
    """The steady answer of an axis to one frequency: phasors.

    Args:
        state: Phasor of z, (n,).
        signals: Phasors of each signal at the points of a sample, (points,).
        slopes: Phasors of each signal's slope within the sample, at some times, (times,).
    """

    state: np.ndarray
    signals: dict[str, np.ndarray]
    slopes: dict[str, np.ndarray]


def nominal_of(
    problem: VehicleProblem, linear: dict[str, LinearChannel], slopes: dict[str, tuple[float, ...]], damping: float
) -> Nominal | None:
    """The nominal flight of channels with given slopes and damping of drag in the plane; None without a reference."""
    if problem.reference is None:
        return None
    drives = drives_of(problem, damping)
    bounds: Signals = {}
    starts = {}
    for name in CHANNELS:
        answers = []
        columns = []
        for axis in AXES_OF[name]:
            drive = drives[axis]
            answers_by_frequency = {
                f: answer_of(problem, name, linear[name], slopes[name], drive, f) for f in drive.frequencies
            }
            answers.append(answers_by_frequency)
            flight_state = np.sum([np.real(answer.state) for answer in answers_by_frequency.values()], axis=0)
            columns.append(first_state(problem, name, slopes[name], drive, len(flight_state)) - flight_state)
        bounds[name] = bounds_of(problem, answers)
        starts[name] = np.stack(columns, axis=-1)
    lift = size(derivative(derivative(drives["z"].reference)))
    return Nominal(bounds, ROOM * lift, ROOM * size(derivative(drives["psi"].reference)), starts)


def drives_of(problem: VehicleProblem, damping: float) -> dict[str, Drive]:
    """The inputs of each axis."""
    references = reference_waves(problem)
    speeds = {axis: derivative(waves) for axis, waves in references.items()}
    bends = {axis: derivative(waves) for axis, waves in speeds.items()}
    alpha_0 = {axis: total(bends[axis], multiple(speeds[axis], damping)) for axis in ("x", "y")}
    quarter_turn = {"x": multiple(alpha_0["y"], -1.0), "y": alpha_0["x"]}
    drives = {"psi": Drive(references["psi"], {}, {"yaw_gap": ("rate", speeds["psi"])})}
    drives["z"] = Drive(references["z"], {}, {"lift_gap": ("wanted", bends["z"])})
    for axis in ("x", "y"):
        lift_force = product(bends["z"], alpha_0[axis], 1.0 / GRAVITY)
        yaw_torque = product(speeds["psi"], quarter_turn[axis], problem.damping)
        inputs = {"force": lift_force, "torque": total(yaw_torque, multiple(lift_force, -problem.stiffness))}
        comparisons = {"alpha_gap": ("alpha", alpha_0[axis]), "wanted_gap": ("wanted", alpha_0[axis])}
        drives[axis] = Drive(references[axis], inputs, comparisons)
    return drives


def answer_of(
    problem: VehicleProblem,
    name: str,
    linear: LinearChannel,
    slopes: tuple[float, ...],
    drive: Drive,
    frequency: Fraction,
) -> Answer:
    """The steady answer of a channel to what drives it at one frequency."""
    channel = problem.channels[name]
    step = sampled_channel(problem, channel, linear, slopes)
    k_1, k_2, k_3, _ = slopes
    t = problem.sample_time
    w = rate_of(frequency)
    m, n = linear.g.size, step.a.shape[0]
    speed = 1j * w * drive.reference.get(frequency, 0.0)
    acceleration = 1j * w * speed
    input_phasors = {key: waves.get(frequency, 0.0) for key, waves in drive.inputs.items()}
    forces = -speed * np.eye(m)[0] + sum(phasor * linear.b[key] for key, phasor in input_phasors.items())
    by_sum = -t * k_2 * speed
    command = (k_1 + k_3) * speed - by_sum
    if channel.nominal:
        command = command + (channel.l0 * speed + acceleration) / channel.nominal[1]
    generator = np.zeros((m + 2, m + 2), complex)
    generator[:m, :m] = linear.f
    generator[:m, m] = linear.g
    generator[:m, m + 1] = forces
    generator[m + 1, m + 1] = 1j * w
    exponential = expm(generator * t)
    sample_input = np.zeros(n, complex)
    sample_input[:m] = exponential[:m, m] * step.direct * command + exponential[:m, m + 1]
    if n > m + 1:
        sample_input[m] = command
    sample_input[n - 1] = by_sum
    state = np.linalg.solve(np.exp(1j * w * t) * np.eye(n) - step.a, sample_input)
    begin = np.concatenate([state[:m], [step.acting @ state + step.direct * command, 1.0]])
    rows = {key: np.array([*c, d, 0.0], complex) for key, (c, d) in linear.signals.items()}
    rows["rate"] = np.array([*linear.signals["e_dot"][0], 0.0, 0.0], complex)
    rows["e_dot"][-1] = -speed
    rows["sigma"][-1] = -speed
    rows["bend"][-1] = input_phasors.get("force", 0.0) - acceleration - channel.l0 * speed
    for gap, (key, waves) in drive.comparisons.items():
        rows[gap] = np.array(rows[key])
        rows[gap][-1] -= waves.get(frequency, 0.0)
    table = np.stack(list(rows.values()))
    phasors_at_points = np.stack([table @ expm(generator * share * t) @ begin for share in POINTS], axis=-1)
    slope = np.stack([table @ expm(generator * share * t) @ generator @ begin for share in (0.0, 0.5, 1.0)], axis=-1)
    signals = dict(zip(rows, phasors_at_points, strict=True))
    signals["u_av"] = np.full(len(POINTS), step.u_av @ state + by_sum - k_1 * speed)
    return Answer(state, signals, dict(zip(rows, slope, strict=True)))


def first_state(problem: VehicleProblem, name: str, slopes: tuple[float, ...], drive: Drive, n: int) -> np.ndarray:
    """The known part of the vehicle's z_0: it moves with the reference, but does not turn."""
    channel = problem.channels[name]
    speed = sum(phasor.real for phasor in derivative(drive.reference).values())
    result = np.zeros(n)
    if name == "psi":
        result[-1] = start_share(problem, channel, slopes) * speed
    else:
        result[1] = speed
    return result


def bounds_of(problem: VehicleProblem, answers: list[dict[Fraction, Answer]]) -> dict[str, float]:
    """Bounds of all signals, from the answers of one axis or of the plane's two axes."""
    eighth = problem.sample_time / 8.0
    frequencies = set().union(*answers)
    first_answer = next(iter(answers[0].values()))
    result = {}
    for key in first_answer.signals:
        largest = np.zeros(len(answers))
        norm = 0.0
        for f in frequencies:
            axis_answers = [answer.get(f) for answer in answers]
            phasors = [np.zeros(len(POINTS)) if answer is None else answer.signals[key] for answer in axis_answers]
            has_slope = key != "u_av"
            slopes = [
                answer.slopes[key] if answer is not None and has_slope else np.zeros(1) for answer in axis_answers
            ]
            growth = [eighth * SLOPE_ROOM * np.max(np.abs(slope)) for slope in slopes]
            largest += [np.max(np.abs(values)) + increment for values, increment in zip(phasors, growth, strict=True)]
            if len(answers) == 2:
                x, y = phasors
                circles = 0.5 * (np.abs(x + 1j * y) + np.abs(x - 1j * y))
                x, y = slopes
                circle_slopes = 0.5 * (np.abs(x + 1j * y) + np.abs(x - 1j * y))
                norm += np.max(circles) + eighth * SLOPE_ROOM * np.max(circle_slopes)
        along_axes = len(answers) == 1 or key in ONE_AXIS
        result[key] = ROOM * float(np.max(largest) if along_axes else norm)
    return result
