"""PX4's cascade below its position control: velocity PID, quaternion attitude control, rate PID.

    a_d = K_P (u - v) + I - K_D v'_f,  I' = K_I (u - v) with anti-windup            at each sample of the loop
    f_d = M (a_z + g)/cos(tilt) along (a_x, a_y, g), within the limits of tilt and thrust
    Omega_d = 2 K_q sgn(q_e0) q_e,  q_e from the attitude to that of f_d, with a yaw weight
    M_d = K_P (Omega_d - Omega) + I - K_D Omega'_f + K_FF Omega_d                   at each tick

The desired heading is the present one, and u_psi is fed forward as a rate of yaw, as PX4 does without a heading
setpoint. Gains of the rate loop are in PX4's units: shares of the largest torque, see
:func:`~dssc_jax.models.uav.inner_loops.px4_conversions.torque_units`. Axes here point forward, left and up instead of
forward, right and down; gains are the same in both.

References:
    PX4 1.14, modules mc_pos_control (PositionControl), mc_att_control (AttitudeControl), lib/rate_control,
    control_allocator (ControlAllocationPseudoInverse) and their parameter reference.
    D. Brescianini, M. Hehn, R. D'Andrea, Nonlinear quadrocopter attitude control (2013).
    L. Rundqwist, Anti-reset windup for PID controllers (1990).
"""

import math
from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import clip, root_abs
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Quaternion, Vec3
from dssc_jax.lanes.functions.approximations import atan2
from dssc_jax.models.uav.inner_loops.px4_conversions import attitude_of, torque_units
from dssc_jax.models.uav.inner_loops.sampled import (
    Craft,
    LowPass,
    Readings,
    Trim,
    blend,
    canonical,
    conjugate,
    half_angle,
    limited,
    low_pass,
    product,
    require_integral,
    require_triples,
    settled_low_pass,
    smoothing,
)
from dssc_jax.models.uav.inner_loops.start import Start
from dssc_jax.models.uav.rotors import Wrench
from dssc_jax.models.uav.vehicle import GRAVITY

RATE_OF_LESS_INTEGRAL = math.radians(400.0)
"""Rate error at which the rate integral stops growing: PX4's reduction of bounce-back after a flip."""
OPPOSITE = -1.0 + 4e-5
"""Cosine of the angle between body z and the desired one, below which they count as opposite."""
SMALLEST_WEIGHT = 1e-4
"""Smallest yaw weight whose effect on the yaw gain is compensated."""
LEAST_MISSING = 2.0**-23
"""Share of the largest torque beyond which a torque that the rotors do not give stops the integral: FLT_EPSILON."""
CUTOFF_OF_GYRO = "IMU_GYRO_CUTOFF; 0: no filter"
CUTOFF_OF_SLOPE = "IMU_DGYRO_CUTOFF; 0: no filter"

TRIPLES = ("attitude_p", "rate_max", "rate_p", "rate_i", "rate_d", "rate_ff", "rate_integral_max", "rate_integral")
"""Fields with a value for roll, pitch and yaw each."""


class Px4Gains(NamedTuple):
    """Gains of PX4's cascade; the defaults are PX4's own, with angles in radians.

    A triple has a value for roll, pitch and yaw each.
    """

    frequency: Annotated[float, Quantity("Hz", "rate of the attitude and rate loops", above=0.0, law=False)] = 400.0
    velocity_p_xy: Annotated[Scalar, Quantity("1/s", "MPC_XY_VEL_P_ACC", above=0.0)] = 1.8
    velocity_i_xy: Annotated[Scalar, Quantity("1/s^2", "MPC_XY_VEL_I_ACC", at_least=0.0)] = 0.4
    velocity_d_xy: Annotated[Scalar, Quantity("1", "MPC_XY_VEL_D_ACC", at_least=0.0)] = 0.2
    velocity_p_z: Annotated[Scalar, Quantity("1/s", "MPC_Z_VEL_P_ACC", above=0.0)] = 4.0
    velocity_i_z: Annotated[Scalar, Quantity("1/s^2", "MPC_Z_VEL_I_ACC", at_least=0.0)] = 2.0
    velocity_d_z: Annotated[Scalar, Quantity("1", "MPC_Z_VEL_D_ACC", at_least=0.0)] = 0.0
    velocity_cutoff: Annotated[float | None, Quantity("Hz", "cutoff of v'", above=0.0, law=False)] = 5.0
    tilt_max: Annotated[Scalar, Quantity("rad", "MPC_TILTMAX_AIR", above=0.0, below=1.55)] = math.radians(45.0)
    thrust_min: Annotated[
        Scalar, Quantity("1", "MPC_THR_MIN, share of full thrust", above=0.0, below=1.0, less_than="thrust_max")
    ] = 0.12
    thrust_max: Annotated[Scalar, Quantity("1", "MPC_THR_MAX", above=0.0, at_most=1.0)] = 1.0
    thrust_margin: Annotated[Scalar, Quantity("1", "MPC_THR_XY_MARG", at_least=0.0, at_most=1.0)] = 0.3
    thrust_hover: Annotated[Scalar | None, Quantity("1", "MPC_THR_HOVER; absent: exact", above=0.0, below=1.0)] = None
    attitude_p: Annotated[tuple[Scalar, ...], Quantity("1/s", "MC_ROLL_P, _PITCH_P, _YAW_P", at_least=0.0)] = (
        6.5,
        6.5,
        2.8,
    )
    yaw_weight: Annotated[Scalar, Quantity("1", "MC_YAW_WEIGHT", at_least=0.0, at_most=1.0)] = 0.4
    rate_max: Annotated[tuple[Scalar, ...], Quantity("rad/s", "MC_ROLLRATE_MAX, ..", above=0.0)] = (
        math.radians(220.0),
        math.radians(220.0),
        math.radians(200.0),
    )
    rate_p: Annotated[tuple[Scalar, ...], Quantity("s", "MC_ROLLRATE_P, .. times _K", at_least=0.0)] = (0.15, 0.15, 0.2)
    rate_i: Annotated[tuple[Scalar, ...], Quantity("1", "MC_ROLLRATE_I, ..", at_least=0.0)] = (0.2, 0.2, 0.1)
    rate_d: Annotated[tuple[Scalar, ...], Quantity("s^2", "MC_ROLLRATE_D, ..", at_least=0.0)] = (0.003, 0.003, 0.0)
    rate_ff: Annotated[tuple[Scalar, ...], Quantity("s", "MC_ROLLRATE_FF, ..", at_least=0.0)] = (0.0, 0.0, 0.0)
    rate_integral_max: Annotated[tuple[Scalar, ...], Quantity("1", "MC_RR_INT_LIM, ..", at_least=0.0)] = (0.3, 0.3, 0.3)
    gyro_cutoff: Annotated[float | None, Quantity("Hz", CUTOFF_OF_GYRO, at_least=0.0, law=False)] = 40.0
    derivative_cutoff: Annotated[float | None, Quantity("Hz", CUTOFF_OF_SLOPE, at_least=0.0, law=False)] = 30.0
    start: Start = Start.ZERO
    velocity_integral: Annotated[tuple[Scalar, ...], Quantity("m/s^2", "first integrals of velocity, x, y, z up")] = (
        0.0,
        0.0,
        0.0,
    )
    rate_integral: Annotated[tuple[Scalar, ...], Quantity("1", "first integrals of rates, of the largest torque")] = (
        0.0,
        0.0,
        0.0,
    )

    @property
    def period(self) -> float:
        """Time between two ticks [s]."""
        return 1.0 / self.frequency

    def prepare(self) -> "Px4Gains":
        """The gains without the filters whose cutoff is 0, after a check of the rules that span several fields.

        Raises:
            ConfigError: A triple has not three values, a settled start has no integral gain of the vertical velocity,
                or the gyroscopes' filter is too fast for the ticks.
        """
        require_triples(self, TRIPLES)
        require_integral(self, "velocity_i_z")
        cutoff = self.gyro_cutoff
        if cutoff is not None and not 2.0 * cutoff < self.frequency:
            rule = f"must be below frequency/2 = {0.5 * self.frequency:g} Hz"
            raise ConfigError("gyro_cutoff", f"{rule}, got {cutoff:g} Hz")
        return self._replace(gyro_cutoff=cutoff or None, derivative_cutoff=self.derivative_cutoff or None)

    def input_gain(self, craft: Craft) -> tuple[Scalar, ...]:
        """k_p of x, y, z and psi: what a command adds to the acceleration at first [1/s]."""
        yaw = (self.rate_p[2] + self.rate_ff[2]) * torque_units(craft).z / craft.inertia.z  # [2]: of roll, pitch, yaw
        return self.velocity_p_xy, self.velocity_p_xy, self.velocity_p_z, yaw

    def init(self, craft: Craft, readings: Readings, carrying: Scalar) -> "Px4State":
        """Integrals at their first values, filters settled, hover.

        Args:
            craft: The vehicle as the software knows it.
            readings: Measurements at the start.
            carrying: Thrust that carries the weight of the draw [N].
        """
        zero = Vec3(0.0, 0.0, 0.0)
        gyro = () if self.gyro_cutoff is None else settled_low_pass(readings.rate, self.gyro_cutoff, self.period)
        thrust = Vec3(0.0, 0.0, self.first_thrust(craft, carrying) / craft.full_thrust)
        return Px4State(
            velocity_integral=self.first_velocity_integral(craft, carrying),
            velocity=readings.velocity,
            acceleration=zero,
            thrust=thrust,
            attitude=readings.attitude,
            yaw_rate=0.0,
            rate_integral=Vec3(*self.rate_integral),
            unallocated=zero,
            gyro=gyro,
            rate=readings.rate,
            turning=zero,
            bounded=0.0,
        )

    def first_velocity_integral(self, craft: Craft, carrying: Scalar) -> Vec3:
        """I of the velocity loops at the start [m/s^2].

        With a settled start its vertical part raises the thrust of hover to ``carrying``, the thrust that carries the
        weight of the draw [N].
        """
        integral = Vec3(*self.velocity_integral)
        if self.start is Start.ZERO:
            return integral
        return integral._replace(z=integral.z + GRAVITY * (carrying / self.hover_thrust(craft) - 1.0))

    def trimmed(self, craft: Craft, state: "Px4State", trim: Trim) -> "Px4State":
        """The state whose integrals hold a trim; their numbers in the study add to it.

        The integral of velocity is then the desired acceleration that gives the trim's thrust, and the integral of the
        rates its moment, in shares of the largest torques.
        """
        upward = trim.upward
        lift = GRAVITY * (trim.thrust * upward.z / self.hover_thrust(craft) - 1.0)
        held = Vec3(GRAVITY * upward.x / upward.z, GRAVITY * upward.y / upward.z, lift)
        return state._replace(
            velocity_integral=Vec3(*self.velocity_integral) + held,
            thrust=upward * (trim.thrust / craft.full_thrust),
            rate_integral=Vec3(*self.rate_integral) + trim.moment.over(torque_units(craft)),
        )

    def first_thrust(self, craft: Craft, carrying: Scalar) -> Scalar:
        """The wanted thrust at the start without an error of velocity [N].

        ``carrying`` is the thrust that carries the weight of the draw [N].
        """
        return self.hover_thrust(craft) * (1.0 + self.first_velocity_integral(craft, carrying).z / GRAVITY)

    def hover_thrust(self, craft: Craft) -> Scalar:
        """The thrust that the software takes to carry the weight [N]."""
        return craft.mass * GRAVITY if self.thrust_hover is None else self.thrust_hover * craft.full_thrust

    def hover(self, craft: Craft) -> Scalar:
        """Share of the full thrust that is taken to carry the weight."""
        return craft.mass * GRAVITY / craft.full_thrust if self.thrust_hover is None else self.thrust_hover

    def sample(
        self, craft: Craft, state: "Px4State", readings: Readings, command: Vec3, yaw_command: Scalar, dt: float
    ) -> "Px4State":
        """Velocity control: from commands to thrust, attitude and rate of yaw.

        A PID in inertial axes gives a desired acceleration, ``setpoint``; its thrust is limited, and the integral gets
        the part of the velocity error that does not drive the thrust further beyond a limit.

        Args:
            craft: The vehicle as the software knows it.
            state: State of the cascade.
            readings: Measurements.
            command: Commanded velocity, inertial [m/s].
            yaw_command: Commanded rate of yaw [rad/s].
            dt: T_s of the loop [s].
        """
        slope = (readings.velocity - state.velocity) * (1.0 / dt)
        acceleration = blend(state.acceleration, slope, smoothing(self.velocity_cutoff, dt))
        error = command - readings.velocity
        proportional = Vec3(self.velocity_p_xy, self.velocity_p_xy, self.velocity_p_z)
        derivative = Vec3(self.velocity_d_xy, self.velocity_d_xy, self.velocity_d_z)
        setpoint = error.scale(proportional) + state.velocity_integral - acceleration.scale(derivative)
        thrust, bounded = self.thrust_of(setpoint, self.hover(craft))
        allowed, windup = self.within_thrust(thrust, setpoint, error, self.hover(craft))
        gain = Vec3(self.velocity_i_xy, self.velocity_i_xy, self.velocity_i_z)
        integral = state.velocity_integral + windup.scale(gain) * dt
        integral = integral._replace(z=clip(integral.z, -GRAVITY, GRAVITY))
        return state._replace(
            velocity_integral=integral,
            velocity=readings.velocity,
            acceleration=acceleration,
            thrust=allowed,
            attitude=attitude_of(allowed, readings.attitude),
            yaw_rate=yaw_command,
            bounded=jnp.where(bounded, 1.0, 0.0),
        )

    def thrust_of(self, setpoint: Vec3, hover: Scalar) -> tuple[Vec3, Scalar]:
        """Thrust for an acceleration, in shares of the full one, within tilt and lower limit; whether that binds.

        Args:
            setpoint: Desired acceleration, inertial, without g [m/s^2].
            hover: Share of the full thrust that carries the weight.
        """
        horizontal = root_abs(setpoint.x * setpoint.x + setpoint.y * setpoint.y)
        steepest = GRAVITY * jnp.sin(self.tilt_max) / jnp.cos(self.tilt_max)
        share = jnp.where(horizontal > steepest, steepest / jnp.maximum(horizontal, steepest), 1.0)
        direction = Vec3(setpoint.x * share, setpoint.y * share, GRAVITY)
        direction = direction / jnp.sqrt(direction.dot(direction))
        collective = (setpoint.z * (hover / GRAVITY) + hover) / direction.z
        bounded = collective < self.thrust_min
        return direction * jnp.maximum(collective, self.thrust_min), bounded

    def within_thrust(self, thrust: Vec3, setpoint: Vec3, error: Vec3, hover: Scalar) -> tuple[Vec3, Vec3]:
        """Thrust within its upper limit, the vertical part first; the velocity error that the integral takes.

        Up to ``thrust_margin``, the horizontal thrust is kept even where the vertical thrust wants all. The integral
        does not take a vertical error that drives the thrust beyond a limit. A horizontal error is reduced by 2/K_P
        times the acceleration that the limit takes away (Rundqwist's anti-windup).

        Args:
            thrust: Wanted thrust, inertial, in shares of the full one.
            setpoint: Desired acceleration, inertial, without g [m/s^2].
            error: Error of the velocity, inertial [m/s].
            hover: Share of the full thrust that carries the weight.
        """
        low = (thrust.z <= self.thrust_min) & (error.z <= 0.0)
        high = (thrust.z >= self.thrust_max) & (error.z >= 0.0)
        vertical_error = jnp.where(low | high, 0.0, error.z)
        norm = root_abs(thrust.x * thrust.x + thrust.y * thrust.y)
        kept = jnp.minimum(norm, self.thrust_margin)
        full = self.thrust_max * self.thrust_max
        vertical = jnp.minimum(thrust.z, jnp.sqrt(jnp.maximum(full - kept * kept, 0.0)))
        left = root_abs(jnp.maximum(full - vertical * vertical, 0.0))
        share = jnp.where(norm > left, left / jnp.maximum(norm, 1e-12), 1.0)
        allowed = Vec3(thrust.x * share, thrust.y * share, vertical)
        x = allowed.x * (GRAVITY / hover)
        y = allowed.y * (GRAVITY / hover)
        saturated = setpoint.x * setpoint.x + setpoint.y * setpoint.y > x * x + y * y
        gain = 2.0 / self.velocity_p_xy
        return allowed, Vec3(
            error.x - jnp.where(saturated, gain * (setpoint.x - x), 0.0),
            error.y - jnp.where(saturated, gain * (setpoint.y - y), 0.0),
            vertical_error,
        )

    def tick(self, craft: Craft, state: "Px4State", readings: Readings, dt: float) -> tuple["Px4State", Wrench]:
        """Attitude and rate control: from the held attitude to thrust and moment.

        The error of the attitude gives a desired body rate. A PID with feed-forward turns the error of the body rate
        into torque commands, in shares of the largest torques. A torque that the rotors do not give stops the integral.
        """
        rate = readings.rate
        gyro = state.gyro
        if isinstance(gyro, LowPass) and self.gyro_cutoff is not None:
            gyro, rate = low_pass(gyro, readings.rate, self.gyro_cutoff, dt)
        slope = (rate - state.rate) * (1.0 / dt)
        turning = blend(state.turning, slope, smoothing(self.derivative_cutoff, dt))
        setpoint = limited(self.rate_for(state, readings.attitude), Vec3(*self.rate_max))
        error = setpoint - rate
        torque = (
            error.scale(Vec3(*self.rate_p))
            + state.rate_integral
            - turning.scale(Vec3(*self.rate_d))
            + setpoint.scale(Vec3(*self.rate_ff))
        )
        missing = state.unallocated.over(torque_units(craft))
        integral = state.rate_integral + self.integrated(error, missing) * dt
        after = state._replace(
            gyro=gyro,
            rate=rate,
            turning=turning,
            rate_integral=limited(integral, Vec3(*self.rate_integral_max)),
        )
        collective = state.thrust.norm()
        return after, Wrench(collective * craft.full_thrust, torque.scale(torque_units(craft)))

    def rate_for(self, state: "Px4State", attitude: Quaternion) -> Vec3:
        """The body rate that turns an attitude into the held one [rad/s]: tilt first, yaw by its weight.

        The rotation to the held attitude is split into the shortest rotation that aligns body z, ``reduced``, and the
        remaining rotation about it, ``yaw``, of which only the share ``yaw_weight`` is kept. The commanded rate of yaw
        is added about the vertical.
        """
        error = product(conjugate(attitude), state.attitude)
        # (x, y, z): the desired body z in body axes; ``reduced`` turns body z to it, and ``yaw`` is left
        x = 2.0 * (error.x * error.z + error.w * error.y)
        y = 2.0 * (error.y * error.z - error.w * error.x)
        z = 1.0 - 2.0 * (error.x * error.x + error.y * error.y)
        cosine, half = half_angle(z, 1.0)
        reduced = Quaternion(cosine, -y * half, x * half, 0.0)
        yaw = canonical(product(conjugate(reduced), error))
        turn = self.yaw_weight * atan2(yaw.z, yaw.w)
        mixed = product(reduced, Quaternion(jnp.cos(turn), 0.0, 0.0, jnp.sin(turn)))
        opposite = z < OPPOSITE  # no shortest rotation of the tilt: all of the error at once, as in PX4
        weighted = canonical(Quaternion(*(jnp.where(opposite, w, m) for w, m in zip(error, mixed, strict=True))))
        roll_p, pitch_p, yaw_p = self.attitude_p
        yaw_p = yaw_p / jnp.where(self.yaw_weight > SMALLEST_WEIGHT, self.yaw_weight, 1.0)
        turned = Vec3(weighted.x, weighted.y, weighted.z).scale(Vec3(2.0 * roll_p, 2.0 * pitch_p, 2.0 * yaw_p))
        return turned + attitude.matrix().c * state.yaw_rate

    def integrated(self, error: Vec3, lacking: Vec3) -> Vec3:
        """Slope of the rate integral: less of a large error, none towards a limit of the rotors.

        Args:
            error: Error of the body rate [rad/s].
            lacking: Torque that the rotors did not give, in shares of the largest torque.
        """
        slopes = []
        for value, missing, gain in zip(error, lacking, self.rate_i, strict=True):
            held = jnp.where(missing > LEAST_MISSING, jnp.minimum(value, 0.0), value)
            held = jnp.where(missing < -LEAST_MISSING, jnp.maximum(held, 0.0), held)
            ratio = held / RATE_OF_LESS_INTEGRAL
            slopes.append(jnp.maximum(1.0 - ratio * ratio, 0.0) * gain * held)
        return Vec3(*slopes)


class Px4State(NamedTuple):
    """State of the cascade; held values go from a sample of the loop to the ticks within it.

    Args:
        velocity_integral: I of the velocity loops [m/s^2].
        velocity: The last measured velocity [m/s].
        acceleration: Filtered slope of the measured velocity [m/s^2].
        thrust: Held thrust, inertial, in shares of the full one.
        attitude: Held attitude.
        yaw_rate: Held rate of yaw [rad/s].
        rate_integral: I of the rate loops, in shares of the largest torque.
        unallocated: Moment that the rotors did not give at the last tick [N m].
        gyro: State of the rate's low-pass filter; () without one.
        rate: The last filtered rate [rad/s].
        turning: Filtered slope of the filtered rate [rad/s^2].
        bounded: Whether the thrust is at its lower limit.
    """

    velocity_integral: Vec3
    velocity: Vec3
    acceleration: Vec3
    thrust: Vec3
    attitude: Quaternion
    yaw_rate: Scalar
    rate_integral: Vec3
    unallocated: Vec3
    gyro: LowPass | tuple[()]
    rate: Vec3
    turning: Vec3
    bounded: Scalar
