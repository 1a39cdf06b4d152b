"""Plausibility of a vehicle's numbers: usual ranges of multirotors, for warnings about a slip of a unit or a factor."""

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from dssc_jax.core.quantities import nominal
from dssc_jax.models.uav.allocation import pseudo_inverse
from dssc_jax.models.uav.authority import largest_accelerations
from dssc_jax.models.uav.battery import Battery, rotor_power
from dssc_jax.models.uav.desaturation import rotors_of_full_thrust
from dssc_jax.models.uav.vehicle import GRAVITY, Vehicle

GEOMETRY = ("rotor", "rotor_angles", "spins", "torque_coefficient", "arm")
"""Fields of a vehicle that determine its control authority."""
LEAST_ACCELERATIONS = {"roll": 2.0, "pitch": 2.0, "yaw": 0.3}
"""Largest angular accelerations in hover [rad/s^2] of the slowest large multirotors; assumed."""

USUAL_POWER = (50.0, 300.0)
"""Electrical power of multirotors in hover over their mass [W/kg]; assumed."""


class UsualRange(NamedTuple):
    """A number of a vehicle and the range that multirotors usually have.

    Args:
        name: Meaning of the number.
        fields: Fields of the vehicle from which it follows.
        value: Value of the number.
        low: Lower end of the usual range.
        high: Upper end of the usual range.
        unit: Unit of value and range.
    """

    name: str
    fields: tuple[str, ...]
    value: float
    low: float
    high: float
    unit: str


def usual_ranges(vehicle: Vehicle) -> list[UsualRange]:
    """The numbers of a vehicle that are compared with usual ranges; laws count with their medians.

    All ranges are assumed.

    * Hover throttle is the share of the largest thrust that carries the weight.
    * Torque over thrust of a propeller is a few per cent of its diameter.
    * The radius of gyration is taken about a horizontal axis.
    * Mass over the square of the arm is some 13 kg/m^2 for a Crazyflie, and 30 to 60 kg/m^2 for larger vehicles; a mass
      in grams or an arm in millimetres leaves the range.
    """
    mass = nominal(vehicle.mass)
    arm = distance_of_rotors(vehicle)
    inertia = [nominal(value) for value in vehicle.body_inertia]
    transverse = 0.5 * (inertia[0] + inertia[1]) + vehicle.rotors * nominal(vehicle.rotor_inertia_xy)
    gyration_radius = (transverse / mass) ** 0.5
    weight = mass * GRAVITY
    coefficients = [nominal(value) for value in vehicle.thrust_coefficients]
    allocation = pseudo_inverse(vehicle)
    full_thrust = rotors_of_full_thrust(allocation) * vehicle.nominal_thrust_limit
    hover_speed = (weight / sum(coefficients)) ** 0.5
    torque_over_thrust = max(nominal(value) for value in vehicle.torque_coefficients)
    relative_gyration = gyration_radius / arm
    ranges = [
        UsualRange("mean distance of the rotors from the centre", ("arm", "rotor"), arm, 0.02, 3.0, "m"),
        UsualRange("mass over square of arm", ("mass", "arm", "rotor"), mass / arm**2, 3.0, 300.0, "kg/m^2"),
        UsualRange("hover throttle", ("max_thrust",), weight / full_thrust, 0.1, 0.7, "of f_max"),
        UsualRange("torque over thrust", ("torque_coefficient",), torque_over_thrust, 0.002, 0.1, "m"),
        UsualRange("radius of gyration over arm", ("mass", "arm", "body_inertia"), relative_gyration, 0.15, 1.2, ""),
        UsualRange("hover speed of a rotor", ("thrust_coefficient", "mass"), hover_speed, 50.0, 4000.0, "rad/s"),
    ]  # fmt: skip
    if vehicle.motor_lag is not None:
        ranges.append(UsualRange("motor lag", ("motor_lag",), nominal(vehicle.motor_lag), 0.01, 0.15, "s"))
    accelerations = largest_accelerations(vehicle, np.array(allocation))
    for axis, least in LEAST_ACCELERATIONS.items():
        name = f"largest {axis} acceleration in hover"
        ranges.append(UsualRange(name, GEOMETRY, accelerations[axis], least, math.inf, "rad/s^2"))
    return ranges


def unusual_power(vehicle: Vehicle, battery: Battery) -> list[str]:
    """Warn of a battery's power in hover that is unusual for the vehicle's mass; no warning is an empty list.

    The rotors are taken to have equal thrusts in hover, and laws count with their medians.

    Args:
        vehicle: The vehicle.
        battery: Its battery, with an efficiency or a hover power.
    """
    mass = nominal(vehicle.mass)
    if battery.efficiency is None:
        power = nominal(battery.hover_power)
        cause = "hover_power"
    else:
        torques = [nominal(value) for value in vehicle.torque_coefficients]
        coefficients = [nominal(value) for value in vehicle.thrust_coefficients]
        thrust = mass * GRAVITY / vehicle.rotors
        speeds = [math.sqrt(thrust / coefficient) for coefficient in coefficients]
        power = float(rotor_power(torques, coefficients, speeds)) / nominal(battery.efficiency)
        cause = "efficiency, and plant.vehicle.thrust_coefficient and torque_coefficient"
    low, high = USUAL_POWER
    if low <= power / mass <= high:
        return []
    value = f"the battery's power in hover is {power:.3g} W, {power / mass:.3g} W/kg"
    return [f"{value}, usual are {low:g} to {high:g} W/kg; see plant.battery.{cause}"]


def distance_of_rotors(vehicle: Vehicle) -> float:
    """Mean distance of the rotors from the vertical body axis z [m]; laws count with their medians."""
    if not vehicle.rotor:
        return nominal(vehicle.arm)
    places = [tuple(map(nominal, rotor.position)) for rotor in vehicle.rotor]
    return sum(math.hypot(x, y) for x, y, _ in places) / len(places)


def implausible(vehicle: Vehicle, fields: Collection[str]) -> list[str]:
    """Warn of each number that is outside of its usual range and follows from a field that the study gives.

    Args:
        vehicle: The vehicle.
        fields: Names of the fields that the study gives; the others are a known vehicle's.
    """
    lines = []
    for number in usual_ranges(vehicle):
        is_usual = number.low <= number.value <= number.high
        stated_fields = [field for field in number.fields if field in fields]
        if is_usual or not stated_fields:
            continue
        value_text = f"{number.name} is {number.value:.3g} {number.unit}".rstrip()
        range_text = f"usual are {number.low:g} to {number.high:g}"
        if math.isinf(number.high):
            range_text = f"usual is at least {number.low:g}"
        lines.append(f"{value_text}, {range_text}; see plant.vehicle.{' and '.join(stated_fields)}")
    return lines
