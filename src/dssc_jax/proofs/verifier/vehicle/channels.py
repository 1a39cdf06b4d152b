"""The linear channels of a vehicle: between the samples, and at the samples with the controller, in balls.

Near hover the vehicle behaves like three independent linear channels, x (and y), z and psi; the remainders r_j are the
differences from them. Between the samples chi' = A_c chi + B_c U + sum of b_j r_j, with the acting command U. Each
signal is a row over (chi, U). At the samples the state is z = (chi, u_(k-1), ..., u_(k-D), q_(k-1)).
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import identity, maximum, side_by_side, stack, total, unit_rows
from dssc_jax.proofs.verifier.held_plant import delay_weights
from dssc_jax.proofs.verifier.vehicle.certificate import ChannelProblem, MiddleProof, VehicleProblem

EQUIVALENT = "u_av"
"""q_k + k_1 sigma_k, the signal that exists at the samples only."""
ALONG_AXES = {"e", "e_dot", "sigma", "bend", EQUIVALENT}
"""The signals of the plane that are bounded along each axis; the others are norms of vectors."""
SignalBalls = Mapping[str, Mapping[str, arb]]
"""Bounds of the signals, by channel and name."""
Rows = dict[str, arb_mat]
"""Rows by the name of their signal."""


class Channel(NamedTuple):
    """A linear channel chi' = A_c chi + B_c U + sum of b_j r_j with signals C chi + d U.

    Args:
        generator: [A_c, B_c], shape (n, n + 1).
        inputs: Columns b_j of the remainders, by name, shape (n, 1) each.
        signals: Rows [C, d] of the signals without u_av, by name, shape (1, n + 1) each.
        constant: Column of the constant force o, shape (n, 1); None: the channel has none.
    """

    generator: arb_mat
    inputs: dict[str, arb_mat]
    signals: Rows
    constant: arb_mat | None = None

    @property
    def order(self) -> int:
        """Number n of the states chi."""
        return self.generator.nrows()

    @property
    def dynamics(self) -> arb_mat:
        """A_c, shape (n, n)."""
        return first_columns(self.generator, self.order)


class SampledChannel(NamedTuple):
    """A channel with its controller at the samples, z+ = A z + b_u omega_u + b_q omega_r.

    omega_u and omega_q are the deviations of the functions from straight lines, in the command and in the sum q. They
    are related by omega_q = s_q omega_u + omega_r.

    Args:
        a: A, shape (m, m).
        by_command: b_u, which includes s_q b_q, shape (m, 1).
        by_integral: b_q, shape (m, 1).
        acting: The acting command U as a row over z, without the omegas of the same sample, shape (1, m).
        fresh: Share of this sample's command u_k in U; 1 without a delay.
        equivalent: u_av as a row over z, without omega_q of the same sample, shape (1, m).
        sigma: sigma as a row over z, shape (1, m).
    """

    a: arb_mat
    by_command: arb_mat
    by_integral: arb_mat
    acting: arb_mat
    fresh: arb
    equivalent: arb_mat
    sigma: arb_mat


def signal_names(name: str, *, lagging: bool) -> set[str]:
    """Names of the signals of a channel.

    Args:
        name: Name of the channel, ``x``, ``z`` or ``psi``.
        lagging: Whether the rotors have a lag, which adds signals.
    """
    names = {"e", "e_dot", "sigma", "wanted", "bend", EQUIVALENT}
    match name:
        case "x":
            names |= {"speed", "alpha", "alpha_dot", "turn", "acceleration"}
            lag_signals = {"gamma", "behind"}
        case "z":
            names |= {"acceleration"}
            lag_signals = {"lift", "behind"}
        case _:
            names |= {"follow"}
            lag_signals = {"gamma", "behind"}
    return names | lag_signals if lagging else names


def size_over_axes(signal: str, axes: Sequence[arb]) -> arb:
    """A bound of a signal from bounds along each axis: their maximum, or their norm if the signal is a vector.

    Args:
        signal: Name of the signal; those in :data:`ALONG_AXES` are no vectors.
        axes: Bounds along the axes of the channel; none gives 0.
    """
    if not axes:
        return arb(0)
    if len(axes) == 1 or signal in ALONG_AXES:
        return maximum(*axes)
    return total([size * size for size in axes]).sqrt().upper()


def channel_of(problem: VehicleProblem, name: str, damping: float) -> Channel:
    """Build one of the three linear channels.

    Args:
        problem: The certificate's problem.
        name: Name of the channel: ``x``, ``z`` or ``psi``.
        damping: c, the damping by drag [1/s]; the channel psi has none.

    Raises:
        ValueError: There is no channel of that name.
    """
    l0 = arb(problem["channels"][name]["l0"])
    match name:
        case "x":
            return plane_channel(problem, l0, arb(damping))
        case "z":
            return vertical_channel(problem, l0, arb(damping))
        case "psi":
            return yaw_channel(problem, l0)
        case _:
            raise ValueError(f"a vehicle has no channel {name!r}")


def plane_channel(problem: VehicleProblem, l0: arb, damping: arb) -> Channel:
    """The channel of x and y: e'' = alpha - c e' + r_force and alpha'' = m + r_torque, where alpha is g times the tilt.

    m = a_0 (a_h - alpha) - a_1 alpha' with the wanted acceleration a_h, and chi = (e, e', alpha, alpha'). A rotor lag
    adds the state gamma, with alpha'' = gamma + r_torque and gamma' = (m - gamma)/tau + r_lag.

    Args:
        problem: The certificate's problem.
        l0: Error pole [1/s].
        damping: c, the damping of drag [1/s].
    """
    lag = rotor_rate(problem)
    e, e_dot, alpha, alpha_dot, *lag_states, command = unit_rows(5 if lag is None else 6)
    demand = (command - e_dot) * arb(problem["velocity_gain"])  # a_h = k_v (U - e')
    turn = (demand - alpha) * arb(problem["stiffness"]) - alpha_dot * arb(problem["damping"])  # m
    acceleration = alpha - e_dot * damping
    signals = kinematics(e, e_dot, l0) | {"bend": acceleration + e_dot * l0, "speed": e_dot}
    signals |= {"alpha": alpha, "alpha_dot": alpha_dot, "wanted": demand, "turn": turn, "acceleration": acceleration}
    if lag is None:
        return Channel(stack([e_dot, acceleration, alpha_dot, turn]), input_columns(4, force=1, torque=3), signals)
    gamma = lag_states[0]  # the only one
    signals |= {"gamma": gamma, "behind": turn - gamma}
    slopes = [e_dot, acceleration, alpha_dot, gamma, (turn - gamma) * lag]
    return Channel(stack(slopes), input_columns(5, force=1, torque=3, lag=4), signals)


def vertical_channel(problem: VehicleProblem, l0: arb, damping: arb) -> Channel:
    """The channel of z: e'' = a_z - c e' + o + r_force with the wanted acceleration a_z; chi = (e, e').

    A rotor lag adds the state q, the lift that the rotors achieve, with e'' = q - c e' + o + r_force and q' = (a_z -
    q)/tau + r_lag. The constant o enters where r_force does.

    Args:
        problem: The certificate's problem.
        l0: Error pole [1/s].
        damping: c, the damping of drag [1/s].
    """
    lag = rotor_rate(problem)
    e, e_dot, *lag_states, command = unit_rows(3 if lag is None else 4)
    demand = (command - e_dot) * arb(problem["velocity_gain"])  # a_z = k_v (U - e')
    lift = demand if lag is None else lag_states[0]
    acceleration = lift - e_dot * damping
    signals = kinematics(e, e_dot, l0) | {"wanted": demand}
    signals |= {"acceleration": acceleration, "bend": acceleration + e_dot * l0}
    if lag is None:
        inputs = input_columns(2, force=1)
        return Channel(stack([e_dot, acceleration]), inputs, signals, inputs["force"])
    signals |= {"lift": lift, "behind": demand - lift}
    inputs = input_columns(3, force=1, lag=2)
    return Channel(stack([e_dot, acceleration, (demand - lift) * lag]), inputs, signals, inputs["force"])


def yaw_channel(problem: VehicleProblem, l0: arb) -> Channel:
    """The channel of psi: psi'' = eta_psi + r_torque with eta_psi = k_y (U - psi') + i_y I and I' = U - psi'.

    chi = (e, psi', I). A rotor lag adds the state gamma_psi, with psi'' = gamma_psi + r_torque and gamma_psi' =
    (eta_psi - gamma_psi)/tau + r_lag.

    Args:
        problem: The certificate's problem.
        l0: Error pole [1/s].
    """
    lag = rotor_rate(problem)
    e, e_dot, integral, *lag_states, command = unit_rows(4 if lag is None else 5)
    follow = command - e_dot
    demand = follow * arb(problem["yaw_gain"]) + integral * arb(problem["yaw_integral_gain"])  # eta_psi
    gamma = demand if lag is None else lag_states[0]
    signals = kinematics(e, e_dot, l0) | {"wanted": demand, "follow": follow, "bend": gamma + e_dot * l0}
    if lag is None:
        return Channel(stack([e_dot, demand, follow]), input_columns(3, torque=1), signals)
    signals |= {"gamma": gamma, "behind": demand - gamma}
    slopes = [e_dot, gamma, follow, (demand - gamma) * lag]
    return Channel(stack(slopes), input_columns(4, torque=1, lag=3), signals)


def rotor_rate(problem: VehicleProblem) -> arb | None:
    """1/tau, the inverse of the rotors' time constant [1/s]; None without a lag."""
    return 1 / arb(problem["rotor_lag"]) if problem["rotor_lag"] > 0 else None


def kinematics(e: arb_mat, e_dot: arb_mat, l0: arb) -> Rows:
    """The rows of e, e' and sigma = e' + l_0 e, the signals that the controller measures, by name.

    Args:
        e: Row of e.
        e_dot: Row of e'.
        l0: Error pole l_0 [1/s].
    """
    return {"e": e, "e_dot": e_dot, "sigma": e_dot + e * l0}


def input_columns(order: int, **places: int) -> dict[str, arb_mat]:
    """The columns b_j of the remainders, each a unit column, by name, shape (order, 1) each.

    Args:
        order: Number of states chi.
        places: For each remainder, by name, the place of the state to whose derivative the remainder adds.
    """
    units = identity(order).tolist()
    return {name: arb_mat([units[place]]).transpose() for name, place in places.items()}


def flow(channel: Channel, time: arb) -> arb_mat:
    """exp([[A_c, B_c], [0, 0]] time), which moves (chi, U) on by a time [s] while U is held; shape (n + 1, n + 1)."""
    n = channel.order
    return (stack([channel.generator, arb_mat(1, n + 1)]) * time).exp()


def forced_response(channel: Channel, column: arb_mat, time: arb) -> arb_mat:
    """The part of chi that a constant input 1 through a column b causes within a time [s], shape (n, 1).

    It is the integral of e^(A_c r) b over r from 0 to the time, which is the last column of exp([[A_c, b], [0, 0]]
    time).

    Args:
        channel: The linear channel.
        column: b, shape (n, 1).
        time: The time [s].
    """
    n = channel.order
    driven = channel._replace(generator=side_by_side(channel.dynamics, column))  # b in place of B_c
    exponential = flow(driven, time)
    return arb_mat([[exponential[i, n]] for i in range(n)])


def sampled_channel(
    channel: Channel, controller: ChannelProblem, proof: MiddleProof, sample_time: float, delay: float
) -> SampledChannel:
    """A channel at its samples, with straight lines in place of the controller's functions.

    In sliding q_k = q_(k-1) + T_s (k_2 sigma + omega_q) and u_k = -(k_1 + k_3) sigma - q_k - omega_u, less the nominal
    control's feedback.

    Args:
        channel: The linear channel.
        controller: The channel's controller, of which only l_0 and the nominal control are used.
        proof: The channel's proof, with the slopes of the lines and the share s_q.
        sample_time: T_s [s].
        delay: Delay of the commands [samples], a real number.
    """
    n = channel.order
    memories = math.ceil(delay)  # D, the number of earlier commands in z
    m = n + memories + 1
    t = arb(sample_time)
    *units, integral = unit_rows(m)
    e = units[0]
    sigma = with_zeros(channel.signals["sigma"], n, m)
    k_1, k_2, k_3 = map(arb, proof["slopes"])
    next_integral = integral + sigma * (t * k_2)  # q_k
    equivalent = next_integral + sigma * k_1  # u_av
    command = -equivalent - sigma * k_3
    if controller["nominal"] is not None:
        a_n, k_n, _ = controller["nominal"]
        l0 = arb(controller["l0"])
        lead = arb(a_n) - l0
        command = command - (e * (lead * l0) - sigma * lead) * (1 / arb(k_n))
    fresh, *weights = delay_weights(delay)
    acting = command * fresh
    for unit, weight in zip(units[n:], weights, strict=True):
        acting = acting + unit * weight
    transition = flow(channel, t)
    phi = first_columns(transition, n).tolist()[:n]
    free = arb_mat([[*row, *[arb(0)] * (m - n)] for row in phi])
    held_command = arb_mat([[transition[i, n]] for i in range(n)])
    memory_rows = [command, *units[n : m - 2]] if memories else []  # the earlier commands move on by one place
    a = stack([free + held_command * acting, *memory_rows, next_integral])
    by_omega_u = [-fresh * entry for (entry,) in held_command.tolist()] + [arb(0)] * memories
    if memories:
        by_omega_u[n] = arb(-1)
    # omega_q adds T_s omega_q to q, and q is subtracted from the command
    by_omega_q = arb_mat([[t * entry] for entry in [*by_omega_u, arb(1)]])
    return SampledChannel(
        a=a,
        by_command=arb_mat([[entry] for entry in [*by_omega_u, arb(0)]]) + by_omega_q * arb(proof["share"]),
        by_integral=by_omega_q,
        acting=acting,
        fresh=fresh,
        equivalent=equivalent,
        sigma=sigma,
    )


def first_columns(matrix: arb_mat, count: int) -> arb_mat:
    """The first ``count`` columns of a matrix."""
    return arb_mat([row[:count] for row in matrix.tolist()])


def with_zeros(row: arb_mat, n: int, m: int) -> arb_mat:
    """Extend the first n entries of a row, those of chi, by zeros to a row over z, shape (1, m)."""
    return arb_mat([[*row.tolist()[0][:n], *[arb(0)] * (m - n)]])


class SignalWithin(NamedTuple):
    """A signal at one time within a sample.

    Args:
        row: The signal as a row over the state z_k at the sample, shape (1, m).
        by_fresh: Factor with which this sample's command u_k enters the signal.
    """

    row: arb_mat
    by_fresh: arb


def signal_within(channel: Channel, sampled: SampledChannel, signal: str, transition: arb_mat) -> SignalWithin:
    """A signal at a time within a sample.

    Args:
        channel: The linear channel.
        sampled: The channel at its samples.
        signal: Name of the signal, not u_av.
        transition: :func:`flow` over the time since the sample.
    """
    n = channel.order
    row = channel.signals[signal] * transition
    by_command = row[0, n]
    return SignalWithin(
        row=with_zeros(row, n, sampled.a.nrows()) + sampled.acting * by_command,
        by_fresh=by_command * sampled.fresh,
    )
