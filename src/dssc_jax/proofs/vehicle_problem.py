"""The problem of a proof for the whole vehicle, in plain numbers; docs/vehicle_proofs.md states the theorem."""

import math
from dataclasses import asdict, dataclass

from dssc_jax.core.json_types import JsonObject
from dssc_jax.proofs.problem import Interval, NominalControl, delay_weights

CHANNELS = ("x", "z", "psi")
"""Channels with a controller; y has the controller of x."""
Sine = tuple[float, float, float]
"""Amplitude [m, rad], period [s] and phase [rad] of the sine amplitude sin(2 pi t/period + phase)."""


@dataclass(frozen=True)
class ChannelProblem:
    """The controller of a channel, and where the channel starts.

    Args:
        l0: Error pole [1/s].
        functions: Kind of the state-dependent functions, in the entry ``kind``, and their constants by name.
        rho: Bound of the switched control [m/s; rad/s in psi].
        nominal: The nominal control; None: there is none.
        start: Where the predictor starts: ``zero``, ``matched`` or ``midpoint``.
        initial: E_0 and V_0, bounds of |e| [m] and |e'| [m/s] at t = 0. In x they bound the norms of the plane's
            vectors. In psi they bound |e| [rad] and |psi'| [rad/s].
    """

    l0: float
    functions: JsonObject
    rho: float
    nominal: NominalControl | None
    start: str
    initial: tuple[float, float]


@dataclass(frozen=True)
class VehicleProblem:
    """A multirotor that hovers or flies the mission, with sampled controllers and intervals of its uncertain numbers.

    Args:
        sample_time: T_s [s].
        delay: Delay of the commands, in samples.
        velocity_gain: k_v of the velocity loops [1/s].
        stiffness: a_0 of the attitude loops [1/s^2].
        damping: a_1 of the attitude loops [1/s].
        yaw_gain: k_y of the yaw rate's loop [1/s].
        yaw_integral_gain: i_y of the yaw rate's loop [1/s^2].
        mass: Interval of the mass M [kg].
        believed_mass: M_n of the inner loops [kg].
        thrust: Interval of kappa = (M_n/M)(k_T/k_Tn).
        turn: Interval that holds nu_i = (k_T/k_Tn) J_n,i/J_i of every axis.
        inertia: Intervals of the diagonal of J [kg m^2].
        believed_inertia: Diagonal of J_n [kg m^2].
        rotors: Number of rotors n.
        arm: Radius L of the circle on which they are [m].
        torque_coefficient: c_tau, torque over thrust [m].
        thrust_coefficient: k_Tn that the inner loops believe [N s^2/rad^2].
        rotor_limit: Largest thrust of a rotor that the allocation commands [N].
        rotor_lag: Time constant tau of a rotor's speed [s]; 0: none.
        rotor_inertia: Axial inertia I_z of a rotor [kg m^2].
        structure_drag: Coefficients across and along body z [N s^2/m^2].
        propeller_drag: Coefficient of a propeller [N s^2/(m rad)].
        wind: Bounds of the horizontal wind's norm and of the vertical wind [m/s].
        channels: Controllers of ``x`` (and y), ``z`` and ``psi``.
        reference: Amplitude, period [s] and phase [rad] of the sine that each axis follows; None where all are at rest.
    """

    sample_time: float
    delay: float
    velocity_gain: float
    stiffness: float
    damping: float
    yaw_gain: float
    yaw_integral_gain: float
    mass: Interval
    believed_mass: float
    thrust: Interval
    turn: Interval
    inertia: tuple[Interval, Interval, Interval]
    believed_inertia: tuple[float, float, float]
    rotors: int
    arm: float
    torque_coefficient: float
    thrust_coefficient: float
    rotor_limit: float
    rotor_lag: float
    rotor_inertia: float
    structure_drag: tuple[float, float]
    propeller_drag: float
    wind: tuple[float, float]
    channels: dict[str, ChannelProblem]
    reference: dict[str, Sine] | None

    def to_dict(self) -> JsonObject:
        """The problem as a table of JSON's types, as a certificate holds it."""
        return asdict(self)

    @property
    def thrust_deviation(self) -> float:
        """k, the largest |kappa - 1| over the interval ``thrust``."""
        return max(abs(end - 1.0) for end in self.thrust)

    @property
    def turn_deviation(self) -> float:
        """delta, the largest |nu_i - 1| over the interval ``turn``."""
        return max(abs(end - 1.0) for end in self.turn)

    def first_sigma(self, name: str) -> float:
        """Sigma_0, a bound of |sigma| at t = 0 [m/s; rad/s in psi]: V_0 + l_0 E_0 and, in psi, |psi_m'(0)| besides.

        Args:
            name: Name of the channel.
        """
        channel = self.channels[name]
        e, e_dot = channel.initial
        if name == "psi" and self.reference is not None:  # the body does not turn, whereas its reference does
            amplitude, period, phase = self.reference["psi"]
            e_dot += abs(2.0 * math.pi * amplitude / period * math.cos(phase))
        return e_dot + channel.l0 * e

    @property
    def starts_away(self) -> bool:
        """Whether the vehicle's reference moves, or the vehicle may start away from its hovering point."""
        return self.reference is not None or any(any(channel.initial) for channel in self.channels.values())

    @property
    def delay_weights(self) -> tuple[float, ...]:
        """Weights of the commands of ages 0, 1, ... samples in the command that acts."""
        return delay_weights(self.delay)
