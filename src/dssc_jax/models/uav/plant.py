"""The complete UAV as a plant with four channels, from velocity commands to position and yaw (1), Section V-B."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.contracts import Plant
from dssc_jax.core.estimation import Estimation
from dssc_jax.core.named import NamedSignal
from dssc_jax.core.numerics import root_abs
from dssc_jax.core.onboard import Onboard
from dssc_jax.core.quantities import quantities_of
from dssc_jax.core.signals import Measurement, PlantInput, Scalar, State
from dssc_jax.core.smoothness import Smoothness, not_smooth, piecewise
from dssc_jax.core.units import ANGLE, POSITION
from dssc_jax.core.vectors import Quaternion, Vec3
from dssc_jax.lanes.functions.approximations import atan2
from dssc_jax.models.uav.aerodynamics import drag
from dssc_jax.models.uav.allocation import Thrusts, allocate
from dssc_jax.models.uav.battery import Supply, supply
from dssc_jax.models.uav.condition import conditioned_motion, scaled_motion, voltage_of, wind_at
from dssc_jax.models.uav.estimators.sensors import rotation_vector
from dssc_jax.models.uav.ground import contact, has_crashed, lowest_foot, rotor_thrusts
from dssc_jax.models.uav.info import EstimateErrors, UavInfo
from dssc_jax.models.uav.inner_loops.article import InnerGains, Integrals, demand, euler_of, euler_rates, trig_of
from dssc_jax.models.uav.inner_loops.sampled import Angles, Trim, attitude_from_angles
from dssc_jax.models.uav.onboard import (
    EstimationError,
    UavState,
    estimated_state,
    estimator_of,
    first_integrals,
    held_start,
    readings_of,
    renew_estimate,
    rotor_sentences,
    sampled_loop,
    software_period,
    software_sample,
    software_start,
    software_tick,
    start_estimate,
    starts_settled,
    taken_over,
    trim_of,
    velocity_commands,
)
from dssc_jax.models.uav.parameters import UavParams, prepare
from dssc_jax.models.uav.rigid_body import BodyState, body_derivative, loaded_derivative
from dssc_jax.models.uav.rotors import RotorMotion, rotor_motion, rotor_torque, wrench

CHANNELS = ("x", "y", "z", "psi")
LEAST_UPRIGHT = math.cos(math.radians(85.0))
"""Smallest cos phi cos theta: with less, the Euler angles are near their singularity."""


def init(params: UavParams) -> UavState:
    """The state at the start; rotors with a lag turn at the speed that the inner loop commands at first."""
    return start_state(params, None)


def settle(params: UavParams, state: UavState, wind: Vec3) -> UavState:
    """The state at the start in a wind [m/s]: in equilibrium with the wind if the integrals start settled.

    Args:
        params: The prepared parameters.
        state: The state from :func:`init`, which is kept if the integrals do not start settled.
        wind: Velocity of the air, inertial [m/s].
    """
    trimmed = trim_of(params, wind)
    return state if trimmed is None else start_state(params, trimmed)


def start_state(params: UavParams, trimmed: Trim | None) -> UavState:
    """The state at the start.

    Args:
        params: The prepared parameters.
        trimmed: The equilibrium in which the vehicle starts; None: the hover in still air.
    """
    zero = Vec3(0.0, 0.0, 0.0)
    speeds = ()
    if params.vehicle.motor_lag is not None:
        thrusts = params.first_thrusts if trimmed is None else trimmed.rotor
        rotors = zip(thrusts, params.believed_coefficients, strict=True)
        speeds = tuple(root_abs(f / coefficient) for f, coefficient in rotors)
    angles = Angles(0.0, 0.0, params.yaw) if trimmed is None else trimmed.angles
    phi = angles.phi if params.roll is None else params.roll
    theta = angles.theta if params.pitch is None else params.pitch
    attitude = attitude_from_angles(Angles(phi, theta, params.yaw))
    state = UavState(
        position=Vec3(*params.position),
        velocity=Vec3(*params.velocity),
        attitude=attitude,
        rate=Vec3(*params.body_rate),
        inner=first_integrals_of_article(params, trimmed),
        speeds=speeds,
    )
    if estimator_of(params) is not None:  # no error until the first estimate
        no_turn = Quaternion(1.0, 0.0, 0.0, 0.0)
        state = state._replace(error=EstimationError(zero, zero, no_turn, zero, nees=0.0))
    if params.battery is not None:
        state = state._replace(charge=params.battery.charge)
    if sampled_loop(params) is None:
        return state
    return state._replace(inner=held_start(params, state, trimmed))


def first_integrals_of_article(params: UavParams, trimmed: Trim | None) -> Integrals | tuple[()]:
    """The integrals of the article's inner loop at the start; () for a sampled inner loop, which has its own.

    Args:
        params: The prepared parameters.
        trimmed: The equilibrium that the integrals hold; None: the hover in still air.
    """
    gains = params.inner_loop
    if not isinstance(gains, InnerGains):
        return ()
    if trimmed is not None:
        return gains.trimmed(params.craft, trimmed)
    return Integrals(velocity=gains.first_velocity_integral(params.craft, params.first_carrying), yaw=0.0)


class RotorCommands(NamedTuple):
    """The demand of the inner loop and the commands of the allocation.

    Args:
        thrust: Demanded net thrust [N].
        rotors: Commanded thrusts of the rotors [N], and whether a limit was exceeded.
        bounded: Whether the wanted lift is at its lower bound.
        slope: Derivative of the inner loop's state; zeros for a sampled one, whose state is held.
    """

    thrust: Scalar
    rotors: Thrusts
    bounded: Scalar
    slope: State


def rotor_commands(params: UavParams, state: UavState, drive: PlantInput) -> RotorCommands:
    """The commands that inner loop and allocation give the rotors at the present state.

    The article's inner loop is evaluated at the present state. A sampled inner loop holds its commands since its last
    tick; the rotors of the draw limit them once more, because their limit may differ from the one that the software
    knows.
    """
    gains = params.inner_loop
    if not isinstance(gains, InnerGains):
        held_loop = state.inner
        limit = params.vehicle.thrust_limit
        thrusts = tuple(jnp.minimum(f, limit) for f in held_loop.rotor)
        return RotorCommands(
            thrust=held_loop.thrust,
            rotors=Thrusts(thrusts, held_loop.limited > 0.5),  # a flag of 0.0 or 1.0, as the next one
            bounded=held_loop.software.bounded > 0.5,
            slope=jax.tree.map(lambda leaf: 0.0, held_loop),
        )
    readings = readings_of(state)
    rotation = readings.attitude.matrix()
    command, yaw_command = velocity_commands(drive)
    demanded = demand(
        gains, params.craft, readings.velocity, rotation, readings.rate, state.inner, command, yaw_command
    )
    limit = params.vehicle.thrust_limit
    rotors = allocate(params.allocation, demanded.thrust, demanded.moment, limit, params.desaturation)
    return RotorCommands(demanded.thrust, rotors, demanded.bounded, demanded.integrals)


class DrivenRotors(NamedTuple):
    """The motion of the rotors, and the battery's supply.

    Args:
        commanded: Motion that the commands ask for.
        actual: Motion with the battery's voltage and the rotors' faults.
        supply: Relative voltage and current of the battery; 1 and 0 without a battery.
    """

    commanded: RotorMotion
    actual: RotorMotion
    supply: Supply


def driven_rotors(params: UavParams, state: UavState, drive: PlantInput, commands: RotorCommands) -> DrivenRotors:
    """The motion of the rotors at the present state: as commanded, and as changed by the battery and by events.

    Args:
        params: The prepared parameters.
        state: The present state.
        drive: The plant's input, with the changes by events.
        commands: The commands from :func:`rotor_commands`.
    """
    commanded = rotor_motion(params.vehicle, commands.rotors.commanded, params.believed_coefficients, state.speeds)
    actual = conditioned_motion(commanded, drive.condition)
    if params.battery is None:
        return DrivenRotors(commanded, actual, Supply(voltage=1.0, current=0.0))
    power = params.power_at_full_voltage(actual.speeds)
    battery_supply = supply(params.battery, state.charge, power)
    factors = (battery_supply.voltage,) * len(actual.speeds)
    return DrivenRotors(commanded, scaled_motion(actual, factors), battery_supply)


def derivative(params: UavParams, state: UavState, drive: PlantInput, t: Scalar) -> UavState:
    """The right-hand side of (1) with inner loops, allocation, rotors and aerodynamics.

    Forces and torques of rotors, drag and ground add up, and move a rigid body with or without additional masses. The
    time ``t`` is not used: wind and commands are in ``drive``.
    """
    vehicle = params.vehicle
    ground = params.ground
    commands = rotor_commands(params, state, drive)
    rotor_state = driven_rotors(params, state, drive, commands)
    motion = rotor_state.actual
    speeds = motion.speeds
    thrust, moment, side_force = wrench(vehicle, rotor_thrusts(vehicle, ground, state.position.z, speeds))
    rotation = state.attitude.matrix()
    wind = wind_at(drive.wind, state.position.z, drive.condition)
    drag_effect = drag(vehicle, rotation, state.rate, state.velocity - wind, speeds)
    force = drag_effect.force  # all forces but thrust and weight, inertial
    if side_force:  # () where all rotors point along body z
        x, y = side_force
        force = force + rotation @ Vec3(x, y, 0.0)
    torque = moment + drag_effect.torque + rotor_torque(vehicle, state.rate, motion)
    if ground is not None:
        contact_effect = contact(ground, state.position, state.velocity, rotation, state.rate)
        force = force + contact_effect.force
        torque = torque + contact_effect.torque
    body = BodyState(state.position, state.velocity, state.attitude, state.rate)
    if drive.condition is not None and drive.condition.load is not None:
        in_body = rotation.transpose @ force + Vec3(0.0, 0.0, thrust)
        load = drive.condition.load
        slope = loaded_derivative(body, vehicle.mass, vehicle.inertia, load, in_body, torque, rotation)
    else:
        slope = body_derivative(body, vehicle.mass, vehicle.inertia, thrust, force, torque, rotation)
    return UavState(
        *slope,  # of position, velocity, attitude and rate
        inner=commands.slope,
        speeds=rotor_state.commanded.accelerations,
        error=jax.tree.map(lambda leaf: 0.0, state.error),  # an estimate's error is held between samples
        charge=() if params.battery is None else -rotor_state.supply.current / params.battery.capacity,
    )


def project(params: UavParams, state: UavState) -> UavState:
    """The state with a quaternion of length 1, which integrators do not keep exactly."""
    return state._replace(attitude=state.attitude.normalised())


def measure(params: UavParams, state: UavState, drive: PlantInput) -> tuple[Measurement, ...]:
    """The measured position and yaw of the four channels with their rates; yaw is in (-pi, pi].

    The rates do not depend on the input.
    """
    del drive
    rotation = state.attitude.matrix()
    angle_rates = euler_rates(trig_of(rotation), state.rate)
    psi = atan2(rotation.b.x, rotation.a.x)
    linear = (Measurement(p, v) for p, v in zip(state.position, state.velocity, strict=True))
    return (*linear, Measurement(psi, angle_rates.psi))


def monitor(params: UavParams, state: UavState, drive: PlantInput) -> UavInfo:
    """The vehicle's report at a sample: attitude, rotors, limits, wind, battery, and the errors of an estimate."""
    rotation = state.attitude.matrix()
    commands = rotor_commands(params, state, drive)
    # root_abs has the derivative 0 at 0, where that of a plain root is NaN: for an upright vehicle
    tilt = atan2(root_abs(rotation.c.x**2 + rotation.c.y**2), rotation.c.z)
    rotor_state = driven_rotors(params, state, drive, commands)
    charge = 1.0 if params.battery is None else jnp.maximum(state.charge, 0.0)
    voltage = rotor_state.supply.voltage * voltage_of(drive.condition)
    wind = wind_at(drive.wind, state.position.z, drive.condition)
    phi, theta, psi = euler_of(rotation)
    info = UavInfo(
        phi=phi,
        theta=theta,
        psi=psi,
        tilt=tilt,
        thrust=commands.thrust,
        rotor_limited=commands.rotors.limited,
        lift_bounded=commands.bounded,
        rotor=commands.rotors.commanded,
        rotor_limit=params.vehicle.thrust_limit,
        wind=wind,
        attitude=state.attitude,
        rate=state.rate,
        rotor_speed=rotor_state.actual.speeds,
        rotor_voltage=voltage,
        battery_charge=charge,
    )
    if state.error == ():
        return info
    error: EstimationError = state.error
    angle = rotation_vector(error.attitude).norm()
    return info._replace(estimate=EstimateErrors(error.position.norm(), error.velocity.norm(), angle, error.nees))


def outputs(params: UavParams) -> tuple[NamedSignal, ...]:
    """The signals that the vehicle reports, with the errors of an estimate if the vehicle has an estimator."""
    quantities = quantities_of(UavInfo)
    if estimator_of(params) is not None:
        quantities |= quantities_of(EstimateErrors)
    return tuple(NamedSignal.of(name, quantity) for name, quantity in quantities.items())


def has_flipped(params: UavParams, state: UavState) -> Scalar:
    """Whether the vehicle has flipped or the Euler angles of the inner loop are near their singularity."""
    return state.attitude.matrix().c.z < LEAST_UPRIGHT


def into_ground(params: UavParams, state: UavState, drive: PlantInput, t: Scalar, dt: Scalar) -> Scalar | bool:
    """Whether the vehicle flies into the ground in the sample that begins with this state; False without a ground.

    The vehicle's vertical acceleration at the sample tells how fast a foot touches.
    """
    ground = params.ground
    if ground is None:
        return False
    foot = lowest_foot(ground, state.attitude.matrix())
    acceleration = derivative(params, state, drive, t).velocity.z
    return has_crashed(ground, state.position.z, foot, state.velocity.z, acceleration, dt)


def input_gain(params: UavParams) -> tuple[Scalar, ...]:
    """The high-frequency gain k_p of x, y, z and psi: what a command adds to the acceleration at first [1/s].

    For the article's inner loop these are the proportional gains of its velocity loops.
    """
    gains = params.inner_loop
    if not isinstance(gains, InnerGains):
        return gains.input_gain(params.craft)
    linear = gains.kd_velocity
    return linear, linear, linear, gains.kd_yaw


def smoothness(params: UavParams) -> Smoothness:
    """Declare where the vehicle has a derivative: everywhere but at the limits of its rotors and its lift.

    A vehicle with a battery, an estimator or a sampled inner loop is not linearised.
    """
    if params.battery is not None:
        return not_smooth("has a battery, which is never at rest; leave [plant.battery] out")
    if estimator_of(params) is not None:
        return not_smooth("has an estimator, which is not linearised; set plant.estimator.kind = 'none'")
    if isinstance(params.inner_loop, InnerGains):
        return piecewise("the limits of its rotors and its lift")
    return not_smooth("has a sampled inner loop, which is not linearised; set plant.inner_loop.kind = 'article'")


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
    broken=has_flipped,
    grounded=into_ground,
    onboard=(
        "the velocity loops of x, y and z",
        "the attitude loops and the yaw-rate loop",
        "the allocation of thrust and torque to the rotors (the mixer)",
    ),
    smooth=smoothness,
    info=UavInfo,
    outputs=outputs,
    settle=settle,
    flies=True,
    software=Onboard(
        period=software_period,
        start=software_start,
        held=lambda state: state.inner,
        holding=lambda state, held: state._replace(inner=held),
        sample=software_sample,
        tick=software_tick,
        frequency="inner_loop.frequency",
        outputs=rotor_sentences,
        directions=("attitude",),
        integrals=first_integrals,
        settled=starts_settled,
        drives="rotor",
        tunable=("inner_loop", "believed"),
        taken_over=taken_over,
    ),
    estimation=Estimation(
        is_enabled=lambda params: estimator_of(params) is not None,
        start=start_estimate,
        step=renew_estimate,
        estimated_state=estimated_state,
    ),
)
