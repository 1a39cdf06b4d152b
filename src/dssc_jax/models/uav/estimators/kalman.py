"""Error-state Kalman filter with 15 states: position, velocity, attitude, biases of gyroscopes and accelerometers.

    p+ = p + v T + R (s - b_a T^2/2) - g e3 T^2/2,  v+ = v + R (w - b_a T) - g e3 T,  q+ = q exp(phi - b_g T)
    error x = (dp, dv, dtheta, db_g, db_a), the attitude's on the inertial side: R_true = exp([dtheta]x) R
    dp' = dv,  dv' = -[f]x dtheta - R db_a - R n_a,  dtheta' = -R db_g - R n_g,  f = R (w/T - b_a)

The inertial unit reads increments over the sample time T in the body frame: the rotation vector phi, and the integral w
and double integral s of the specific force. f is this force in the inertial frame, in which e3 points up, and R is the
matrix of the attitude q. Gyroscopes and accelerometers have the biases b_g and b_a and the noise n_g and n_a.

Each measured number makes a separate update, which needs no inverse of a matrix. A delayed position is compared with
p - v tau. The filter knows the standard deviations of its sensors, but not their scale errors.

Reference:
    J. Sola, Quaternion kinematics for the error-state Kalman filter (2017), sections 5 to 7.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.numerics import wrap_angle
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Mat3, Vec3
from dssc_jax.models.uav.estimators.sensors import (
    Aids,
    Increments,
    Motion,
    Random,
    SensorMemory,
    Sensors,
    StartPlace,
    heading_of,
    rotation_of,
    rotation_vector,
    sense,
    start_sensors,
    strapdown_step,
)
from dssc_jax.models.uav.inner_loops.sampled import conjugate, product

STATES = 15
# index of the first component of each part of the error state
POSITION = 0
VELOCITY = 3
ATTITUDE = 6
GYRO_BIAS = 9
ACCEL_BIAS = 12
NAVIGATION = 9
"""Number of leading error states in the normalised squared error: position, velocity, attitude."""
LEAST_VARIANCE = 1e-30
"""Innovations with a smaller variance are ignored, which keeps the division finite."""
ROUNDED_PIVOT = 64.0
"""Pivots up to this many rounding errors of their variance count as 0."""

Covariance = tuple[tuple[Scalar, ...], ...]
"""Lower triangle of a symmetric matrix, by rows."""
Sparse = tuple[tuple[int, Scalar], ...]
"""The entries of a row that are not 0, each with the index of its column."""


class KalmanMemory(NamedTuple):
    """State of the filter and of its sensors.

    Args:
        estimate: Estimated motion.
        gyro_bias: Estimated bias of the gyroscopes [rad/s].
        accel_bias: Estimated bias of the accelerometers [m/s^2].
        covariance: Covariance of the error state.
        sensors: State of the sensors.
    """

    estimate: Motion
    gyro_bias: Vec3
    accel_bias: Vec3
    covariance: Covariance
    sensors: SensorMemory


class KalmanFilter(NamedTuple):
    """Parameters of a Kalman filter: its sensors, and the standard deviations of the first estimate."""

    sensors: Sensors = Sensors()
    initial_position: Annotated[Scalar, Quantity("m", "standard deviation at first", at_least=0.0)] = 0.0
    initial_velocity: Annotated[Scalar, Quantity("m/s", "standard deviation at first", at_least=0.0)] = 0.0
    initial_attitude: Annotated[Scalar, Quantity("rad", "standard deviation at first", at_least=0.0)] = 0.0

    def start(self, motion: Motion, random: Random) -> KalmanMemory:
        """Start the filter at t = 0, with errors drawn from its covariance.

        The bias estimates start at 0; the true biases are drawn by the sensors.
        """
        attitude_error = random.vector(StartPlace.ATTITUDE, self.initial_attitude)
        zero = Vec3(0.0, 0.0, 0.0)
        sensors = start_sensors(self.sensors, motion, random)
        estimate = Motion(
            position=motion.position - random.vector(StartPlace.POSITION, self.initial_position),
            velocity=motion.velocity - random.vector(StartPlace.VELOCITY, self.initial_velocity),
            attitude=product(rotation_of(-attitude_error), motion.attitude),
            rate=motion.rate + sensors.gyro_bias,
        )
        return KalmanMemory(
            estimate=estimate,
            gyro_bias=zero,
            accel_bias=zero,
            covariance=self.first_covariance(),
            sensors=sensors,
        )

    def first_covariance(self) -> Covariance:
        """Covariance of the first estimate's error, a diagonal matrix."""
        stds = (
            *(self.initial_position,) * 3,
            *(self.initial_velocity,) * 3,
            *(self.initial_attitude,) * 3,
            *(self.sensors.gyro_bias,) * 3,
            *(self.sensors.accel_bias,) * 3,
        )
        rows: list[list[Scalar]] = [[0.0] * (i + 1) for i in range(STATES)]  # the lower triangle
        for i, std in enumerate(stds):
            rows[i][i] = std * std
        return tuple(map(tuple, rows))

    def step(self, memory: KalmanMemory, motion: Motion, random: Random, k: Scalar, dt: float) -> KalmanMemory:
        """The memory after a sample: the inertial unit predicts the motion, and the other sensors correct it.

        Args:
            memory: The memory after the sample before.
            motion: The true motion at the sample.
            random: Noise of the sample.
            k: Index of the sample.
            dt: Sample time [s].
        """
        sensors, increments, readings = sense(self.sensors, memory.sensors, motion, random, k, dt)
        predicted = self.predict(memory, increments, dt)
        corrected = self.correct(predicted, readings, dt)
        estimate = corrected.estimate._replace(rate=increments.rate - corrected.gyro_bias)
        return corrected._replace(estimate=estimate, sensors=sensors)

    def predict(self, memory: KalmanMemory, increments: Increments, dt: float) -> KalmanMemory:
        """The estimate one sample later by strapdown integration, with the covariance of its error.

        The covariance is D (F D P D' F' + Q) D'. Q is diagonal: the noise of the inertial unit, and the random walk of
        its biases. D moves the position by half a sample of the velocity, before and after F changes the velocity, so
        that an error of the specific force moves the position by T^2/2 in the same sample.
        """
        previous = memory.estimate
        rotation = previous.attitude.matrix()
        velocity_step = increments.velocity - memory.accel_bias * dt
        position_step = increments.position - memory.accel_bias * (0.5 * dt * dt)
        force = rotation @ (velocity_step / dt)
        position, velocity = strapdown_step(previous, rotation, velocity_step, position_step, dt)
        rotation_step = rotation_of(increments.rotation - memory.gyro_bias * dt)
        noises = (
            (VELOCITY, self.sensors.accel_noise),
            (ATTITUDE, self.sensors.gyro_noise),
            (GYRO_BIAS, self.sensors.gyro_walk),
            (ACCEL_BIAS, self.sensors.accel_walk),
        )
        drifted = transformed(memory.covariance, half_drift(dt))
        covariance = [list(row) for row in transformed(drifted, transition(rotation, force, dt))]
        for first, density in noises:
            for i in range(first, first + 3):
                covariance[i][i] = covariance[i][i] + density * density * dt
        estimate = Motion(
            position=position,
            velocity=velocity,
            attitude=product(previous.attitude, rotation_step).normalised(),
            rate=previous.rate,
        )
        changed = tuple(map(tuple, covariance))
        return memory._replace(estimate=estimate, covariance=transformed(changed, half_drift(dt)))

    def correct(self, memory: KalmanMemory, readings: Aids, dt: float) -> KalmanMemory:
        """The estimate after the updates by position, height and heading, and the covariance of its error.

        A sensor that is None is absent. The corrections of one sample add up to an error state, which is added to the
        estimate at the end; its attitude part turns the estimated attitude.
        """
        update = Update(memory.covariance, (0.0,) * STATES)
        estimate = memory.estimate
        delay = self.sensors.delay_samples * dt
        if self.sensors.position is not None:
            difference = readings.position - (estimate.position - estimate.velocity * delay)
            for i, value in enumerate(difference):
                row: Sparse = ((POSITION + i, 1.0),)  # derivative of the reading by the error state
                if delay:
                    row = (*row, (VELOCITY + i, -delay))
                update = update.with_reading(row, value, self.sensors.position, readings.has_position)
        if self.sensors.height is not None:
            difference = readings.height - estimate.position.z
            update = update.with_reading(((POSITION + 2, 1.0),), difference, self.sensors.height, readings.has_height)
        if self.sensors.heading is not None:
            difference = wrap_angle(readings.heading - heading_of(estimate.attitude))
            row = heading_row(estimate.attitude.matrix())
            update = update.with_reading(row, difference, self.sensors.heading, readings.has_heading)
        parts = (Vec3(*update.error[first : first + 3]) for first in range(0, STATES, 3))
        position, velocity, attitude, gyro_bias, accel_bias = parts
        corrected = Motion(
            position=estimate.position + position,
            velocity=estimate.velocity + velocity,
            attitude=product(rotation_of(attitude), estimate.attitude).normalised(),
            rate=estimate.rate,
        )
        return memory._replace(
            estimate=corrected,
            gyro_bias=memory.gyro_bias + gyro_bias,
            accel_bias=memory.accel_bias + accel_bias,
            covariance=update.covariance,
        )

    def nees(self, memory: KalmanMemory, motion: Motion) -> Scalar:
        """Squared error of position, velocity and attitude, normalised by its covariance.

        If the covariance is right, the result has a chi-squared law with 9 degrees of freedom. By the covariance, the
        error of a state may follow exactly from the errors of the states before it. Such a state does not count, and
        the law has one degree of freedom less for each.
        """
        estimate = memory.estimate
        attitude_error = rotation_vector(product(motion.attitude, conjugate(estimate.attitude)))
        error = (*(motion.position - estimate.position), *(motion.velocity - estimate.velocity), *attitude_error)
        return normalised_square(memory.covariance, error)


def transition(rotation: Mat3, force: Vec3, dt: float) -> tuple[Sparse, ...]:
    """The rows of F - I, where F changes velocity and attitude of the error state over a sample, to first order in dt.

    Args:
        rotation: R of the estimated attitude, body to inertial.
        force: Specific force f, inertial axes [m/s^2].
        dt: Length of the sample [s].
    """
    rows: list[list[tuple[int, Scalar]]] = [[] for _ in range(STATES)]
    cross = ((0.0, -force.z, force.y), (force.z, 0.0, -force.x), (-force.y, force.x, 0.0))  # [f]x
    for i in range(3):
        for j in range(3):
            if i != j:
                rows[VELOCITY + i].append((ATTITUDE + j, -cross[i][j] * dt))
            rows[VELOCITY + i].append((ACCEL_BIAS + j, -rotation[i][j] * dt))
            rows[ATTITUDE + i].append((GYRO_BIAS + j, -rotation[i][j] * dt))
    return tuple(map(tuple, rows))


def half_drift(dt: float) -> tuple[Sparse, ...]:
    """The rows of D - I, where D moves the position by the velocity over half a sample of length dt [s]."""
    rows: list[Sparse] = [()] * STATES
    for i in range(3):
        rows[POSITION + i] = ((VELOCITY + i, 0.5 * dt),)
    return tuple(rows)


def entry(covariance: Covariance, i: int, j: int) -> Scalar:
    """Entry (i, j) of a symmetric matrix of which the lower triangle is stored.

    Args:
        covariance: The lower triangle.
        i: Row, from 0.
        j: Column, from 0.
    """
    return covariance[i][j] if i >= j else covariance[j][i]


def transformed(covariance: Covariance, rows: tuple[Sparse, ...]) -> Covariance:
    """The covariance F P F' after a transition F.

    Args:
        covariance: The covariance P before.
        rows: The rows of F - I, most of whose entries are 0.
    """
    left = []  # F P
    for i in range(STATES):
        line = []
        for j in range(STATES):
            value = entry(covariance, i, j)
            for column, weight in rows[i]:
                value = value + weight * entry(covariance, column, j)
            line.append(value)
        left.append(line)
    result = []  # the lower triangle of (F P) F'
    for i in range(STATES):
        line = []
        for j in range(i + 1):
            value = left[i][j]
            for column, weight in rows[j]:
                value = value + weight * left[i][column]
            line.append(value)
        result.append(tuple(line))
    return tuple(result)


def heading_row(rotation: Mat3) -> Sparse:
    """The row of a heading: derivative of the yaw by the attitude's part of the error state.

    The derivative is 1 for a rotation about the vertical axis, and tan theta for one about the horizontal direction of
    the body's x axis.
    """
    cos2_theta = rotation.a.x * rotation.a.x + rotation.b.x * rotation.b.x
    ratio = -rotation.c.x / jnp.maximum(cos2_theta, 1e-12)  # sin theta/cos^2 theta, finite at the singularity
    return (ATTITUDE, rotation.a.x * ratio), (ATTITUDE + 1, rotation.b.x * ratio), (ATTITUDE + 2, 1.0)


class Update(NamedTuple):
    """The covariance P and the estimated error state, while the filter takes in the readings of a sample one by one."""

    covariance: Covariance
    error: tuple[Scalar, ...]

    def with_reading(self, row: Sparse, difference: Scalar, std: Scalar, is_taken: Scalar) -> "Update":
        """The update by one measured number; without a reading at this sample, nothing changes.

        Args:
            row: Derivative h of the number by the error state, as a row.
            difference: The reading minus the estimate.
            std: Standard deviation of the reading's noise.
            is_taken: Whether there is a reading at this sample.
        """
        cross_covariance = []  # P h'
        for i in range(STATES):
            value: Scalar = 0.0
            for column, weight in row:
                value = value + weight * entry(self.covariance, i, column)
            cross_covariance.append(value)
        variance: Scalar = std * std
        innovation = difference
        for column, weight in row:
            variance = variance + weight * cross_covariance[column]
            innovation = innovation - weight * self.error[column]
        counts = jnp.logical_and(is_taken, variance > LEAST_VARIANCE)
        inverse = jnp.where(counts, 1.0 / jnp.maximum(variance, LEAST_VARIANCE), 0.0)
        gains = [value * inverse for value in cross_covariance]
        rows = []
        for i in range(STATES):
            rows.append(tuple(self.covariance[i][j] - gains[i] * cross_covariance[j] for j in range(i + 1)))
        error = tuple(value + gain * innovation for value, gain in zip(self.error, gains, strict=True))
        return Update(tuple(rows), error)


def normalised_square(covariance: Covariance, error: tuple[Scalar, ...]) -> Scalar:
    """The normalised squared error e' P^-1 e, for the leading block of the covariance P that belongs to e.

    P = L D L' with a lower triangle L of ones on its diagonal and a diagonal D; with z = L^-1 e, the result is the sum
    of z_i^2/D_i. Row i of the factors follows from the rows before it. Where P is singular, D_i is 0 up to rounding for
    some i, and these terms are left out. This happens in the first sample after an exact start: there the errors of
    velocity and position come from the same noise.

    Args:
        covariance: The covariance P, whose leading block belongs to e.
        error: The error e of position, velocity and attitude, length 9.
    """
    factor: list[list[Scalar]] = []  # L below its diagonal
    inverse: list[Scalar] = []  # of D
    solution: list[Scalar] = []  # L^-1 e
    total: Scalar = 0.0
    for i in range(NAVIGATION):
        line: list[Scalar] = []
        for j in range(i):
            value = covariance[i][j]
            for m in range(j):
                value = value - line[m] * factor[j][m]
            line.append(value)
        pivot = covariance[i][i]
        scaled = [value * inverse[j] for j, value in enumerate(line)]
        value = error[i]
        for j in range(i):
            pivot = pivot - scaled[j] * line[j]
            value = value - scaled[j] * solution[j]
        factor.append(scaled)
        rounding = ROUNDED_PIVOT * jnp.finfo(jnp.result_type(pivot)).eps * covariance[i][i]
        is_regular = pivot > rounding
        inverse.append(jnp.where(is_regular, 1.0 / jnp.where(is_regular, pivot, 1.0), 0.0))
        solution.append(value)
        total = total + value * value * inverse[i]
    return total
