"""The linear channels of a vehicle: between the samples, and at the samples with the controller, in floating point.

Near hover the vehicle behaves like three independent linear channels, x (and y), z and psi; the remainders r_j are the
differences from them. docs/vehicle_proofs.md has the equations.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from dssc_jax.proofs.vehicle_problem import ChannelProblem, VehicleProblem

GRAVITY = 9.81
"""g [m/s^2]."""


class Signal(NamedTuple):
    """A signal C chi + d U of a linear channel, where U is the command that acts.

    Args:
        row: C, shape (m,).
        direct: d.
    """

    row: np.ndarray
    direct: float


class Damping(NamedTuple):
    """Damping c by drag [1/s] in the linear channels: ``plane`` in x and y, ``vertical`` in z."""

    plane: float
    vertical: float


class StraightLines(NamedTuple):
    """The straight lines in place of a channel's functions phi_1, phi_2 and n.

    Args:
        k_1: Slope of the line in place of phi_1.
        k_2: Slope of the line in place of phi_2 [1/s].
        k_3: Slope of the line in place of n.
        share: s_q, the share of omega_u in omega_q.
    """

    k_1: float
    k_2: float
    k_3: float
    share: float


@dataclass(frozen=True)
class LinearChannel:
    """A linear channel chi' = A_c chi + B_c U + sum of b_j r_j with signals C chi + d U; U is the command that acts.

    Args:
        dynamics: A_c, shape (m, m).
        control: B_c, shape (m,).
        remainders: Columns b_j of the remainders r_j, by name, shape (m,) each.
        signals: The signals, by name.
    """

    dynamics: np.ndarray
    control: np.ndarray
    remainders: dict[str, np.ndarray]
    signals: dict[str, Signal]


@dataclass(frozen=True)
class SampledChannel:
    """One sample of a channel with its controller, z+ = A z + b_u omega_u + b_q omega_r.

    z = (chi, u_(k-1), ..., u_(k-D), q_(k-1)) with a delay of D samples, rounded up. omega_u and omega_q are the
    deviations of the functions from straight lines, in the command and in the sum q, and omega_q = s_q omega_u +
    omega_r.

    Args:
        a: A, shape (n, n).
        by_command: b_u, which includes s_q b_q, shape (n,).
        by_integral: b_q, shape (n,).
        acting: The command that acts, as a row over z, without the omegas of the same sample, shape (n,).
        fresh: Share of this sample's command in the acting command; 1 without a delay.
        equivalent: u_av = q_k + k_1 sigma_k as a row over z, shape (n,).
    """

    a: np.ndarray
    by_command: np.ndarray
    by_integral: np.ndarray
    acting: np.ndarray
    fresh: float
    equivalent: np.ndarray


class ChannelBuilder:
    """A :class:`LinearChannel` under construction, whose attributes have the names and meanings of that class.

    The attribute ``states`` holds each state as a row over chi. ``signals`` holds the signals besides e, e', sigma and
    bend, which :meth:`channel` adds.

    Args:
        count: Number of states without a rotor lag; the first two are e and e'.
        lag: Whether there is a rotor lag, which adds one state at the end.
    """

    def __init__(self, count: int, *, lag: bool) -> None:
        """Begin with chi' = 0, without remainders and signals."""
        m = count + lag
        self.states = np.eye(m)
        self.dynamics = np.zeros((m, m))
        self.control = np.zeros(m)
        self.remainders: dict[str, np.ndarray] = {}
        self.signals: dict[str, Signal] = {}

    def drive(self, place: int, demand: Signal, lag: float, achieved_name: str) -> None:
        """Make a demand the derivative of a state, at once or through the rotors' lag.

        With a lag tau the derivative is the achieved value, which is the last state. Its derivative is (demand -
        achieved)/tau plus the remainder ``lag``. The signal ``behind`` is then demand - achieved.

        Args:
            place: Place of the driven state in chi.
            demand: The demand, as a signal.
            lag: tau [s]; 0: no lag.
            achieved_name: Name of the achieved value as a signal; unused without a lag.
        """
        if not lag:
            self.dynamics[place] = demand.row
            self.control[place] = demand.direct
            return
        achieved = self.states[-1]
        difference = demand.row - achieved
        self.dynamics[place] = achieved
        self.dynamics[-1] = difference / lag
        self.control[-1] = demand.direct / lag
        self.remainders["lag"] = achieved  # a unit column at the last state
        self.signals |= {achieved_name: Signal(achieved, 0.0), "behind": Signal(difference, demand.direct)}

    def channel(self, controller: ChannelProblem) -> LinearChannel:
        """Finish the channel: add the signals e, e', sigma = e' + l_0 e and bend = e'' + l_0 e'.

        Args:
            controller: The channel's controller, of which l_0 is used.
        """
        e, e_dot = self.states[:2]
        errors = {
            "e": Signal(e, 0.0),
            "e_dot": Signal(e_dot, 0.0),
            "sigma": Signal(e_dot + controller.l0 * e, 0.0),
            "bend": Signal(self.dynamics[1] + controller.l0 * e_dot, self.control[1]),
        }
        return LinearChannel(self.dynamics, self.control, self.remainders, errors | self.signals)


def planar_channel(problem: VehicleProblem, damping: float) -> LinearChannel:
    """The channel of x and y: e'' = alpha - c e' + r_force and alpha'' = m + r_torque, where alpha is g times the tilt.

    m = a_0 (a_h - alpha) - a_1 alpha' with the wanted acceleration a_h, and chi = (e, e', alpha, alpha'). A rotor lag
    adds the state gamma, with alpha'' = gamma + r_torque and gamma' = (m - gamma)/tau + r_lag.

    Args:
        problem: The vehicle.
        damping: c, the damping of drag [1/s].
    """
    k_v = problem.velocity_gain
    a_0 = problem.stiffness
    a_1 = problem.damping
    builder = ChannelBuilder(4, lag=problem.rotor_lag > 0.0)
    _, e_dot, alpha, alpha_dot = builder.states[:4]
    demand = Signal(-k_v * e_dot, k_v)  # a_h = k_v (U - e')
    turn = Signal(a_0 * (-k_v * e_dot - alpha) - a_1 * alpha_dot, a_0 * k_v)  # m
    builder.dynamics[:3] = [e_dot, alpha - damping * e_dot, alpha_dot]
    builder.drive(3, turn, problem.rotor_lag, "gamma")
    builder.remainders |= {"force": e_dot, "torque": alpha_dot}
    builder.signals |= {
        "alpha": Signal(alpha, 0.0),
        "alpha_dot": Signal(alpha_dot, 0.0),
        "wanted": demand,
        "turn": turn,
        "speed": Signal(e_dot, 0.0),
        "acceleration": Signal(builder.dynamics[1], 0.0),
    }
    return builder.channel(problem.channels["x"])


def vertical_channel(problem: VehicleProblem, damping: float) -> LinearChannel:
    """The channel of z: e'' = a_z - c e' + r_force with the wanted acceleration a_z; chi = (e, e').

    A rotor lag adds the state q, the acceleration that the rotors achieve, with e'' = q - c e' + r_force and q' = (a_z
    - q)/tau + r_lag. The constant o acts like r_force; its response is computed from the column of ``force``.

    Args:
        problem: The vehicle.
        damping: c, the damping of drag [1/s].
    """
    k_v = problem.velocity_gain
    builder = ChannelBuilder(2, lag=problem.rotor_lag > 0.0)
    e_dot = builder.states[1]
    demand = Signal(-k_v * e_dot, k_v)  # a_z = k_v (U - e')
    builder.dynamics[0] = e_dot
    builder.drive(1, demand, problem.rotor_lag, "lift")
    builder.dynamics[1] -= damping * e_dot
    builder.remainders["force"] = e_dot
    builder.signals |= {"wanted": demand, "acceleration": Signal(builder.dynamics[1], builder.control[1])}
    return builder.channel(problem.channels["z"])


def yaw_channel(problem: VehicleProblem) -> LinearChannel:
    """The channel of psi: psi'' = eta_psi + r_torque with eta_psi = k_y (U - psi') + i_y I and I' = U - psi'.

    chi = (e, psi', I). A rotor lag adds the state gamma_psi, with psi'' = gamma_psi + r_torque and gamma_psi' =
    (eta_psi - gamma_psi)/tau + r_lag.
    """
    builder = ChannelBuilder(3, lag=problem.rotor_lag > 0.0)
    _, rate, integral = builder.states[:3]
    follow = Signal(-rate, 1.0)  # U - psi'
    demand_row = -problem.yaw_gain * rate + problem.yaw_integral_gain * integral
    demand = Signal(demand_row, problem.yaw_gain)  # eta_psi
    builder.dynamics[0] = rate
    builder.drive(1, demand, problem.rotor_lag, "gamma")
    builder.dynamics[2] = follow.row
    builder.control[2] = follow.direct
    builder.remainders["torque"] = rate
    builder.signals |= {"wanted": demand, "follow": follow}
    return builder.channel(problem.channels["psi"])


class Flow(NamedTuple):
    """The exact solution of a channel without remainders after a time t: chi(t) = exp(A_c t) chi(0) + gamma(t) U.

    Args:
        phi: exp(A_c t), shape (m, m).
        gamma: gamma(t), the part of chi(t) that a held command of 1 causes, shape (m,).
    """

    phi: np.ndarray
    gamma: np.ndarray


def flow(linear: LinearChannel, time: float) -> Flow:
    """Compute the exact solution of a channel without remainders after a time [s]."""
    m = linear.control.size
    generator = np.zeros((m + 1, m + 1))
    generator[:m, :m] = linear.dynamics
    generator[:m, m] = linear.control
    exponential = expm(generator * time)
    return Flow(exponential[:m, :m], exponential[:m, m])


def sampled_channel(
    problem: VehicleProblem, channel: ChannelProblem, linear: LinearChannel, lines: StraightLines
) -> SampledChannel:
    """A channel at its samples, with straight lines in place of the controller's functions.

    In sliding q_k = q_(k-1) + T_s (k_2 sigma + omega_q) and u_k = -(k_1 + k_3) sigma - q_k - omega_u, less the nominal
    control's feedback.

    Args:
        problem: The vehicle.
        channel: The controller of the channel.
        linear: The channel between the samples.
        lines: The straight lines, and the share s_q.
    """
    k_1, k_2, k_3, share = lines
    t = problem.sample_time
    weights = problem.delay_weights
    m = linear.control.size
    memory = len(weights) - 1  # D, the number of earlier commands in z
    n = m + memory + 1
    unit = np.eye(n)
    e, e_dot = unit[:2]
    sigma = e_dot + channel.l0 * e
    q = unit[n - 1] + t * k_2 * sigma
    command = -(k_1 + k_3) * sigma - q
    if channel.nominal:
        a_n, k_n, _ = channel.nominal
        command = command - ((a_n - channel.l0) * channel.l0 * e + (channel.l0 - a_n) * sigma) / k_n
    acting = weights[0] * command
    for i, weight in enumerate(weights[1:]):
        acting = acting + weight * unit[m + i]
    phi, gamma = flow(linear, t)
    a = np.zeros((n, n))
    a[:m, :m] = phi
    a[:m] += np.outer(gamma, acting)
    by_omega_u = np.zeros(n)
    by_omega_u[:m] = -gamma * weights[0]
    if memory:  # the command joins the earlier ones, and these move on by one place
        a[m] = command
        by_omega_u[m] = -1.0
        for i in range(1, memory):
            a[m + i] = unit[m + i - 1]
    a[n - 1] = q
    by_omega_q = t * (by_omega_u + unit[n - 1])  # omega_q adds T_s omega_q to q, and q is subtracted from the command
    return SampledChannel(
        a=a,
        by_command=by_omega_u + share * by_omega_q,
        by_integral=by_omega_q,
        acting=acting,
        fresh=weights[0],
        equivalent=q + k_1 * sigma,
    )
