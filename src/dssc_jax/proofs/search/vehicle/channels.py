"""The linear channel of each controller, sampled, and what its signals are at most, in floating point."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.linalg import expm

from dssc_jax.proofs.search.fixed_point import responses
from dssc_jax.proofs.vehicle_problem import ChannelProblem, VehicleProblem

GRAVITY = 9.81
POINTS = (0.125, 0.375, 0.625, 0.875)
"""Times within a sample at which signals are bounded, in T_s; every time is within T_s/8 of one."""
PIECES = 4
"""Pieces of each half of the rotors' lag, or of a shorter sample, in integrals by the trapezoidal rule."""
MOST_PIECES = 32
"""Largest number of pieces of a sample."""
ONE_AXIS = ("e", "e_dot", "sigma", "bend", "u_av")
"""Signals of the plane's channel that are bounded along each axis; the others are norms of vectors."""
MOST_CONSTANT_SAMPLES = 40_000
CONSTANT_SETTLED = 1e-4
"""Share of a response to a constant at which it counts as settled."""


Signal: TypeAlias = tuple[np.ndarray, float]
"""The row C and the number d of a signal C chi + d U."""


@dataclass(frozen=True)
class Linear:
    """A linear channel chi' = A_c chi + B_c U + sum of b_j r_j with signals C chi + d U.

    Args:
        f: A_c, (m, m).
        g: B_c, (m,).
        b: Columns of the remainders by name, (m,) each.
        signals: Rows C and numbers d by name.
    """

    f: np.ndarray
    g: np.ndarray
    b: dict[str, np.ndarray]
    signals: dict[str, Signal]


@dataclass(frozen=True)
class ChannelResponse:
    """Bounds of a channel's signals for remainders of size 1.

    Args:
        names: The signals, in order.
        remainders: Names of the remainders.
        gains: Sums for each point of a sample, signal and input, (points, signals, inputs); the first two inputs are
            omega_u and omega_q, the others the remainders.
        constant: Largest response to a constant force 1, (points, signals).
        starts: Peaks of the responses to e, e' and q_(-1), (points, signals, 3).
    """

    names: tuple[str, ...]
    remainders: tuple[str, ...]
    gains: np.ndarray
    constant: np.ndarray
    starts: np.ndarray


@dataclass(frozen=True)
class Sampled:
    """One sample of a channel: z+ = A z, z = (chi, earlier commands, q).

    Args:
        a: A, (n, n).
        acting: Row of the command that acts, (n,).
        direct: Share of this sample's command in it.
        u: Column of omega_u, (n,).
        q: Column of omega_q, (n,).
        u_av: Row of q_k + k_1 sigma_k.
    """

    a: np.ndarray
    acting: np.ndarray
    direct: float
    u: np.ndarray
    q: np.ndarray
    u_av: np.ndarray


class Parts:
    """The parts of a linear channel while it is put together."""

    def __init__(self, states: int, *, lagged: bool) -> None:
        """Matrices of zeros; with a lag there is one more state, the last one."""
        m = states + lagged
        self.unit = np.eye(m)
        self.f = np.zeros((m, m))
        self.g = np.zeros(m)
        self.b: dict[str, np.ndarray] = {}
        self.signals: dict[str, Signal] = {}

    def drive(self, place: int, demand: Signal, lag: float, achieved: str) -> None:
        """Let a demand drive the slope of a state, at once or through a lag, whose state is the signal ``achieved``."""
        if not lag:
            self.f[place], self.g[place] = demand
            return
        state = self.unit[-1]
        behind = (demand[0] - state, demand[1])
        self.f[place] = state
        self.f[-1] = behind[0] / lag
        self.g[-1] = behind[1] / lag
        self.b["lag"] = state
        self.signals |= {achieved: (state, 0.0), "behind": behind}

    def channel(self, controller: ChannelProblem) -> Linear:
        """The channel, with the signals e, e', sigma and the slope of sigma."""
        e, e_dot = self.unit[:2]
        errors = {
            "e": (e, 0.0),
            "e_dot": (e_dot, 0.0),
            "sigma": (e_dot + controller.l0 * e, 0.0),
            "bend": (self.f[1] + controller.l0 * e_dot, self.g[1]),
        }
        return Linear(self.f, self.g, self.b, errors | self.signals)


def planar_channel(problem: VehicleProblem, damping: float) -> Linear:
    """The channel of x and y: chi = (e, e', alpha, alpha', and gamma with a lag). ``damping`` is that of drag [1/s]."""
    k_v, a_0, a_1 = problem.velocity_gain, problem.stiffness, problem.damping
    parts = Parts(4, lagged=problem.rotor_lag > 0.0)
    _, e_dot, alpha, alpha_dot = parts.unit[:4]
    demand = (-k_v * e_dot, k_v)
    turn = (a_0 * (demand[0] - alpha) - a_1 * alpha_dot, a_0 * k_v)
    parts.f[:3] = [e_dot, alpha - damping * e_dot, alpha_dot]
    parts.drive(3, turn, problem.rotor_lag, "gamma")
    parts.b |= {"force": e_dot, "torque": alpha_dot}
    parts.signals |= {"alpha": (alpha, 0.0), "alpha_dot": (alpha_dot, 0.0), "wanted": demand, "turn": turn}
    parts.signals |= {"speed": (e_dot, 0.0), "acceleration": (parts.f[1], 0.0)}
    return parts.channel(problem.channels["x"])


def vertical_channel(problem: VehicleProblem, damping: float) -> Linear:
    """The channel of z: chi = (e, e', and q with a lag)."""
    k_v = problem.velocity_gain
    parts = Parts(2, lagged=problem.rotor_lag > 0.0)
    e_dot = parts.unit[1]
    demand = (-k_v * e_dot, k_v)
    parts.f[0] = e_dot
    parts.drive(1, demand, problem.rotor_lag, "lift")
    parts.f[1] -= damping * e_dot
    parts.b["force"] = e_dot
    parts.signals |= {"wanted": demand, "acceleration": (parts.f[1], parts.g[1])}
    return parts.channel(problem.channels["z"])


def yaw_channel(problem: VehicleProblem) -> Linear:
    """The channel of psi: chi = (e, psi', I, and gamma_psi with a lag)."""
    parts = Parts(3, lagged=problem.rotor_lag > 0.0)
    _, rate, integrated = parts.unit[:3]
    follow = (-rate, 1.0)
    demand = (-problem.yaw_gain * rate + problem.yaw_integral_gain * integrated, problem.yaw_gain)
    parts.f[0] = rate
    parts.drive(1, demand, problem.rotor_lag, "gamma")
    parts.f[2], parts.g[2] = follow
    parts.b["torque"] = rate
    parts.signals |= {"wanted": demand, "follow": follow}
    return parts.channel(problem.channels["psi"])


def flow(linear: Linear, time: float) -> tuple[np.ndarray, np.ndarray]:
    """exp(A_c t), and what a command 1 held for this time adds to chi."""
    m = linear.g.size
    generator = np.zeros((m + 1, m + 1))
    generator[:m, :m] = linear.f
    generator[:m, m] = linear.g
    held = expm(generator * time)
    return held[:m, :m], held[:m, m]


def sampled(problem: VehicleProblem, channel: ChannelProblem, linear: Linear, slopes: tuple[float, ...]) -> Sampled:
    """One sample with slopes k_1, k_2, k_3 of the functions."""
    k_1, k_2, k_3 = slopes
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
    return Sampled(a, acting, weights[0], u, t * (u + unit[n - 1]), q + k_1 * sigma)


@dataclass(frozen=True)
class Seen:
    """A sampled channel, its signals at the points of a sample, and its inputs.

    Args:
        step: One sample.
        names: The signals.
        rows: Row of each point and signal over z, (points * signals, n).
        direct: What the inputs of the same sample do, (points, signals, inputs).
        columns: Columns of omega_u, omega_q, and of the remainders at the ends of the pieces of a sample, (n, inputs).
        pieces: Number of these pieces.
        held: Column of a constant force, (n,).
        within: What a constant force of the same sample does, (points * signals,).
    """

    step: Sampled
    names: tuple[str, ...]
    rows: np.ndarray
    direct: np.ndarray
    columns: np.ndarray
    pieces: int
    held: np.ndarray
    within: np.ndarray


def pieces_of(problem: VehicleProblem) -> int:
    """Number of pieces of a sample."""
    if not problem.rotor_lag:
        return PIECES
    return int(min(PIECES * np.ceil(2.0 * problem.sample_time / problem.rotor_lag), MOST_PIECES))


def seen_channel(problem: VehicleProblem, channel: ChannelProblem, linear: Linear, slopes: tuple[float, ...]) -> Seen:
    """A channel with slopes k_1, k_2, k_3, at its samples."""
    step = sampled(problem, channel, linear, slopes)
    t = problem.sample_time
    pieces = pieces_of(problem)
    m, n = linear.g.size, step.a.shape[0]
    names = (*linear.signals, "u_av")
    rows = np.zeros((len(POINTS), len(names), n))
    direct = np.zeros((len(POINTS), len(names), 2 + len(linear.b)))
    within = np.zeros((len(POINTS), len(names)))
    forces = np.stack(list(linear.b.values()), axis=1)
    force = linear.b.get("force", np.zeros(m))
    for place, share in enumerate(POINTS):
        phi, gamma = flow(linear, share * t)
        inner = [flow(linear, share * t * part)[0] @ forces for part in np.linspace(0.0, 1.0, pieces + 1)]
        pushed = integral(linear, force, share * t)
        for row, (c, d) in enumerate(linear.signals.values()):
            by_command = c @ gamma + d
            rows[place, row, :m] = c @ phi
            rows[place, row] += by_command * step.acting
            direct[place, row, :2] = abs(by_command * step.direct) * np.array([1.0, t])
            direct[place, row, 2:] = share * t * trapezoid([np.abs(c @ columns) for columns in inner])
            within[place, row] = c @ pushed
        rows[place, -1] = step.u_av
        direct[place, -1, 1] = t
    columns = np.zeros((n, 2 + (pieces + 1) * forces.shape[1]))
    columns[:, 0] = step.u
    columns[:, 1] = step.q
    moved = [flow(linear, t * part / pieces)[0] @ forces for part in range(pieces + 1)]
    columns[:m, 2:] = np.concatenate(moved, axis=1)
    held = np.append(integral(linear, force, t), np.zeros(n - m))
    return Seen(step, names, rows.reshape(-1, n), direct, columns, pieces, held, within.ravel())


def over_sample(effects: np.ndarray, pieces: int, sample_time: float) -> np.ndarray:
    """Effects of omega_u, omega_q and each remainder over a whole sample, from those at its times, (..., inputs)."""
    times = effects[..., 2:].reshape(*effects.shape[:-1], pieces + 1, -1)
    integrals = sample_time * trapezoid([times[..., i, :] for i in range(pieces + 1)])
    return np.concatenate([effects[..., :2], integrals], axis=-1)


def channel_response(
    problem: VehicleProblem, channel: ChannelProblem, linear: Linear, slopes: tuple[float, ...]
) -> ChannelResponse | None:
    """Bounds of all signals for inputs of size 1; None if the sampled channel is not stable or too slow."""
    seen = seen_channel(problem, channel, linear, slopes)
    a, rows = seen.step.a, seen.rows
    if np.max(np.abs(np.linalg.eigvals(a))) >= 1.0:
        return None
    result = responses(a, rows, seen.columns, np.zeros((a.shape[0], 0)))
    if result is None:
        return None
    shape = (len(POINTS), len(seen.names))
    gains = over_sample(result.sums, seen.pieces, problem.sample_time).reshape(*shape, -1) + seen.direct
    constant = np.zeros(rows.shape[0])
    if problem.thrust_deviation and channel is problem.channels["z"]:
        constant = constant_response(a, rows, seen.held, seen.within)
    peaks = np.zeros((rows.shape[0], 3))
    if any(channel.initial):
        starts = start_columns(problem, channel, a.shape[0], slopes)
        peaks = np.stack([constant_peaks(a, rows, start, np.zeros(rows.shape[0])) for start in starts], axis=-1)
    return ChannelResponse(
        seen.names,
        tuple(linear.b),
        gains,
        constant.reshape(shape),
        peaks.reshape(*shape, 3),
    )


@dataclass(frozen=True)
class ChannelSeries:
    """Responses of a channel sample by sample; rows are points of a sample and signals.

    Args:
        effects: Magnitudes of what inputs of size 1 in one sample cause so many samples later, (samples, rows, inputs).
        constant: Response to a constant force 1 from t = 0 on, (samples, rows).
        starts: Responses to e, e' and q_(-1), (samples, rows, 3).
    """

    effects: np.ndarray
    constant: np.ndarray
    starts: np.ndarray


def channel_series(
    problem: VehicleProblem, channel: ChannelProblem, linear: Linear, slopes: tuple[float, ...], length: int
) -> ChannelSeries:
    """The responses over a number of samples; only the channel of z has a constant force."""
    seen = seen_channel(problem, channel, linear, slopes)
    a = seen.step.a
    n = a.shape[0]
    equilibrium = np.linalg.solve(np.eye(n) - a, seen.held)
    z = np.column_stack([seen.columns, -equilibrium, *start_columns(problem, channel, n, slopes)])
    inputs = seen.columns.shape[1]
    answers = np.zeros((length, seen.rows.shape[0], z.shape[1]))
    for k in range(length):
        answers[k] = seen.rows @ z
        z = a @ z
    effects = np.zeros((length, seen.rows.shape[0], 2 + len(linear.b)))
    effects[0] = seen.direct.reshape(seen.rows.shape[0], -1)
    effects[1:] = over_sample(np.abs(answers[:-1, :, :inputs]), seen.pieces, problem.sample_time)
    constant = answers[..., inputs] + seen.rows @ equilibrium + seen.within
    if channel is not problem.channels["z"]:
        constant = np.zeros(constant.shape)
    return ChannelSeries(effects, constant, answers[..., inputs + 1 :])


def trapezoid(values: list[np.ndarray]) -> np.ndarray:
    """The mean of equally spaced values by the trapezoidal rule."""
    return (0.5 * (values[0] + values[-1]) + sum(values[1:-1])) / (len(values) - 1)


def integral(linear: Linear, column: np.ndarray, time: float) -> np.ndarray:
    """What an input 1 through a column adds to chi within a time."""
    return flow(Linear(linear.f, column, linear.b, linear.signals), time)[1]


def start_columns(
    problem: VehicleProblem, channel: ChannelProblem, n: int, slopes: tuple[float, ...]
) -> list[np.ndarray]:
    """z_0 for e = 1, for e' = 1 and for q_(-1) = 1."""
    k_1, k_2, _ = slopes
    share = {"zero": 0.0, "matched": k_1, "midpoint": k_1 + 0.5 * problem.sample_time * k_2}[channel.start]
    unit = np.eye(n)
    return [unit[0] - share * channel.l0 * unit[n - 1], unit[1] - share * unit[n - 1], unit[n - 1]]


def constant_peaks(a: np.ndarray, rows: np.ndarray, z: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """The largest |offset + row A^k z| of each row."""
    peaks = np.abs(offset + rows @ z)
    first = np.max(np.abs(z), initial=1e-300)
    for _ in range(MOST_CONSTANT_SAMPLES):
        z = a @ z
        peaks = np.maximum(peaks, np.abs(offset + rows @ z))
        if np.max(np.abs(z)) < CONSTANT_SETTLED * first:
            break
    return peaks


def constant_response(a: np.ndarray, rows: np.ndarray, held: np.ndarray, within: np.ndarray) -> np.ndarray:
    """The largest response to a constant 1 from t = 0 on, of each row."""
    equilibrium = np.linalg.solve(np.eye(a.shape[0]) - a, held)
    return constant_peaks(a, rows, -equilibrium, rows @ equilibrium + within)
