"""Types of the vehicle's report at a sample, for metrics and trajectories."""

from typing import Annotated, NamedTuple

from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Quaternion, Vec3


class EstimateErrors(NamedTuple):
    """Errors of the vehicle's estimate at a sample.

    ``nees`` is the normalised squared error of position, velocity and attitude: chi-squared with 9 degrees of freedom
    for a consistent filter, and 0 where the estimator has no covariance.
    """

    position_estimate_error: Annotated[Scalar, Quantity("m", "error of the estimated position")]
    velocity_estimate_error: Annotated[Scalar, Quantity("m/s", "error of the estimated velocity")]
    attitude_estimate_error: Annotated[Scalar, Quantity("rad", "angle of the attitude's estimation error")]
    nees: Annotated[Scalar, Quantity("1", "normalised squared error of the estimate")]


class UavInfo(NamedTuple):
    """The vehicle's report at a sample.

    ``rotor`` has the commanded thrusts f_i, limited to ``rotor_limit``, and ``rotor_speed`` the speeds |thetadot_i|.
    Without a battery ``battery_charge`` stays at 1. ``estimate`` is () without an estimator.
    """

    phi: Annotated[Scalar, Quantity("rad", "roll", periodic=True)]
    theta: Annotated[Scalar, Quantity("rad", "pitch")]
    psi: Annotated[Scalar, Quantity("rad", "yaw", periodic=True)]
    tilt: Annotated[Scalar, Quantity("rad", "tilt of body z")]
    thrust: Annotated[Scalar, Quantity("N", "wanted net thrust")]
    rotor_limited: Annotated[Scalar, Quantity("1", "a rotor at its limit")]
    lift_bounded: Annotated[Scalar, Quantity("1", "wanted lift at its lower bound")]
    rotor: Annotated[tuple[Scalar, ...], Quantity("N", "commanded thrust of rotor")]
    rotor_limit: Annotated[Scalar, Quantity("N", "limit of a rotor's thrust")]
    wind: Annotated[Vec3, Quantity("m/s", "wind along")]
    attitude: Annotated[Quaternion, Quantity("1", "attitude quaternion, body to inertial,")]
    rate: Annotated[Vec3, Quantity("rad/s", "rate about body")]
    rotor_speed: Annotated[tuple[Scalar, ...], Quantity("rad/s", "speed of rotor")]
    rotor_voltage: Annotated[Scalar, Quantity("1", "voltage at the rotors, relative to full")]
    battery_charge: Annotated[Scalar, Quantity("1", "charge of the battery, relative to full")]
    estimate: EstimateErrors | tuple[()] = ()
