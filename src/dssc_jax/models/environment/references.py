"""Desired trajectories y_m with their first two derivatives."""

import math
from enum import StrEnum
from typing import Annotated, Any, NamedTuple, TypeAlias

import jax.numpy as jnp

from dssc_jax.core.contracts import NoParams, Reference
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import ReferencePoint, Scalar


class SineParams(NamedTuple):
    """y_m = offset + amplitude sin(2 pi t/period + phase)."""

    amplitude: Annotated[Scalar, Quantity("y", "amplitude")]
    period: Annotated[Scalar, Quantity("s", "period", above=0.0)]
    phase: Annotated[Scalar, Quantity("rad", "phase")] = 0.0
    offset: Annotated[Scalar, Quantity("y", "offset")] = 0.0


class Axis(StrEnum):
    """The mission's four degrees of freedom."""

    X = "x"
    Y = "y"
    Z = "z"
    PSI = "psi"


def sine_at(params: SineParams, t: Scalar) -> ReferencePoint:
    """The sine and its derivatives at t."""
    rate = 2.0 * math.pi / params.period
    angle = rate * t + params.phase
    swing, slope = params.amplitude * jnp.sin(angle), params.amplitude * rate * jnp.cos(angle)
    return ReferencePoint(params.offset + swing, slope, -rate * rate * swing)


MISSION = {
    Axis.X: SineParams(20.0, 40.0),
    Axis.Y: SineParams(20.0, 40.0, phase=math.pi / 2),
    Axis.Z: SineParams(3.0, 60.0, offset=5.0),
    Axis.PSI: SineParams(-math.pi / 4, 40.0, offset=math.pi / 4),
}
"""The desired trajectories of Section V-B: x, y, z in m, psi in rad."""


def mission(axis: Axis) -> Reference:
    """One axis of the mission, with the article's numbers."""
    return Reference(NoParams, lambda params, t: sine_at(MISSION[axis], t))


class HoverParams(NamedTuple):
    """A fixed position and yaw."""

    position: Annotated[tuple[Scalar, ...], Quantity("m", "desired position x, y, z")] = (0.0, 0.0, 0.0)
    yaw: Annotated[Scalar, Quantity("rad", "desired yaw")] = 0.0


class StepsParams(NamedTuple):
    """Steps of position and yaw from zero at the time ``at``."""

    position: Annotated[tuple[Scalar, ...], Quantity("m", "step of the position x, y, z")] = (0.0, 0.0, 0.0)
    yaw: Annotated[Scalar, Quantity("rad", "step of the yaw")] = 0.0
    at: Annotated[Scalar, Quantity("s", "time of the step", at_least=0.0)] = 0.0


Flight: TypeAlias = tuple[ReferencePoint, ReferencePoint, ReferencePoint, ReferencePoint]
"""Desired x, y, z and psi."""


def three_values(params: Any) -> Any:
    """Require a position of three values.

    Raises:
        ConfigError: otherwise.
    """
    if len(params.position) != 3:
        raise ConfigError("position", f"needs three values, got {len(params.position)}")
    return params


def resting(position: tuple[Scalar, ...], yaw: Scalar) -> Flight:
    """A fixed point."""
    x, y, z, psi = (ReferencePoint(value, 0.0, 0.0) for value in (*position, yaw))
    return x, y, z, psi


def steps_at(params: StepsParams, t: Scalar) -> Flight:
    """Zero before the step, the given point afterwards; exact to rounding at samples t = k T_s."""
    on = jnp.where(t >= params.at * (1.0 - 1e-12), 1.0, 0.0)
    return resting(tuple(on * value for value in params.position), on * params.yaw)


def whole_mission(params: NoParams, t: Scalar) -> Flight:
    """All four axes."""
    x, y, z, psi = (sine_at(axis, t) for axis in MISSION.values())
    return x, y, z, psi


WHOLE_MISSION = Reference(NoParams, whole_mission)
HOVER = Reference(HoverParams, lambda params, t: resting(params.position, params.yaw), three_values)
STEPS = Reference(StepsParams, steps_at, three_values)
ZERO = Reference(NoParams, lambda params, t: ReferencePoint(0.0, 0.0, 0.0))
SINE = Reference(SineParams, sine_at)
MISSION_ENTRY = Entry({axis: mission(axis) for axis in Axis}, "one axis of the article's mission", "axis", Axis.X)
