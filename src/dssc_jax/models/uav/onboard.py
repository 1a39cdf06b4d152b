"""Software on board of the UAV: its state, the sampled inner loop with the allocation, and the estimator."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.numerics import dot
from dssc_jax.core.quantities import nominal
from dssc_jax.core.signals import PlantInput, Scalar, State
from dssc_jax.core.vectors import Quaternion, Vec3
from dssc_jax.models.uav.allocation import allocate
from dssc_jax.models.uav.estimators import Estimator, NoEstimator
from dssc_jax.models.uav.estimators.sensors import Motion, Random
from dssc_jax.models.uav.inner_loops import SampledInnerLoop
from dssc_jax.models.uav.inner_loops.article import InnerGains
from dssc_jax.models.uav.inner_loops.sampled import (
    Angles,
    Readings,
    Trim,
    allocated_moment,
    angles_of,
    conjugate,
    net_wrench,
    product,
)
from dssc_jax.models.uav.inner_loops.start import Start
from dssc_jax.models.uav.parameters import UavParams
from dssc_jax.models.uav.trim import trim
from dssc_jax.models.uav.vehicle import Vehicle

SMALL_BUMP = 1e-3
"""Largest change of a rotor's thrust that a takeover may cause, as a fraction of the largest thrust."""


class HeldLoop(NamedTuple):
    """State and results of a sampled inner loop; they are constant between two ticks.

    Args:
        software: State of the inner loop.
        thrust: Demanded net thrust [N].
        rotor: Commanded thrusts f_i [N].
        limited: 1 if a rotor is at a limit, else 0.
    """

    software: State
    thrust: Scalar
    rotor: tuple[Scalar, ...]
    limited: Scalar


class UavState(NamedTuple):
    """State of the vehicle.

    Args:
        position: Position, inertial axes [m].
        velocity: Velocity, inertial axes [m/s].
        attitude: Rotation from the body axes to the inertial axes.
        rate: Angular rate, body axes [rad/s].
        inner: :class:`Integrals` of the article's inner loop, or the :class:`HeldLoop` of a sampled one.
        speeds: Rotor speeds |thetadot_i| [rad/s]; () without a motor lag.
        error: :class:`EstimationError` of the estimate at the last sample; () without an estimator.
        charge: Charge of the battery, relative to that of the full one; () without a battery.
    """

    position: Vec3
    velocity: Vec3
    attitude: Quaternion
    rate: Vec3
    inner: State
    speeds: tuple[Scalar, ...]
    error: State = ()
    charge: State = ()


class EstimationError(NamedTuple):
    """Error of an estimate: the estimate minus the true value.

    Args:
        position: Error of the position, inertial axes [m].
        velocity: Error of the velocity, inertial axes [m/s].
        attitude: Rotation in inertial axes that turns the true attitude into the estimated one.
        rate: Error of the angular rate, body axes [rad/s].
        nees: Normalised squared error of position, velocity and attitude; 0 without a covariance.
    """

    position: Vec3
    velocity: Vec3
    attitude: Quaternion
    rate: Vec3
    nees: Scalar


def estimator_of(params: UavParams) -> Estimator | None:
    """The estimator of the vehicle's motion; None: there is none, and the controllers see the true state."""
    return None if isinstance(params.estimator, NoEstimator) else params.estimator


def sampled_loop(params: UavParams) -> SampledInnerLoop | None:
    """The sampled inner loop; None: the inner loop is the article's, which is continuous in time."""
    gains = params.inner_loop
    return None if isinstance(gains, InnerGains) else gains


def required_loop(params: UavParams) -> SampledInnerLoop:
    """The sampled inner loop of parameters that must have one."""
    loop = sampled_loop(params)
    assert loop is not None
    return loop


def trim_of(params: UavParams, wind: Vec3 | None) -> Trim | None:
    """The equilibrium in a wind [m/s] in which the integrals start.

    None: there is no wind, or the integrals do not start settled.
    """
    if wind is None or not starts_settled(params):
        return None
    return trim(params, wind)


def software_start(params: UavParams, state: UavState, wind: Vec3 | None) -> HeldLoop:
    """State and results of a sampled inner loop at the start, in a wind [m/s]; None: there is no wind."""
    return held_start(params, state, trim_of(params, wind))


def held_start(params: UavParams, state: UavState, trimmed: Trim | None) -> HeldLoop:
    """State and results of a sampled inner loop that holds an equilibrium; None: the hover in still air.

    Args:
        params: The prepared parameters.
        state: The vehicle's state at the start.
        trimmed: The equilibrium that the inner loop holds; None: the hover in still air.
    """
    loop = required_loop(params)
    software = loop.init(params.craft, readings_of(state), params.first_carrying)
    if trimmed is None:
        return HeldLoop(software, params.first_thrust, params.first_thrusts, limited=0.0)
    return HeldLoop(loop.trimmed(params.craft, software, trimmed), trimmed.thrust, trimmed.rotor, limited=0.0)


def taken_over(params: UavParams, state: UavState, thrusts: tuple[Scalar, ...], dt: float) -> tuple[HeldLoop, Scalar]:
    """A sampled inner loop that goes on with rotor thrusts [N] of another software, in steady flight at its readings.

    The net thrust and moment of the rotors become the equilibrium that the integrals hold.

    Args:
        params: The prepared parameters.
        state: The vehicle's state at the takeover.
        thrusts: Thrusts of the rotors that the other software commands [N].
        dt: T_s of the loop [s].

    Returns:
        State and results of the inner loop; and 1 if its next thrusts have the same effect as those of the other
        software, else 0, as where the thrusts would be beyond the limits of the inner loop.
    """
    craft = params.craft
    readings = readings_of(state)
    loop = required_loop(params)
    software = loop.init(craft, readings, params.first_carrying)
    wrench = net_wrench(craft, thrusts)
    angles = Angles(*angles_of(readings.attitude.matrix()))
    software = loop.trimmed(craft, software, Trim(angles, wrench.thrust, wrench.moment, thrusts))
    before = state._replace(inner=HeldLoop(software, wrench.thrust, thrusts, 0.0))
    # commands that keep the velocity, with a yaw rate of 0; no disturbances, wind or named inputs
    drive = PlantInput((*readings.velocity, 0.0), (0.0,) * 4, None, ())
    following = software_tick(params, software_sample(params, before, drive, dt), loop.period).inner
    carried = True
    for row, commanded in zip(craft.allocation, following.rotor, strict=True):
        demanded = dot(row, (wrench.thrust, *wrench.moment))
        carried = carried & (jnp.abs(commanded - demanded) <= SMALL_BUMP * craft.rotor_limit)
    return HeldLoop(software, wrench.thrust, following.rotor, following.limited), jnp.where(carried, 1.0, 0.0)


def first_integrals(params: UavParams) -> tuple[str, ...]:
    """Names of the numbers of the study at which the integrals of velocity start; () without integral action."""
    gains = params.inner_loop
    if isinstance(gains, InnerGains) and nominal(gains.kp_velocity) == 0.0:
        return ()
    return tuple(f"inner_loop.velocity_integral.{axis}" for axis in range(3))


def starts_settled(params: UavParams) -> bool:
    """Whether the inner loop's integrals start in the equilibrium of the draw, and not at the study's numbers alone."""
    return params.inner_loop.start is Start.SETTLED


def velocity_commands(drive: PlantInput) -> tuple[Vec3, Scalar]:
    """Commands of velocity [m/s] and yaw rate [rad/s] with their disturbances."""
    x, y, z, psi = (u + d for u, d in zip(drive.command, drive.disturbance, strict=True))
    return Vec3(x, y, z), psi


def software_period(params: UavParams) -> float | None:
    """Time between two ticks of the sampled inner loop [s]; None: the inner loop is not sampled."""
    loop = sampled_loop(params)
    return None if loop is None else loop.period


def readings_of(state: UavState) -> Readings:
    """What the inner loop measures: the true motion, or the motion with the error of the last estimate added."""
    if state.error == ():  # no estimator
        return Readings(state.velocity, state.attitude, state.rate)
    error = state.error
    return Readings(state.velocity + error.velocity, product(error.attitude, state.attitude), state.rate + error.rate)


def estimated_state(params: UavParams, state: UavState) -> UavState:
    """The state as the controllers see it: the estimated motion in place of the true one, and no error beside it."""
    if state.error == ():  # no estimator
        return state
    readings = readings_of(state)
    position = state.position + state.error.position
    return state._replace(
        position=position, velocity=readings.velocity, attitude=readings.attitude, rate=readings.rate, error=()
    )


def motion_of(state: UavState) -> Motion:
    """The vehicle's true motion: position, velocity, attitude and angular rate."""
    return Motion(state.position, state.velocity, state.attitude, state.rate)


def with_estimate(estimator: Estimator, state: UavState, memory: State) -> tuple[UavState, State]:
    """The state with the error of the estimate in an estimator's memory, and this memory.

    The error is the estimate minus the true motion; the estimator's normalised squared error stands beside it.
    """
    motion = motion_of(state)
    estimate = memory.estimate
    error = EstimationError(
        position=estimate.position - motion.position,
        velocity=estimate.velocity - motion.velocity,
        attitude=product(estimate.attitude, conjugate(motion.attitude)),
        rate=estimate.rate - motion.rate,
        nees=estimator.nees(memory, motion),
    )
    return state._replace(error=error), memory


def required_estimator(params: UavParams) -> Estimator:
    """The estimator of parameters that must have one."""
    estimator = estimator_of(params)
    assert estimator is not None
    return estimator


def start_estimate(params: UavParams, state: UavState, key: jax.Array) -> tuple[UavState, State]:
    """The state with the error of the first estimate, and the estimator's memory at t = 0."""
    estimator = required_estimator(params)
    return with_estimate(estimator, state, estimator.start(motion_of(state), Random(key)))


def renew_estimate(
    params: UavParams, state: UavState, memory: State, key: jax.Array, k: Scalar, dt: float
) -> tuple[UavState, State]:
    """The state with the error of the estimate at sample k, and the estimator's memory after it.

    Args:
        params: Parameters with an estimator.
        state: The vehicle's state at sample k.
        memory: The estimator's memory after the sample before.
        key: Random key of the sample.
        k: Index of the sample.
        dt: Length of a sample [s].
    """
    estimator = required_estimator(params)
    return with_estimate(estimator, state, estimator.step(memory, motion_of(state), Random(key), k, dt))


def software_sample(params: UavParams, state: UavState, drive: PlantInput, dt: float) -> UavState:
    """Velocity control of a sampled inner loop.

    Velocity control runs once in each sample of the outer loop, and its demand is held for the ticks in the sample.
    """
    command, yaw_command = velocity_commands(drive)
    software = required_loop(params).sample(
        params.craft, state.inner.software, readings_of(state), command, yaw_command, dt
    )
    return state._replace(inner=state.inner._replace(software=software))


def software_tick(params: UavParams, state: UavState, dt: float) -> UavState:
    """Attitude and rate control of a sampled inner loop, and the allocation to the rotors.

    Both run at each tick. If a rotor is at a limit, the moment that the rotors do not give is fed back to the inner
    loop, where it may stop integrals.
    """
    craft = params.craft
    software, demand = required_loop(params).tick(craft, state.inner.software, readings_of(state), dt)
    thrusts = allocate(params.allocation, demand.thrust, demand.moment, params.rotor_limit, params.desaturation)
    missing = demand.moment - allocated_moment(craft, thrusts.commanded)
    unallocated = Vec3(*(jnp.where(thrusts.limited, value, 0.0) for value in missing))
    software = software._replace(unallocated=unallocated)
    limited = jnp.where(thrusts.limited, 1.0, 0.0)
    return state._replace(inner=HeldLoop(software, demand.thrust, thrusts.commanded, limited))


class RotorMount(NamedTuple):
    """Where a rotor is, and its turning sense.

    Args:
        position: Nominal place in body axes [m].
        torque_sign: Sign of the rotor's drag torque: 1 if the rotor turns clockwise as seen from above.
    """

    position: tuple[float, ...]
    torque_sign: Scalar


def rotor_mounts(vehicle: Vehicle) -> list[RotorMount]:
    """The mount of each rotor, in the order of the rotors."""
    if vehicle.rotor:
        return [RotorMount(tuple(map(nominal, rotor.position)), rotor.direction) for rotor in vehicle.rotor]
    mounts = []
    arm = nominal(vehicle.arm)
    for x, y, spin in zip(*vehicle.directions(), vehicle.spins, strict=True):
        mounts.append(RotorMount((arm * x, arm * y, 0.0), spin))
    return mounts


def rotor_sentences(params: UavParams) -> tuple[str, ...]:
    """Sentences for the generated code's README: the commands, the axes, and each rotor's place and turning sense."""
    vehicle = params.vehicle
    sentences = [
        "Commands are `u_p` of each channel: velocities along x, y, z [m/s] and the rate of yaw [rad/s].",
        "World axes are x, y, z up, body axes forward, left, up. From NED and FRD: (x, y, z) = (east, north, -down), "
        "a body vector (a, b, c) becomes (a, -b, -c), and yaw counts counter-clockwise from x. PX4's quaternion "
        "(w, x, y, z) becomes (w + z, x + y, x - y, w - z)/sqrt(2).",
        f"A rotor gives at most {params.rotor_limit:.6g} N as the mixer knows it. PX4's command of a motor, from 0 to "
        f"1, is its thrust over that: `rotor_0`/{params.rotor_limit:.6g} where THR_MDL_FAC = 0.",
        "Parameters that end in `_0`, `_1`, `_2` are those of roll, pitch and yaw; of `velocity_integral` of x, y, z.",
        "Places of rotors are in metres from the centre of mass.",
    ]
    for index, mount in enumerate(rotor_mounts(vehicle)):
        at = ", ".join(f"{value:.4g}" for value in mount.position)
        direction_text = "clockwise" if nominal(mount.torque_sign) > 0.0 else "counter-clockwise"
        named = f"`rotor_{index}`, rotor {index + 1} of trajectories"
        sentences.append(f"{named}, is at ({at}) and turns {direction_text} as seen from above.")
    return tuple(sentences)
