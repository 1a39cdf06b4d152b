"""The types of a vehicle's certificate; docs/vehicle_proofs.md says what the entries are."""

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
    """The linear channel of a proof.

    ``slopes`` are k_1, k_2 and k_3 of the lines in place of the functions, ``share`` is that of omega_u in omega_q,
    ``drag_damping`` is c [1/s], ``rate`` is lambda [1/s], and ``p`` is P of V = z'Pz.
    """

    slopes: Sequence[float]
    share: float
    drag_damping: float
    rate: float
    p: Sequence[Sequence[float]]


class ChannelProof(MiddleProof):
    """The linear channel of a proof, and bounds of its signals by name."""

    bounds: Mapping[str, float]


class CellsProof(TypedDict):
    """The time cells of a proof: ``samples`` of a cell, and bounds of the signals in each of the J first cells."""

    samples: int
    bounds: Mapping[str, Mapping[str, Sequence[float]]]


class VehicleProof(TypedDict):
    """The proof of a vehicle.

    The bounds of ``channels`` are those at all times or, with ``cells``, those of the last cell. ``settled`` has other
    linear channels for the upper limits as time grows; null: those of ``channels``.
    """

    channels: Mapping[str, ChannelProof]
    cells: CellsProof | None
    settled: Mapping[str, MiddleProof] | None


class VehicleCertificate(TypedDict):
    """The content of a certificate's file: a vehicle's problem and its proof."""

    version: int
    kind: str
    problem: VehicleProblem
    proof: VehicleProof
