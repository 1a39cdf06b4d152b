"""Complementary filter: the inertial unit gives the fast motion, other sensors the slow one, with constant gains.

    tilt:     the rotation of a sample T is corrected by k_tilt T (a/|a| x R' e3)
    heading:  the same rotation by k_heading T (psi_m - psi) about the vertical
    position: p by 2 w T_p (p_m - p), and v by w^2 T_p (p_m - p)
    bias:     b_g by -k_bias T times the rate of both corrections of the attitude

Here a is the measured specific force, psi_m and p_m are a measured heading and position, and T_p is the time between
two positions.

In accelerated flight a is not vertical, which disturbs the estimate of the tilt in proportion to k_tilt. A real filter
has this error too.

Reference:
    R. Mahony, T. Hamel, J.-M. Pflimlin, Nonlinear complementary filters on the special orthogonal group (2008).
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.numerics import wrap_angle
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Quaternion, Vec3
from dssc_jax.models.uav.estimators.sensors import (
    Aids,
    Increments,
    Motion,
    Random,
    SensorMemory,
    Sensors,
    heading_of,
    rotation_of,
    sense,
    start_sensors,
    strapdown_step,
)
from dssc_jax.models.uav.inner_loops.sampled import product


class ComplementaryMemory(NamedTuple):
    """State of the filter and of its sensors; ``gyro_bias`` is the estimated bias [rad/s]."""

    estimate: Motion
    gyro_bias: Vec3
    sensors: SensorMemory


class ComplementaryFilter(NamedTuple):
    """Parameters of a complementary filter: its sensors and gains."""

    sensors: Sensors = Sensors()
    tilt_gain: Annotated[Scalar, Quantity("1/s", "gain of the tilt k_tilt", at_least=0.0)] = 0.2
    heading_gain: Annotated[Scalar, Quantity("1/s", "gain of the heading", at_least=0.0)] = 0.5
    bias_gain: Annotated[Scalar, Quantity("1/s^2", "gain of the gyroscopes' bias", at_least=0.0)] = 0.01
    position_bandwidth: Annotated[Scalar, Quantity("rad/s", "bandwidth w of position and velocity", at_least=0.0)] = 2.0

    def start(self, motion: Motion, random: Random) -> ComplementaryMemory:
        """The filter at t = 0: it knows the true motion, but not the biases.

        The first estimated rate is therefore the true one plus the bias of the gyroscopes.
        """
        sensors = start_sensors(self.sensors, motion, random)
        estimate = motion._replace(rate=motion.rate + sensors.gyro_bias)
        return ComplementaryMemory(estimate, Vec3(0.0, 0.0, 0.0), sensors)

    def step(
        self, memory: ComplementaryMemory, motion: Motion, random: Random, k: Scalar, dt: float
    ) -> ComplementaryMemory:
        """The memory after a sample: the inertial unit is integrated, and the other sensors correct the result.

        Args:
            memory: The memory after the sample before.
            motion: The true motion at the sample.
            random: Noise of the sample.
            k: Index of the sample.
            dt: Length of a sample [s].
        """
        sensors, increments, aids = sense(self.sensors, memory.sensors, motion, random, k, dt)
        attitude = memory.estimate.attitude
        rotation = attitude.matrix()
        position, velocity = strapdown_step(memory.estimate, rotation, increments.velocity, increments.position, dt)
        correction = self.attitude_correction(attitude, rotation.c, increments, aids)
        rotation_step = rotation_of(increments.rotation + (correction - memory.gyro_bias) * dt)
        position, velocity = self.corrected_by_aids(position, velocity, aids, dt)
        bias = memory.gyro_bias - correction * (self.bias_gain * dt)
        estimate = Motion(position, velocity, product(attitude, rotation_step).normalised(), increments.rate - bias)
        return ComplementaryMemory(estimate, bias, sensors)

    def attitude_correction(self, attitude: Quaternion, vertical: Vec3, increments: Increments, aids: Aids) -> Vec3:
        """The body rate that corrects the attitude [rad/s], by the accelerometers and by a heading.

        Args:
            attitude: Estimated attitude at the sample before.
            vertical: The inertial z axis in body axes, by this attitude.
            increments: Readings of the inertial unit.
            aids: Readings of the other sensors.
        """
        size = jnp.maximum(increments.velocity.norm(), 1e-9)  # not 0, in free fall
        correction = (increments.velocity / size).cross(vertical) * self.tilt_gain
        if self.sensors.heading is None:
            return correction
        innovation = wrap_angle(aids.heading - heading_of(attitude))
        # a heading stands for all samples until the next one, so its gain counts once for each of them
        gain = self.heading_gain * round(self.sensors.heading_period)
        return correction + vertical * jnp.where(aids.has_heading, gain * innovation, 0.0)

    def corrected_by_aids(self, position: Vec3, velocity: Vec3, aids: Aids, dt: float) -> tuple[Vec3, Vec3]:
        """Position [m] and velocity [m/s] after the corrections by a position and by a height.

        A delayed reading of the position is compared with the estimate at the time of the reading, which is the present
        estimate taken back along the velocity. Heights are corrected with the same bandwidth.

        Args:
            position: Estimated position before the corrections [m].
            velocity: Estimated velocity before the corrections [m/s].
            aids: Readings of position and height.
            dt: Length of a sample [s].
        """
        if self.sensors.position is not None:
            period = dt * round(self.sensors.position_period)
            innovation = aids.position - (position - velocity * (self.sensors.delay_samples * dt))
            weight = jnp.where(aids.has_position, self.position_bandwidth * period, 0.0)
            position = position + innovation * (2.0 * weight)
            velocity = velocity + innovation * (weight * self.position_bandwidth)
        if self.sensors.height is not None:
            innovation = aids.height - position.z
            weight = jnp.where(aids.has_height, self.position_bandwidth * dt * round(self.sensors.height_period), 0.0)
            position = position._replace(z=position.z + 2.0 * weight * innovation)
            velocity = velocity._replace(z=velocity.z + weight * self.position_bandwidth * innovation)
        return position, velocity

    def nees(self, memory: ComplementaryMemory, motion: Motion) -> Scalar:
        """The normalised squared error, which is always 0 here because the filter has no covariance."""
        return 0.0
