"""Flights of the vehicle: a desired position and yaw over time."""

from typing import Annotated, NamedTuple, TypeAlias, TypeVar

import jax.numpy as jnp

from dssc_jax.core.contracts import NoParams, Reference
from dssc_jax.core.default_functions import unchanging
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ReferencePoint, Scalar
from dssc_jax.models.references.sine import MISSION, sine_at


class HoverParams(NamedTuple):
    """The position and yaw at which the vehicle hovers."""

    position: Annotated[tuple[Scalar, ...], Quantity("m", "desired position x, y, z")] = (0.0, 0.0, 0.0)
    yaw: Annotated[Scalar, Quantity("rad", "desired yaw")] = 0.0


class StepsParams(NamedTuple):
    """The position and yaw to which the vehicle steps from zero at the time ``at``."""

    position: Annotated[tuple[Scalar, ...], Quantity("m", "step of the position x, y, z")] = (0.0, 0.0, 0.0)
    yaw: Annotated[Scalar, Quantity("rad", "step of the yaw")] = 0.0
    at: Annotated[Scalar, Quantity("s", "time of the step", at_least=0.0, begins=True)] = 0.0


Flight: TypeAlias = tuple[ReferencePoint, ReferencePoint, ReferencePoint, ReferencePoint]
"""Desired points of x, y, z [m] and psi [rad]."""

Placed = TypeVar("Placed", HoverParams, StepsParams)


def require_place_in_space(params: Placed) -> Placed:
    """The parameters themselves, whose position must have the three values x, y, z.

    Raises:
        ConfigError: The position has another number of values.
    """
    if len(params.position) != 3:
        raise ConfigError("position", f"needs three values, got {len(params.position)}")
    return params


def fixed_point(position: tuple[Scalar, ...], yaw: Scalar) -> Flight:
    """The flight that stays at a position x, y, z [m] and a yaw [rad]."""
    x, y, z, psi = (ReferencePoint(value, 0.0, 0.0) for value in (*position, yaw))
    return x, y, z, psi


def steps_at(params: StepsParams, t: Scalar) -> Flight:
    """The flight at t [s]: at zero before the step, at its point afterwards."""
    begins = params.at * (1.0 - 1e-12)  # slightly early, because t = k T_s is rounded
    on = jnp.where(t >= begins, 1.0, 0.0)
    return fixed_point(tuple(on * value for value in params.position), on * params.yaw)


def whole_mission(params: NoParams, t: Scalar) -> Flight:
    """The article's mission in all four axes at t [s]; it has no parameters."""
    x, y, z, psi = (sine_at(axis, t) for axis in MISSION.values())
    return x, y, z, psi


MISSION_PERIOD = float(max(axis.period for axis in MISSION.values()))
"""The longest period of the mission's axes [s]."""

WHOLE_MISSION = Reference(NoParams, whole_mission, last_change=lambda params: MISSION_PERIOD)
HOVER = Reference(
    params=HoverParams,
    at=lambda params, t: fixed_point(params.position, params.yaw),
    prepare=require_place_in_space,
    last_change=unchanging,
)
STEPS = Reference(StepsParams, steps_at, require_place_in_space, last_change=unchanging)
