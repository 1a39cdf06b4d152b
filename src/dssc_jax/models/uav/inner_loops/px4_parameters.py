"""PX4's parameters as the gains of its cascade."""

import itertools
import math
from collections.abc import Mapping

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
"""PX4's parameters of the fields that are single numbers in the same units."""
TRIPLES = {
    "attitude_p": ("MC_ROLL_P", "MC_PITCH_P", "MC_YAW_P"),
    "rate_i": ("MC_ROLLRATE_I", "MC_PITCHRATE_I", "MC_YAWRATE_I"),
    "rate_p": ("MC_ROLLRATE_P", "MC_PITCHRATE_P", "MC_YAWRATE_P"),
    "rate_d": ("MC_ROLLRATE_D", "MC_PITCHRATE_D", "MC_YAWRATE_D"),
    "rate_ff": ("MC_ROLLRATE_FF", "MC_PITCHRATE_FF", "MC_YAWRATE_FF"),
    "rate_integral_max": ("MC_RR_INT_LIM", "MC_PR_INT_LIM", "MC_YR_INT_LIM"),
}
DEGREES = {"rate_max": ("MC_ROLLRATE_MAX", "MC_PITCHRATE_MAX", "MC_YAWRATE_MAX")}
FACTORS = ("MC_ROLLRATE_K", "MC_PITCHRATE_K", "MC_YAWRATE_K")
"""PX4's factors of the gains P, I and D of the rate loops."""
FACTORED = ("rate_p", "rate_i", "rate_d")
TILT = "MPC_TILTMAX_AIR"
GAIN_PARAMETERS = (*PARAMETERS.values(), *itertools.chain(*(TRIPLES | DEGREES).values()), *FACTORS, TILT)
"""All parameters of PX4 that :func:`gains_from` takes."""


def gains_from(parameters: Mapping[str, float]) -> TomlTable:
    """The table ``[plant.inner_loop]`` for PX4's parameters MC_ and MPC_; entries that they do not set are left out."""
    table: TomlTable = {"kind": "px4"}
    for field, name in PARAMETERS.items():
        if name in parameters:
            table[field] = parameters[name]
    for field, names in (TRIPLES | DEGREES).items():
        involved = names + FACTORS if field in FACTORED else names
        if not any(name in parameters for name in involved):
            continue
        values = []
        for place, name in enumerate(names):
            default = Px4Gains._field_defaults[field][place]
            value = parameters.get(name, math.degrees(default) if field in DEGREES else default)
            value = math.radians(value) if field in DEGREES else value
            values.append(value * parameters.get(FACTORS[place], 1.0) if field in FACTORED else value)
        table[field] = values
    if TILT in parameters:
        table["tilt_max"] = math.radians(parameters[TILT])
    return table
