"""The types of a vehicle's certificate; docs/vehicle_proofs.md describes the entries."""

from collections.abc import Mapping, Sequence
from typing import TypedDict

from dssc_jax.proofs.verifier.certificate import Interval

CHANNELS = ("x", "z", "psi")
"""The channels; x stands for x and y, whose signals are vectors of the plane."""
Bounds = Mapping[str, Mapping[str, float]]
"""Bounds of the signals, by channel and name."""


class ChannelProblem(TypedDict):
    """The controller and the start of a channel.

    :class:`dssc_jax.proofs.vehicle_problem.ChannelProblem` documents the entries.
    """

    l0: float
    functions: Mapping[str, float | str]
    rho: float
    nominal: tuple[float, float, bool] | None
    start: str
    initial: Sequence[float]


class VehicleProblem(TypedDict):
    """The vehicle, its inner loops and its wind, in SI units and radians.

    :class:`dssc_jax.proofs.vehicle_problem.VehicleProblem` documents the entries.
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
    inertia: Sequence[Interval]
    believed_inertia: Sequence[float]
    rotors: int
    arm: float
    torque_coefficient: float
    thrust_coefficient: float
    rotor_limit: float
    rotor_lag: float
    rotor_inertia: float
    structure_drag: Sequence[float]
    propeller_drag: float
    wind: Sequence[float]
    channels: Mapping[str, ChannelProblem]
    reference: Mapping[str, Sequence[float]] | None


class MiddleProof(TypedDict):
    """The linear channel of a proof, with straight lines in place of the controller's functions."""

    slopes: Sequence[float]  # k_1, k_2 and k_3 of the straight lines in place of phi_1, phi_2 and phi_3
    share: float  # s_q, the share of omega_u in omega_q
    drag_damping: float  # c [1/s]
    rate: float  # lambda [1/s], with which V = z'Pz falls
    p: Sequence[Sequence[float]]  # P, by rows


class ChannelProof(MiddleProof):
    """The linear channel of a proof, and bounds of its signals."""

    bounds: Mapping[str, float]  # Y of each signal at all times or, with time cells, in the last cell


class CellsProof(TypedDict):
    """The time cells of a proof before the last one, with bounds of the signals in each."""

    samples: int  # c, number of samples of a cell
    bounds: Mapping[str, Mapping[str, Sequence[float]]]  # Y_0 to Y_(J-1), by channel and signal


class VehicleProof(TypedDict):
    """The proof of a vehicle."""

    channels: Mapping[str, ChannelProof]
    cells: CellsProof | None  # null: one bound of each signal for all times
    settled: Mapping[str, MiddleProof] | None  # other linear channels for the upper limits; null: the same


class VehicleCertificate(TypedDict):
    """The content of a certificate's file: a vehicle's problem and its proof."""

    version: int
    kind: str
    problem: VehicleProblem
    proof: VehicleProof
