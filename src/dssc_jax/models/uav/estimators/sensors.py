"""Sensors of a vehicle's estimator: inertial unit, position, height and heading.

The inertial unit gives increments of rotation, velocity and position over a sample, in the body frame at the start of
the sample, as units with compensated coning and sculling do. Without noise, bias and scale error the increments are
those of the true motion, and strapdown integration is exact.
"""

import math
from enum import IntEnum
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.numerics import is_zero, standard_normals
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Mat3, Quaternion, Vec3
from dssc_jax.lanes.functions.approximations import atan2
from dssc_jax.models.uav.inner_loops.sampled import canonical, conjugate, product
from dssc_jax.models.uav.vehicle import GRAVITY

MOST_DELAYED = 64
"""Largest delay of a position [samples]."""
UP = Vec3(0.0, 0.0, GRAVITY)
"""The specific force that holds the vehicle against its weight, inertial [m/s^2]."""


class StartPlace(IntEnum):
    """Numbers that tell the random draws at t = 0 apart."""

    GYRO_BIAS = 0
    ACCEL_BIAS = 1
    ATTITUDE = 2
    POSITION = 3
    VELOCITY = 4


class SamplePlace(IntEnum):
    """Numbers that tell the random draws of a sample apart."""

    GYRO = 0
    ACCEL = 1
    POSITION = 2
    GYRO_WALK = 3
    ACCEL_WALK = 4
    HEIGHT = 5
    HEADING = 6


class Motion(NamedTuple):
    """Motion of the vehicle, true or estimated.

    Args:
        position: Position in the inertial frame [m].
        velocity: Velocity in the inertial frame [m/s].
        attitude: Rotation from the body frame to the inertial frame.
        rate: Angular rate in the body frame [rad/s].
    """

    position: Vec3
    velocity: Vec3
    attitude: Quaternion
    rate: Vec3


class Sensors(NamedTuple):
    """The sensors of a vehicle and their errors.

    A standard deviation of 0 means a perfect sensor; None means that the vehicle does not have the sensor. Periods and
    delays are in samples of the loop. During the outage no position is measured.
    """

    gyro_noise: Annotated[Scalar, Quantity("rad/s^0.5", "noise density of the gyroscopes", at_least=0.0)] = 0.0
    accel_noise: Annotated[Scalar, Quantity("m/s^1.5", "noise density of the accelerometers", at_least=0.0)] = 0.0
    gyro_bias: Annotated[Scalar, Quantity("rad/s", "standard deviation of the gyroscopes' bias", at_least=0.0)] = 0.0
    accel_bias: Annotated[Scalar, Quantity("m/s^2", "standard deviation of the accelerometers' bias", at_least=0.0)] = (
        0.0
    )
    gyro_walk: Annotated[Scalar, Quantity("rad/s^1.5", "random walk of the gyroscopes' bias", at_least=0.0)] = 0.0
    accel_walk: Annotated[Scalar, Quantity("m/s^2.5", "random walk of the accelerometers' bias", at_least=0.0)] = 0.0
    gyro_scale: Annotated[Scalar, Quantity("1", "scale error of the gyroscopes, which no filter knows")] = 0.0
    accel_scale: Annotated[Scalar, Quantity("1", "scale error of the accelerometers, which no filter knows")] = 0.0
    position: Annotated[Scalar | None, Quantity("m", "standard deviation of positions", at_least=0.0)] = 0.0
    position_period: Annotated[float, Quantity("samples", "period of positions", at_least=1.0, law=False)] = 1.0
    position_delay: Annotated[
        float, Quantity("samples", "delay of positions", at_least=0.0, at_most=MOST_DELAYED, law=False)
    ] = 0.0
    outage_start: Annotated[
        Scalar | None, Quantity("s", "start of an outage of positions", at_least=0.0, begins=True)
    ] = None
    outage_duration: Annotated[Scalar, Quantity("s", "duration of the outage", at_least=0.0)] = 0.0
    height: Annotated[Scalar | None, Quantity("m", "standard deviation of barometric heights", at_least=0.0)] = None
    height_period: Annotated[float, Quantity("samples", "period of heights", at_least=1.0, law=False)] = 1.0
    heading: Annotated[Scalar | None, Quantity("rad", "standard deviation of headings", at_least=0.0)] = 0.0
    heading_period: Annotated[float, Quantity("samples", "period of headings", at_least=1.0, law=False)] = 1.0

    @property
    def delay_samples(self) -> int:
        """Delay of a position [samples]."""
        return round(self.position_delay)


class SensorMemory(NamedTuple):
    """State of the sensors between two samples.

    Args:
        previous: The true motion at the last sample.
        gyro_bias: True bias of the gyroscopes [rad/s].
        accel_bias: True bias of the accelerometers [m/s^2].
        positions: True positions at the last samples [m], the newest first; as many as the delay has samples.
    """

    previous: Motion
    gyro_bias: Vec3
    accel_bias: Vec3
    positions: tuple[Vec3, ...]


class Increments(NamedTuple):
    """Readings of the inertial unit: increments over a sample in the body frame at its start, and the angular rate.

    Args:
        rotation: Rotation vector [rad].
        velocity: Integral of the specific force [m/s].
        position: Double integral of the specific force [m].
        rate: Angular rate at the end of the sample [rad/s].
    """

    rotation: Vec3
    velocity: Vec3
    position: Vec3
    rate: Vec3


class Aids(NamedTuple):
    """Readings of position [m], height [m] and heading [rad] at a sample, with flags whether each was taken there."""

    position: Vec3
    has_position: Scalar
    height: Scalar
    has_height: Scalar
    heading: Scalar
    has_heading: Scalar


class Random(NamedTuple):
    """The source of the independent normal numbers of a sample.

    Numbers with different values of ``place`` are independent. Where the standard deviation is known to be 0, or None,
    the numbers are zeros and the program draws none.
    """

    key: jax.Array

    def numbers(self, place: int, std: Scalar | None, count: int) -> tuple[Scalar, ...]:
        """``count`` numbers with mean 0 and standard deviation ``std``.

        Args:
            place: Number that tells these random numbers apart from others of the same key.
            std: Standard deviation; None counts as 0.
            count: How many numbers.
        """
        if std is None or is_zero(std):
            return (0.0,) * count
        return tuple(number * std for number in standard_normals(jax.random.fold_in(self.key, int(place)), count))

    def vector(self, place: int, std: Scalar | None) -> Vec3:
        """Three numbers with mean 0 and standard deviation ``std``."""
        return Vec3(*self.numbers(place, std, 3))

    def number(self, place: int, std: Scalar | None) -> Scalar:
        """One number with mean 0 and standard deviation ``std``."""
        return self.numbers(place, std, 1)[0]


def rotation_vector(q: Quaternion) -> Vec3:
    """The rotation vector [rad] of a unit quaternion: the axis times the angle, at most pi.

    It is the quaternion's imaginary part times angle/sin(angle/2). Near the zero rotation the limit 2 of this quotient
    stands in its place.
    """
    q = canonical(q)
    imaginary = Vec3(q.x, q.y, q.z)
    square = imaginary.dot(imaginary)
    size = jnp.sqrt(jnp.maximum(square, 1e-24))
    small = square < 1e-16
    return imaginary * jnp.where(small, 2.0, 2.0 * atan2(size, q.w) / size)


def rotation_of(vector: Vec3) -> Quaternion:
    """The unit quaternion of a rotation vector [rad]; the inverse of :func:`rotation_vector`.

    The imaginary part is the vector times sin(angle/2)/angle. Near the zero rotation the limit 1/2 of this quotient
    stands in its place.
    """
    square = vector.dot(vector)
    size = jnp.sqrt(jnp.maximum(square, 1e-24))
    small = square < 1e-16
    factor = jnp.where(small, 0.5, jnp.sin(0.5 * size) / size)
    return Quaternion(jnp.where(small, 1.0, jnp.cos(0.5 * size)), *(vector * factor)).normalised()


def heading_of(attitude: Quaternion) -> Scalar:
    """The yaw angle of an attitude [rad]."""
    rotation = attitude.matrix()
    return atan2(rotation.b.x, rotation.a.x)


def start_sensors(sensors: Sensors, motion: Motion, random: Random) -> SensorMemory:
    """The sensors at t = 0, with random biases and with delayed positions as if the vehicle had rested at its place."""
    return SensorMemory(
        previous=motion,
        gyro_bias=random.vector(StartPlace.GYRO_BIAS, sensors.gyro_bias),
        accel_bias=random.vector(StartPlace.ACCEL_BIAS, sensors.accel_bias),
        positions=(motion.position,) * sensors.delay_samples,
    )


def sense(
    sensors: Sensors, memory: SensorMemory, motion: Motion, random: Random, k: Scalar, dt: float
) -> tuple[SensorMemory, Increments, Aids]:
    """The readings of all sensors at sample k, from the true motion.

    A reading that is not taken at this sample has a value nevertheless; its flag tells that the value does not count.

    Args:
        sensors: Parameters of the sensors.
        memory: State of the sensors at the sample before.
        motion: The true motion at the sample.
        random: Noise of the sample.
        k: Index of the sample.
        dt: Length of a sample [s].

    Returns:
        The state of the sensors, the increments since the sample before, and the other readings.
    """
    increments = measured_increments(sensors, memory, motion, random, dt)
    positions = (motion.position, *memory.positions)  # the latest first
    next_memory = SensorMemory(
        previous=motion,
        gyro_bias=memory.gyro_bias + random.vector(SamplePlace.GYRO_WALK, sensors.gyro_walk) * math.sqrt(dt),
        accel_bias=memory.accel_bias + random.vector(SamplePlace.ACCEL_WALK, sensors.accel_walk) * math.sqrt(dt),
        positions=positions[:-1],
    )
    return next_memory, increments, measured_aids(sensors, motion, positions[-1], random, k, dt)


def measured_increments(
    sensors: Sensors, memory: SensorMemory, motion: Motion, random: Random, dt: float
) -> Increments:
    """The readings of the inertial unit: the true increments since the sample before, with its errors.

    Args:
        sensors: Parameters of the sensors.
        memory: State of the sensors at the sample before.
        motion: The true motion at the sample.
        random: Noise of the sample.
        dt: Length of a sample [s].
    """
    previous = memory.previous
    to_body = previous.attitude.matrix().transpose
    rotation = rotation_vector(product(conjugate(previous.attitude), motion.attitude))
    velocity = to_body @ (motion.velocity - previous.velocity + UP * dt)
    position = to_body @ (motion.position - previous.position - previous.velocity * dt + UP * (0.5 * dt * dt))
    rotation_error = memory.gyro_bias * dt + random.vector(SamplePlace.GYRO, sensors.gyro_noise) * math.sqrt(dt)
    velocity_error = memory.accel_bias * dt + random.vector(SamplePlace.ACCEL, sensors.accel_noise) * math.sqrt(dt)
    return Increments(
        rotation=rotation * (1.0 + sensors.gyro_scale) + rotation_error,
        velocity=velocity * (1.0 + sensors.accel_scale) + velocity_error,
        position=position * (1.0 + sensors.accel_scale) + velocity_error * (0.5 * dt),
        rate=motion.rate * (1.0 + sensors.gyro_scale) + rotation_error / dt,
    )


def measured_aids(
    sensors: Sensors, motion: Motion, delayed_position: Vec3, random: Random, k: Scalar, dt: float
) -> Aids:
    """The readings of position, height and heading with their noise, and whether each is taken at sample k.

    Args:
        sensors: Parameters of the sensors.
        motion: The true motion at the sample.
        delayed_position: The true position one delay before [m].
        random: Noise of the sample.
        k: Index of the sample.
        dt: Length of a sample [s].
    """
    has_position = is_reading_time(k, sensors.position_period)
    if sensors.outage_start is not None:
        t = k * dt
        has_begun = t >= sensors.outage_start
        is_outage = jnp.logical_and(has_begun, t < sensors.outage_start + sensors.outage_duration)
        has_position = jnp.logical_and(has_position, jnp.logical_not(is_outage))
    return Aids(
        position=delayed_position + random.vector(SamplePlace.POSITION, sensors.position),
        has_position=has_position,
        height=motion.position.z + random.number(SamplePlace.HEIGHT, sensors.height),
        has_height=is_reading_time(k, sensors.height_period),
        heading=heading_of(motion.attitude) + random.number(SamplePlace.HEADING, sensors.heading),
        has_heading=is_reading_time(k, sensors.heading_period),
    )


def strapdown_step(motion: Motion, rotation: Mat3, velocity: Vec3, position: Vec3, dt: float) -> tuple[Vec3, Vec3]:
    """Position [m] and velocity [m/s] one sample later, by strapdown integration.

    Args:
        motion: The estimate at the sample before.
        rotation: Matrix R of the estimate's attitude, body to inertial.
        velocity: Increment of the velocity by the specific force, body axes [m/s].
        position: Increment of the position by the specific force, body axes [m].
        dt: Length of the sample [s].
    """
    next_velocity = motion.velocity + rotation @ velocity - UP * dt
    next_position = motion.position + motion.velocity * dt + rotation @ position - UP * (0.5 * dt * dt)
    return next_position, next_velocity


def is_reading_time(k: Scalar, period: float) -> Scalar:
    """Whether a sensor with a period [samples] takes a reading at sample k.

    Args:
        k: Index of the sample.
        period: Time between two readings [samples].
    """
    count = round(period)
    return k >= 0 if count == 1 else k % count == 0  # with a period of 1 always, without a division
