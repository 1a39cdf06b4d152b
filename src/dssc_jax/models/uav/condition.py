"""Effects of events on the vehicle: the speeds of its rotors, and the wind at its height."""

from collections.abc import Sequence

from dssc_jax.core.events import Condition
from dssc_jax.core.numerics import root_abs
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.models.uav.rotors import RotorMotion


def voltage_of(condition: Condition | None) -> Scalar:
    """The voltage after events, relative to the voltage without them; 1 if no event changes it."""
    return 1.0 if condition is None or condition.voltage is None else condition.voltage


def conditioned_motion(motion: RotorMotion, condition: Condition | None) -> RotorMotion:
    """The motion of the rotors after events, which multiply each speed by a factor.

    A rotor's factor is the relative voltage times the square root of the rotor's share of thrust, because thrust goes
    with the square of the speed.

    Args:
        motion: The motion without events.
        condition: The changes by the events; None: the study has no events of the vehicle.
    """
    if condition is None:
        return motion
    if not condition.effectiveness and condition.voltage is None:
        return motion
    effectiveness = condition.effectiveness or (1.0,) * len(motion.speeds)
    return scaled_motion(motion, [root_abs(thrust_share) * voltage_of(condition) for thrust_share in effectiveness])


def scaled_motion(motion: RotorMotion, factors: Sequence[Scalar]) -> RotorMotion:
    """The motion of rotors after each speed, and its rate if there is one, is multiplied by a factor.

    Args:
        motion: The motion before.
        factors: Factor of each rotor.
    """
    speeds = tuple(f * w for f, w in zip(factors, motion.speeds, strict=True))
    if not motion.accelerations:
        return RotorMotion(speeds, ())
    return RotorMotion(speeds, tuple(f * w for f, w in zip(factors, motion.accelerations, strict=True)))


def wind_at(wind: Vec3, height: Scalar, condition: Condition | None) -> Vec3:
    """The wind at a height, with the shears that events have added [m/s].

    Args:
        wind: The wind without events [m/s].
        height: Height z of the vehicle [m].
        condition: The changes by the events; None: the study has no events of the vehicle.
    """
    if condition is None:
        return wind
    for shear in condition.shears:
        wind = wind + shear.gradient * (height - shear.height)
    return wind
