"""The linear channel of each controller, and the channel at its samples, in floating point."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.linalg import expm

from dssc_jax.proofs.vehicle_problem import ChannelProblem, VehicleProblem

GRAVITY = 9.81


Signal: TypeAlias = tuple[np.ndarray, float]
"""The row C and the number d of a signal C chi + d U."""


@dataclass(frozen=True)
class LinearChannel:
    """A linear channel chi' = A_c chi + B_c U + sum of b_j r_j with signals C chi + d U.

    Args:
        f: A_c, (m, m).
        g: B_c, (m,).
        b: Columns b_j of the remainders by name, (m,) each.
        signals: Rows C and numbers d by name.
    """

    f: np.ndarray
    g: np.ndarray
    b: dict[str, np.ndarray]
    signals: dict[str, Signal]


@dataclass(frozen=True)
class SampledChannel:
    """One sample of a channel: z+ = A z, z = (chi, earlier commands, q).

    Args:
        a: A, (n, n).
        acting: Row of the command that acts, (n,).
        direct: Share of this sample's command in it.
        u: Column of omega_u, together with its share in omega_q, (n,).
        q: Column of what omega_q has besides this share, (n,).
        u_av: Row of q_k + k_1 sigma_k, (n,).
    """

    a: np.ndarray
    acting: np.ndarray
    direct: float
    u: np.ndarray
    q: np.ndarray
    u_av: np.ndarray


class ChannelBuilder:
    """Puts a :class:`LinearChannel` together.

    ``states`` has the row of each state, ``slopes`` those of the states' derivatives, ``control`` the command's factor
    in these, and ``remainders`` the columns of the remainders by name.
    """

    def __init__(self, count: int, *, lag: bool) -> None:
        """A channel of ``count`` states whose slopes are zero; a lag adds one more state, the last one."""
        m = count + lag
        self.states = np.eye(m)
        self.slopes = np.zeros((m, m))
        self.control = np.zeros(m)
        self.remainders: dict[str, np.ndarray] = {}
        self.signals: dict[str, Signal] = {}

    def drive(self, index: int, demand: Signal, lag: float, response: str) -> None:
        """Let a demand drive the slope of a state, at once or through a lag.

        Args:
            index: The state.
            demand: The demand.
            lag: Time constant of the lag [s]; 0: none.
            response: Name of the signal that the lag makes of the demand.
        """
        if not lag:
            self.slopes[index], self.control[index] = demand
            return
        state = self.states[-1]
        error = (demand[0] - state, demand[1])
        self.slopes[index] = state
        self.slopes[-1] = error[0] / lag
        self.control[-1] = error[1] / lag
        self.remainders["lag"] = state
        self.signals |= {response: (state, 0.0), "behind": error}

    def channel(self, controller: ChannelProblem) -> LinearChannel:
        """The channel with its signals, to which e, e', sigma and the slope of sigma are added."""
        e, e_dot = self.states[:2]
        errors = {
            "e": (e, 0.0),
            "e_dot": (e_dot, 0.0),
            "sigma": (e_dot + controller.l0 * e, 0.0),
            "bend": (self.slopes[1] + controller.l0 * e_dot, self.control[1]),
        }
        return LinearChannel(self.slopes, self.control, self.remainders, errors | self.signals)


def planar_channel(problem: VehicleProblem, damping: float) -> LinearChannel:
    """The channel of x and y: chi = (e, e', alpha, alpha'), or with a lag (e, e', alpha, alpha', gamma).

    ``damping`` is that of drag [1/s].
    """
    k_v = problem.velocity_gain
    a_0 = problem.stiffness
    a_1 = problem.damping
    builder = ChannelBuilder(4, lag=problem.rotor_lag > 0.0)
    _, e_dot, alpha, alpha_dot = builder.states[:4]
    demand = (-k_v * e_dot, k_v)
    turn = (a_0 * (demand[0] - alpha) - a_1 * alpha_dot, a_0 * k_v)
    builder.slopes[:3] = [e_dot, alpha - damping * e_dot, alpha_dot]
    builder.drive(3, turn, problem.rotor_lag, "gamma")
    builder.remainders |= {"force": e_dot, "torque": alpha_dot}
    builder.signals |= {"alpha": (alpha, 0.0), "alpha_dot": (alpha_dot, 0.0), "wanted": demand, "turn": turn}
    builder.signals |= {"speed": (e_dot, 0.0), "acceleration": (builder.slopes[1], 0.0)}
    return builder.channel(problem.channels["x"])


def vertical_channel(problem: VehicleProblem, damping: float) -> LinearChannel:
    """The channel of z: chi = (e, e'), or with a lag (e, e', q), where q is the acceleration that the rotors achieve.

    ``damping`` is that of drag [1/s].
    """
    k_v = problem.velocity_gain
    builder = ChannelBuilder(2, lag=problem.rotor_lag > 0.0)
    e_dot = builder.states[1]
    demand = (-k_v * e_dot, k_v)
    builder.slopes[0] = e_dot
    builder.drive(1, demand, problem.rotor_lag, "lift")  # e'' also has the damping of drag
    builder.slopes[1] -= damping * e_dot
    builder.remainders["force"] = e_dot
    builder.signals |= {"wanted": demand, "acceleration": (builder.slopes[1], builder.control[1])}
    return builder.channel(problem.channels["z"])


def yaw_channel(problem: VehicleProblem) -> LinearChannel:
    """The channel of psi: chi = (e, psi', I), or with a lag (e, psi', I, gamma_psi); I is the integral of U - psi'."""
    builder = ChannelBuilder(3, lag=problem.rotor_lag > 0.0)
    _, rate, integral = builder.states[:3]
    follow = (-rate, 1.0)
    demand = (-problem.yaw_gain * rate + problem.yaw_integral_gain * integral, problem.yaw_gain)
    builder.slopes[0] = rate
    builder.drive(1, demand, problem.rotor_lag, "gamma")
    builder.slopes[2], builder.control[2] = follow
    builder.remainders["torque"] = rate
    builder.signals |= {"wanted": demand, "follow": follow}
    return builder.channel(problem.channels["psi"])


def flow(linear: LinearChannel, time: float) -> tuple[np.ndarray, np.ndarray]:
    """exp(A_c t), (m, m), and what a command 1 that is held for the time t [s] adds to chi, (m,)."""
    m = linear.g.size
    generator = np.zeros((m + 1, m + 1))
    generator[:m, :m] = linear.f
    generator[:m, m] = linear.g
    exponential = expm(generator * time)
    return exponential[:m, :m], exponential[:m, m]


def sampled_channel(
    problem: VehicleProblem, channel: ChannelProblem, linear: LinearChannel, slopes: tuple[float, ...]
) -> SampledChannel:
    """A channel at its samples, with straight lines in place of its functions.

    Args:
        problem: The vehicle.
        channel: The controller of the channel.
        linear: Its linear channel.
        slopes: Slopes k_1, k_2, k_3 of the lines, and the share of omega_u in omega_q.
    """
    k_1, k_2, k_3, share = slopes
    t = problem.sample_time
    weights = problem.delay_weights
    m = linear.g.size
    memory = len(weights) - 1
    n = m + memory + 1
    unit = np.eye(n)
    sigma = unit[1] + channel.l0 * unit[0]
    q = unit[n - 1] + t * k_2 * sigma
    command = -(k_1 + k_3) * sigma - q
    if channel.nominal:
        a_n, gain, _ = channel.nominal
        command = command - ((a_n - channel.l0) * channel.l0 * unit[0] + (channel.l0 - a_n) * sigma) / gain
    acting = weights[0] * command
    for i, weight in enumerate(weights[1:]):
        acting = acting + weight * unit[m + i]
    phi, gamma = flow(linear, t)
    a = np.zeros((n, n))
    a[:m, :m] = phi
    a[:m] += np.outer(gamma, acting)
    u = np.zeros(n)
    u[:m] = -gamma * weights[0]
    if memory:
        a[m] = command
        u[m] = -1.0
        for i in range(1, memory):
            a[m + i] = unit[m + i - 1]
    a[n - 1] = q
    sum_column = t * (u + unit[n - 1])
    return SampledChannel(
        a=a, acting=acting, direct=weights[0], u=u + share * sum_column, q=sum_column, u_av=q + k_1 * sigma
    )
