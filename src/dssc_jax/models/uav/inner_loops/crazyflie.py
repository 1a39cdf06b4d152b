"""The Crazyflie's PID cascade below its position control: velocity, attitude and rate, in Euler angles.

    theta_d = PID(u - v, forward), phi_d = -PID(u - v, left), within the limit of tilt; f_d = hover + PID(u_z - v_z)
    (phi', theta', psi')_d = PID of the angles, psi_d the integral of u_psi
    M_d = PID(Omega_d - Omega)

All derivatives are of the measurement, and there is no compensation of the tilt. The firmware's units are degrees
and motor commands of 16 bit; here they are radians and shares of the full thrust, so the firmware's gains are converted
by 180/pi/65535. A roll or pitch command changes each rotor by half the command, and a yaw command by the whole command.

References:
    Bitcraze, crazyflie-firmware, controller_pid.c, position_controller_pid.c, attitude_pid_controller.c, pid.c,
    power_distribution_quadrotor.c and platform_defaults_cf2.h (2024).
"""

import math
from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np

from dssc_jax.core.numerics import clip, is_zero, wrap_angle
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Mat3, Vec3
from dssc_jax.models.uav.inner_loops.sampled import (
    Craft,
    Readings,
    Trim,
    angles_of,
    limited,
    require_integral,
    require_triples,
)
from dssc_jax.models.uav.inner_loops.start import Start
from dssc_jax.models.uav.rotors import Wrench
from dssc_jax.models.uav.vehicle import GRAVITY

MOTOR_RANGE = 65535.0
"""Motor command of full thrust."""
PER_RADIAN = math.degrees(1.0) / MOTOR_RANGE
"""From the firmware's motor command per degree to a share of the full thrust per radian."""
THRUST_SCALE = 1000.0 / MOTOR_RANGE
"""From the output of the vertical PID to a share of the full thrust."""
OVERHEAD = 1.1
"""Limit of the horizontal PIDs over the limit of the tilt."""
INTEGRAL_OF_VELOCITY = 5000.0
"""Limit of the integrals of velocity [m]."""


TRIPLES = (
    "attitude_p",
    "attitude_i",
    "attitude_d",
    "attitude_integral_max",
    "rate_p",
    "rate_i",
    "rate_d",
    "rate_integral_max",
    "attitude_integral",
    "rate_integral",
)
"""Fields with a value for roll, pitch and yaw each."""


class CrazyflieGains(NamedTuple):
    """Gains of the Crazyflie's cascade; the defaults are the firmware's, in SI units.

    A triple has a value for roll, pitch and yaw each; velocity gains are horizontal, and climb gains vertical.
    """

    frequency: Annotated[float, Quantity("Hz", "rate of the attitude and rate loops", above=0.0, law=False)] = 500.0
    velocity_p: Annotated[Scalar, Quantity("rad s/m", "proportional gain of velocity, to tilt", above=0.0)] = (
        math.radians(25.0)
    )
    velocity_i: Annotated[Scalar, Quantity("rad/m", "integral gain of velocity", at_least=0.0)] = math.radians(1.0)
    velocity_d: Annotated[Scalar, Quantity("rad s^2/m", "derivative gain of velocity", at_least=0.0)] = 0.0
    climb_p: Annotated[Scalar, Quantity("s/m", "proportional gain of climb, to full thrust", above=0.0)] = (
        25.0 * THRUST_SCALE
    )
    climb_i: Annotated[Scalar, Quantity("1/m", "integral gain of climb", at_least=0.0)] = 15.0 * THRUST_SCALE
    climb_d: Annotated[Scalar, Quantity("s^2/m", "derivative gain of climb", at_least=0.0)] = 0.0
    tilt_max: Annotated[Scalar, Quantity("rad", "limit of roll and pitch", above=0.0, below=1.55)] = math.radians(20.0)
    thrust_min: Annotated[Scalar, Quantity("1", "least share of full thrust", at_least=0.0, below=1.0)] = (
        20000.0 / MOTOR_RANGE
    )
    thrust_hover: Annotated[
        Scalar | None, Quantity("1", "share of full thrust in hover; absent: exact", above=0.0, below=1.0)
    ] = None
    attitude_p: Annotated[tuple[Scalar, ...], Quantity("1/s", "proportional gains of angles", at_least=0.0)] = (
        6.0,
        6.0,
        6.0,
    )
    attitude_i: Annotated[tuple[Scalar, ...], Quantity("1/s^2", "integral gains of angles", at_least=0.0)] = (
        3.0,
        3.0,
        1.0,
    )
    attitude_d: Annotated[tuple[Scalar, ...], Quantity("1", "derivative gains of angles", at_least=0.0)] = (
        0.0,
        0.0,
        0.35,
    )
    attitude_integral_max: Annotated[tuple[Scalar, ...], Quantity("rad s", "limits of integrals", above=0.0)] = (
        math.radians(20.0),
        math.radians(20.0),
        math.radians(360.0),
    )
    rate_p: Annotated[tuple[Scalar, ...], Quantity("s", "proportional gains of rates", at_least=0.0)] = (
        250.0 * PER_RADIAN,
        250.0 * PER_RADIAN,
        120.0 * PER_RADIAN,
    )
    rate_i: Annotated[tuple[Scalar, ...], Quantity("1", "integral gains of rates", at_least=0.0)] = (
        500.0 * PER_RADIAN,
        500.0 * PER_RADIAN,
        16.7 * PER_RADIAN,
    )
    rate_d: Annotated[tuple[Scalar, ...], Quantity("s^2", "derivative gains of rates", at_least=0.0)] = (
        2.5 * PER_RADIAN,
        2.5 * PER_RADIAN,
        0.0,
    )
    rate_integral_max: Annotated[tuple[Scalar, ...], Quantity("rad", "limits of integrals", above=0.0)] = (
        math.radians(33.3),
        math.radians(33.3),
        math.radians(166.7),
    )
    start: Start = Start.ZERO
    velocity_integral: Annotated[
        tuple[Scalar, ...], Quantity("m", "first integrals of velocity, along the heading, left and up")
    ] = (0.0, 0.0, 0.0)
    attitude_integral: Annotated[tuple[Scalar, ...], Quantity("rad s", "first integrals of angles")] = (0.0, 0.0, 0.0)
    rate_integral: Annotated[tuple[Scalar, ...], Quantity("rad", "first integrals of rates")] = (0.0, 0.0, 0.0)

    @property
    def period(self) -> float:
        """Time between two ticks [s]."""
        return 1.0 / self.frequency

    def prepare(self) -> "CrazyflieGains":
        """The gains themselves, which must have three values where they are triples; raises ConfigError.

        A settled start also needs an integral gain of climb.
        """
        require_triples(self, TRIPLES)
        require_integral(self, "climb_i")
        return self

    def input_gain(self, craft: Craft) -> tuple[Scalar, ...]:
        """k_p of x, y, z and psi: what a command adds to the acceleration at first [1/s]."""
        level = GRAVITY * self.velocity_p
        _, _, yaw_p = self.attitude_p
        _, _, yaw_rate_p = self.rate_p
        yaw = yaw_p * yaw_rate_p * torque_units(craft).z / craft.inertia.z
        return level, level, self.climb_p * craft.full_thrust / craft.mass, yaw

    def init(self, craft: Craft, readings: Readings, carrying: Scalar) -> "CrazyflieState":
        """Integrals at their first values, hover.

        Args:
            craft: The vehicle as the software knows it.
            readings: Measurements at the start.
            carrying: Thrust that carries the weight of the draw [N].
        """
        zero = Vec3(0.0, 0.0, 0.0)
        angles = angles_of(readings.attitude.matrix())
        setpoint = Vec3(0.0, 0.0, angles.z)
        level = heading_velocity(readings.velocity, readings.attitude.matrix())
        return CrazyflieState(
            velocity=Pid(self.first_velocity_integral(craft, carrying), level),
            attitude=Pid(Vec3(*self.attitude_integral), angles),
            rate=Pid(Vec3(*self.rate_integral), readings.rate),
            thrust=self.first_thrust(craft, carrying) / craft.full_thrust,
            setpoint=setpoint,
            yaw_rate=0.0,
            unallocated=zero,
            bounded=0.0,
        )

    def first_velocity_integral(self, craft: Craft, carrying: Scalar) -> Vec3:
        """Integrals of velocity at the start, along the heading, to the left and up [m].

        With a settled start the vertical one raises the thrust of hover to ``carrying``, the thrust that carries the
        weight of the draw [N].
        """
        integral = Vec3(*self.velocity_integral)
        if self.start is Start.ZERO:
            return integral
        lacking = (carrying - self.hover_thrust(craft)) / craft.full_thrust
        return integral._replace(z=integral.z + lacking / self.climb_i)

    def trimmed(self, craft: Craft, state: "CrazyflieState", trim: Trim) -> "CrazyflieState":
        """The state whose integrals hold a trim; their numbers in the study add to it.

        The study's start values of the integrals are added to the values that hold the equilibrium. An integral without
        a gain stays at the study's number, and nothing holds that part of the trim.
        """
        lacking = (trim.thrust - self.hover_thrust(craft)) / craft.full_thrust
        held = Vec3(
            over_gain(trim.angles.theta, self.velocity_i),
            over_gain(-trim.angles.phi, self.velocity_i),
            over_gain(lacking, self.climb_i),
        )
        torque = trim.moment.over(torque_units(craft))
        rates = Vec3(*(over_gain(value, gain) for value, gain in zip(torque, self.rate_i, strict=True)))
        return state._replace(
            velocity=state.velocity._replace(integral=Vec3(*self.velocity_integral) + held),
            rate=state.rate._replace(integral=Vec3(*self.rate_integral) + rates),
            thrust=trim.thrust / craft.full_thrust,
        )

    def first_thrust(self, craft: Craft, carrying: Scalar) -> Scalar:
        """The wanted thrust at the start without an error of velocity [N].

        ``carrying`` is the thrust that carries the weight of the draw [N].
        """
        climb = self.climb_i * self.first_velocity_integral(craft, carrying).z
        return self.hover_thrust(craft) + climb * craft.full_thrust

    def hover_thrust(self, craft: Craft) -> Scalar:
        """The thrust that the software takes to carry the weight [N]."""
        return craft.mass * GRAVITY if self.thrust_hover is None else self.thrust_hover * craft.full_thrust

    def hover(self, craft: Craft) -> Scalar:
        """Share of the full thrust that is taken to carry the weight."""
        return craft.mass * GRAVITY / craft.full_thrust if self.thrust_hover is None else self.thrust_hover

    def sample(
        self, craft: Craft, state: "CrazyflieState", readings: Readings, command: Vec3, yaw_command: Scalar, dt: float
    ) -> "CrazyflieState":
        """Velocity control: from commands to thrust, roll and pitch.

        Three PIDs act on the velocity along the heading, to its left, and up.

        Args:
            craft: The vehicle as the software knows it.
            state: State of the cascade.
            readings: Measurements.
            command: Commanded velocity, inertial [m/s].
            yaw_command: Commanded rate of yaw [rad/s].
            dt: T_s of the loop [s].
        """
        rotation = readings.attitude.matrix()
        measured = heading_velocity(readings.velocity, rotation)
        error = heading_velocity(command, rotation) - measured
        gains = (
            Vec3(self.velocity_p, self.velocity_p, self.climb_p),
            Vec3(self.velocity_i, self.velocity_i, self.climb_i),
            Vec3(self.velocity_d, self.velocity_d, self.climb_d),
        )
        bound = Vec3(INTEGRAL_OF_VELOCITY, INTEGRAL_OF_VELOCITY, INTEGRAL_OF_VELOCITY)
        slope = (measured - state.velocity.measured) * (1.0 / dt)
        velocity, output = pid(state.velocity, error, measured, slope, gains, bound, dt)
        forward = clip(output.x, -self.tilt_max, self.tilt_max)
        left = clip(output.y, -self.tilt_max, self.tilt_max)
        climb = clip(output.z, -0.5, 0.5)  # half of the full thrust: the firmware's limit of this PID
        thrust = climb + self.hover(craft)
        bounded = thrust < self.thrust_min
        return state._replace(
            velocity=velocity,
            thrust=clip(thrust, self.thrust_min, 1.0),
            setpoint=Vec3(-left, forward, state.setpoint.z),
            yaw_rate=yaw_command,
            bounded=jnp.where(bounded, 1.0, 0.0),
        )

    def tick(
        self, craft: Craft, state: "CrazyflieState", readings: Readings, dt: float
    ) -> tuple["CrazyflieState", Wrench]:
        """Attitude and rate control: from the held angles to thrust and moment.

        Three PIDs turn errors of the angles into desired rates, and three others turn errors of the rates into torque
        commands, which :func:`torque_units` converts to moments. Angles of yaw are wrapped to (-pi, pi].

        Args:
            craft: The vehicle as the software knows it.
            state: State of the cascade.
            readings: Measurements.
            dt: Time since the last tick [s].
        """
        # attitude: from errors of the angles to desired rates
        angles = angles_of(readings.attitude.matrix())
        setpoint = state.setpoint._replace(z=wrap_angle(state.setpoint.z + state.yaw_rate * dt))
        error = setpoint - angles
        error = error._replace(z=wrap_angle(error.z))
        change = angles - state.attitude.measured
        slope = change._replace(z=wrap_angle(change.z)) * (1.0 / dt)
        gains = (Vec3(*self.attitude_p), Vec3(*self.attitude_i), Vec3(*self.attitude_d))
        bound = Vec3(*self.attitude_integral_max)
        attitude, rates = pid(state.attitude, error, angles, slope, gains, bound, dt)
        # rates: from their errors to torque commands
        slope = (readings.rate - state.rate.measured) * (1.0 / dt)
        gains = (Vec3(*self.rate_p), Vec3(*self.rate_i), Vec3(*self.rate_d))
        bound = Vec3(*self.rate_integral_max)
        rate, torque = pid(state.rate, rates - readings.rate, readings.rate, slope, gains, bound, dt)
        after = state._replace(attitude=attitude, rate=rate, setpoint=setpoint)
        return after, Wrench(state.thrust * craft.full_thrust, torque.scale(torque_units(craft)))


class Pid(NamedTuple):
    """State of three PIDs: the integrals of their errors, and their last measurements."""

    integral: Vec3
    measured: Vec3


class CrazyflieState(NamedTuple):
    """State of the cascade.

    Args:
        velocity: State of the velocity PIDs, along the heading, to its left, and up.
        attitude: State of the attitude PIDs.
        rate: State of the rate PIDs.
        thrust: Held thrust, as a share of the full one.
        setpoint: Held roll and pitch, and the desired yaw [rad].
        yaw_rate: Held rate of yaw [rad/s].
        unallocated: Moment that the rotors did not give at the last tick, which this cascade does not read [N m].
        bounded: Whether the thrust is at its lower limit.
    """

    velocity: Pid
    attitude: Pid
    rate: Pid
    thrust: Scalar
    setpoint: Vec3
    yaw_rate: Scalar
    unallocated: Vec3
    bounded: Scalar


def pid(
    state: Pid,
    error: Vec3,
    measured: Vec3,
    slope: Vec3,
    gains: tuple[Vec3, Vec3, Vec3],
    integral_max: Vec3,
    dt: Scalar,
) -> tuple[Pid, Vec3]:
    """One sample of three PIDs with the derivative of the measurement and a limited integral, backward Euler.

    Args:
        state: Integrals and last measurements.
        error: Errors of the three measurements.
        measured: The measurements.
        slope: Derivatives of the measurements.
        gains: Proportional, integral and derivative gains.
        integral_max: Limits of the integrals' magnitudes.
        dt: Time since the last sample [s].

    Returns:
        The next state, and the outputs.
    """
    proportional, integral_gain, derivative = gains
    integral = limited(state.integral + error * dt, integral_max)
    output = error.scale(proportional) + integral.scale(integral_gain) - slope.scale(derivative)
    return Pid(integral, measured), output


def over_gain(value: Scalar, gain: Scalar) -> Scalar:
    """The integral that gives a value; 0 without a gain.

    A gain that is known to be 0 before tracing adds nothing to the program; a traced gain may be 0 in some draws.
    """
    if is_zero(gain):
        return 0.0
    missing = gain == 0.0
    return jnp.where(missing, 0.0, value / jnp.where(missing, 1.0, gain))


def heading_velocity(velocity: Vec3, rotation: Mat3) -> Vec3:
    """A velocity along the heading, to its left, and up [m/s].

    Args:
        velocity: The velocity, inertial axes [m/s].
        rotation: R, body to inertial, which gives the heading.
    """
    flat = 1.0 / jnp.sqrt(jnp.maximum(rotation.a.x * rotation.a.x + rotation.b.x * rotation.b.x, 1e-12))
    cosine = rotation.a.x * flat
    sine = rotation.b.x * flat
    return Vec3(velocity.x * cosine + velocity.y * sine, velocity.y * cosine - velocity.x * sine, velocity.z)


def torque_units(craft: Craft) -> Vec3:
    """The moments about body x, y, z [N m] of commands of 1, as the firmware's power distribution scales them.

    A command of 1 changes the thrust of the rotor with the largest entry in its column of the allocation: by half of
    the rotor's limit for roll and pitch, and by the whole limit for yaw.
    """
    moment_columns = np.array(craft.allocation, dtype=float)[:, 1:4]  # thrust per moment [1/m], without net thrust
    largest_entries = np.abs(moment_columns).max(axis=0)
    roll, pitch, yaw = (craft.rotor_limit / float(entry) for entry in largest_entries)
    return Vec3(0.5 * roll, 0.5 * pitch, yaw)
