"""The types of a vehicle's certificate; docs/vehicle_proofs.md says what the entries are."""

from collections.abc import Mapping, Sequence
from typing import TypedDict

from dssc_jax.proofs.verifier.certificate import Interval

CHANNELS = ("x", "z", "psi")
"""The channels; x stands for x and y, whose signals are vectors of the plane."""
Bounds = Mapping[str, Mapping[str, float]]
"""Bounds of the signals, by channel and name."""


class ChannelProblem(TypedDict):
    """The sampled controller of a channel, and its start."""

    l0: float
    functions: Mapping[str, float | str]
    rho: float
    nominal: tuple[float, float, bool] | None
    start: str
    initial: Sequence[float]


class VehicleProblem(TypedDict):
    """The vehicle, its inner loops and its wind; in SI units and radians.

    ``reference`` has amplitude, period and phase of the sine that each axis follows; null where it is at rest.
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
    """The linear channel: slopes k_1, k_2, k_3 of the functions, the share of omega_u in omega_q, c, lambda and P."""

    slopes: Sequence[float]
    share: float
    drag_damping: float
    rate: float
    p: Sequence[Sequence[float]]


class ChannelProof(MiddleProof):
    """The linear channel, and the bounds of the signals."""

    bounds: Mapping[str, float]


class CellsProof(TypedDict):
    """The samples c of a time cell, and the bounds of the signals in each of the J first cells."""

    samples: int
    bounds: Mapping[str, Mapping[str, Sequence[float]]]


class VehicleProof(TypedDict):
    """The proofs of the channels, whose bounds are those of the last cell; the time cells before it; other channels.

    ``settled`` has the linear channels for the upper limits; null means those of ``channels``.
    """

    channels: Mapping[str, ChannelProof]
    cells: CellsProof | None
    settled: Mapping[str, MiddleProof] | None


class VehicleCertificate(TypedDict):
    """A problem and its proof."""

    version: int
    kind: str
    problem: VehicleProblem
    proof: VehicleProof
