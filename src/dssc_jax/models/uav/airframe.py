"""Vehicles from PX4: the geometry (CA_) and mass properties (SIH_) of a parameter file as the table [plant.vehicle].

PX4's body axes point forward, right and down; here they point forward, left and up. A rotor at (CA_ROTORi_PX,
CA_ROTORi_PY) therefore sits at the angle atan2(-PY, PX). A positive CA_ROTORi_KM means a rotor that turns
counter-clockwise as seen from above, whose drag torque about the upward axis is negative: s_i = -sgn(KM).

Sources: PX4's parameter reference (control allocation; simulation in hardware) and its module simulator_sih.
"""

import math
import re
from collections.abc import Mapping
from typing import NamedTuple

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.uav.vehicle import ROUNDED_TO_ZERO

LINE = re.compile(
    r"^\s*(?:param\s+(?:set|set-default)\s+(?P<set>\w+)\s+(?P<to>\S+)"  # an airframe's start-up script
    r"|\d+\s+\d+\s+(?P<name>\w+)\s+(?P<value>\S+)\s+\d+\s*$)",  # a ground station's file: vehicle, component, .., type
    re.MULTILINE,
)
SIMILAR = 0.01  # relative difference of rotors that count as equal
MULTIROTOR = 0  # of CA_AIRFRAME
MOST_ROTORS = 12  # that PX4's control allocation takes
READ = ("CA_", "SIH_")
LARGEST_PARAMETER = 1e6
"""Of a parameter in PX4's units; no length, mass, thrust or inertia of a multirotor is larger."""
MOMENT_COEFFICIENT = 0.05
THRUST_COEFFICIENT = 6.5
AXIS = (0.0, 0.0, -1.0)
"""PX4's defaults of CA_ROTORi_KM, CA_ROTORi_CT and CA_ROTORi_AX, _AY, _AZ."""

PRODUCTS = ("SIH_IXY", "SIH_IXZ", "SIH_IYZ")
GIVEN_BY = {
    "mass": "SIH_MASS",
    "body_inertia": "SIH_IXX, SIH_IYY and SIH_IZZ",
    "max_thrust": "SIH_T_MAX",
    "motor_lag": "SIH_T_TAU",
}
"""Fields of the vehicle that a file may lack, and the parameters that give them."""


class Airframe(NamedTuple):
    """A vehicle as a study's table.

    Args:
        vehicle: The table ``[plant.vehicle]``.
        notes: What the file does not give, or gives in another form than the model has.
    """

    vehicle: TomlTable
    notes: tuple[str, ...]


def parameters_in(text: str) -> dict[str, float]:
    """The numeric parameters that an airframe's script or a ground station's file sets; the last setting counts.

    Raises:
        ConfigError: one of geometry or mass properties is not finite, or too large.
    """
    values: dict[str, float] = {}
    for line in LINE.finditer(text):
        name, value = (line["set"], line["to"]) if line["set"] else (line["name"], line["value"])
        try:
            values[name] = float(value)
        except ValueError:  # a variable of the shell
            values.pop(name, None)
    for name, value in values.items():
        if name.startswith(READ) and not abs(value) <= LARGEST_PARAMETER:
            raise ConfigError(name, f"must be a finite number of at most {LARGEST_PARAMETER:g}, got {value:g}")
    return values


def common(values: list[float], subject: str) -> float:
    """The mean of a number that all rotors have in common; raises ConfigError."""
    mean = sum(values) / len(values)
    if any(abs(value - mean) > SIMILAR * abs(mean) for value in values):
        listed = ", ".join(f"{value:g}" for value in values)
        raise ConfigError(
            subject, f"must be the same for all rotors, as the model has equal rotors on a circle; got {listed}"
        )
    return mean


def rotors_of(parameters: Mapping[str, float]) -> TomlTable:
    """Angles, spins, arm and torque over thrust from CA_ROTOR_COUNT and CA_ROTORi_; raises ConfigError."""
    count = parameters.get("CA_ROTOR_COUNT", 0.0)
    if count not in range(4, MOST_ROTORS + 1):
        raise ConfigError("CA_ROTOR_COUNT", f"must be a whole number from 4 to {MOST_ROTORS}, got {count:g}")
    if parameters.get("CA_AIRFRAME", MULTIROTOR) != MULTIROTOR:
        raise ConfigError("CA_AIRFRAME", f"must be 0, a multirotor, got {parameters['CA_AIRFRAME']:g}")
    places = []
    coefficients = []
    thrusts = []
    for i in range(int(count)):
        axis = tuple(parameters.get(f"CA_ROTOR{i}_A{c}", default) for c, default in zip("XYZ", AXIS, strict=True))
        if axis[:2] != (0.0, 0.0) or axis[2] >= 0.0:
            raise ConfigError(f"CA_ROTOR{i}_AX, _AY, _AZ", f"must point up, 0, 0, -1; got {axis}: a tilted rotor")
        places.append(tuple(parameters.get(f"CA_ROTOR{i}_P{c}", 0.0) for c in "XY"))
        coefficients.append(parameters.get(f"CA_ROTOR{i}_KM", MOMENT_COEFFICIENT))
        thrusts.append(parameters.get(f"CA_ROTOR{i}_CT", THRUST_COEFFICIENT))
    arm = common([math.hypot(x, y) for x, y in places], "CA_ROTORi_PX, CA_ROTORi_PY (distance from the centre)")
    if arm < ROUNDED_TO_ZERO:
        raise ConfigError("CA_ROTORi_PX, CA_ROTORi_PY", "must be given; all rotors are at the centre")
    torque = common([abs(coefficient) for coefficient in coefficients], "CA_ROTORi_KM")
    common(thrusts, "CA_ROTORi_CT")
    if all(coefficient > 0.0 for coefficient in coefficients) or all(coefficient < 0.0 for coefficient in coefficients):
        raise ConfigError("CA_ROTORi_KM", "must have both signs: rotors that all turn the same way cannot hold the yaw")
    return {
        "arm": arm,
        "torque_coefficient": torque,
        "rotor_angles": [math.atan2(-y, x) for x, y in places],
        "spins": [-math.copysign(1.0, coefficient) for coefficient in coefficients],
    }


def properties_of(parameters: Mapping[str, float]) -> TomlTable:
    """Mass, inertia, largest thrust and lag from SIH_, as far as they are given.

    The inertia is that of the whole vehicle, so the rotors' own is zero. PX4's lag is one of thrust; near hover, where
    thrust is linear in speed, the speed has the same.
    """
    properties: TomlTable = {}
    if "SIH_MASS" in parameters:
        properties["mass"] = parameters["SIH_MASS"]
    inertia = [parameters[name] for name in ("SIH_IXX", "SIH_IYY", "SIH_IZZ") if name in parameters]
    if len(inertia) == 3:
        properties |= {"body_inertia": inertia, "rotor_inertia_xy": 0.0, "rotor_inertia_z": 0.0}
    if "SIH_T_MAX" in parameters:
        properties["max_thrust"] = parameters["SIH_T_MAX"]
        if "SIH_Q_MAX" in parameters:  # the simulated plant; CA_ROTORi_KM is what the allocation believes
            properties["torque_coefficient"] = parameters["SIH_Q_MAX"] / parameters["SIH_T_MAX"]
    if "SIH_T_TAU" in parameters:
        properties["motor_lag"] = parameters["SIH_T_TAU"]
    return properties


def read_airframe(text: str, base: str = "m600_quadrotor") -> Airframe:
    """The vehicle of a PX4 airframe script, or of a parameter file saved by a ground station.

    Args:
        text: The file's text.
        base: The vehicle whose numbers hold where the file gives none.

    Raises:
        ConfigError: the file does not describe a multirotor with equal, upright rotors on a circle.
    """
    parameters = parameters_in(text)
    if not any(name.startswith("CA_") for name in parameters):
        raise ConfigError("", "sets no parameter CA_..; a PX4 airframe or parameter file is needed")
    vehicle: TomlTable = {"kind": base} | rotors_of(parameters)
    relative = vehicle["arm"] >= 0.99 and all(
        parameters.get(f"CA_ROTOR{i}_P{c}", 0.0) in (-1.0, -0.866, -0.5, 0.0, 0.5, 0.866, 1.0)
        for i in range(len(vehicle["spins"]))
        for c in "XY"
    )
    vehicle |= properties_of(parameters)
    notes = [f"{field} is the base vehicle's: the file does not set {name}"
             for field, name in GIVEN_BY.items() if field not in vehicle]  # fmt: skip
    notes.append("thrust_coefficient is the base vehicle's: PX4 knows no rotor speed in rad/s")
    notes.append("structure_drag and propeller_drag are the base vehicle's: PX4's drag is linear in speed")
    if relative:
        notes.append("arm may be a ratio: the rotors' positions look like those of a generic airframe, not metres")
    if any(parameters.get(name, 0.0) for name in PRODUCTS):
        notes.append(f"{', '.join(PRODUCTS)} are left out: the model's axes are principal axes")
    return Airframe(vehicle, tuple(notes))
