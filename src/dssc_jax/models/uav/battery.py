"""A battery: its voltage falls with its charge and with the current, and with it the speed of all rotors.

With the share s of its charge Q left, the battery has the voltage V_0 = V_e + (V_f - V_e) s at rest, and V = V_0 - R I
under the current I. The commanded speeds w_i are those at the full voltage V_f; the rotors turn at r w_i with
r = V/V_f. The rotors take the power V I = r^3 P, where P = sum of c_tau,i k_T,i w_i^3/eta. Therefore
R P r^2/V_f + V_f r - V_0 = 0, and s' = -I/Q. A battery without charge gives no voltage and no current.

If a hover power P_h is given in place of eta, P is P_h times the sum of c_tau,i k_T,i w_i^3 over its value in hover.
Then P depends on thrusts alone: a common factor of all k_T or of all c_tau cancels.
"""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.models.uav.vehicle import RotorCoefficients, Vehicle


class Battery(NamedTuple):
    """A battery whose voltage without load is linear in its charge, and 0 V when no charge is left."""

    capacity: Annotated[Scalar, Quantity("A s", "charge Q of the full battery; 1 A h is 3600 A s", above=0.0)]
    resistance: Annotated[Scalar, Quantity("ohm", "internal resistance R, with cables", at_least=0.0)]
    full_voltage: Annotated[Scalar, Quantity("V", "voltage V_f at rest when full", above=0.0)]
    empty_voltage: Annotated[
        Scalar, Quantity("V", "voltage V_e at rest when empty", above=0.0, less_than="full_voltage")
    ]
    efficiency: Annotated[
        Scalar | None, Quantity("1", "efficiency eta of motors and controllers", above=0.0, at_most=1.0)
    ] = None
    charge: Annotated[Scalar, Quantity("1", "charge at the start, relative to Q", above=0.0, at_most=1.0)] = 1.0
    hover_power: Annotated[
        Scalar | None, Quantity("W", "power P_h in hover with the believed mass, in place of efficiency", above=0.0)
    ] = None


class Supply(NamedTuple):
    """What a battery supplies: its voltage r relative to the full battery's, and its current I [A]."""

    voltage: Scalar
    current: Scalar


def checked_battery(battery: Battery, vehicle: Vehicle) -> Battery:
    """The battery itself, if it states the power that the rotors take.

    Raises:
        ConfigError: Not exactly one of ``efficiency`` and ``hover_power`` is given, or an efficiency is given and the
            coefficients of the rotors are nominal, so that their power is not known.
    """
    if (battery.efficiency is None) == (battery.hover_power is None):
        raise ConfigError("battery", "needs either efficiency, or hover_power in watts")
    if battery.hover_power is None and vehicle.rotor_coefficients is RotorCoefficients.NOMINAL:
        rule = "needs hover_power in watts in place of efficiency: vehicle.rotor_coefficients is 'nominal', so that"
        remedy = "with the rotors' own thrust_coefficient and torque_coefficient, set 'actual'"
        raise ConfigError("battery", f"{rule} the rotors' power is not known; {remedy}")
    return battery


def rotor_power(
    torque_coefficients: Sequence[Scalar], thrust_coefficients: Sequence[Scalar], speeds: Sequence[Scalar]
) -> Scalar:
    """Mechanical power sum c_tau k_T |thetadot_i|^3 of the rotors [W].

    Args:
        torque_coefficients: c_tau of each rotor [m].
        thrust_coefficients: k_T of each rotor [N s^2/rad^2].
        speeds: Speed of each rotor [rad/s].
    """
    power: Scalar = 0.0
    for c_tau, k_t, speed in zip(torque_coefficients, thrust_coefficients, speeds, strict=True):
        power = power + jnp.abs(c_tau) * k_t * jnp.abs(speed) ** 3
    return power


def supply(battery: Battery, charge: Scalar, power: Scalar) -> Supply:
    """Voltage and current of a battery that drives the rotors, whose power is proportional to the voltage's cube.

    Args:
        battery: The battery.
        charge: Charge s, relative to that of the full battery.
        power: Power P that the rotors would take at full voltage [W].
    """
    full = battery.full_voltage
    open_circuit = jnp.where(charge > 0.0, battery.empty_voltage + (full - battery.empty_voltage) * charge, 0.0)
    load = battery.resistance * power / full
    # the positive root r of load r^2 + full r - open_circuit = 0, in the form without cancellation
    ratio = 2.0 * open_circuit / (full + jnp.sqrt(full * full + 4.0 * load * open_circuit))
    return Supply(ratio, power * ratio * ratio / full)
