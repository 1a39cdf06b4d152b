"""Inner loops: state-feedback linearisation with integral action, from velocity commands to thrust and moment.

The article gives their gains but not their formulas; this is a reconstruction:

    a = k_d (u - v) + k_p int (u - v)                                        for x, y, z
    theta_d = atan((a_x cos psi + a_y sin psi)/(a_z + g))
    phi_d = atan(cos theta_d (a_x sin psi - a_y cos psi)/(a_z + g))
    f = M (a_z + g)/(cos phi cos theta), or M |a + g e3|
    phi'' = 60 (phi_d - phi) - 15 phi', theta'' likewise, psi'' = k_d (u_psi - psi') + k_p int (u_psi - psi')
    M_net = J W euler'' + J W' euler' + Omega x J Omega,   Omega = W euler'

with R = R_z(psi) R_y(theta) R_x(phi). The inner loops use nominal values of mass and inertia, not the draw's.
"""

from enum import StrEnum
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.numerics import is_zero
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Mat3, Vec3
from dssc_jax.lanes.functions.approximations import atan2
from dssc_jax.models.uav.inner_loops.sampled import Craft, Trim, attitude_from_angles, require_integral
from dssc_jax.models.uav.inner_loops.start import Start
from dssc_jax.models.uav.rigid_body import turning_moment
from dssc_jax.models.uav.vehicle import GRAVITY

FEED_FORWARD_ROUNDS = 12
"""Rounds in which desired angles and their fed-forward rates agree in a trim."""
LEAST_LIFT = 0.1 * GRAVITY  # a_z + g is bounded below by g/10


@jax.tree_util.register_static
class ThrustRule(StrEnum):
    """How the thrust follows from the desired acceleration a.

    With ``projection`` the vertical part of the thrust over the mass is a_z + g, whatever the tilt. With ``norm`` the
    thrust is |a + g e3| times the mass.
    """

    PROJECTION = "projection"
    NORM = "norm"


@jax.tree_util.register_static
class AttitudeReference(StrEnum):
    """Whether the desired roll and pitch, phi_d and theta_d, count as constants, or their rates are fed forward.

    With a held command the desired acceleration changes as -k_d v does. Feed-forward of the rates then acts like more
    stiffness of the attitude, and slows the velocity loops down from 1/(s + 1) to 0.8/(s + 0.8).
    """

    PLAIN = "plain"
    RATE_FEED_FORWARD = "rate_feed_forward"


class InnerGains(NamedTuple):
    """Gains of the article's inner loops (Section V-B), variants of their reconstruction, and the integrals' start."""

    kp_velocity: Annotated[Scalar, Quantity("1/s^2", "integral gain of x, y, z", at_least=0.0)] = 0.0
    kd_velocity: Annotated[Scalar, Quantity("1/s", "proportional gain of x, y, z", above=0.0)] = 1.0
    kp_attitude: Annotated[Scalar, Quantity("1/s^2", "stiffness of phi, theta", above=0.0)] = 60.0
    kd_attitude: Annotated[Scalar, Quantity("1/s", "damping of phi, theta", above=0.0)] = 15.0
    kp_yaw: Annotated[Scalar, Quantity("1/s^2", "integral gain of psi'", at_least=0.0)] = 0.2
    kd_yaw: Annotated[Scalar, Quantity("1/s", "proportional gain of psi'", above=0.0)] = 1.0
    thrust: ThrustRule = ThrustRule.PROJECTION
    attitude: AttitudeReference = AttitudeReference.PLAIN
    start: Start = Start.ZERO
    velocity_integral: Annotated[tuple[Scalar, ...], Quantity("m", "first integrals of velocity, x, y, z up")] = (
        0.0,
        0.0,
        0.0,
    )

    def prepare(self) -> "InnerGains":
        """The gains themselves, after a check of the integrals at the start; raises ConfigError."""
        require_integral(self, "kp_velocity")
        return self

    def first_velocity_integral(self, craft: Craft, carrying: Scalar) -> Vec3:
        """int (u - v) at the start [m].

        With a settled start its vertical part raises the thrust from the believed weight to ``carrying``, the thrust
        that carries the draw [N].
        """
        integral = Vec3(*self.velocity_integral)
        if self.start is Start.ZERO:
            return integral
        return integral._replace(z=integral.z + (carrying / craft.mass - GRAVITY) / self.kp_velocity)

    def trimmed(self, craft: Craft, trim: Trim) -> "Integrals":
        """The integrals that hold an equilibrium; the study's start values add to the integrals of velocity [m].

        The attitude loops have no integral action. Where the equilibrium needs a moment, the desired angles therefore
        differ from the true angles, so that the attitude loops demand this moment. The inner loop does not know the
        drag, and takes the force against the drag for an acceleration. With feed-forward it therefore also feeds
        forward rates of the desired angles; a fixed-point iteration makes angles and rates agree.

        Args:
            craft: The vehicle as the inner loop knows it.
            trim: The equilibrium.
        """
        rotation = attitude_from_angles(trim.angles).matrix()
        at = trig_of(rotation)
        wanted = euler_rates(at, trim.moment.over(craft.inertia))  # accelerations of the angles [rad/s^2]
        specific_thrust = trim.thrust / craft.mass  # [m/s^2]
        surplus = trim.upward * specific_thrust - Vec3(0.0, 0.0, GRAVITY)  # acceleration that the inner loop assumes
        by_norm = self.thrust is ThrustRule.NORM
        feeds = self.attitude is AttitudeReference.RATE_FEED_FORWARD
        phi_rate: Scalar = 0.0  # rates of the desired roll and pitch [rad/s]
        theta_rate: Scalar = 0.0
        desired = Vec3(0.0, 0.0, GRAVITY)  # desired acceleration, with g
        for _ in range(FEED_FORWARD_ROUNDS if feeds else 1):
            phi = trim.angles.phi + (wanted.phi - self.kd_attitude * phi_rate) / self.kp_attitude
            theta = trim.angles.theta + (wanted.theta - self.kd_attitude * theta_rate) / self.kp_attitude
            up = specific_thrust * (jnp.cos(phi) * jnp.cos(theta) if by_norm else rotation.c.z)
            desired = acceleration_for_tilt(phi, theta, up, at)
            if feeds:
                heading = (at.cpsi, at.spsi)
                heading_dot = (jnp.zeros_like(at.cpsi), jnp.zeros_like(at.spsi))
                slope = surplus * -self.kd_velocity  # of the desired acceleration
                _, (phi_rate, theta_rate) = jax.jvp(desired_tilt, (desired, heading), (slope, heading_dot))
        held = (desired - Vec3(0.0, 0.0, GRAVITY)) / self.kp_velocity
        yaw = 0.0 if is_zero(self.kp_yaw) else wanted.psi / self.kp_yaw
        return Integrals(Vec3(*self.velocity_integral) + held, yaw)

    def first_thrust(self, craft: Craft, carrying: Scalar) -> Scalar:
        """The wanted thrust at the start without an error of velocity [N].

        ``carrying`` is the thrust that carries the draw [N].
        """
        lift = GRAVITY + self.kp_velocity * self.first_velocity_integral(craft, carrying).z
        return craft.mass * lift

    @property
    def has_proof(self) -> bool:
        """Whether the theorem of the vehicle covers this inner loop, in some of its variants."""
        return True


class Integrals(NamedTuple):
    """int (u - v) of the velocity loops [m], and int (u_psi - psi') [rad]."""

    velocity: Vec3
    yaw: Scalar


class Euler(NamedTuple):
    """Roll phi, pitch theta, yaw psi [rad], or their rates."""

    phi: Scalar
    theta: Scalar
    psi: Scalar


class Trig(NamedTuple):
    """Cosines and sines of the Euler angles, from the rotation matrix; ``secant`` is 1/cos theta."""

    cphi: Scalar
    sphi: Scalar
    ctheta: Scalar
    stheta: Scalar
    cpsi: Scalar
    spsi: Scalar
    secant: Scalar


class Lean(NamedTuple):
    """Sides of two right-angled triangles, whose angles are the desired roll and pitch [m/s^2].

    tan theta_d is ``forward`` over ``up``, and tan phi_d is ``left`` over ``slant``.
    """

    forward: Scalar
    up: Scalar
    left: Scalar
    slant: Scalar


class Demand(NamedTuple):
    """Demand of the inner loops: thrust [N], moment [N m], rates of the integrals, and whether a_z was bounded.

    The wanted lift a_z + g is bounded below by ``LEAST_LIFT``.
    """

    thrust: Scalar
    moment: Vec3
    integrals: Integrals
    bounded: Scalar


def trig_of(rotation: Mat3) -> Trig:
    """Sines and cosines of the Euler angles of a rotation, without inverse functions.

    The pitch is taken within [-pi/2, pi/2], so that cos theta is not negative. Near the singularity cos theta counts as
    1e-6, and ``secant`` stays finite.
    """
    square = jnp.maximum(rotation.c.y**2 + rotation.c.z**2, 1e-12)
    secant = 1.0 / jnp.sqrt(square)
    return Trig(
        cphi=rotation.c.z * secant,
        sphi=rotation.c.y * secant,
        ctheta=square * secant,
        stheta=-rotation.c.x,
        cpsi=rotation.a.x * secant,
        spsi=rotation.b.x * secant,
        secant=secant,
    )


def euler_of(rotation: Mat3) -> Euler:
    """The Euler angles of a rotation [rad]: pitch in [-pi/2, pi/2], roll and yaw in (-pi, pi]."""
    flat = jnp.sqrt(rotation.c.y**2 + rotation.c.z**2)
    return Euler(
        atan2(rotation.c.y, rotation.c.z),
        atan2(-rotation.c.x, flat),
        atan2(rotation.b.x, rotation.a.x),
    )


def euler_rates(at: Trig, rate: Vec3) -> Euler:
    """The rates of the Euler angles, W^-1 Omega [rad/s], for a body rate Omega [rad/s].

    W is the matrix with Omega = W euler'.

    Args:
        at: Sines and cosines of the angles.
        rate: Body rate Omega [rad/s].
    """
    turn = at.sphi * rate.y + at.cphi * rate.z
    psi = turn * at.secant
    return Euler(rate.x + at.stheta * psi, at.cphi * rate.y - at.sphi * rate.z, psi)


def lean(acceleration: Vec3, heading: tuple[Scalar, Scalar]) -> Lean:
    """The triangles of phi_d and theta_d for a desired acceleration.

    Args:
        acceleration: a_x, a_y, and a_z + g [m/s^2].
        heading: (cos psi, sin psi).
    """
    cpsi, spsi = heading
    forward = acceleration.x * cpsi + acceleration.y * spsi
    left = acceleration.x * spsi - acceleration.y * cpsi
    # tan phi_d = (left/a_z) cos theta_d, and cos theta_d = a_z/(a_z^2 + forward^2)^(1/2)
    return Lean(forward, acceleration.z, left, jnp.sqrt(acceleration.z**2 + forward**2))


def desired_tilt(acceleration: Vec3, heading: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
    """The desired roll and pitch (phi_d, theta_d) [rad]; arguments as for :func:`lean`."""
    sides = lean(acceleration, heading)
    return atan2(sides.left, sides.slant), atan2(sides.forward, sides.up)


def acceleration_for_tilt(phi: Scalar, theta: Scalar, up: Scalar, at: Trig) -> Vec3:
    """The desired acceleration, with g, that gives a desired roll and pitch: the inverse of :func:`desired_tilt`.

    Args:
        phi: Desired roll [rad].
        theta: Desired pitch [rad].
        up: Vertical part of the acceleration, with g [m/s^2].
        at: Cosine and sine of the present yaw.
    """
    forward = up * jnp.tan(theta)
    left = up * jnp.tan(phi) / jnp.cos(theta)
    return Vec3(forward * at.cpsi + left * at.spsi, forward * at.spsi - left * at.cpsi, up)


def tilt_error(acceleration: Vec3, at: Trig) -> tuple[Scalar, Scalar]:
    """What roll and pitch lack of the desired ones, (phi_d - phi, theta_d - theta) [rad].

    Each difference is one ``atan2``: the triangle is turned back by the present angle first. The vehicle is upright
    here, because a flip ends the draw.

    Args:
        acceleration: a_x, a_y, and a_z + g [m/s^2].
        at: Sines and cosines of the present angles.
    """
    forward, up, left, slant = lean(acceleration, (at.cpsi, at.spsi))
    return (
        atan2(left * at.cphi - slant * at.sphi, slant * at.cphi + left * at.sphi),
        atan2(forward * at.ctheta - up * at.stheta, up * at.ctheta + forward * at.stheta),
    )


def moment_for(inertia: Vec3, at: Trig, rate: Vec3, turning: Euler, desired: Euler) -> Vec3:
    """The moment for desired accelerations of the Euler angles, J W euler'' + J W' euler' + Omega x J Omega [N m].

    W euler' = (phi' - psi' sin theta, R_phi^T (theta', psi' cos theta)), where R_phi turns by phi. Its derivative is
    (phi'' - (psi' sin theta)', R_phi^T (theta'' + phi' psi' cos theta, (psi' cos theta)' - phi' theta')).

    Args:
        inertia: Diagonal of J [kg m^2].
        at: Sines and cosines of the angles.
        rate: Body rate Omega [rad/s].
        turning: Rates of the angles, euler' [rad/s].
        desired: Desired accelerations of the angles, euler'' [rad/s^2].
    """
    dphi, dtheta, dpsi = turning
    level = at.ctheta * dpsi
    rolling = desired.phi - at.stheta * desired.psi - dtheta * level
    pitching = desired.theta + dphi * level
    yawing = at.ctheta * desired.psi - dtheta * (dphi + at.stheta * dpsi)
    angular = Vec3(rolling, at.cphi * pitching + at.sphi * yawing, at.cphi * yawing - at.sphi * pitching)
    return angular.scale(inertia) + turning_moment(inertia, rate)


def demand(
    gains: InnerGains,
    craft: Craft,
    velocity: Vec3,
    rotation: Mat3,
    rate: Vec3,
    integrals: Integrals,
    command: Vec3,
    yaw_command: Scalar,
) -> Demand:
    """Thrust and moment for velocity commands, and the slopes of the integrals.

    The velocity errors give a desired acceleration; its lift gives the thrust, and its direction the desired angles.
    The attitude loops give accelerations of the angles, and these the moment.

    Args:
        gains: Gains and variants.
        craft: The vehicle as the inner loop knows it.
        velocity: v, inertial [m/s].
        rotation: R, body to inertial.
        rate: Body rate Omega [rad/s].
        integrals: State of the integral actions.
        command: Velocity commands u_x, u_y, u_z [m/s].
        yaw_command: u_psi [rad/s].
    """
    at = trig_of(rotation)
    error = command - velocity
    turning = euler_rates(at, rate)
    desired = error * gains.kd_velocity + integrals.velocity * gains.kp_velocity  # acceleration
    lift = desired.z + GRAVITY
    bounded = lift < LEAST_LIFT
    desired = desired._replace(z=jnp.where(bounded, LEAST_LIFT, lift))
    by_norm = gains.thrust is ThrustRule.NORM
    thrust = craft.mass * (desired.norm() if by_norm else desired.z / rotation.c.z)  # cos phi cos theta
    if gains.attitude is AttitudeReference.RATE_FEED_FORWARD:
        body_z = Vec3(rotation.a.z, rotation.b.z, rotation.c.z)
        acceleration = body_z * (thrust / craft.mass) - Vec3(0.0, 0.0, GRAVITY)
        slope = error * gains.kp_velocity - acceleration * gains.kd_velocity  # of the desired acceleration
        slope = slope._replace(z=jnp.where(bounded, 0.0, slope.z))
        heading = (at.cpsi, at.spsi)
        heading_dot = (-at.spsi * turning.psi, at.cpsi * turning.psi)
        _, (phi_d_dot, theta_d_dot) = jax.jvp(desired_tilt, (desired, heading), (slope, heading_dot))
    else:
        phi_d_dot = 0.0
        theta_d_dot = 0.0
    phi_error, theta_error = tilt_error(desired, at)
    yaw_error = yaw_command - turning.psi
    accelerate = Euler(
        gains.kp_attitude * phi_error + gains.kd_attitude * (phi_d_dot - turning.phi),
        gains.kp_attitude * theta_error + gains.kd_attitude * (theta_d_dot - turning.theta),
        gains.kd_yaw * yaw_error + gains.kp_yaw * integrals.yaw,
    )
    moment = moment_for(craft.inertia, at, rate, turning, accelerate)
    return Demand(thrust, moment, Integrals(error, yaw_error), bounded)
