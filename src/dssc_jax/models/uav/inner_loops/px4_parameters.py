"""PX4's parameters as the gains of its cascade.

References:
    PX4 Autopilot, parameter definitions of mc_pos_control, mc_att_control and mc_rate_control (ranges and units).
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import replace

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import quantities_of
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.uav.inner_loops.px4 import Px4Gains

PARAMETERS = {
    "velocity_p_xy": "MPC_XY_VEL_P_ACC",
    "velocity_i_xy": "MPC_XY_VEL_I_ACC",
    "velocity_d_xy": "MPC_XY_VEL_D_ACC",
    "velocity_p_z": "MPC_Z_VEL_P_ACC",
    "velocity_i_z": "MPC_Z_VEL_I_ACC",
    "velocity_d_z": "MPC_Z_VEL_D_ACC",
    "thrust_min": "MPC_THR_MIN",
    "thrust_max": "MPC_THR_MAX",
    "thrust_margin": "MPC_THR_XY_MARG",
    "thrust_hover": "MPC_THR_HOVER",
    "yaw_weight": "MC_YAW_WEIGHT",
    "gyro_cutoff": "IMU_GYRO_CUTOFF",
    "derivative_cutoff": "IMU_DGYRO_CUTOFF",
}
"""PX4's parameter of each field that is a single number in the same unit."""
TRIPLES = {
    "attitude_p": ("MC_ROLL_P", "MC_PITCH_P", "MC_YAW_P"),
    "rate_i": ("MC_ROLLRATE_I", "MC_PITCHRATE_I", "MC_YAWRATE_I"),
    "rate_p": ("MC_ROLLRATE_P", "MC_PITCHRATE_P", "MC_YAWRATE_P"),
    "rate_d": ("MC_ROLLRATE_D", "MC_PITCHRATE_D", "MC_YAWRATE_D"),
    "rate_ff": ("MC_ROLLRATE_FF", "MC_PITCHRATE_FF", "MC_YAWRATE_FF"),
    "rate_integral_max": ("MC_RR_INT_LIM", "MC_PR_INT_LIM", "MC_YR_INT_LIM"),
}
"""PX4's parameters of each field that has a number for roll, pitch and yaw, in the same unit."""
DEGREES = {"rate_max": ("MC_ROLLRATE_MAX", "MC_PITCHRATE_MAX", "MC_YAWRATE_MAX")}
"""PX4's parameters in degrees, of fields in radians."""
FACTORS = ("MC_ROLLRATE_K", "MC_PITCHRATE_K", "MC_YAWRATE_K")
"""PX4's factors of the gains P, I and D of the rate loops."""
FACTORED = ("rate_p", "rate_i", "rate_d")
"""The fields of these gains."""
TILT = "MPC_TILTMAX_AIR"
LOOP_RATE = "IMU_GYRO_RATEMAX"
"""PX4's parameter of the rate of the attitude and rate loops [Hz]."""
UNITS_OF_ANGLES = {"rad": " degrees", "rad/s": " degrees/s"}
"""PX4's units of angles and of their rates, by those of the cascade."""
GAIN_PARAMETERS = (*PARAMETERS.values(), *itertools.chain(*(TRIPLES | DEGREES).values()), *FACTORS, TILT)
"""All parameters of PX4 that :func:`gains_from` takes."""

RANGES = {
    "MPC_XY_VEL_P_ACC": (1.2, 5.0),
    "MPC_XY_VEL_I_ACC": (0.0, 60.0),
    "MPC_XY_VEL_D_ACC": (0.1, 2.0),
    "MPC_Z_VEL_P_ACC": (2.0, 15.0),
    "MPC_Z_VEL_I_ACC": (0.2, 3.0),
    "MPC_Z_VEL_D_ACC": (0.0, 2.0),
    "MPC_THR_MIN": (0.05, 0.5),
    "MPC_THR_HOVER": (0.1, 0.8),
    TILT: (20.0, 89.0),
    "MC_ROLL_P": (0.0, 12.0),
    "MC_PITCH_P": (0.0, 12.0),
    "MC_YAW_P": (0.0, 5.0),
    "MC_ROLLRATE_P": (0.01, 0.5),
    "MC_PITCHRATE_P": (0.01, 0.6),
    "MC_YAWRATE_P": (0.0, 0.6),
    "MC_ROLLRATE_D": (0.0, 0.01),
    "MC_ROLLRATE_K": (0.01, 5.0),
    "MC_PITCHRATE_K": (0.01, 5.0),
    "MC_YAWRATE_K": (0.0, 5.0),
    "MPC_XY_P": (0.0, 2.0),
    "MPC_Z_P": (0.0, 1.5),
    "IMU_GYRO_RATEMAX": (100.0, 2000.0),
}
"""The range that PX4 states for a parameter, in its unit."""
USUAL = {
    **dict.fromkeys(TRIPLES["rate_integral_max"], (0.0, 1.0)),
    **dict.fromkeys(DEGREES["rate_max"], (10.0, 1800.0)),
}
"""Assumed ranges of parameters for which PX4 states none, or one from 0 on: shares of the largest torque, degrees/s."""


def require_admissible(parameters: Mapping[str, float]) -> None:
    """Require values of PX4's parameters that the cascade admits.

    Raises:
        ConfigError: A value is not admissible; the message has PX4's name and unit of the parameter.
    """
    require_ranges(parameters)
    defaults = Px4Gains._field_defaults
    for name in FACTORS:
        if parameters.get(name, 1.0) < 0.0:
            raise ConfigError(name, f"must be >= 0, got {parameters[name]:g}")
    least = parameters.get("MPC_THR_MIN", defaults["thrust_min"])
    largest = parameters.get("MPC_THR_MAX", defaults["thrust_max"])
    if not least < largest:
        raise ConfigError("MPC_THR_MIN", f"must be < MPC_THR_MAX = {largest:g}, got {least:g}")
    cutoff = parameters.get("IMU_GYRO_CUTOFF", 0.0)
    limit = 0.5 * (parameters.get(LOOP_RATE, 0.0) or defaults["frequency"])
    if not cutoff < limit:
        raise ConfigError("IMU_GYRO_CUTOFF", f"must be below half the rate of the loops, {limit:g} Hz, got {cutoff:g}")


def require_ranges(parameters: Mapping[str, float]) -> None:
    """Require each of PX4's parameters to be in the range of its field, converted to PX4's unit.

    Raises:
        ConfigError: One is not.
    """
    quantities = quantities_of(Px4Gains)
    field_of = {name: field for field, name in PARAMETERS.items()} | {TILT: "tilt_max"}
    for field, names in (TRIPLES | DEGREES).items():
        field_of |= dict.fromkeys(names, field)
    for name, field in field_of.items():
        if name not in parameters:
            continue
        quantity = quantities[field]
        unit = UNITS_OF_ANGLES.get(quantity.unit, "")
        if unit:
            quantity = replace(quantity, above=in_degrees(quantity.above), below=in_degrees(quantity.below))
        value = parameters[name]
        rule = quantity.violated_by(value, value)
        if rule is not None:
            raise ConfigError(name, f"{rule}{unit}, got {value:g}")


def in_degrees(angle: float | None) -> float | None:
    """A bound in degrees; None: there is none."""
    return None if angle is None else math.degrees(angle)


def unusual_gains(parameters: Mapping[str, float]) -> list[str]:
    """Warn of gains and limits outside of the ranges that PX4 states, as after a slip of a unit."""
    warnings = []
    for name, (low, high) in RANGES.items():
        value = parameters.get(name, low)
        if not low <= value <= high:
            unit = " degrees" if name == TILT else ""
            warnings.append(f"{name} is {value:g}{unit}; PX4's range is {low:g} to {high:g}: check the units")
    for name, (low, high) in USUAL.items():
        value = parameters.get(name, low)
        if not low <= value <= high:
            unit = " degrees/s" if name in DEGREES["rate_max"] else ""
            warnings.append(f"{name} is {value:g}{unit}; usual is {low:g} to {high:g}: check the units")
    return warnings


def triple(field: str, names: tuple[str, str, str], parameters: Mapping[str, float]) -> list[float]:
    """The gains of roll, pitch and yaw for a field; a gain that the parameters do not set has its default.

    PX4 multiplies some gains of the rate loops by a factor, which is 1 unless it is set.

    Args:
        field: Name of the field in :class:`Px4Gains`.
        names: PX4's parameters for roll, pitch and yaw.
        parameters: Values of PX4's parameters by name.
    """
    values = []
    for name, factor, default in zip(names, FACTORS, Px4Gains._field_defaults[field], strict=True):
        value = parameters.get(name, default)
        values.append(value * parameters.get(factor, 1.0) if field in FACTORED else value)
    return values


def triple_of_degrees(field: str, names: tuple[str, str, str], parameters: Mapping[str, float]) -> list[float]:
    """The values of roll, pitch and yaw for a field in radians [rad/s], from parameters in degrees.

    Args:
        field: Name of the field in :class:`Px4Gains`.
        names: PX4's parameters for roll, pitch and yaw.
        parameters: Values of PX4's parameters by name.
    """
    values = []
    for name, default in zip(names, Px4Gains._field_defaults[field], strict=True):
        values.append(math.radians(parameters.get(name, math.degrees(default))))
    return values


def gains_from(parameters: Mapping[str, float]) -> TomlTable:
    """The table ``[plant.inner_loop]`` for PX4's parameters MC_ and MPC_; entries that they do not set are left out.

    A field of three values is set if the parameters set at least one of them; PX4's defaults fill up the others.
    """
    table: TomlTable = {"kind": "px4"}
    for field, name in PARAMETERS.items():
        if name in parameters:
            table[field] = parameters[name]
    for field, names in TRIPLES.items():
        factors = FACTORS if field in FACTORED else ()
        if any(name in parameters for name in (*names, *factors)):
            table[field] = triple(field, names, parameters)
    for field, names in DEGREES.items():
        if any(name in parameters for name in names):
            table[field] = triple_of_degrees(field, names, parameters)
    if TILT in parameters:
        table["tilt_max"] = math.radians(parameters[TILT])
    return table
