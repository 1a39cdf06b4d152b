"""Make the problem of a proof from a vehicle's study: check that a proof covers its parts, extract plain numbers."""

import math
from collections.abc import Sequence

import numpy as np

from dssc_jax.core.contracts import Controller, Unmodelled
from dssc_jax.core.registry import Discretisation
from dssc_jax.core.signals import Scalar
from dssc_jax.design.ends import Ends, ends_of
from dssc_jax.design.loop_bounds import NotCovered
from dssc_jax.models.actuators import NO_DYNAMICS
from dssc_jax.models.actuators.delay import DELAY
from dssc_jax.models.controllers.dssc import DSSC, SSC
from dssc_jax.models.controllers.dssc_forms import DsscGains
from dssc_jax.models.controllers.gain_functions import Vgsta
from dssc_jax.models.controllers.modulation import ConstantModulation
from dssc_jax.models.differentiators import NO_DIFFERENTIATOR
from dssc_jax.models.disturbances import NO_DISTURBANCE
from dssc_jax.models.references.flights import HOVER, WHOLE_MISSION
from dssc_jax.models.references.sine import MISSION
from dssc_jax.models.sensors import IDEAL
from dssc_jax.models.uav.desaturation import Desaturation
from dssc_jax.models.uav.inner_loops.article import AttitudeReference, InnerGains, ThrustRule
from dssc_jax.models.uav.plant import UAV, UavParams
from dssc_jax.models.uav.vehicle import Vehicle
from dssc_jax.proofs.law_content import functions_content, nominal_content
from dssc_jax.proofs.problem import Interval
from dssc_jax.proofs.vehicle_problem import ChannelProblem, Sine, VehicleProblem
from dssc_jax.study import Study

UNCERTAIN = ("plant.vehicle.mass", "plant.vehicle.thrust_coefficient", "plant.vehicle.body_inertia")
"""Beginnings of the names of numbers that a proof of the vehicle covers over an interval."""
ONLY_BOUNDS = ("plant.position", "plant.velocity", "plant.yaw", "wind.")
"""Beginnings of the names of uncertain numbers that only bound a start or the wind."""
TURN = 2.0 * math.pi
"""A full turn [rad]."""
START_ROOM = 1e-12
"""Room in the bounds of a start for the rounding of where a moving reference begins [m], [m/s], [rad]."""
EQUAL_ANGLES = 1e-9
"""Largest difference [rad] of angles that count as equal."""
ONE: Interval = (1.0, 1.0)
"""The interval of the number 1."""
AXES = {"x": 0, "z": 2, "psi": 3}
"""Place of each channel of the problem among the loop's channels x, y, z, psi; y has the controller of x."""


def is_vehicle(study: Study) -> bool:
    """Whether the study's plant is the complete vehicle."""
    return study.loop.plant is UAV


def vehicle_problem_of(study: Study) -> VehicleProblem:
    """Make the problem of a vehicle's study; its sweep is ignored, and the support of each law becomes an interval.

    Raises:
        NotCovered: A part of the loop is outside of the theorem; the message gives the reason.
    """
    if study.config.event:
        raise NotCovered("[[event]] changes the loop at a time")
    require_laws(study)
    ends = ends_of(study.without_sweep())
    require_loop(study)
    plant = ends.part("plant")
    inner_gains = require_inner_loop(plant)
    vehicle = ends.low.plant.vehicle
    require_geometry(plant)
    model = ends.low.plant.inner_model
    masses = interval_of([end.plant.vehicle.mass for end in ends])
    thrusts = interval_of([end.plant.vehicle.thrust_coefficient for end in ends])
    thrust_ratio = quotient(thrusts, (model.thrust_coefficient, model.thrust_coefficient))  # k_T/k_Tn
    inertias = zip(ends.low.plant.vehicle.inertia, ends.high.plant.vehicle.inertia, strict=True)
    inertia = [interval_of(pair) for pair in inertias]  # of J_x, J_y and J_z
    turn_ratios = []  # nu_i = (k_T/k_Tn) J_n,i/J_i of each axis
    for believed, interval in zip(model.inertia, inertia, strict=True):
        turn_ratios.append(product(thrust_ratio, quotient((believed, believed), interval)))
    return VehicleProblem(
        sample_time=study.loop.sample_time,
        delay=delay_of(study, ends),
        velocity_gain=float(inner_gains.kd_velocity),
        stiffness=float(inner_gains.kp_attitude),
        damping=float(inner_gains.kd_attitude),
        yaw_gain=float(inner_gains.kd_yaw),
        yaw_integral_gain=float(inner_gains.kp_yaw),
        mass=masses,
        believed_mass=float(model.mass),
        thrust=product(thrust_ratio, quotient((model.mass, model.mass), masses)),
        turn=(min(low for low, _ in turn_ratios), max(high for _, high in turn_ratios)),
        inertia=(inertia[0], inertia[1], inertia[2]),
        believed_inertia=(float(model.inertia.x), float(model.inertia.y), float(model.inertia.z)),
        rotors=vehicle.rotors,
        arm=float(vehicle.arm),
        torque_coefficient=float(vehicle.torque_coefficient),
        thrust_coefficient=float(model.thrust_coefficient),
        rotor_limit=min(float(end.plant.vehicle.thrust_limit) for end in ends),
        rotor_lag=float(vehicle.motor_lag or 0.0),
        rotor_inertia=float(vehicle.rotor_inertia_z),
        structure_drag=(float(vehicle.structure_drag[0]), float(vehicle.structure_drag[2])),
        propeller_drag=float(vehicle.propeller_drag),
        wind=wind_of(study, ends),
        channels=channels_of(study, ends),
        reference=reference_of(study),
    )


def require_laws(study: Study) -> None:
    """Require that a proof covers every uncertain number of a study over an interval, and that its law has bounds.

    Raises:
        NotCovered: A proof does not cover an uncertain number, or its law has no bounds.
    """
    for name, law in study.written_laws.items():
        if not name.startswith((*UNCERTAIN, *ONLY_BOUNDS)):
            raise NotCovered(
                f"{name} is uncertain; a proof of the vehicle takes intervals of {', '.join(UNCERTAIN)} only"
            )
        if not all(math.isfinite(end) for end in law.support):
            raise NotCovered(f"the law of {name} has no bounds; give one with bounded support")


def require_loop(study: Study) -> None:
    """Require that the theorem covers the loop around the vehicle.

    The vehicle starts level, hovers or flies the mission, and measures exactly. Only the wind disturbs it. On the
    mission its rotors have no lag.

    Raises:
        NotCovered: A part of the loop differs; the message names the part.
    """
    loop = study.loop
    plant: UavParams = study.template.plant
    if any((plant.roll or 0.0, plant.pitch or 0.0, *plant.body_rate)):
        raise NotCovered("plant.roll, plant.pitch or plant.body_rate is not 0: a proof starts level and does not turn")
    if loop.reference not in (HOVER, WHOLE_MISSION):
        raise NotCovered("a proof of the vehicle takes reference.kind = 'hover' or 'mission'")
    if loop.reference is WHOLE_MISSION and study.template.plant.vehicle.motor_lag:
        raise NotCovered("the rotors have a lag, and the reference moves")
    estimation = loop.plant.estimation
    if estimation is not None and estimation.is_enabled(study.template.plant):
        raise NotCovered("the controllers see an estimate; a proof of the vehicle takes plant.estimator.kind = 'none'")
    if any(sensor is not IDEAL for sensor in loop.sensor):
        raise NotCovered("a sensor is not ideal")
    if any(differentiator is not NO_DIFFERENTIATOR for differentiator in loop.differentiator):
        raise NotCovered("a rate is not measured exactly, but by a differentiator")
    if any(disturbance is not NO_DISTURBANCE for disturbance in loop.disturbance):
        raise NotCovered("a channel has a disturbance besides the wind")


def require_inner_loop(plant: Ends) -> InnerGains:
    """Return the gains of the inner loops, which must be those of the article, in the variant that the theorem covers.

    Args:
        plant: The plant's parameters at the lower and the upper ends of all laws.

    Raises:
        NotCovered: The inner loops are others, the theorem does not cover an option, or a gain is uncertain.
    """
    inner = plant.low.inner_loop
    if not getattr(inner, "has_proof", False):
        raise NotCovered("plant.inner_loop is sampled; a proof of the vehicle takes plant.inner_loop.kind = 'article'")
    if inner != plant.high.inner_loop:
        raise NotCovered("a gain of the inner loops is uncertain")
    if inner.thrust is not ThrustRule.PROJECTION:
        raise NotCovered("plant.inner_loop.thrust is not 'projection'")
    if inner.attitude is not AttitudeReference.PLAIN:
        raise NotCovered("plant.inner_loop.attitude is not 'plain'")
    if inner.kp_velocity != 0.0:
        raise NotCovered("plant.inner_loop.kp_velocity is not 0")
    if inner.kp_yaw == 0.0:
        raise NotCovered("plant.inner_loop.kp_yaw is 0, so that the integral of the yaw rate's error does not decay")
    return inner


def require_geometry(plant: Ends) -> None:
    """Require equally spaced rotors with alternating spins, equal drag along body x and y, and no ground or battery.

    Thrusts beyond their limits must be clipped, without any other desaturation.

    Args:
        plant: The plant's parameters at the lower and the upper ends of all laws.

    Raises:
        NotCovered: The vehicle differs; the message names the part.
    """
    vehicle: Vehicle = plant.low.vehicle
    if vehicle.rotor:
        raise NotCovered(
            "[[plant.vehicle.rotor]] places the rotors anywhere; a proof takes equal rotors on a circle, by arm, "
            "rotor_angles and spins"
        )
    if plant.low.ground is not None:
        raise NotCovered("[plant.ground] pushes the vehicle up")
    if plant.low.battery is not None:
        raise NotCovered("[plant.battery] slows the rotors down")
    if plant.low.desaturation is not Desaturation.CLIP:
        raise NotCovered("plant.desaturation is not 'clip'")
    n = vehicle.rotors
    angles = np.array(vehicle.rotor_angles, dtype=float)
    angle_steps = np.diff(np.append(angles, angles[0] + TURN))
    spins = np.array(vehicle.spins, dtype=float)
    is_regular = np.max(np.abs(angle_steps - TURN / n)) <= EQUAL_ANGLES
    alternates = n % 2 == 0 and np.all(spins[1:] == -spins[:-1])
    if not (is_regular and alternates):
        raise NotCovered("the rotors are not equally spaced, counter-clockwise, with alternating spins")
    if vehicle.structure_drag[0] != vehicle.structure_drag[1]:
        raise NotCovered("plant.vehicle.structure_drag differs between body x and y")


def interval_of(values: Sequence[Scalar]) -> Interval:
    """Find the smallest interval that contains some values."""
    return float(min(values)), float(max(values))


def with_rounding_room(interval: Interval) -> Interval:
    """Widen an interval by four units in the last place at each end, more than rounding loses; exactly 1 stays 1.

    The ends must be positive.
    """
    if interval == ONE:
        return interval
    low, high = interval
    return low - 4.0 * math.ulp(low), high + 4.0 * math.ulp(high)


def quotient(a: Interval, b: Interval) -> Interval:
    """Enclose a/b for positive a and b in intervals; the quotient of a number by itself is exactly 1."""
    a_low, a_high = a
    b_low, b_high = b
    if a == b and a_low == a_high:
        return ONE
    return with_rounding_room((a_low / b_high, a_high / b_low))


def product(a: Interval, b: Interval) -> Interval:
    """Enclose the product a b for positive a and b in intervals; a factor of exactly 1 leaves the other unchanged."""
    if a == ONE:
        return b
    if b == ONE:
        return a
    a_low, a_high = a
    b_low, b_high = b
    return with_rounding_room((a_low * b_low, a_high * b_high))


def delay_of(study: Study, ends: Ends) -> float:
    """Return the delay of the commands [samples], the same in all channels; 0 without unmodelled dynamics.

    Args:
        study: The study.
        ends: The loop's parameters at the lower and the upper ends of all laws.

    Raises:
        NotCovered: The unmodelled dynamics are not a single delay, or the delay is uncertain or differs between
            channels.
    """
    models: tuple[Unmodelled, ...] = study.loop.unmodelled
    if all(model is NO_DYNAMICS for model in models):
        return 0.0
    if any(model is not DELAY for model in models):
        raise NotCovered("the unmodelled dynamics are no single delay; a lag belongs to plant.vehicle.motor_lag")
    samples = {float(delay_params.samples) for end in ends for delay_params in end.unmodelled}
    if len(samples) > 1:
        raise NotCovered("the delay is uncertain, or differs between the channels")
    return samples.pop()


def wind_of(study: Study, ends: Ends) -> tuple[float, float]:
    """Return bounds of the norm of the horizontal wind and of the magnitude of the vertical wind [m/s].

    Args:
        study: The study.
        ends: The loop's parameters at the lower and the upper ends of all laws.

    Raises:
        NotCovered: The kind of wind states no bounds.
    """
    wind = study.loop.wind
    if wind.bounds is None:
        raise NotCovered("the wind has no known bound; wind.kind = 'bounded' states one")
    limits = [wind.bounds(end.wind) for end in ends]
    return max(float(limit.speed) for limit in limits), max(float(limit.vertical) for limit in limits)


def channels_of(study: Study, ends: Ends) -> dict[str, ChannelProblem]:
    """Make the controller and the start of each channel of the problem, by name; the channel x stands for y, too.

    Raises:
        NotCovered: The theorem does not cover a controller, or the controllers of x and y differ.
    """
    gains = ends.low.controller
    if gains[0] != gains[1] or study.loop.controller[0] is not study.loop.controller[1]:
        raise NotCovered("the controllers of x and y differ")
    starts = starts_of(study, ends)
    return {name: channel_of(study, place, gains[place], starts[name]) for name, place in AXES.items()}


def channel_of(study: Study, place: int, gains: object, initial: tuple[float, float]) -> ChannelProblem:
    """Make the problem of a single channel: its controller, and bounds of its start.

    Args:
        study: The study.
        place: Place of the channel among the loop's channels, a value of :data:`AXES`.
        gains: Gains of the channel's controller.
        initial: E_0 and V_0, bounds of |e| [m, rad] and |e'| [m/s, rad/s] at t = 0, by :func:`starts_of`.

    Raises:
        NotCovered: The controller is outside of the theorem.
    """
    covered_gains = require_covered_controller(study.loop.channels[place], study.loop.controller[place], gains)
    return ChannelProblem(
        l0=float(covered_gains.l0),
        functions=functions_content(covered_gains.functions),
        rho=float(covered_gains.rho.rho),
        nominal=nominal_content(covered_gains.nominal),
        start=covered_gains.predictor_start.value,
        initial=initial,
    )


def require_covered_controller(name: str, controller: Controller, gains: object) -> DsscGains:
    """Return the gains of a channel's controller, after checking that the theorem covers the controller.

    Args:
        name: Name of the channel, for the message.
        controller: The channel's controller.
        gains: The controller's gains, of any type.

    Raises:
        NotCovered: The controller is outside of the theorem; the message gives the reason.
    """
    conservative = (DSSC.members[Discretisation.CONSERVATIVE], SSC.members[Discretisation.CONSERVATIVE])
    if controller not in conservative or not isinstance(gains, DsscGains):
        raise NotCovered(f"the controller of {name} is not DSSC or SSC in the conservative form")
    if not isinstance(gains.rho, ConstantModulation):
        raise NotCovered(f"rho of {name} is not constant")
    if gains.sign_width is not None:
        raise NotCovered(f"the sign of {name} is smoothed")
    if isinstance(gains.functions, Vgsta) or not gains.functions.finite_slope:
        raise NotCovered(f"phi_1 of {name} depends on e, or has no finite slope at sigma = 0")
    return gains


def reference_of(study: Study) -> dict[str, Sine] | None:
    """Return the sine that each axis follows, as amplitude [m, rad], period [s] and phase [rad]; None in hover."""
    if study.loop.reference is HOVER:
        return None
    return {
        axis.value: (float(sine.amplitude), float(sine.period), float(sine.phase)) for axis, sine in MISSION.items()
    }


def first_points(study: Study, ends: Ends) -> list[tuple[float, float]]:
    """Return the value [m, rad] and rate [m/s, rad/s] of each axis's reference at t = 0, in the order x, y, z, psi."""
    if study.loop.reference is HOVER:
        hover = ends.low.reference
        return [(float(value), 0.0) for value in (*hover.position, hover.yaw)]
    points = []
    for sine in MISSION.values():
        rate = TURN / sine.period
        place = sine.offset + sine.amplitude * math.sin(sine.phase)
        points.append((place, sine.amplitude * rate * math.cos(sine.phase)))
    return points


def starts_of(study: Study, ends: Ends) -> dict[str, tuple[float, float]]:
    """Return E_0 and V_0, bounds of |e| [m, rad] and |e'| [m/s, rad/s] at t = 0, by channel.

    In x they bound the norms of the plane's vectors. In psi V_0 bounds |psi'| itself, which is 0 at the start.
    """
    plants: list[UavParams] = [end.plant for end in ends]
    *first_points_of_axes, (first_yaw, _) = first_points(study, ends)
    distances = []
    speeds = []
    for axis, (place, rate) in enumerate(first_points_of_axes):
        distances.append(largest_of([end.position[axis] - place for end in plants]))
        speeds.append(largest_of([end.velocity[axis] - rate for end in plants]))
    yaw_errors = [float(end.yaw) - first_yaw for end in plants]
    # the vehicle takes the shorter way round, so the mean of both ends loses its full turns
    full_turns = TURN * round(sum(yaw_errors) / (2.0 * TURN))
    yaw_error = largest_of([angle - full_turns for angle in yaw_errors])
    room = 0.0 if study.loop.reference is HOVER else START_ROOM
    return {
        "x": (math.hypot(*distances[:2]) + room, math.hypot(*speeds[:2]) + room),
        "z": (distances[2] + room, speeds[2] + room),
        "psi": (yaw_error + room, 0.0),
    }


def largest_of(values: Sequence[Scalar]) -> float:
    """Return the largest of the magnitudes of some values."""
    return max(abs(float(value)) for value in values)
