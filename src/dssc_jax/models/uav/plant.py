"""The complete UAV as a plant with four channels, from velocity commands to position and yaw (1), Section V-B."""

import math
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.contracts import Plant
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import root_abs
from dssc_jax.core.onboard import Onboard
from dssc_jax.core.quantities import Quantity, nominal
from dssc_jax.core.registry import Slot
from dssc_jax.core.signals import Measurement, PlantInput, Scalar, State
from dssc_jax.core.smoothness import Smoothness, not_smooth, piecewise
from dssc_jax.core.units import ANGLE, POSITION
from dssc_jax.core.vectors import Quaternion, Vec3, quaternion_from_euler
from dssc_jax.lanes.functions.approximations import atan2
from dssc_jax.models.uav.aerodynamics import drag
from dssc_jax.models.uav.allocation import Thrusts, allocate, geometry, pseudo_inverse
from dssc_jax.models.uav.condition import conditioned_motion, wind_at
from dssc_jax.models.uav.desaturation import Desaturation
from dssc_jax.models.uav.ground import Ground, contact, has_crashed, lift_factor, prepared_ground
from dssc_jax.models.uav.info import UavInfo
from dssc_jax.models.uav.inner_loops import INNER_LOOPS, SampledInnerLoop
from dssc_jax.models.uav.inner_loops.article import InnerGains, Integrals, demand, euler_of, euler_rates, trig_of
from dssc_jax.models.uav.inner_loops.sampled import Craft, Readings, allocated_moment
from dssc_jax.models.uav.presets import VEHICLES
from dssc_jax.models.uav.rigid_body import BodyState, body_derivative, loaded_derivative
from dssc_jax.models.uav.rotors import rotor_motion, rotor_torque, wrench
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
    """Parameters of the UAV.

    The fields after ``ground`` follow from the vehicle's nominal values before tracing: ``allocation``, rows
    (f, M) -> f_i; ``moments``, rows f_i -> M; ``believed_rotors``, the nominal k_T of rotors anywhere, while those on a
    circle share that of ``believed``; ``rotor_limit``, a rotor's largest thrust as the inner loop knows it [N].
    """

    vehicle: Annotated[Vehicle, Slot(VEHICLES, default="m600_quadrotor")]
    believed: Believed = Believed()
    inner_loop: Annotated[InnerGains | SampledInnerLoop, Slot(INNER_LOOPS, default="article")] = InnerGains()
    position: Annotated[tuple[Scalar, ...], Quantity("m", "initial position")] = (0.0, 0.0, 0.0)
    velocity: Annotated[tuple[Scalar, ...], Quantity("m/s", "initial velocity")] = (0.0, 0.0, 0.0)
    yaw: Annotated[Scalar, Quantity("rad", "initial yaw psi")] = 0.0
    desaturation: Desaturation = Desaturation.CLIP
    ground: Ground | None = None
    allocation: tuple = ()
    moments: tuple = ()
    believed_rotors: tuple = ()
    rotor_limit: float = 0.0

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

    @property
    def hover_thrusts(self) -> tuple[Scalar, ...]:
        """Thrusts of the rotors at which the believed vehicle hovers, complete after :func:`prepare` [N]."""
        weight = self.inner_model.mass * GRAVITY
        if not self.vehicle.rotor:
            return (weight / self.vehicle.rotors,) * self.vehicle.rotors
        return tuple(row[0] * weight for row in self.allocation)

    @property
    def craft(self) -> Craft:
        """The vehicle as a sampled inner loop knows it, complete after :func:`prepare`."""
        model = self.inner_model
        return Craft(model.mass, model.inertia, self.allocation, self.moments, self.rotor_limit)


class HeldLoop(NamedTuple):
    """A sampled inner loop between its samples.

    Args:
        software: State of the inner loop.
        thrust: Held wanted net thrust [N].
        rotor: Held commanded thrusts f_i [N].
        limited: Whether a rotor is at a limit.
    """

    software: State
    thrust: Scalar
    rotor: tuple[Scalar, ...]
    limited: Scalar


class UavState(NamedTuple):
    """State of the body, of the inner loop and, with a motor lag, rotor speeds |thetadot_i| [rad/s].

    ``inner`` are the :class:`Integrals` of the article's inner loop, or the :class:`HeldLoop` of a sampled one.
    """

    position: Vec3
    velocity: Vec3
    attitude: Quaternion
    rate: Vec3
    inner: State
    speeds: tuple[Scalar, ...]


def init(params: UavParams) -> UavState:
    """Attitude at rest; rotors with a lag are at hover speed."""
    vehicle = params.vehicle
    zero = Vec3(0.0, 0.0, 0.0)
    speeds = ()
    if vehicle.motor_lag is not None:
        hover = zip(params.hover_thrusts, params.believed_coefficients, strict=True)
        speeds = tuple(root_abs(f / coefficient) for f, coefficient in hover)
    attitude = quaternion_from_euler(0.0, 0.0, params.yaw)
    state = UavState(Vec3(*params.position), Vec3(*params.velocity), attitude, zero, Integrals(zero, 0.0), speeds)
    return state if sampled_loop(params) is None else state._replace(inner=software_start(params, state))


def sampled_loop(params: UavParams) -> SampledInnerLoop | None:
    """The sampled inner loop; None: it is the article's."""
    gains = params.inner_loop
    return None if isinstance(gains, InnerGains) else gains


def required_loop(params: UavParams) -> SampledInnerLoop:
    """The sampled inner loop of parameters that have one."""
    loop = sampled_loop(params)
    assert loop is not None
    return loop


def software_start(params: UavParams, state: UavState) -> HeldLoop:
    """A sampled inner loop in hover."""
    software = required_loop(params).init(params.craft, readings_of(state))
    return HeldLoop(software, params.inner_model.mass * GRAVITY, params.hover_thrusts, 0.0)


def velocity_commands(drive: PlantInput) -> tuple[Vec3, Scalar]:
    """Commands of velocity [m/s] and yaw rate [rad/s] with their disturbances."""
    x, y, z, psi = (u + d for u, d in zip(drive.command, drive.disturbance, strict=True))
    return Vec3(x, y, z), psi


class RotorCommands(NamedTuple):
    """What the inner loop gives: net thrust [N], rotor thrusts, whether the lift is bounded, slope of its state."""

    thrust: Scalar
    rotors: Thrusts
    bounded: Scalar
    slope: State


def rotor_commands(params: UavParams, state: UavState, drive: PlantInput) -> RotorCommands:
    """Inner loop and allocation; those of a sampled inner loop are held."""
    gains = params.inner_loop
    if not isinstance(gains, InnerGains):
        held = state.inner
        limit = params.vehicle.thrust_limit
        given = tuple(jnp.minimum(f, limit) for f in held.rotor)
        rotors = Thrusts(given, held.limited > 0.5)
        return RotorCommands(held.thrust, rotors, held.software.bounded > 0.5, jax.tree.map(lambda leaf: 0.0, held))
    model = params.inner_model
    rotation = state.attitude.matrix()
    command, yaw_command = velocity_commands(drive)
    demanded = demand(
        gains, model.mass, model.inertia, state.velocity, rotation, state.rate, state.inner, command, yaw_command
    )
    limit = params.vehicle.thrust_limit
    rotors = allocate(params.allocation, demanded.thrust, demanded.moment, limit, params.desaturation)
    return RotorCommands(demanded.thrust, rotors, demanded.bounded, demanded.integrals)


def software_period(params: UavParams) -> float | None:
    """Time between two ticks of a sampled inner loop [s]."""
    loop = sampled_loop(params)
    return None if loop is None else loop.period


def readings_of(state: UavState) -> Readings:
    """What the inner loop measures."""
    return Readings(state.velocity, state.attitude, state.rate)


def software_sample(params: UavParams, state: UavState, drive: PlantInput, dt: float) -> UavState:
    """Velocity control of a sampled inner loop."""
    command, yaw_command = velocity_commands(drive)
    software = required_loop(params).sample(
        params.craft, state.inner.software, readings_of(state), command, yaw_command, dt
    )
    return state._replace(inner=state.inner._replace(software=software))


def software_tick(params: UavParams, state: UavState, dt: float) -> UavState:
    """Attitude and rate control of a sampled inner loop, and the allocation to the rotors."""
    craft = params.craft
    software, wanted = required_loop(params).tick(craft, state.inner.software, readings_of(state), dt)
    thrusts = allocate(params.allocation, wanted.thrust, wanted.moment, params.rotor_limit, params.desaturation)
    missing = wanted.moment - allocated_moment(craft, thrusts.commanded)
    unallocated = Vec3(*(jnp.where(thrusts.limited, value, 0.0) for value in missing))
    software = software._replace(unallocated=unallocated)
    limited = jnp.where(thrusts.limited, 1.0, 0.0)
    return state._replace(inner=HeldLoop(software, wanted.thrust, thrusts.commanded, limited))


def derivative(params: UavParams, state: UavState, drive: PlantInput, t: Scalar) -> UavState:
    """Right-hand side of (1) with inner loops, allocation, rotors and aerodynamics."""
    vehicle = params.vehicle
    commands = rotor_commands(params, state, drive)
    turning = rotor_motion(vehicle, commands.rotors.commanded, params.believed_coefficients, state.speeds)
    motion = conditioned_motion(turning, drive.condition)
    speeds = motion.speeds
    lift = tuple(k * w * w for k, w in zip(vehicle.thrust_coefficients, speeds, strict=True))
    ground = params.ground
    if ground is not None and ground.rotor_radius is not None:
        factor = lift_factor(ground, state.position.z)
        lift = tuple(factor * f for f in lift)
    thrust, moment, across = wrench(vehicle, lift)
    rotation = state.attitude.matrix()
    wind = wind_at(drive.wind, state.position.z, drive.condition)
    air = drag(vehicle, rotation, state.rate, state.velocity - wind, speeds)
    force = air.force
    if across:
        force = force + rotation @ Vec3(across[0], across[1], 0.0)
    torque = moment + air.torque + rotor_torque(vehicle, state.rate, motion)
    if ground is not None:
        standing = contact(ground, state.position, state.velocity, rotation, state.rate)
        force = force + standing.force
        torque = torque + standing.torque
    body = BodyState(state.position, state.velocity, state.attitude, state.rate)
    if drive.condition is not None and drive.condition.load is not None:
        in_body = rotation.transpose @ force + Vec3(0.0, 0.0, thrust)
        load = drive.condition.load
        slope = loaded_derivative(body, vehicle.mass, vehicle.inertia, load, in_body, torque, rotation)
    else:
        slope = body_derivative(body, vehicle.mass, vehicle.inertia, thrust, force, torque, rotation)
    return UavState(*slope, commands.slope, turning.accelerations)


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
    commands = rotor_commands(params, state, drive)
    tilt = atan2(root_abs(rotation.c.x**2 + rotation.c.y**2), rotation.c.z)  # upright, the slope is 0 and not NaN
    limits = commands.rotors.limited, commands.bounded
    rotors = commands.rotors.commanded, params.vehicle.thrust_limit
    turning = rotor_motion(params.vehicle, commands.rotors.commanded, params.believed_coefficients, state.speeds)
    body = state.attitude, state.rate, conditioned_motion(turning, drive.condition).speeds
    wind = wind_at(drive.wind, state.position.z, drive.condition)
    return UavInfo(*euler_of(rotation), tilt, commands.thrust, *limits, *rotors, wind, *body)


def broken(params: UavParams, state: UavState) -> Scalar:
    """Whether the vehicle has flipped or the Euler angles of the inner loop are near their singularity."""
    return state.attitude.matrix().c.z < LEAST_UPRIGHT


def into_ground(params: UavParams, state: UavState) -> Scalar | bool:
    """Whether the vehicle has flown into the ground; False where there is none."""
    return False if params.ground is None else has_crashed(params.ground, state.position.z, state.velocity.z)


def input_gain(params: UavParams) -> tuple[Scalar, ...]:
    """k_p of each channel: the velocity loops' proportional gains [1/s]."""
    gains = params.inner_loop
    if not isinstance(gains, InnerGains):
        return gains.input_gain(params.craft)
    linear = gains.kd_velocity
    return linear, linear, linear, gains.kd_yaw


def smoothness(params: UavParams) -> Smoothness:
    """Where the vehicle has a derivative; a sampled inner loop is not linearised."""
    if isinstance(params.inner_loop, InnerGains):
        return piecewise("the limits of its rotors and its lift")
    return not_smooth("has a sampled inner loop, which is not linearised; set plant.inner_loop.kind = 'article'")


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
    limit = vehicle.max_thrust
    return params._replace(
        ground=None if params.ground is None else prepared_ground(params.ground, vehicle.mass),
        believed=believed,
        allocation=allocation,
        moments=tuple(map(tuple, geometry(vehicle)[1:].tolist())),
        believed_rotors=believed_rotors(params),
        rotor_limit=2.0 * nominal(vehicle.mass) * GRAVITY / vehicle.rotors if limit is None else nominal(limit),
    )


def believed_rotors(params: UavParams) -> tuple[float, ...]:
    """The nominal k_T of rotors anywhere: that of ``[plant.believed]`` for all, or each rotor's own."""
    vehicle = params.vehicle
    if not vehicle.rotor:
        return ()
    believed = params.believed.thrust_coefficient
    return tuple(nominal(value if believed is None else believed) for value in vehicle.thrust_coefficients)


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
    grounded=into_ground,
    onboard=(
        "the velocity loops of x, y and z",
        "the attitude loops and the yaw-rate loop",
        "the allocation of thrust and torque to the rotors (the mixer)",
    ),
    smooth=smoothness,
    info=UavInfo,
    software=Onboard(
        period=software_period,
        start=software_start,
        held=lambda state: state.inner,
        holding=lambda state, held: state._replace(inner=held),
        sample=software_sample,
        tick=software_tick,
        frequency="inner_loop.frequency",
    ),
)
