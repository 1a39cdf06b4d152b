"""Mass, inertia, thrust, drag and lag of a PX4 vehicle, from the simulation's parameters (SIH_) of its file.

:mod:`dssc_jax.models.uav.airframe` names the sources.
"""

from collections.abc import Mapping

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.uav.airframe_rotors import PlacedRotor, are_ratios, errors_in_px4_names, vehicle_of
from dssc_jax.models.uav.allocation import pseudo_inverse
from dssc_jax.models.uav.desaturation import rotors_of_full_thrust
from dssc_jax.models.uav.vehicle import GRAVITY, RotorCoefficients

INERTIA = ("SIH_IXX", "SIH_IYY", "SIH_IZZ")
"""The moments of inertia."""
PRODUCTS = ("SIH_IXY", "SIH_IXZ", "SIH_IYZ")
"""The products of inertia."""
SIH_DEFAULTS: dict[str, float] = {
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
"""PX4's defaults in a file for the simulation in hardware, which is one that sets SIH_VEHICLE_TYPE."""
SIH_MULTIROTORS = {0: "quadrotor", 4: "hexacopter"}
"""Values of SIH_VEHICLE_TYPE for multirotors; the others are planes, VTOLs and a rover."""
GYRATION = (0.45, 0.45, 0.6)
"""Radii of gyration over the arm: means of the package's vehicles with sources, which differ by a third."""
HOVER_SPEED = 500.0
"""Nominal rotor speed in hover [rad/s], where the true one is not known: PX4's parameters contain none."""
HOVER_FACTOR = 1.25
"""Factor between a stated hover command and that of mass and thrust, from which they contradict each other; assumed."""
SIMULATION_PARAMETERS = ("SIH_VEHICLE_TYPE", *SIH_DEFAULTS, *PRODUCTS, "MPC_THR_HOVER")
"""Parameters that are read here."""


def require_sizes(rotors: list[PlacedRotor], parameters: Mapping[str, float]) -> None:
    """Require a mass, and arm lengths if the rotors' positions are ratios.

    Args:
        rotors: The rotors.
        parameters: The file's parameters.

    Raises:
        ConfigError: The mass is not positive, or sizes are missing; the message names all that are missing.
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


def body_inertia(parameters: Mapping[str, float], arm: float, notes: list[str]) -> list[float]:
    """The moments of inertia [kg m^2]; a moment that the file lacks is estimated from mass and arm.

    An estimate adds a note.

    Args:
        parameters: The file's parameters.
        arm: Length of an arm [m].
        notes: The list to which a note is added.

    Raises:
        ConfigError: A stated moment is not positive; or one moment is larger than the sum of the others, which no body
            has, and an estimate is among them.
    """
    missing = [name for name in INERTIA if name not in parameters]
    for name in INERTIA:
        if name in parameters and not parameters[name] > 0.0:
            raise ConfigError(name, f"must be > 0, got {parameters[name]:g} kg m^2")
    if missing:
        axes = "" if missing == list(INERTIA) else " about the other axes"
        notes.append(
            f"body_inertia{axes} is estimated from mass and arm, within a third: the file does not set "
            f"{', '.join(missing)}"
        )
    estimates = [parameters["SIH_MASS"] * (radius * arm) ** 2 for radius in GYRATION]
    inertia = [parameters.get(name, estimate) for name, estimate in zip(INERTIA, estimates, strict=True)]
    if missing and 2.0 * max(inertia) > sum(inertia):
        values = ", ".join(f"{name} = {value:.3g}" for name, value in zip(INERTIA, inertia, strict=True))
        raise ConfigError(
            ", ".join(missing),
            f"must be set, too: with estimates of {'it' if len(missing) == 1 else 'them'}, {values} kg m^2, one moment "
            "is larger than the sum of the others, as of no body",
        )
    return inertia


def thrust_entries(parameters: Mapping[str, float], lift: float, notes: list[str]) -> TomlTable:
    """Entries of the vehicle for a rotor's largest thrust, and for its torque over thrust if the file has both.

    Without SIH_T_MAX the largest thrust follows from the hover command MPC_THR_HOVER; without either, it is twice the
    thrust in hover.

    Args:
        parameters: The file's parameters.
        lift: Thrust of each rotor in hover [N].
        notes: The list to which a note is added.

    Raises:
        ConfigError: MPC_THR_HOVER is not in (0, 1], or SIH_T_MAX is not positive.
    """
    if "SIH_T_MAX" in parameters:
        if not parameters["SIH_T_MAX"] > 0.0:
            raise ConfigError("SIH_T_MAX", f"must be > 0, got {parameters['SIH_T_MAX']:g} N")
        entries: TomlTable = {"max_thrust": parameters["SIH_T_MAX"]}
        if "SIH_Q_MAX" in parameters:  # of the simulated plant; CA_ROTORi_KM is the allocation's assumption
            entries["torque_coefficient"] = parameters["SIH_Q_MAX"] / parameters["SIH_T_MAX"]
        return entries
    if "MPC_THR_HOVER" not in parameters:
        notes.append("max_thrust is twice that of hover: the file sets neither SIH_T_MAX nor MPC_THR_HOVER")
        return {"max_thrust": 2.0 * lift}
    hover_command = parameters["MPC_THR_HOVER"]
    if not 0.0 < hover_command <= 1.0:
        raise ConfigError("MPC_THR_HOVER", f"must be > 0 and <= 1, got {hover_command:g}")
    notes.append("max_thrust follows from MPC_THR_HOVER, with thrust linear in the command; the file sets no SIH_T_MAX")
    return {"max_thrust": lift / hover_command}


def contradicted_hover(parameters: Mapping[str, float], geometry: TomlTable) -> list[str]:
    """Warn of a hover command MPC_THR_HOVER that contradicts mass and largest thrust SIH_T_MAX.

    Args:
        parameters: The file's parameters.
        geometry: Entries of the vehicle that place its rotors.
    """
    if not {"SIH_T_MAX", "MPC_THR_HOVER"} <= set(parameters):
        return []
    by_thrust = hover_thrust(parameters, geometry) / parameters["SIH_T_MAX"]
    stated = parameters["MPC_THR_HOVER"]
    if stated / HOVER_FACTOR < by_thrust < HOVER_FACTOR * stated:
        return []
    return [
        f"MPC_THR_HOVER is {stated:g}, and hover takes {by_thrust:.3g} of SIH_T_MAX = {parameters['SIH_T_MAX']:g} N "
        f"with {parameters['SIH_MASS']:g} kg: the model takes SIH_T_MAX, and PX4's cascade the command"
    ]


def rotors_of(geometry: TomlTable) -> int:
    """The number of rotors that entries of the vehicle place, in a list or on a circle."""
    return len(geometry.get("rotor") or geometry["spins"])


def hover_thrust(parameters: Mapping[str, float], geometry: TomlTable) -> float:
    """Compute the mean thrust of the rotors in hover [N]; tilted rotors push more than they lift.

    Args:
        parameters: The file's parameters, with the mass.
        geometry: Entries of the vehicle that place its rotors.

    Raises:
        ConfigError: The rotors cannot command all axes.
    """
    with errors_in_px4_names(parameters):
        allocation = pseudo_inverse(vehicle_of(geometry))
    return parameters["SIH_MASS"] * GRAVITY / rotors_of_full_thrust(allocation)


def drag_entries(parameters: Mapping[str, float], speeds: float, notes: list[str]) -> TomlTable:
    """Make the vehicle's entries for the drag, which is SIH_KDV v in hover.

    The drag is that of the propellers, whose coefficient is SIH_KDV over the sum of the rotors' speeds.

    Args:
        parameters: The file's parameters.
        speeds: Sum of the rotors' speeds in hover [rad/s].
        notes: The list to which a note is added.
    """
    if "SIH_KDV" in parameters:
        notes.append("drag is SIH_KDV v in hover; SIH_KDW, the damping of rotations, is left out")
    else:
        notes.append("drag is 0, so that a wind has no effect: the file does not set SIH_KDV; structure_drag gives it")
    propeller_drag = parameters.get("SIH_KDV", 0.0) / speeds
    return {"structure_drag": [0.0, 0.0, 0.0], "propeller_drag": propeller_drag}


def coefficient_entries(
    parameters: Mapping[str, float], lift: float, hover_speed: float | None, notes: list[str]
) -> TomlTable:
    """Make the vehicle's thrust coefficient, and tell whether its coefficients are true or nominal.

    Thrust and torque coefficients are true if the rotors' speed in hover is known and if SIH_Q_MAX and SIH_T_MAX give
    the torque. Otherwise they are nominal: a torque from CA_ROTORi_KM, for example, is an assumption of the allocation.

    Args:
        parameters: The file's parameters.
        lift: Thrust of each rotor in hover [N].
        hover_speed: Speed of the rotors in hover [rad/s]; None: it is not known.
        notes: The list to which notes are added.
    """
    speed = HOVER_SPEED if hover_speed is None else hover_speed
    entries: TomlTable = {"thrust_coefficient": lift / speed**2}
    causes = []
    if hover_speed is None:
        causes.append(f"thrust_coefficient is that of {HOVER_SPEED:g} rad/s in hover, for want of a stated hover speed")
    missing = [name for name in ("SIH_Q_MAX", "SIH_T_MAX") if name not in parameters]
    if missing:
        causes.append(
            f"torque_coefficient is CA_ROTORi_KM, which the allocation assumes, for want of {' and '.join(missing)}"
        )
    if causes:
        entries["rotor_coefficients"] = RotorCoefficients.NOMINAL.value
        notes += causes
        notes.append(
            "rotor_coefficients are nominal: rotor speeds and the power that a battery gives depend on them, so state "
            "hover_power in [plant.battery]"
        )
    return entries


def properties_of(
    parameters: Mapping[str, float], geometry: TomlTable, hover_speed: float | None, notes: list[str]
) -> TomlTable:
    """Make the entries of the vehicle for mass, inertia, thrust, drag and lag; every estimate adds a note.

    The file's inertia is the whole vehicle's, so the rotors' inertia is zero. PX4's lag delays the thrust; near hover,
    where the thrust is linear in the rotor speed, the speed has the same lag. SIH_KDV v is the propellers' drag at
    their speed in hover.

    Args:
        parameters: The file's parameters.
        geometry: Entries of the vehicle that place its rotors.
        hover_speed: Speed of the rotors in hover [rad/s]; None: it is not known.
        notes: The list to which notes are added.

    Raises:
        ConfigError: MPC_THR_HOVER is not in (0, 1], or the rotors cannot command all axes.
    """
    mass = parameters["SIH_MASS"]
    lift = hover_thrust(parameters, geometry)
    properties: TomlTable = {"mass": mass, "rotor_inertia_xy": 0.0, "rotor_inertia_z": 0.0}
    properties["body_inertia"] = body_inertia(parameters, geometry["arm"], notes)
    properties |= coefficient_entries(parameters, lift, hover_speed, notes)
    speed = HOVER_SPEED if hover_speed is None else hover_speed
    properties |= drag_entries(parameters, rotors_of(geometry) * speed, notes)
    properties |= thrust_entries(parameters, lift, notes)
    if "SIH_T_TAU" in parameters:
        properties["motor_lag"] = parameters["SIH_T_TAU"]
    else:
        notes.append("motor_lag is left out, so that rotors follow at once: the file does not set SIH_T_TAU")
    if any(parameters.get(name, 0.0) for name in PRODUCTS):
        notes.append(f"{', '.join(PRODUCTS)} are left out: the model's axes are principal axes")
    return properties


def with_simulation_defaults(parameters: dict[str, float], notes: list[str]) -> dict[str, float]:
    """Add PX4's defaults of the simulation in hardware, with a note, if the file is one for that simulation.

    A file for the simulation in hardware sets SIH_VEHICLE_TYPE.

    Raises:
        ConfigError: The file is for another vehicle than a multirotor.
    """
    if "SIH_VEHICLE_TYPE" not in parameters:
        return parameters
    if parameters["SIH_VEHICLE_TYPE"] not in SIH_MULTIROTORS:
        kinds = ", ".join(f"{number} ({kind})" for number, kind in SIH_MULTIROTORS.items())
        raise ConfigError(
            "SIH_VEHICLE_TYPE", f"must be that of a multirotor, {kinds}, got {parameters['SIH_VEHICLE_TYPE']:g}"
        )
    unset = [name for name in SIH_DEFAULTS if name not in parameters]
    if unset:
        notes.append(f"{', '.join(unset)} are PX4's defaults of the simulation in hardware")
    return SIH_DEFAULTS | parameters


def with_stated_sizes(
    parameters: dict[str, float], mass: float | None, arm: float | None, notes: list[str]
) -> dict[str, float]:
    """The parameters with the stated mass and arm in place of the file's.

    Args:
        parameters: The file's parameters.
        mass: Mass [kg]; None: the file's stays.
        arm: Length of an arm [m]; None: the file's lengths stay.
        notes: The list to which a note is added if the masses differ.
    """
    stated_values = {}
    if mass is not None:
        stated_values["SIH_MASS"] = mass
        if parameters.get("SIH_MASS", mass) != mass:
            notes.append(f"the mass is the stated one, {mass:g} kg, in place of SIH_MASS = {parameters['SIH_MASS']:g}")
    if arm is not None:
        stated_values |= {"SIH_L_ROLL": arm, "SIH_L_PITCH": arm}
    return parameters | stated_values


def drop_torque_of_single_rotors(vehicle: TomlTable) -> None:
    """Remove the torque coefficient of each listed rotor, so that the vehicle's own holds for all rotors.

    The vehicle's coefficient is then that of the simulated plant, from SIH_Q_MAX and SIH_T_MAX.
    """
    for entry in vehicle.get("rotor", []):
        entry.pop("torque_coefficient")
