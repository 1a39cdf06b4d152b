"""Table [plant] of a PX4 vehicle, from the geometry (CA_), mass properties (SIH_) and gains (MC_, MPC_) of its file.

PX4's body axes point forward, right and down; here they point forward, left and up. A rotor at (CA_ROTORi_PX,
CA_ROTORi_PY) therefore sits at the angle atan2(-PY, PX). A positive CA_ROTORi_KM means a rotor that turns
counter-clockwise as seen from above, whose drag torque about the upward axis is negative: s_i = -sgn(KM).

Sources: PX4's parameter reference (control allocation; simulation in hardware; multicopter attitude and position
control), its module simulator_sih and its class ActuatorEffectivenessRotors.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.uav.airframe_names import misspelt_names, require_multirotor
from dssc_jax.models.uav.airframe_properties import (
    SIMULATION_PARAMETERS,
    contradicted_hover,
    drop_torque_of_single_rotors,
    properties_of,
    require_sizes,
    with_simulation_defaults,
    with_stated_sizes,
)
from dssc_jax.models.uav.airframe_rotors import (
    ROTOR_PARAMETERS,
    are_ratios,
    flying_vehicle,
    geometry_of,
    in_metres,
    placed_rotors,
)
from dssc_jax.models.uav.desaturation import Desaturation
from dssc_jax.models.uav.inner_loops.px4_parameters import (
    GAIN_PARAMETERS,
    LOOP_RATE,
    gains_from,
    require_admissible,
    unusual_gains,
)
from dssc_jax.models.uav.plausibility import implausible

LINE = re.compile(
    r"[ \t]*(?:param[ \t]+(?:set|set-default)[ \t]+(?P<set>\w+)[ \t]*(?P<to>[^\s#]*)"  # an airframe's start-up script
    r"|\d+\s+\d+\s+(?P<name>\w+)\s+(?P<value>\S+)\s+\d+\s*$)",  # a ground station's file: vehicle, component, .., type
)
"""A line that sets a parameter."""
MIXER = re.compile(r"^[ \t]*set[ \t]+MIXER\b", re.MULTILINE)
"""A line by which a start-up script of earlier versions of PX4 names the file of its mixer."""
MIXER_REMEDY = (
    "its rotors are in the mixer that it sets, a file of its own, as in PX4 before 1.14: take the airframe of a later "
    "version, or add CA_ROTOR_COUNT and of each rotor CA_ROTORi_PX, _PY and _KM"
)
FILE_REMEDY = "a PX4 airframe or parameter file is needed"
"""What to do about a file without rotors."""
ROTORS_OF_ALL_FORCES = 6
"""Number of tilted rotors that can give any force and moment together."""
FEW_TILTED = (
    "the model's allocation meets thrust and moments exactly and ignores side forces; PX4's weighs all six, so that "
    "commands differ by about 1 %"
)
"""What to know of PX4's cascade with fewer tilted rotors than that."""
GAIN = re.compile(r"M(?:P?)C_\w+_(?:P|I|D|FF|K)(?:_ACC)?")
"""Names of PX4's gains."""
PREFIXES = ("CA_", "SIH_", "MC_", "MPC_", "IMU_GYRO_", "IMU_DGYRO_", "THR_MDL_FAC")
"""Beginnings of the names of the parameters that are read."""
LARGEST_PARAMETER = 1e6
"""Largest size of a parameter in PX4's units; no length, mass, thrust or inertia of a multirotor is larger."""
AIRMODES = (Desaturation.AIRMODE_DISABLED, Desaturation.AIRMODE_ROLL_PITCH, Desaturation.AIRMODE_ROLL_PITCH_YAW)
"""The modes of MC_AIRMODE, from 0."""
ARTICLE_PARAMETERS = ("MC_AIRMODE", "MC_ROLL_P", "MPC_XY_VEL_P_ACC", "MPC_XY_VEL_I_ACC", "MPC_THR_HOVER")
"""Parameters that the article's inner loop uses."""
CASCADE_PARAMETERS = ("MC_AIRMODE", "MPC_XY_P", "MPC_Z_P", *GAIN_PARAMETERS)
"""Parameters that PX4's cascade uses."""

OUTER_GAINS = ("MPC_XY_P", "MPC_Z_P", "MC_YAW_P")
"""Gains of position and yaw, which belong to the controllers outside of the vehicle."""
"""Rate of PX4's attitude and rate loops [Hz]."""
LIMITS = (
    "THR_MDL_FAC",
    "MPC_XY_VEL_MAX",
    "MPC_Z_VEL_MAX_UP",
    "MPC_Z_VEL_MAX_DN",
    "MPC_XY_CRUISE",
    "MPC_YAWRAUTO_MAX",
    "MC_YAWRAUTO_MAX",  # the same in earlier versions of PX4
)
"""Parameters that shape a flight but have no field in ``[plant]``; the velocity limits belong to a controller."""
CASCADE_LIMITS = (LOOP_RATE, "MPC_TILTMAX_AIR", "MPC_THR_MIN", "MPC_THR_MAX", "MPC_THR_XY_MARG", "IMU_GYRO_CUTOFF")
"""Parameters that only PX4's cascade uses."""

READ = (
    *ROTOR_PARAMETERS,
    *SIMULATION_PARAMETERS,
    *ARTICLE_PARAMETERS,
    *CASCADE_PARAMETERS,
    *OUTER_GAINS,
    *LIMITS,
    *CASCADE_LIMITS,
)
"""All parameters that are read."""


class Airframe(NamedTuple):
    """The tables of a study for a vehicle.

    Args:
        vehicle: The table ``[plant.vehicle]``.
        notes: Sentences on what the file does not give, or gives in another form than the model needs.
        plant: The other entries of ``[plant]``: desaturation and gains of the inner loops.
        warnings: Sentences on numbers outside of the usual range of multirotors, and on misspelt names of parameters.
    """

    vehicle: TomlTable
    notes: tuple[str, ...]
    plant: TomlTable
    warnings: tuple[str, ...]


def parameters_in(text: str) -> dict[str, float]:
    """Parse the parameters that the text of a file sets, by name; the last setting of a name counts.

    Raises:
        ConfigError: A parameter that the model reads is not a number.
    """
    values: dict[str, float] = {}
    for number, text_line in enumerate(text.splitlines(), start=1):
        line = LINE.match(text_line)
        if line is None:
            continue
        is_script = line["set"] is not None
        name = line["set"] if is_script else line["name"]
        value = line["to"] if is_script else line["value"]
        try:
            values[name] = float(value)
        except ValueError:
            if name.startswith(PREFIXES) and not value.startswith("$"):  # $ marks a variable of the shell
                raise ConfigError(name, f"must be a number, got {value!r} in line {number}") from None
            values.pop(name, None)  # its last setting is no number, so it has none
    return values


def require_finite(values: Mapping[str, float]) -> None:
    """Require that every parameter that is read is finite, and of a size of at most ``LARGEST_PARAMETER``.

    Raises:
        ConfigError: A parameter is not.
    """
    for name, value in values.items():
        if name.startswith(PREFIXES) and not abs(value) <= LARGEST_PARAMETER:
            raise ConfigError(name, f"must be a finite number of at most {LARGEST_PARAMETER:g}, got {value:g}")


def note_unmatched_gains(parameters: Mapping[str, float], used_gains: tuple[str, ...], notes: list[str]) -> None:
    """Add a note that names the gains of the file without a counterpart in the model.

    Args:
        parameters: The file's parameters.
        used_gains: Names of the gains that have a counterpart.
        notes: The list to which the note is added.
    """
    gains = [name for name in parameters if GAIN.fullmatch(name) and name not in used_gains]
    if gains:
        notes.append(f"left out, without a counterpart here: {', '.join(sorted(gains))}")


def note_unused_limits(parameters: Mapping[str, float], use_px4_cascade: bool, notes: list[str]) -> None:
    """Add a note of the limits in the file that the table does not use, with their values.

    Args:
        parameters: The file's parameters.
        use_px4_cascade: Whether the inner loop is PX4's cascade, which uses some of the limits.
        notes: The list to which a note is added.
    """
    names = LIMITS if use_px4_cascade else LIMITS + CASCADE_LIMITS
    settings = [f"{name} = {parameters[name]:g}" for name in names if name in parameters]
    if settings:
        notes.append(f"not used: {', '.join(settings)}")


def missing_coordinates(parameters: Mapping[str, float]) -> list[str]:
    """Warn of coordinates that the file gives for some rotors only; PX4's default for the others is 0.

    A coordinate that no rotor has is 0 for all, and needs no warning.
    """
    missing = []
    count = int(parameters["CA_ROTOR_COUNT"])
    for axis in "XYZ":
        names = [f"CA_ROTOR{index}_P{axis}" for index in range(count)]
        unset = [name for name in names if name not in parameters]
        if len(unset) < count:  # a coordinate that no rotor has is 0 for all
            missing += unset
    if not missing:
        return []
    return [f"taken as 0, PX4's default, though other rotors have them: {', '.join(missing)}"]


def cascade_gains(parameters: Mapping[str, float], notes: list[str]) -> TomlTable:
    """Make the table ``[plant.inner_loop]`` of PX4's cascade with the file's gains.

    Args:
        parameters: The file's parameters.
        notes: The list to which notes on what the table leaves out are added.
    """
    gains = gains_from(parameters)
    if parameters.get(LOOP_RATE, 0.0) > 0.0:
        gains["frequency"] = parameters[LOOP_RATE]
        notes.append(f"frequency is {LOOP_RATE}; frequency times loop.sample_time must be a whole number")
    else:
        notes.append(f"frequency is 400 Hz: the file does not set {LOOP_RATE}")
    notes.append("PX4's defaults hold for gains of its cascade that the file does not set")
    outer = [f"{name} = {parameters[name]:g}" for name in OUTER_GAINS if name in parameters]
    notes.append(f"k_p of [controller], of its .z and of its .psi: {', '.join(outer or OUTER_GAINS)}")
    return gains


def article_gains(parameters: Mapping[str, float], notes: list[str]) -> TomlTable:
    """Make the table ``[plant.inner_loop]`` of the article's inner loop, with the gains that the file sets.

    MPC_XY_VEL_P_ACC and MPC_XY_VEL_I_ACC are gains of the model, too. PX4 turns an error of roll into a desired rate by
    the factor p = MC_ROLL_P, whereas the model's attitude loop is of second order. With k_p/k_d = p and a double pole,
    its gains are k_d = 4 p and k_p = 4 p^2.

    Args:
        parameters: The file's parameters.
        notes: The list to which notes are added.
    """
    gains: TomlTable = {}
    if "MPC_XY_VEL_P_ACC" in parameters:
        gains["kd_velocity"] = parameters["MPC_XY_VEL_P_ACC"]
        gains["kp_velocity"] = parameters.get("MPC_XY_VEL_I_ACC", 0.4)  # PX4's default
        notes.append("kd_velocity and kp_velocity are those of x and y; the model has the same for z (MPC_Z_VEL_..)")
    if "MC_ROLL_P" in parameters:
        p = parameters["MC_ROLL_P"]
        gains |= {"kp_attitude": 4.0 * p**2, "kd_attitude": 4.0 * p}
        notes.append("kp_attitude and kd_attitude follow from MC_ROLL_P; MC_.._RATE gains have no counterpart")
    return gains


def control_entries(parameters: Mapping[str, float], notes: list[str], use_px4_cascade: bool) -> TomlTable:
    """Make the entries of ``[plant]`` for the desaturation and for the inner loop.

    MC_AIRMODE, by default 0, chooses the desaturation.

    Args:
        parameters: The file's parameters.
        notes: The list to which notes are added.
        use_px4_cascade: Whether the inner loop is PX4's cascade, and not the article's.

    Raises:
        ConfigError: MC_AIRMODE has another value than PX4's.
    """
    mode = parameters.get("MC_AIRMODE", 0.0)
    if mode not in range(len(AIRMODES)):
        raise ConfigError("MC_AIRMODE", f"must be 0, 1 or 2, got {mode:g}")
    if "MC_AIRMODE" not in parameters:
        notes.append("desaturation is that of MC_AIRMODE = 0, PX4's default: the file does not set it")
    control: TomlTable = {"desaturation": AIRMODES[int(mode)].value}
    gains = cascade_gains(parameters, notes) if use_px4_cascade else article_gains(parameters, notes)
    return control | {"inner_loop": gains} if gains else control


def airframe_of(
    parameters: dict[str, float],
    mass: float | None,
    arm: float | None,
    use_px4_cascade: bool,
    hover_speed: float | None,
) -> Airframe:
    """The study's tables for PX4's parameters by name; arguments as for :func:`read_airframe`.

    This function does not look for misspelt names.

    Raises:
        ConfigError: The parameters give no mass, or describe something that the model cannot represent.
    """
    notes: list[str] = []
    parameters = with_simulation_defaults(parameters, notes)
    parameters = with_stated_sizes(parameters, mass, arm, notes)
    rotors = placed_rotors(parameters)
    require_sizes(rotors, parameters)
    if arm is not None or are_ratios(rotors):
        if are_ratios(rotors):
            lengths = "SIH_L_PITCH and SIH_L_ROLL" if arm is None else f"the stated length, {arm:g} m"
            notes.append(f"positions are ratios, and became metres by {lengths}")
        else:
            notes.append(f"positions in metres were multiplied by the stated {arm:g}")
        rotors = in_metres(rotors, parameters)
    geometry = geometry_of(rotors)
    if (
        use_px4_cascade
        and len(rotors) < ROTORS_OF_ALL_FORCES
        and any("axis" in entry for entry in geometry.get("rotor", ()))
    ):
        notes.append(FEW_TILTED)
    vehicle: TomlTable = {"kind": "m600_quadrotor"} | geometry | properties_of(parameters, geometry, hover_speed, notes)
    if "torque_coefficient" in vehicle and "SIH_Q_MAX" in parameters:
        drop_torque_of_single_rotors(vehicle)
    warnings = implausible(flying_vehicle(vehicle, parameters), vehicle)
    if use_px4_cascade:
        require_admissible(parameters)
        warnings += unusual_gains(parameters)
    control = control_entries(parameters, notes, use_px4_cascade)
    note_unmatched_gains(parameters, CASCADE_PARAMETERS if use_px4_cascade else ARTICLE_PARAMETERS, notes)
    note_unused_limits(parameters, use_px4_cascade, notes)
    warnings += missing_coordinates(parameters) + contradicted_hover(parameters, geometry)
    return Airframe(vehicle, tuple(notes), control, tuple(warnings))


def read_airframe(
    text_or_parameters: str | Mapping[str, float],
    mass: float | None = None,
    arm: float | None = None,
    use_px4_cascade: bool = False,
    hover_speed: float | None = None,
) -> Airframe:
    """Convert PX4 parameters to the study's vehicle tables, with notes on what the parameters do not specify.

    The parameters come from an airframe script, from a file that a ground station saved, or from a log.

    Args:
        text_or_parameters: The file's text, or parameters by name.
        mass: Mass of the vehicle [kg]; None: the file's.
        arm: Length of an arm [m], by which all positions are multiplied. None: the positions of PX4's generic airframes
            are ratios of SIH_L_PITCH and SIH_L_ROLL in the file, and other positions are in metres.
        use_px4_cascade: Whether the inner loop is PX4's cascade with the file's gains, and not the article's.
        hover_speed: Mean speed of the rotors in hover [rad/s], which no parameter of PX4 gives. None: it is not known,
            and the vehicle's coefficients are nominal.

    Raises:
        ConfigError: The file gives no mass, or describes something that the model cannot represent.
    """
    text = text_or_parameters if isinstance(text_or_parameters, str) else ""
    require_multirotor(text)
    parameters = dict(parameters_in(text) if isinstance(text_or_parameters, str) else text_or_parameters)
    require_finite(parameters)
    if not any(name.startswith("CA_") for name in parameters):
        is_mixer_file = MIXER.search(text) is not None
        raise ConfigError("", f"sets no parameter CA_..; {MIXER_REMEDY if is_mixer_file else FILE_REMEDY}")
    misspelt = misspelt_names(parameters, READ)
    try:
        airframe = airframe_of(parameters, mass, arm, use_px4_cascade, hover_speed)
    except ConfigError as error:
        raise ConfigError(error.where, "; ".join((error.rule, *misspelt))) from None
    return airframe._replace(warnings=(*airframe.warnings, *misspelt))
