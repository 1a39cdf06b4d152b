"""Sines as desired outputs, and the four axes of the article's mission.

In units, y stands for the unit of the plant's output.
"""

import math
from enum import StrEnum
from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import NoParams, Reference
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import ReferencePoint, Scalar


class SineParams(NamedTuple):
    """The sine y_m = offset + amplitude sin(2 pi t/period + phase)."""

    amplitude: Annotated[Scalar, Quantity("y", "amplitude")]
    period: Annotated[Scalar, Quantity("s", "period", above=0.0)]
    phase: Annotated[Scalar, Quantity("rad", "phase")] = 0.0
    offset: Annotated[Scalar, Quantity("y", "offset")] = 0.0


class Axis(StrEnum):
    """The vehicle's four degrees of freedom: position and yaw."""

    X = "x"
    Y = "y"
    Z = "z"
    PSI = "psi"


def sine_at(params: SineParams, t: Scalar) -> ReferencePoint:
    """The sine y_m and its derivatives y_m', y_m'' at t [s]."""
    rate = 2.0 * math.pi / params.period
    angle = rate * t + params.phase
    swing = params.amplitude * jnp.sin(angle)
    slope = params.amplitude * rate * jnp.cos(angle)
    return ReferencePoint(params.offset + swing, slope, -rate * rate * swing)


MISSION = {
    Axis.X: SineParams(20.0, 40.0),
    Axis.Y: SineParams(20.0, 40.0, phase=math.pi / 2),
    Axis.Z: SineParams(3.0, 60.0, offset=5.0),
    Axis.PSI: SineParams(-math.pi / 4, 40.0, offset=math.pi / 4),
}
"""The desired trajectories of Section V-B: x, y, z in m, psi in rad."""


def mission(axis: Axis) -> Reference:
    """Make the reference of one axis of the article's mission, which has no parameters."""
    return Reference(
        params=NoParams,
        at=lambda params, t: sine_at(MISSION[axis], t),
        last_change=lambda params: float(MISSION[axis].period),
    )


SINE = Reference(SineParams, sine_at, level=lambda params: params.offset, last_change=lambda params: params.period)
MISSION_ENTRY = Entry({axis: mission(axis) for axis in Axis}, "one axis of the article's mission", "axis", Axis.X)
