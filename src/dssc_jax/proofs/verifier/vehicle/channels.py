"""The linear channels of the vehicle, and each as a sampled loop: exact numbers in, balls out.

Between the samples chi' = A_c chi + B_c U + sum of b_j r_j. A row over (chi, U) stands for each signal. The samples
have z = (chi, u_(k-1), ..., u_(k-D), q_(k-1)).
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import identity, stack, unit_rows
from dssc_jax.proofs.verifier.held_plant import delay_weights
from dssc_jax.proofs.verifier.vehicle.certificate import ChannelProblem, MiddleProof, VehicleProblem

EQUIVALENT = "u_av"
"""The signal that exists at the samples only."""
ALONG_AXES = {"e", "e_dot", "sigma", "bend", EQUIVALENT}
"""The signals of the plane that are bounded along each axis; the others are norms of vectors."""
SignalBalls = Mapping[str, Mapping[str, arb]]
"""Bounds of the signals, by channel and name."""
Rows = dict[str, arb_mat]
"""Rows by the name of their signal."""


class Channel(NamedTuple):
    """A linear channel chi' = A_c chi + B_c U + sum of b_j r_j with signals C chi + d U.

    Args:
        generator: [A_c, B_c], (n, n + 1).
        inputs: Columns b_j of the remainders, by name, (n, 1) each.
        signals: Rows [C, d] of the signals without u_av, by name, (1, n + 1) each.
        constant: Column of the constant force o, (n, 1); None: the channel has none.
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
        """A_c, (n, n)."""
        return first_columns(self.generator, self.order)


class SampledChannel(NamedTuple):
    """A channel at its samples, z+ = A z + b_u omega_u + b_q omega_r.

    omega_u and omega_r are what the functions deviate by from straight lines: in the command, and in the sum q.

    Args:
        a: A, (m, m).
        by_command: b_u, the column of omega_u with its share of omega_q, (m, 1).
        by_integral: b_q, the column of omega_r, (m, 1).
        acting: Row of the acting command U, (1, m), without the omegas of the same sample.
        fresh: Share of this sample's command u_k in U; less than 1 with a delay.
        equivalent: Row of u_av, (1, m), without omega_q of the same sample.
        sigma: Row of sigma, (1, m).
    """

    a: arb_mat
    by_command: arb_mat
    by_integral: arb_mat
    acting: arb_mat
    fresh: arb
    equivalent: arb_mat
    sigma: arb_mat


def signal_names(name: str, *, lagging: bool) -> set[str]:
    """Names of the signals of a channel; ``lagging`` tells whether the rotors have a lag."""
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


def channel_of(problem: VehicleProblem, name: str, damping: float) -> Channel:
    """The linear channel of this name, with the damping of drag c [1/s]."""
    l0 = arb(problem["channels"][name]["l0"])
    match name:
        case "x":
            return plane_channel(problem, l0, arb(damping))
        case "z":
            return vertical_channel(problem, l0, arb(damping))
        case _:
            return yaw_channel(problem, l0)


def plane_channel(problem: VehicleProblem, l0: arb, damping: arb) -> Channel:
    """The linear channel of x and y: chi = (e, e', alpha, alpha'), with a rotor lag also gamma."""
    lag = rotor_rate(problem)
    e, e_dot, alpha, alpha_dot, *lag_states, command = unit_rows(5 if lag is None else 6)
    demand = (command - e_dot) * arb(problem["velocity_gain"])
    turn = (demand - alpha) * arb(problem["stiffness"]) - alpha_dot * arb(problem["damping"])
    acceleration = alpha - e_dot * damping
    signals = kinematics(e, e_dot, l0) | {"bend": acceleration + e_dot * l0, "speed": e_dot}
    signals |= {"alpha": alpha, "alpha_dot": alpha_dot, "wanted": demand, "turn": turn, "acceleration": acceleration}
    if lag is None:
        return Channel(stack([e_dot, acceleration, alpha_dot, turn]), input_columns(4, force=1, torque=3), signals)
    (gamma,) = lag_states
    signals |= {"gamma": gamma, "behind": turn - gamma}
    slopes = [e_dot, acceleration, alpha_dot, gamma, (turn - gamma) * lag]
    return Channel(stack(slopes), input_columns(5, force=1, torque=3, lag=4), signals)


def vertical_channel(problem: VehicleProblem, l0: arb, damping: arb) -> Channel:
    """The linear channel of z: chi = (e, e'), with a rotor lag also the lift; the constant o acts like a force."""
    lag = rotor_rate(problem)
    e, e_dot, *lag_states, command = unit_rows(3 if lag is None else 4)
    demand = (command - e_dot) * arb(problem["velocity_gain"])
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
    """The linear channel of psi: chi = (e, psi', integral of U - psi'), with a rotor lag also gamma."""
    lag = rotor_rate(problem)
    e, e_dot, integral, *lag_states, command = unit_rows(4 if lag is None else 5)
    follow = command - e_dot
    demand = follow * arb(problem["yaw_gain"]) + integral * arb(problem["yaw_integral_gain"])
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
    """The rows of e, e' and sigma, which the controller measures."""
    return {"e": e, "e_dot": e_dot, "sigma": e_dot + e * l0}


def input_columns(order: int, **places: int) -> dict[str, arb_mat]:
    """The unit columns of the remainders, (order, 1) each; ``places`` names the state in whose slope each acts."""
    units = identity(order).tolist()
    return {name: arb_mat([units[place]]).transpose() for name, place in places.items()}


def flow(channel: Channel, time: arb) -> arb_mat:
    """exp([[A_c, B_c], [0, 0]] time): what state and held command become within a time [s], (n + 1, n + 1)."""
    n = channel.order
    return (stack([channel.generator, arb_mat(1, n + 1)]) * time).exp()


def forced_response(channel: Channel, column: arb_mat, time: arb) -> arb_mat:
    """The integral of e^(A_c r) b for r from 0 to a time, (n, 1): the last column of exp([[A_c, b], [0, 0]] time)."""
    n = channel.order
    a = channel.generator.tolist()
    b = column.tolist()
    rows = [[*a[i][:n], b[i][0]] for i in range(n)]
    rows.append([arb(0)] * (n + 1))
    exponential = (arb_mat(rows) * time).exp().tolist()
    return arb_mat([[exponential[i][n]] for i in range(n)])


def sampled_channel(
    channel: Channel, controller: ChannelProblem, proof: MiddleProof, sample_time: float, delay: float
) -> SampledChannel:
    """A channel at its samples, with straight lines in place of the controller's functions.

    Args:
        channel: The linear channel.
        controller: Its controller, of which l_0 and the nominal control matter.
        proof: Its proof, with the slopes of the lines.
        sample_time: T_s [s].
        delay: Delay of the commands [samples], a real number.
    """
    n = channel.order
    memories = math.ceil(delay)
    m = n + memories + 1
    t = arb(sample_time)
    *units, integral = unit_rows(m)
    sigma = with_zeros(channel.signals["sigma"], n, m)
    e = units[0]
    slope_1, slope_2, slope_n = map(arb, proof["slopes"])
    next_integral = integral + sigma * (t * slope_2)
    equivalent = next_integral + sigma * slope_1
    command = -equivalent - sigma * slope_n
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
    by_command_held = arb_mat([[row[n]] for row in transition.tolist()[:n]])
    free = arb_mat([[*row[:n], *[arb(0)] * (m - n)] for row in transition.tolist()[:n]])
    memory_rows = [command, *units[n : m - 2]] if memories else []
    a = stack([free + by_command_held * acting, *memory_rows, next_integral])
    by_command = [-fresh * row[0] for row in by_command_held.tolist()]
    remainder = [arb(0)] * memories
    if memories:
        remainder[0] = arb(-1)
    by_integral = arb_mat([[t * x] for x in [*by_command, *remainder, arb(1)]])
    return SampledChannel(
        a=a,
        by_command=arb_mat([[x] for x in [*by_command, *remainder, arb(0)]]) + by_integral * arb(proof["share"]),
        by_integral=by_integral,
        acting=acting,
        fresh=fresh,
        equivalent=equivalent,
        sigma=sigma,
    )


def first_columns(matrix: arb_mat, count: int) -> arb_mat:
    """The first columns of a matrix."""
    return arb_mat([row[:count] for row in matrix.tolist()])


def with_zeros(row: arb_mat, n: int, m: int) -> arb_mat:
    """The first n entries of a row, those of chi, extended by zeros to a row over z, (1, m)."""
    return arb_mat([[*row.tolist()[0][:n], *[arb(0)] * (m - n)]])


def row_at(channel: Channel, sampled: SampledChannel, signal: str, transition: arb_mat) -> tuple[arb_mat, arb]:
    """A signal within a sample: its row over z_k, (1, m), and its factor of the same sample's command deviation.

    Args:
        channel: The linear channel.
        sampled: The channel at its samples.
        signal: Name of the signal, not u_av.
        transition: :func:`flow` over the time since the sample.
    """
    n = channel.order
    row = channel.signals[signal] * transition
    by_command = row[0, n]
    return with_zeros(row, n, sampled.a.nrows()) + sampled.acting * by_command, by_command * sampled.fresh
