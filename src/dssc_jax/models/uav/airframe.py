"""Vehicles from PX4: geometry (CA_), mass properties (SIH_), gains (MC_, MPC_) of a parameter file as table [plant].

PX4's body axes point forward, right and down; here they point forward, left and up. A rotor at (CA_ROTORi_PX,
CA_ROTORi_PY) therefore sits at the angle atan2(-PY, PX). A positive CA_ROTORi_KM means a rotor that turns
counter-clockwise as seen from above, whose drag torque about the upward axis is negative: s_i = -sgn(KM).

Sources: PX4's parameter reference (control allocation; simulation in hardware; multicopter attitude and position
control), its module simulator_sih and its class ActuatorEffectivenessRotors.
"""

import math
import re
from collections.abc import Mapping
from typing import NamedTuple

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.uav.airframe_rotors import (
    PlacedRotor,
    are_ratios,
    flying_vehicle,
    geometry_of,
    in_metres,
    placed_rotors,
)
from dssc_jax.models.uav.desaturation import Desaturation
from dssc_jax.models.uav.inner_loops.px4_parameters import GAIN_PARAMETERS, gains_from
from dssc_jax.models.uav.plausibility import implausible
from dssc_jax.models.uav.vehicle import GRAVITY

LINE = re.compile(
    r"[ \t]*(?:param[ \t]+(?:set|set-default)[ \t]+(?P<set>\w+)[ \t]*(?P<to>[^\s#]*)"  # an airframe's start-up script
    r"|\d+\s+\d+\s+(?P<name>\w+)\s+(?P<value>\S+)\s+\d+\s*$)",  # a ground station's file: vehicle, component, .., type
)
GAIN = re.compile(r"M(?:P?)C_\w+_(?:P|I|D|FF|K)(?:_ACC)?")
READ = ("CA_", "SIH_", "MC_", "MPC_", "IMU_GYRO_", "IMU_DGYRO_", "THR_MDL_FAC")
LARGEST_PARAMETER = 1e6
"""Largest size of a parameter in PX4's units; no length, mass, thrust or inertia of a multirotor is larger."""
PRODUCTS = ("SIH_IXY", "SIH_IXZ", "SIH_IYZ")
INERTIA = ("SIH_IXX", "SIH_IYY", "SIH_IZZ")
SIMULATED: dict[str, float] = {
    "SIH_MASS": 1.0,
    "SIH_IXX": 0.025,
    "SIH_IYY": 0.025,
    "SIH_IZZ": 0.030,
    "SIH_T_MAX": 5.0,
    "SIH_Q_MAX": 0.1,
    "SIH_T_TAU": 0.05,
    "SIH_L_ROLL": 0.2,
    "SIH_L_PITCH": 0.2,
    "SIH_KDV": 1.0,
}
"""PX4's defaults, which hold in a file that is made for the simulation in hardware (it sets SIH_VEHICLE_TYPE)."""
GYRATION = (0.45, 0.45, 0.6)
"""Radii of gyration over the rotors' distance: means of the package's sourced vehicles, which differ by a third."""
HOVER_SPEED = 500.0
"""Rotor speed in hover [rad/s], a scale alone: PX4 knows no rotor speed, and nothing else follows from it here."""
AIRMODES = (Desaturation.AIRMODE_DISABLED, Desaturation.AIRMODE_ROLL_PITCH, Desaturation.AIRMODE_ROLL_PITCH_YAW)
"""The modes of MC_AIRMODE, from 0."""
TAKEN_GAINS = ("MC_AIRMODE", "MC_ROLL_P", "MPC_XY_VEL_P_ACC", "MPC_XY_VEL_I_ACC", "MPC_THR_HOVER")
TAKEN_BY_CASCADE = ("MC_AIRMODE", "MPC_XY_P", "MPC_Z_P", *GAIN_PARAMETERS)
"""Parameters that the inner loop takes: the article's, and PX4's cascade."""

OUTER_GAINS = ("MPC_XY_P", "MPC_Z_P", "MC_YAW_P")
"""Gains of position and yaw, which are those of the controllers around the vehicle."""
LOOP_RATE = "IMU_GYRO_RATEMAX"
"""Rate of PX4's attitude and rate loops [Hz]."""
LIMITS = ("THR_MDL_FAC", "MPC_XY_VEL_MAX", "MPC_Z_VEL_MAX_UP", "MPC_Z_VEL_MAX_DN", "MPC_XY_CRUISE", "MPC_YAWRAUTO_MAX")
"""Parameters that shape a flight and that no field of ``[plant]`` takes; the velocity limits belong to a controller."""
CASCADE_LIMITS = (LOOP_RATE, "MPC_TILTMAX_AIR", "MPC_THR_MIN", "MPC_THR_MAX", "MPC_THR_XY_MARG", "IMU_GYRO_CUTOFF")
"""Parameters that only PX4's cascade takes."""


class Airframe(NamedTuple):
    """A vehicle as a study's table.

    Args:
        vehicle: The table ``[plant.vehicle]``.
        notes: What the file does not give, or gives in another form than the model has.
        plant: The other entries of ``[plant]``: desaturation and gains of the inner loops.
        warnings: Numbers outside of the range that multirotors usually have.
    """

    vehicle: TomlTable
    notes: tuple[str, ...]
    plant: TomlTable
    warnings: tuple[str, ...]


def parameters_in(text: str) -> dict[str, float]:
    """The numeric parameters that an airframe's script or a ground station's file sets; the last setting counts.

    Raises:
        ConfigError: the value of a parameter that is read is no number.
    """
    values: dict[str, float] = {}
    for number, text_line in enumerate(text.splitlines(), start=1):
        line = LINE.match(text_line)
        if line is None:
            continue
        name, value = (line["set"], line["to"]) if line["set"] else (line["name"], line["value"])
        try:
            values[name] = float(value)
        except ValueError:
            if name.startswith(READ) and not value.startswith("$"):  # a variable of the shell is not known
                raise ConfigError(name, f"must be a number, got {value!r} in line {number}") from None
            values.pop(name, None)
    return values


def require_finite(values: Mapping[str, float]) -> None:
    """Require that every parameter that is read is finite, and no larger than any length, mass or gain; ConfigError."""
    for name, value in values.items():
        if name.startswith(READ) and not abs(value) <= LARGEST_PARAMETER:
            raise ConfigError(name, f"must be a finite number of at most {LARGEST_PARAMETER:g}, got {value:g}")


def note_unmatched_gains(parameters: Mapping[str, float], used_gains: tuple[str, ...], notes: list[str]) -> None:
    """Add a note that names the gains of the file for which the model has no counterpart."""
    gains = [name for name in parameters if GAIN.fullmatch(name) and name not in used_gains]
    if gains:
        notes.append(f"left out, without a counterpart here: {', '.join(sorted(gains))}")


def note_unused_limits(parameters: Mapping[str, float], cascade: bool, notes: list[str]) -> None:
    """Add a note of the limits in the file that the table does not use, with their values."""
    names = LIMITS if cascade else LIMITS + CASCADE_LIMITS
    settings = [f"{name} = {parameters[name]:g}" for name in names if name in parameters]
    if settings:
        notes.append(f"not used: {', '.join(settings)}")


def missing_coordinates(parameters: Mapping[str, float]) -> list[str]:
    """A warning of coordinates that the file gives for some rotors only; the others count as 0, PX4's default."""
    missing = []
    count = int(parameters["CA_ROTOR_COUNT"])
    for axis in "XYZ":
        names = [f"CA_ROTOR{index}_P{axis}" for index in range(count)]
        absent = [name for name in names if name not in parameters]
        if len(absent) < count:
            missing += absent
    return [f"taken as 0, PX4's default, though other rotors have them: {', '.join(missing)}"] if missing else []


def require_sizes(rotors: list[PlacedRotor], parameters: Mapping[str, float]) -> None:
    """Require a mass, and lengths for positions that are ratios.

    Raises:
        ConfigError: One is missing, and the message names all that are missing; or the mass is not positive.
    """
    if not parameters.get("SIH_MASS", 1.0) > 0.0:
        raise ConfigError("SIH_MASS", f"must be > 0, got {parameters['SIH_MASS']:g} kg")
    missing = []
    if "SIH_MASS" not in parameters:
        missing.append("the file does not set SIH_MASS, the mass; give it with --mass KG")
    if are_ratios(rotors) and not ("SIH_L_ROLL" in parameters and "SIH_L_PITCH" in parameters):
        missing.append("positions are ratios of a generic airframe, not metres; give what they are ratios of, --arm M")
    if missing:
        raise ConfigError("SIH_MASS" if "SIH_MASS" not in parameters else "CA_ROTORi_PX, _PY", "; ".join(missing))


def properties_of(parameters: Mapping[str, float], geometry: TomlTable, notes: list[str]) -> TomlTable:
    """Mass, inertia, largest thrust, lag and drag; what is estimated gets a note.

    The inertia is that of the whole vehicle, so the rotors' own is zero. PX4's lag is one of thrust; near hover, where
    thrust is linear in speed, the speed has the same. SIH_KDV v is the propellers' drag at their speed in hover.
    """
    mass = parameters["SIH_MASS"]
    listed_rotors = geometry.get("rotor", [])
    count = len(listed_rotors or geometry["spins"])
    upward = sum(entry["axis"][2] / math.hypot(*entry["axis"]) for entry in listed_rotors if "axis" in entry)
    lift = mass * GRAVITY / (upward if upward > 0.0 else count)  # tilted rotors push more than they lift
    properties: TomlTable = {"mass": mass, "rotor_inertia_xy": 0.0, "rotor_inertia_z": 0.0}
    if all(name in parameters for name in INERTIA):
        properties["body_inertia"] = [parameters[name] for name in INERTIA]
    else:
        properties["body_inertia"] = [mass * (share * geometry["arm"]) ** 2 for share in GYRATION]
        notes.append("body_inertia is estimated from mass and arm, within a third: the file does not set SIH_IXX, ..")
    properties["thrust_coefficient"] = lift / HOVER_SPEED**2
    notes.append(
        f"thrust_coefficient only sets the scale of rotor speeds, {HOVER_SPEED:g} rad/s in hover: PX4 has none"
    )
    properties["structure_drag"] = [0.0, 0.0, 0.0]
    properties["propeller_drag"] = parameters.get("SIH_KDV", 0.0) / (count * HOVER_SPEED)
    notes.append(
        "drag is SIH_KDV v in hover; SIH_KDW, the damping of rotations, is left out"
        if "SIH_KDV" in parameters
        else "drag is 0, so that a wind has no effect: the file does not set SIH_KDV; structure_drag gives it"
    )
    if "SIH_T_MAX" in parameters:
        properties["max_thrust"] = parameters["SIH_T_MAX"]
        if "SIH_Q_MAX" in parameters:  # the simulated plant; CA_ROTORi_KM is what the allocation believes
            properties["torque_coefficient"] = parameters["SIH_Q_MAX"] / parameters["SIH_T_MAX"]
    elif "MPC_THR_HOVER" in parameters:
        if not 0.0 < parameters["MPC_THR_HOVER"] <= 1.0:
            raise ConfigError("MPC_THR_HOVER", f"must be > 0 and <= 1, got {parameters['MPC_THR_HOVER']:g}")
        properties["max_thrust"] = lift / parameters["MPC_THR_HOVER"]
        notes.append(
            "max_thrust follows from MPC_THR_HOVER, with thrust linear in the command; the file sets no SIH_T_MAX"
        )
    else:
        notes.append("max_thrust is twice that of hover: the file sets neither SIH_T_MAX nor MPC_THR_HOVER")
    if "SIH_T_TAU" in parameters:
        properties["motor_lag"] = parameters["SIH_T_TAU"]
    else:
        notes.append("motor_lag is left out, so that rotors follow at once: the file does not set SIH_T_TAU")
    if any(parameters.get(name, 0.0) for name in PRODUCTS):
        notes.append(f"{', '.join(PRODUCTS)} are left out: the model's axes are principal axes")
    return properties


def control_of(parameters: Mapping[str, float], notes: list[str], cascade: bool) -> TomlTable:
    """Desaturation from MC_AIRMODE, by default 0, and gains of the inner loops from MC_ and MPC_ that the file sets.

    MPC_XY_VEL_P_ACC and MPC_XY_VEL_I_ACC are the model's gains. MC_ROLL_P p is the stiffness of an attitude loop with a
    fast rate loop; the model's second-order loop with p = k_p/k_d and a double pole has k_d = 4 p and k_p = 4 p^2.

    Raises:
        ConfigError: MC_AIRMODE is none of PX4's.
    """
    mode = parameters.get("MC_AIRMODE", 0.0)
    if mode not in range(len(AIRMODES)):
        raise ConfigError("MC_AIRMODE", f"must be 0, 1 or 2, got {mode:g}")
    if "MC_AIRMODE" not in parameters:
        notes.append("desaturation is that of MC_AIRMODE = 0, PX4's default: the file does not set it")
    control: TomlTable = {"desaturation": AIRMODES[int(mode)].value}
    if cascade:
        inner = gains_from(parameters)
        if parameters.get(LOOP_RATE, 0.0) > 0.0:
            inner["frequency"] = parameters[LOOP_RATE]
            notes.append(f"frequency is {LOOP_RATE}; frequency times loop.sample_time must be a whole number")
        else:
            notes.append(f"frequency is 400 Hz: the file does not set {LOOP_RATE}")
        notes.append("PX4's defaults hold for gains of its cascade that the file does not set")
        outer = [f"{name} = {parameters[name]:g}" for name in OUTER_GAINS if name in parameters]
        notes.append(f"k_p of [controller], of its .z and of its .psi: {', '.join(outer or OUTER_GAINS)}")
        return control | {"inner_loop": inner}
    gains: TomlTable = {}
    if "MPC_XY_VEL_P_ACC" in parameters:
        gains["kd_velocity"] = parameters["MPC_XY_VEL_P_ACC"]
        gains["kp_velocity"] = parameters.get("MPC_XY_VEL_I_ACC", 0.4)
        notes.append("kd_velocity and kp_velocity are those of x and y; the model has the same for z (MPC_Z_VEL_..)")
    if "MC_ROLL_P" in parameters:
        gains |= {"kp_attitude": 4.0 * parameters["MC_ROLL_P"] ** 2, "kd_attitude": 4.0 * parameters["MC_ROLL_P"]}
        notes.append("kp_attitude and kd_attitude follow from MC_ROLL_P; MC_.._RATE gains have no counterpart")
    return control | ({"inner_loop": gains} if gains else {})


def read_airframe(
    file: str | Mapping[str, float], mass: float | None = None, arm: float | None = None, cascade: bool = False
) -> Airframe:
    """The vehicle of a PX4 airframe script, of a parameter file saved by a ground station, or of a log's parameters.

    Args:
        file: The file's text, or parameters by name.
        mass: Mass of the vehicle [kg]; None: that of the file.
        arm: Length by which positions that are ratios are multiplied [m]; None: positions that are those of PX4's
            generic airframes are multiplied by SIH_L_PITCH and SIH_L_ROLL of the file, others are metres.
        cascade: Whether the inner loop is PX4's cascade with the file's gains, and not the article's.

    Raises:
        ConfigError: the file gives no mass, or has something that the model has no part for.
    """
    parameters = parameters_in(file) if isinstance(file, str) else dict(file)
    require_finite(parameters)
    if not any(name.startswith("CA_") for name in parameters):
        raise ConfigError("", "sets no parameter CA_..; a PX4 airframe or parameter file is needed")
    notes: list[str] = []
    if "SIH_VEHICLE_TYPE" in parameters:
        absent = [name for name in SIMULATED if name not in parameters]
        parameters = SIMULATED | parameters
        if absent:
            notes.append(f"{', '.join(absent)} are PX4's defaults of the simulation in hardware")
    if mass is not None and parameters.get("SIH_MASS", mass) != mass:
        notes.append(f"the mass is the stated one, {mass:g} kg, in place of SIH_MASS = {parameters['SIH_MASS']:g}")
    stated_values = {"SIH_MASS": mass, "SIH_L_ROLL": arm, "SIH_L_PITCH": arm}
    parameters |= {name: value for name, value in stated_values.items() if value is not None}
    rotors = placed_rotors(parameters)
    relative = arm is not None or are_ratios(rotors)
    require_sizes(rotors, parameters)
    if relative:
        rotors = in_metres(rotors, parameters)
        notes.append("positions are ratios, and became metres by the stated length, or SIH_L_PITCH and SIH_L_ROLL")
    geometry = geometry_of(rotors)
    vehicle: TomlTable = {"kind": "m600_quadrotor"} | geometry | properties_of(parameters, geometry, notes)
    if "torque_coefficient" in vehicle and "SIH_Q_MAX" in parameters:
        for entry in vehicle.get("rotor", []):
            entry.pop("torque_coefficient")
    warnings = implausible(flying_vehicle(vehicle, parameters), vehicle)
    control = control_of(parameters, notes, cascade)
    note_unmatched_gains(parameters, TAKEN_BY_CASCADE if cascade else TAKEN_GAINS, notes)
    note_unused_limits(parameters, cascade, notes)
    warnings += missing_coordinates(parameters)
    return Airframe(vehicle, tuple(notes), control, tuple(warnings))
