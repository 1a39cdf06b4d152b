"""(V0) The form of a vehicle's certificate, which is checked before anything is computed.

Most functions take a value of the file that was not checked before, and raise ``Rejected`` if the value breaks a
rule. An argument ``place`` names the entry in the message, and ``name`` the channel.
"""

import math
from typing import Any, cast

from dssc_jax.proofs.verifier.balls import Rejected
from dssc_jax.proofs.verifier.vehicle.certificate import (
    CHANNELS,
    CellsProof,
    ChannelProblem,
    ChannelProof,
    MiddleProof,
    VehicleCertificate,
    VehicleProblem,
    VehicleProof,
)
from dssc_jax.proofs.verifier.vehicle.channels import channel_of, signal_names
from dssc_jax.proofs.verifier.vehicle.premises import with_premise
from dssc_jax.proofs.verifier.vehicle.rotors import LEAST_ROTORS
from dssc_jax.proofs.verifier.well_formed import (
    MOST_DELAY,
    STARTS,
    require_count,
    require_entries,
    require_finite,
    require_functions,
    require_interval,
    require_list,
    require_nominal,
    require_not_negative,
    require_numbers,
    require_positive,
    require_shape,
    require_sizes,
    require_symmetric,
)

KIND = "vehicle"
"""The entry ``kind`` of a vehicle's certificate."""
VERSION = 2
"""The entry ``version`` of a vehicle's certificate."""
MOST_SAMPLES = 2000
"""Largest number of samples of a time cell."""
MOST_TIME_CELLS = 400
"""Largest number of time cells before the last one."""
POSITIVE = (
    "sample_time",
    "velocity_gain",
    "stiffness",
    "damping",
    "yaw_gain",
    "believed_mass",
    "arm",
    "torque_coefficient",
    "thrust_coefficient",
    "rotor_limit",
)
"""Numbers of a problem that must be positive."""
NOT_NEGATIVE = ("yaw_integral_gain", "rotor_lag", "rotor_inertia", "propeller_drag")
"""Numbers of a problem that may be 0."""
REFERENCE_AXES = {"x", "y", "z", "psi"}
"""Axes that a moving reference has a sine for."""
NOT_COVERED = ("vgsta", "sta")
"""Functions that depend on e, or whose slope is infinite at 0."""


def require_certificate(content: object) -> VehicleCertificate:
    """Return the content of a file as a certificate if all of its parts have the right form; reject anything else."""
    try:
        certificate = require_entries(content, VehicleCertificate.__required_keys__, "the certificate")
        version = certificate["version"]
        require_shape(type(version) is int and version == VERSION, "version", f"is not {VERSION}")
        require_shape(certificate["kind"] == KIND, "kind", f"is not {KIND}")
        problem = require_problem(certificate["problem"])
        require_proof(problem, certificate["proof"])
    except Rejected as rejected:
        raise with_premise(rejected, "V0") from None
    return cast(VehicleCertificate, content)


def require_problem(content: object) -> VehicleProblem:
    """Return a table as the problem of a vehicle that the theorem covers; reject anything else."""
    problem: dict[str, Any] = require_entries(content, VehicleProblem.__required_keys__, "problem")
    for name in POSITIVE:
        require_positive(problem[name], name)
    for name in NOT_NEGATIVE:
        require_not_negative(problem[name], name)
    delay = require_finite(problem["delay"], "delay")
    require_shape(0 <= delay <= MOST_DELAY, "delay", f"is not within [0, {MOST_DELAY}]")
    rotors = require_finite(problem["rotors"], "rotors")
    is_even = rotors >= LEAST_ROTORS and rotors % 2 == 0
    require_shape(is_even, "rotors", f"is no even number of at least {LEAST_ROTORS}")
    for name in ("mass", "thrust", "turn"):
        require_positive_interval(problem[name], name)
    for interval in require_list(problem["inertia"], 3, "inertia"):
        require_positive_interval(interval, "inertia")
    for value in require_list(problem["believed_inertia"], 3, "believed_inertia"):
        require_positive(value, "believed_inertia")
    for name in ("structure_drag", "wind"):
        require_sizes(problem[name], 2, name)
    channels = require_entries(problem["channels"], set(CHANNELS), "channels")
    for name in CHANNELS:
        require_channel(channels[name], name)
    if problem["reference"] is not None:
        require_reference(problem["reference"])
        require_shape(problem["rotor_lag"] == 0, "rotor_lag", "is not 0, and the reference moves")
    return cast(VehicleProblem, content)


def require_reference(content: object) -> None:
    """Reject anything but amplitude, period and phase of a sine for every axis, with a positive period."""
    sines = require_entries(content, REFERENCE_AXES, "reference")
    for axis in REFERENCE_AXES:
        _, period, _ = require_numbers(sines[axis], 3, f"reference.{axis}")
        require_shape(period > 0, f"reference.{axis}", "has no positive period")


def require_positive_interval(content: object, place: str) -> None:
    """Reject anything but an interval of positive numbers."""
    low, _ = require_interval(content, place)
    require_shape(low > 0, place, "is not positive")


def require_channel(content: object, name: str) -> None:
    """Reject anything but the controller and the start of a channel.

    The functions of the controller must be covered: they depend on sigma alone, with a finite slope at 0.
    """
    channel: dict[str, Any] = require_entries(content, ChannelProblem.__required_keys__, f"channels.{name}")
    require_positive(channel["l0"], f"{name}.l0")
    require_positive(channel["rho"], f"{name}.rho")
    require_functions(channel["functions"], "conservative")
    is_covered = channel["functions"]["kind"] not in NOT_COVERED
    require_shape(is_covered, f"{name}.functions", "depend on e, which is not covered")
    require_nominal(channel["nominal"], f"{name}.nominal")
    require_shape(channel["start"] in STARTS, f"{name}.start", f"is none of {', '.join(STARTS)}")
    require_sizes(channel["initial"], 2, f"{name}.initial")


def require_proof(problem: VehicleProblem, content: object) -> None:
    """Reject anything but a proof whose channels, time cells and other channels for upper limits fit the problem."""
    proof = require_entries(content, VehicleProof.__required_keys__, "proof")
    channels = require_entries(proof["channels"], set(CHANNELS), "proof.channels")
    for name in CHANNELS:
        require_channel_proof(problem, name, channels[name])
    if proof["cells"] is not None:
        require_cells(problem, proof["cells"])
    if proof["settled"] is not None:
        require_shape(problem["reference"] is None, "settled", "has channels besides those of the nominal flight")
        settled = require_entries(proof["settled"], set(CHANNELS), "proof.settled")
        for name in CHANNELS:
            middle = require_entries(settled[name], MiddleProof.__required_keys__, f"settled {name}")
            require_linear_channel(problem, name, middle)


def require_cells(problem: VehicleProblem, content: object) -> None:
    """Reject anything but time cells with positive bounds of all signals, as many for each signal."""
    cells: dict[str, Any] = require_entries(content, CellsProof.__required_keys__, "cells")
    require_count(cells["samples"], MOST_SAMPLES, "cells.samples", f"is no integer from 1 to {MOST_SAMPLES}")
    channels = require_entries(cells["bounds"], set(CHANNELS), "cells.bounds")
    count = None  # of cells: any number for the first signal, then the same for all others
    for name in CHANNELS:
        names = signal_names(name, lagging=problem["rotor_lag"] > 0)
        for signal, values in require_entries(channels[name], names, f"cells.{name}").items():
            bounds = require_numbers(values, count, f"cells.{name}.{signal}")
            count = len(bounds)
            is_within = 1 <= count <= MOST_TIME_CELLS
            require_shape(is_within, f"cells.{name}.{signal}", f"has no items, or more than {MOST_TIME_CELLS}")
            require_shape(all(bound > 0 for bound in bounds), f"cells.{name}.{signal}", "is not positive")


def require_channel_proof(problem: VehicleProblem, name: str, content: object) -> None:
    """Check that a channel's proof gives an admissible linear channel and a positive bound for every signal.

    Args:
        problem: The problem, which tells the channel's signals.
        name: Name of the channel.
        content: The channel's part of the certificate, not yet checked.

    Raises:
        Rejected: An entry is missing, unknown or not admissible.
    """
    proof: dict[str, Any] = require_entries(content, ChannelProof.__required_keys__, f"proof of {name}")
    require_linear_channel(problem, name, proof)
    names = signal_names(name, lagging=problem["rotor_lag"] > 0)
    for signal, bound in require_entries(proof["bounds"], names, f"{name}.bounds").items():
        require_positive(bound, f"{name}.{signal}")


def require_linear_channel(problem: VehicleProblem, name: str, proof: dict[str, Any]) -> None:
    """Reject anything but slopes, share, damping, lambda and P of a linear channel, where P fits the state z.

    The channel psi must have no damping by drag.
    """
    require_numbers(proof["slopes"], 3, f"{name}.slopes")
    require_finite(proof["share"], f"{name}.share")
    require_not_negative(proof["drag_damping"], f"{name}.drag_damping")
    require_shape(name != "psi" or proof["drag_damping"] == 0, f"{name}.drag_damping", "is not 0")
    require_positive(proof["rate"], f"{name}.rate")
    chi = channel_of(problem, name, proof["drag_damping"]).order
    memories = math.ceil(problem["delay"])
    require_symmetric(proof["p"], chi + memories + 1, f"{name}.p")  # z has q besides
