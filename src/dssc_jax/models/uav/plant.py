"""The complete UAV as a plant with four channels, from velocity commands to position and yaw (1), Section V-B."""

import math
from typing import Annotated, NamedTuple

from dssc_jax.core.contracts import Plant
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.events import Condition
from dssc_jax.core.numerics import root_abs
from dssc_jax.core.quantities import Quantity, nominal
from dssc_jax.core.registry import Slot
from dssc_jax.core.signals import Measurement, PlantInput, Scalar
from dssc_jax.core.smoothness import piecewise
from dssc_jax.core.units import ANGLE, POSITION
from dssc_jax.core.vectors import Quaternion, Vec3, quaternion_from_euler
from dssc_jax.lanes.functions.approximations import atan2
from dssc_jax.models.uav.aerodynamics import drag
from dssc_jax.models.uav.allocation import Thrusts, allocate, pseudo_inverse
from dssc_jax.models.uav.desaturation import Desaturation
from dssc_jax.models.uav.inner_loop import Demand, InnerGains, Integrals, demand, euler_of, euler_rates, trig_of
from dssc_jax.models.uav.presets import VEHICLES
from dssc_jax.models.uav.rigid_body import BodyState, body_derivative, loaded_derivative
from dssc_jax.models.uav.rotors import RotorMotion, rotor_motion, rotor_torque, wrench
from dssc_jax.models.uav.vehicle import GRAVITY, Vehicle, check_vehicle

CHANNELS = ("x", "y", "z", "psi")
LEAST_UPRIGHT = math.cos(math.radians(85.0))  # cos phi cos theta below this is a singular attitude


class Believed(NamedTuple):
    """Nominal values of the inner loop; absent numbers are the vehicle's own, or the medians of their laws."""

    mass: Annotated[Scalar | None, Quantity("kg", "believed mass M_n", above=0.0)] = None
    inertia: Annotated[tuple[Scalar, ...] | None, Quantity("kg m^2", "believed total inertia J", above=0.0)] = None
    thrust_coefficient: Annotated[Scalar | None, Quantity("N s^2/rad^2", "believed k_T", above=0.0)] = None


class InnerModel(NamedTuple):
    """The inner loop's model of the vehicle: M [kg], diagonal of J [kg m^2], k_T [N s^2/rad^2]."""

    mass: Scalar
    inertia: Vec3
    thrust_coefficient: Scalar


class UavParams(NamedTuple):
    """Parameters of the UAV; ``allocation`` follows from the vehicle's nominal geometry before tracing.

    ``believed_rotors`` are the nominal k_T of rotors anywhere; those on a circle share that of ``believed``.
    """

    vehicle: Annotated[Vehicle, Slot(VEHICLES, default="m600_quadrotor")]
    believed: Believed = Believed()
    inner_loop: InnerGains = InnerGains()
    position: Annotated[tuple[Scalar, ...], Quantity("m", "initial position")] = (0.0, 0.0, 0.0)
    velocity: Annotated[tuple[Scalar, ...], Quantity("m/s", "initial velocity")] = (0.0, 0.0, 0.0)
    yaw: Annotated[Scalar, Quantity("rad", "initial yaw psi")] = 0.0
    allocation: tuple = ()
    desaturation: Desaturation = Desaturation.CLIP
    believed_rotors: tuple = ()

    @property
    def inner_model(self) -> InnerModel:
        """The nominal values, complete after :func:`prepare`."""
        mass, inertia, thrust_coefficient = self.believed
        assert mass is not None
        assert inertia is not None
        assert thrust_coefficient is not None
        return InnerModel(mass, Vec3(*inertia), thrust_coefficient)

    @property
    def believed_coefficients(self) -> tuple[Scalar, ...]:
        """The nominal k_T of each rotor, complete after :func:`prepare` [N s^2/rad^2]."""
        return self.believed_rotors or (self.inner_model.thrust_coefficient,) * self.vehicle.rotors


class UavState(NamedTuple):
    """State of the body, inner-loop integrals and, with a motor lag, rotor speeds |thetadot_i| [rad/s]."""

    position: Vec3
    velocity: Vec3
    attitude: Quaternion
    rate: Vec3
    integrals: Integrals
    speeds: tuple[Scalar, ...]


class UavInfo(NamedTuple):
    """Values of the vehicle for metrics and trajectories: Euler angles [rad], tilt [rad], active limits.

    ``rotor`` has the commanded thrusts f_i [N] after their limit ``rotor_limit`` [N], ``wind`` the wind [m/s].
    """

    phi: Annotated[Scalar, Quantity("rad", "roll")]
    theta: Annotated[Scalar, Quantity("rad", "pitch")]
    psi: Annotated[Scalar, Quantity("rad", "yaw")]
    tilt: Annotated[Scalar, Quantity("rad", "tilt of body z")]
    thrust: Annotated[Scalar, Quantity("N", "wanted net thrust")]
    rotor_limited: Annotated[Scalar, Quantity("1", "a rotor at its limit")]
    lift_bounded: Annotated[Scalar, Quantity("1", "wanted lift at its lower bound")]
    rotor: Annotated[tuple[Scalar, ...], Quantity("N", "commanded thrust of rotor")]
    rotor_limit: Annotated[Scalar, Quantity("N", "limit of a rotor's thrust")]
    wind: Annotated[Vec3, Quantity("m/s", "wind along")]


def init(params: UavParams) -> UavState:
    """Attitude at rest; rotors with a lag are at hover speed."""
    vehicle = params.vehicle
    zero = Vec3(0.0, 0.0, 0.0)
    speeds = ()
    if vehicle.motor_lag is not None:
        speeds = hover_speeds(params)
    return UavState(
        Vec3(*params.position),
        Vec3(*params.velocity),
        quaternion_from_euler(0.0, 0.0, params.yaw),
        zero,
        Integrals(zero, 0.0),
        speeds,
    )


def hover_speeds(params: UavParams) -> tuple[Scalar, ...]:
    """Speeds of the rotors at which the believed vehicle hovers [rad/s]."""
    believed = params.inner_model
    rotors = params.vehicle.rotors
    if not params.vehicle.rotor:
        return (root_abs(believed.mass * GRAVITY / rotors / believed.thrust_coefficient),) * rotors
    lift = (row[0] * believed.mass * GRAVITY for row in params.allocation)
    return tuple(root_abs(f / k) for f, k in zip(lift, params.believed_coefficients, strict=True))


def demanded_thrusts(params: UavParams, state: UavState, drive: PlantInput) -> tuple[Demand, Thrusts]:
    """Inner loops and allocation."""
    x, y, z, psi = (u + d for u, d in zip(drive.command, drive.disturbance, strict=True))
    rotation = state.attitude.matrix()
    demanded = demand(
        params.inner_loop,
        params.inner_model.mass,
        params.inner_model.inertia,
        state.velocity,
        rotation,
        state.rate,
        state.integrals,
        Vec3(x, y, z),
        psi,
    )
    limit = params.vehicle.thrust_limit
    return demanded, allocate(params.allocation, demanded.thrust, demanded.moment, limit, params.desaturation)


def derivative(params: UavParams, state: UavState, drive: PlantInput, t: Scalar) -> UavState:
    """Right-hand side of (1) with inner loops, allocation, rotors and aerodynamics."""
    vehicle = params.vehicle
    inner, thrusts = demanded_thrusts(params, state, drive)
    turning = rotor_motion(vehicle, thrusts.commanded, params.believed_coefficients, state.speeds)
    motion = conditioned_motion(turning, drive.condition)
    speeds = motion.speeds
    lift = tuple(k * w * w for k, w in zip(vehicle.thrust_coefficients, speeds, strict=True))
    thrust, moment, across = wrench(vehicle, lift)
    rotation = state.attitude.matrix()
    air = drag(vehicle, rotation, state.rate, state.velocity - wind_at(state, drive), speeds)
    force = air.force
    if across:
        force = force + rotation @ Vec3(across[0], across[1], 0.0)
    torque = moment + air.torque + rotor_torque(vehicle, state.rate, motion)
    body = BodyState(state.position, state.velocity, state.attitude, state.rate)
    if drive.condition is not None and drive.condition.load is not None:
        in_body = rotation.transpose @ force + Vec3(0.0, 0.0, thrust)
        load = drive.condition.load
        slope = loaded_derivative(body, vehicle.mass, vehicle.inertia, load, in_body, torque, rotation)
    else:
        slope = body_derivative(body, vehicle.mass, vehicle.inertia, thrust, force, torque, rotation)
    return UavState(*slope, inner.integrals, turning.accelerations)


def conditioned_motion(motion: RotorMotion, condition: Condition | None) -> RotorMotion:
    """The motion of rotors that have lost effectiveness or voltage: thrust goes with the square of the speed."""
    if condition is None or (not condition.effectiveness and condition.voltage is None):
        return motion
    voltage = 1.0 if condition.voltage is None else condition.voltage
    shares = condition.effectiveness or (1.0,) * len(motion.speeds)
    factors = [root_abs(share) * voltage for share in shares]
    speeds = tuple(f * w for f, w in zip(factors, motion.speeds, strict=True))
    if not motion.accelerations:
        return RotorMotion(speeds, ())
    return RotorMotion(speeds, tuple(f * w for f, w in zip(factors, motion.accelerations, strict=True)))


def wind_at(state: UavState, drive: PlantInput) -> Vec3:
    """The wind at the vehicle, with the shears of its condition [m/s]."""
    wind: Vec3 = drive.wind
    for shear in drive.condition.shears if drive.condition is not None else ():
        wind = wind + shear.gradient * (state.position.z - shear.height)
    return wind


def project(params: UavParams, state: UavState) -> UavState:
    """Normalise the quaternion, because integrators drift."""
    return state._replace(attitude=state.attitude.normalised())


def measure(params: UavParams, state: UavState, drive: PlantInput) -> tuple[Measurement, ...]:
    """Position and yaw with their rates, which do not depend on the input; yaw in (-pi, pi]."""
    del drive
    rotation = state.attitude.matrix()
    turning = euler_rates(trig_of(rotation), state.rate)
    psi = atan2(rotation.b.x, rotation.a.x)
    linear = (Measurement(p, v) for p, v in zip(state.position, state.velocity, strict=True))
    return (*linear, Measurement(psi, turning.psi))


def monitor(params: UavParams, state: UavState, drive: PlantInput) -> UavInfo:
    """Attitude and limits at a sample."""
    rotation = state.attitude.matrix()
    inner, thrusts = demanded_thrusts(params, state, drive)
    tilt = atan2(root_abs(rotation.c.x**2 + rotation.c.y**2), rotation.c.z)  # upright, the slope is 0 and not NaN
    limits = thrusts.limited, inner.bounded
    rotors = thrusts.commanded, params.vehicle.thrust_limit
    return UavInfo(*euler_of(rotation), tilt, inner.thrust, *limits, *rotors, wind_at(state, drive))


def broken(params: UavParams, state: UavState) -> Scalar:
    """Whether the vehicle has flipped or the Euler angles of the inner loop are near their singularity."""
    return state.attitude.matrix().c.z < LEAST_UPRIGHT


def input_gain(params: UavParams) -> tuple[Scalar, ...]:
    """k_p of each channel: the velocity loops' proportional gains [1/s]."""
    linear = params.inner_loop.kd_velocity
    return linear, linear, linear, params.inner_loop.kd_yaw


def prepare(params: UavParams) -> UavParams:
    """Check the vehicle, and derive allocation and nominal values from its numbers; raises ConfigError."""
    vehicle = params.vehicle
    try:
        check_vehicle(vehicle)
        allocation = pseudo_inverse(vehicle)
    except ConfigError as error:
        raise error.within_path("vehicle") from None
    for name in ("position", "velocity"):
        if len(getattr(params, name)) != 3:
            raise ConfigError(name, f"needs three values, got {len(getattr(params, name))}")
    plain = vehicle._replace(
        body_inertia=tuple(nominal(value) for value in vehicle.body_inertia),
        rotor_inertia_xy=nominal(vehicle.rotor_inertia_xy),
        rotor_inertia_z=nominal(vehicle.rotor_inertia_z),
    )
    vehicle_values = Believed(nominal(vehicle.mass), tuple(plain.inertia), nominal(vehicle.thrust_coefficient))
    chosen = {name: value for name, value in params.believed._asdict().items() if value is not None}
    believed = vehicle_values._replace(**chosen)
    if len(chosen.get("inertia", (0, 0, 0))) != 3:
        raise ConfigError("believed.inertia", f"needs three values, got {chosen['inertia']}")
    return params._replace(believed=believed, allocation=allocation, believed_rotors=believed_rotors(params))


def believed_rotors(params: UavParams) -> tuple[float, ...]:
    """The nominal k_T of rotors anywhere: that of ``[plant.believed]`` for all, or each rotor's own."""
    vehicle = params.vehicle
    if not vehicle.rotor:
        return ()
    given = params.believed.thrust_coefficient
    return tuple(nominal(value if given is None else given) for value in vehicle.thrust_coefficients)


UAV = Plant(
    UavParams,
    init,
    derivative,
    measure,
    input_gain,
    velocities=("velocity", "rate", "speeds"),
    prepare=prepare,
    channels=CHANNELS,
    angles=("psi",),
    units=(POSITION, POSITION, POSITION, ANGLE),
    project=project,
    monitor=monitor,
    broken=broken,
    onboard=(
        "the velocity loops of x, y and z",
        "the attitude loops and the yaw-rate loop",
        "the allocation of thrust and torque to the rotors (the mixer)",
    ),
    smooth=piecewise("the limits of its rotors and its lift"),
    info=UavInfo,
)
