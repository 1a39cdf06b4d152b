"""The rotors of a PX4 file: from CA_ROTORi_ to entries of [plant.vehicle], and the check that they can fly.

:mod:`dssc_jax.models.uav.airframe` describes PX4's axes and the model's.
"""

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.uav.allocation import flying_allocation
from dssc_jax.models.uav.vehicle import QUADROTOR, ROUNDED_TO_ZERO, Rotor, RotorCoefficients, Vehicle

SIMILAR = 0.01
"""Largest relative deviation from the mean at which rotors' thrust coefficients count as equal."""
ROUNDED = 1e-4
"""Largest relative deviation from the mean at which distances and torques of rotors are equal but for rounding."""
RATIOS = (-1.0, -0.866025, -0.866, -0.707, -0.5, 0.0, 0.5, 0.707, 0.866, 0.866025, 1.0)
"""Coordinates that occur in PX4's generic airframes, which give ratios in place of metres."""
MULTIROTOR = 0
"""Value of CA_AIRFRAME for a multirotor."""
MOST_ROTORS = 12
"""Largest number of rotors that PX4's control allocation supports."""
MOMENT_COEFFICIENT = 0.05
THRUST_COEFFICIENT = 6.5
AXIS = (0.0, 0.0, -1.0)
"""PX4's defaults of CA_ROTORi_KM, CA_ROTORi_CT and CA_ROTORi_AX, _AY, _AZ."""

REFUSED = {
    "CA_R_REV": "has reversible rotors, and a rotor of the model pushes one way",
    "CA_SV_TL_COUNT": "has servos that tilt rotors, and a rotor of the model is fixed",
}
"""Parameters that must be 0, because the model lacks what they describe, with the reason for the message."""

ROTOR_PARAMETERS = (
    "CA_AIRFRAME",
    "CA_ROTOR_COUNT",
    *REFUSED,
    *(f"CA_ROTOR{i}_{part}" for i in range(MOST_ROTORS) for part in ("PX", "PY", "PZ", "AX", "AY", "AZ", "KM", "CT")),
)
"""Parameters that are read here."""

PX4_NAMES = {
    "spins": "CA_ROTORi_KM",
    "rotor": "CA_ROTORi_PX, _PY, _PZ, _AX, _AY, _AZ, _KM",
    "rotor_angles": "CA_ROTORi_PX, _PY",
    "max_thrust": "SIH_T_MAX, MPC_THR_HOVER",
    "body_inertia": "SIH_IXX, SIH_IYY, SIH_IZZ",
}
"""PX4's parameters behind each entry of the vehicle, for messages."""


class PlacedRotor(NamedTuple):
    """A rotor in the model's axes.

    Args:
        place: Position relative to the centre of mass [m]; ratios in files of generic airframes.
        axis: Direction of the thrust.
        moment: CA_ROTORi_KM, the torque over the thrust with PX4's sign of the spin [m].
    """

    place: tuple[float, float, float]
    axis: tuple[float, float, float]
    moment: float


def are_equal(values: list[float], share: float) -> bool:
    """Whether all values differ from their mean by at most ``share`` times the mean."""
    mean = sum(values) / len(values)
    return all(abs(value - mean) <= share * abs(mean) for value in values)


def require_common(values: list[float], subject: str) -> None:
    """Require that all rotors have the same value of a parameter, up to ``SIMILAR``.

    Args:
        values: The value of each rotor.
        subject: Name of the parameter, for the message.

    Raises:
        ConfigError: The values differ by more.
    """
    if not are_equal(values, SIMILAR):
        values_text = ", ".join(f"{value:g}" for value in values)
        raise ConfigError(subject, f"must be the same for all rotors, which have one largest thrust; got {values_text}")


def rotor_count(parameters: Mapping[str, float]) -> int:
    """The number of rotors of a multirotor with fixed rotors that push one way.

    Raises:
        ConfigError: The airframe is of another kind, or the number is not from 4 to ``MOST_ROTORS``.
    """
    if parameters.get("CA_AIRFRAME", MULTIROTOR) != MULTIROTOR:
        raise ConfigError("CA_AIRFRAME", f"must be 0, a multirotor, got {parameters['CA_AIRFRAME']:g}")
    for name, reason in REFUSED.items():
        if parameters.get(name, 0.0):
            raise ConfigError(name, f"must be 0, got {parameters[name]:g}: the airframe {reason}")
    count = parameters.get("CA_ROTOR_COUNT", 0.0)
    if count not in range(4, MOST_ROTORS + 1):
        rule = f"must be a whole number from 4 to {MOST_ROTORS}, got {count:g}"
        reason = ": fewer fixed rotors than 4 cannot hold thrust and three moments" if count < 4 else ""
        raise ConfigError("CA_ROTOR_COUNT", f"{rule}{reason}")
    return int(count)


def require_places(parameters: Mapping[str, float], count: int) -> None:
    """Require that each of ``count`` rotors has a horizontal coordinate, if at least one of them has any.

    Raises:
        ConfigError: Some rotors have a coordinate and others have none; the message names the others.
    """
    unplaced = []
    for i in range(count):
        if f"CA_ROTOR{i}_PX" not in parameters and f"CA_ROTOR{i}_PY" not in parameters:
            unplaced.append(i)
    if 0 < len(unplaced) < count:
        names = ", ".join(f"CA_ROTOR{i}_PX, _PY" for i in unplaced)
        rule = f"must be set, to 0 for a rotor at the centre: CA_ROTOR_COUNT is {count:g}, and the file gives no place"
        raise ConfigError(names, rule)


def placed_rotor(parameters: Mapping[str, float], index: int) -> PlacedRotor:
    """Rotor ``index``, from 0, turned from PX4's axes (forward, right, down) to the model's (forward, left, up).

    Raises:
        ConfigError: The rotor's axis is zero.
    """
    name = f"CA_ROTOR{index}"
    ax, ay, az = (parameters.get(f"{name}_A{c}", default) for c, default in zip("XYZ", AXIS, strict=True))
    px, py, pz = (parameters.get(f"{name}_P{c}", 0.0) for c in "XYZ")
    if not (ax or ay or az):
        raise ConfigError(f"{name}_AX, _AY, _AZ", "must not all be 0")
    return PlacedRotor(
        place=(px, -py + 0.0, -pz + 0.0),  # + 0.0 turns -0.0 into 0.0
        axis=(ax, -ay + 0.0, -az + 0.0),
        moment=parameters.get(f"{name}_KM", MOMENT_COEFFICIENT),
    )


def placed_rotors(parameters: Mapping[str, float]) -> list[PlacedRotor]:
    """The rotors that CA_ROTOR_COUNT and CA_ROTORi_ describe.

    Raises:
        ConfigError: The airframe is no multirotor of the model, a rotor has no place or no axis, all rotors are at the
            centre, or their thrust coefficients differ.
    """
    count = rotor_count(parameters)
    require_places(parameters, count)
    rotors = [placed_rotor(parameters, i) for i in range(count)]
    require_common([parameters.get(f"CA_ROTOR{i}_CT", THRUST_COEFFICIENT) for i in range(count)], "CA_ROTORi_CT")
    if all(math.hypot(*rotor.place) < ROUNDED_TO_ZERO for rotor in rotors):
        raise ConfigError("CA_ROTORi_PX, CA_ROTORi_PY", "must be given; all rotors are at the centre")
    return rotors


def geometry_of(rotors: list[PlacedRotor]) -> TomlTable:
    """The entries of the vehicle that place its rotors: angles for equal rotors on a level circle, else a list."""
    moments = [rotor.moment for rotor in rotors]
    places = [rotor.place for rotor in rotors]
    axes = [rotor.axis for rotor in rotors]
    is_upright = all(x == 0.0 and y == 0.0 and z > 0.0 for x, y, z in axes)
    distances = [math.hypot(x, y) for x, y, _ in places]
    arm = sum(distances) / len(distances)
    mean_moment = sum(map(abs, moments)) / len(moments)
    is_regular = are_equal(distances, ROUNDED) and are_equal([abs(moment) for moment in moments], ROUNDED)
    is_level = all(z == 0.0 for _, _, z in places)
    signs = [-math.copysign(1.0, moment) for moment in moments]  # of the drag torque, s_i
    if is_upright and is_regular and is_level:
        return {
            "arm": arm,
            "torque_coefficient": mean_moment,
            "rotor_angles": [math.atan2(y, x) for x, y, _ in places],
            "spins": signs,
        }
    rotor_entries = []
    for rotor, sign in zip(rotors, signs, strict=True):
        entry: TomlTable = {"position": list(rotor.place), "direction": sign, "torque_coefficient": abs(rotor.moment)}
        rotor_entries.append(entry if is_upright else entry | {"axis": list(rotor.axis)})
    return {"arm": arm, "torque_coefficient": mean_moment, "rotor": rotor_entries}


def vehicle_of(table: TomlTable) -> Vehicle:
    """The vehicle of the table ``[plant.vehicle]``, or of some of its entries; ``QUADROTOR`` has the missing ones."""
    values = {name: value for name, value in table.items() if name in Vehicle._fields and name != "rotor"}
    common = {"torque_coefficient": table["torque_coefficient"]}  # of rotors that state none
    rotors = tuple(Rotor(**(common | entry)) for entry in table.get("rotor", ()))
    coefficients = RotorCoefficients(table.get("rotor_coefficients", RotorCoefficients.ACTUAL))
    return QUADROTOR._replace(**(values | {"rotor": rotors, "rotor_coefficients": coefficients}))


@contextmanager
def errors_in_px4_names(parameters: Mapping[str, float]) -> Iterator[None]:
    """In every error about a vehicle that is raised inside, replace names of fields by PX4's names of parameters.

    Args:
        parameters: PX4's parameters; the message names the rotors that have a default in place of one.

    Raises:
        ConfigError: The error raised inside, with PX4's names.
    """
    try:
        yield
    except ConfigError as error:
        rule = re.sub(r"\b(?:rotor|rotor_angles)\.(\d+)", r"CA_ROTOR\1", error.rule)
        place = PX4_NAMES.get(error.where, error.where)
        raise ConfigError(place, rule + (default_text(parameters) if place.startswith("CA_ROTOR") else "")) from None


def flying_vehicle(table: TomlTable, parameters: Mapping[str, float]) -> Vehicle:
    """The vehicle of a table, which must be able to hover and to command all axes.

    Args:
        table: The table ``[plant.vehicle]``.
        parameters: PX4's parameters from which the table was made.

    Raises:
        ConfigError: The vehicle cannot do so; the message has PX4's names of the parameters.
    """
    vehicle = vehicle_of(table)
    with errors_in_px4_names(parameters):
        flying_allocation(vehicle)
    return vehicle


def default_text(parameters: Mapping[str, float]) -> str:
    """The end of a message that names the rotors whose KM is PX4's default; empty if the file sets them all."""
    names = [f"CA_ROTOR{i}_KM" for i in range(int(parameters.get("CA_ROTOR_COUNT", 0)))]
    missing = [name for name in names if name not in parameters]
    if not missing:
        return ""
    return f"; the file does not set {', '.join(missing)}, for which PX4's default {MOMENT_COEFFICIENT:g} counts"


def are_ratios(rotors: list[PlacedRotor]) -> bool:
    """Whether the rotors' positions are ratios of a generic airframe, and not metres.

    They are if all horizontal coordinates occur in ``RATIOS``, and the largest one is about 1.
    """
    coordinates: list[float] = []
    for rotor in rotors:
        coordinates += rotor.place[:2]
    return max(map(abs, coordinates)) >= 0.99 and all(value in RATIOS for value in coordinates)


def in_metres(rotors: list[PlacedRotor], parameters: Mapping[str, float]) -> list[PlacedRotor]:
    """The rotors in metres: ratios of a generic airframe times the arm lengths SIH_L_PITCH and SIH_L_ROLL.

    PX4 has no such length for heights; they are multiplied by the mean of both lengths.
    """
    forward = parameters["SIH_L_PITCH"]
    lateral = parameters["SIH_L_ROLL"]
    placed = []
    for rotor in rotors:
        x, y, z = rotor.place
        placed.append(rotor._replace(place=(x * forward, y * lateral, z * 0.5 * (forward + lateral))))
    return placed
