"""Make the problem of a proof from a study: check that a proof covers its parts, and extract plain numbers."""

import math
from collections.abc import Iterable
from dataclasses import asdict
from typing import NamedTuple, TypeAlias

import jax

from dssc_jax.core.contracts import Controller, Differentiator, Sensor
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.registry import Discretisation
from dssc_jax.design.ends import Ends, ends_of
from dssc_jax.design.loop_bounds import NotCovered, disturbance_bounds, reference_bounds, require_no_inputs
from dssc_jax.models.actuators import NO_DYNAMICS
from dssc_jax.models.actuators.delay import DELAY
from dssc_jax.models.actuators.lag import LAG, Order
from dssc_jax.models.actuators.transfer_function import TRANSFER_FUNCTION
from dssc_jax.models.controllers.dssc import DSSC, SSC
from dssc_jax.models.controllers.dssc_forms import DsscGains
from dssc_jax.models.controllers.modulation import ConstantModulation
from dssc_jax.models.controllers.pi import PI, PiGains
from dssc_jax.models.differentiators import NO_DIFFERENTIATOR
from dssc_jax.models.disturbances.partition import PARTITION
from dssc_jax.models.disturbances.prescribed import STEP
from dssc_jax.models.plants.normal_form import NORMAL_FORM
from dssc_jax.models.sensors import IDEAL
from dssc_jax.models.sensors.lag import SENSOR_LAG
from dssc_jax.proofs.law_content import functions_content, nominal_content
from dssc_jax.proofs.problem import Interval, ProofProblem
from dssc_jax.proofs.vehicle_coverage import is_vehicle, vehicle_problem_of
from dssc_jax.proofs.vehicle_problem import VehicleProblem
from dssc_jax.study import Study
from dssc_jax.study.actuators import kind_in, tables_of

LARGEST_NUMBER = 1e100
"""Largest number that a problem may have, so that its square is a number of float64."""
UNCERTAIN = ("plant.k_p", "plant.a_p", "unmodelled.0.mu")
"""Paths, in the loop's parameters, of the numbers that a proof covers over an interval."""
BOUNDED_SIGNALS = ("plant.initial", "disturbance.", "reference.")
"""Beginnings of the names of numbers that only enter a problem through the bounds of a start or a signal."""
LAGS = {
    LAG.members[Order.ONE]: ((1.0,), (1.0, 1.0)),
    LAG.members[Order.TWO]: ((1.0,), (1.0, 2.0, 1.0)),
}
"""Numerator and denominator of each lag, in rising powers of mu s."""
UNPROVED_CONTROLLER = "the controller is not DSSC, SSC or PI, in implicit or conservative form"
"""Reason why a controller is not covered."""

AnyProblem: TypeAlias = ProofProblem | VehicleProblem
"""What is to be proved: a loop of the class (5)-(8), or a whole vehicle."""


def problem_of(study: Study) -> AnyProblem:
    """Make the problem of a study, a loop of the class (5)-(8) or a vehicle; its sweep is ignored.

    The support of each law becomes an interval of the problem.

    Raises:
        NotCovered: A part of the loop is outside of what a proof covers; the message gives the reason.
    """
    return vehicle_problem_of(study) if is_vehicle(study) else axis_problem_of(study)


def axis_problem_of(study: Study) -> ProofProblem:
    """Make the problem of a loop of the class (5)-(8); its sweep is ignored.

    The supports of the laws of k_p, a_p and mu become intervals. Other laws widen the bounds of a start or a signal.

    Raises:
        NotCovered: A part of the loop is outside of the class; the message gives the reason.
    """
    study = study.without_sweep()
    loop = study.loop
    if len(tables_of(study.config, "unmodelled")) > 1:
        raise NotCovered(
            f"the actuators form a chain, {kind_in(study.config, 'unmodelled')}; only one of them is covered"
        )
    ends = ends_of(study)
    require_covered_laws(study)
    if loop.plant is not NORMAL_FORM:
        raise NotCovered("the plant is not of the class (5)-(8), which kind = 'normal_form' writes down")
    low, high = ends
    zero_dynamics = low.plant.zero_dynamics
    disturbance = disturbance_of(study, ends)
    reference_suprema = reference_bounds(loop.reference, ends.part("reference"))  # by name; empty at rest
    lag = sensor_lag(loop.sensor[0], loop.differentiator[0], ends)  # the loop has a single channel
    if reference_suprema and zero_dynamics is not None:
        raise NotCovered("the reference moves, and the plant has zero dynamics")
    if reference_suprema and lag:
        raise NotCovered("the reference moves, and the sensor lags")
    speed = float(reference_suprema.get("y_m_dot", 0.0))
    acceleration = float(reference_suprema.get("y_m_ddot", 0.0))
    jerk = float(reference_suprema.get("y_m_dddot", 0.0))
    problem = ProofProblem(
        sample_time=loop.sample_time,
        k_p=(float(low.plant.k_p), float(high.plant.k_p)),
        a_p=(float(low.plant.a_p), float(high.plant.a_p)),
        zero_a=tuple(map(float, zero_dynamics.a)) if zero_dynamics else (),
        zero_c=tuple(map(float, zero_dynamics.c)) if zero_dynamics else (),
        sensor_lag=lag,
        level=disturbance.level,
        slope=disturbance.slope,
        reference=(speed, acceleration, jerk),
        initial=initial_errors(study, ends),
        by_state=disturbance.by_state,
        reference_size=float(reference_suprema.get("y_m", 0.0)) if any(disturbance.by_state) else 0.0,
        **unmodelled_of(study, ends),
        **controller_of(study),
    )
    require_squares(problem)
    return problem


def require_squares(problem: ProofProblem) -> None:
    """Require that the square of every number of a problem is finite in float64.

    Raises:
        NotCovered: A number is too large.
    """
    for name, value in asdict(problem).items():
        if not all(abs(number) <= LARGEST_NUMBER for number in numbers_in(value)):
            raise NotCovered(f"{name} holds a number beyond {LARGEST_NUMBER:g}, whose square is none of float64")


def require_covered_laws(study: Study) -> None:
    """Require that a proof covers every uncertain number of a study over an interval, and that its law has bounds.

    Raises:
        NotCovered: A proof does not cover an uncertain number, its law has no bounds, or the number is a parameter of
            the study rather than a number of the loop.
    """
    for name, law in study.written_laws.items():
        if name in study.parameter_names:
            followers = ", ".join(study.followers(name))
            if not followers:
                raise NotCovered(f"{name} is uncertain, and nothing follows from it; leave it out")
            raise NotCovered(f"{name} is uncertain, and {followers} follows from it; give the latter a law of its own")
        covered_paths = set(study.numbers[name].paths) & set(UNCERTAIN)
        if not covered_paths and not name.startswith(BOUNDED_SIGNALS):
            raise NotCovered(
                f"{name} is uncertain; a proof takes intervals of plant.k_p, plant.a_p, unmodelled.mu only"
            )
        if not all(abs(end) < float("inf") for end in law.support):
            raise NotCovered(f"the law of {name} has no bounds; give one with bounded support")


def numbers_in(value: object) -> list[float]:
    """List all numbers in a field of a problem, at any depth of its tables and tuples; text and None are left out."""
    if isinstance(value, int | float):
        return [value]
    items: Iterable[object] = ()
    if isinstance(value, dict):
        items = value.values()
    elif isinstance(value, tuple):
        items = value
    numbers: list[float] = []
    for item in items:
        numbers += numbers_in(item)
    return numbers


class DisturbanceBounds(NamedTuple):
    """Bounds of a study's disturbance.

    Args:
        level: Bound of |d| [m/s] for the part that does not depend on the state.
        slope: Bound of |d'| [m/s^2] for the same part.
        by_state: k_d1 to k_d5 of (30), by which the disturbance grows with the state.
    """

    level: float
    slope: float
    by_state: tuple[float, ...]


def disturbance_of(study: Study, ends: Ends) -> DisturbanceBounds:
    """Return the bounds of a study's disturbance.

    A step after t = 0 is refused, since its slope has no bound.

    Args:
        study: The study, with a single channel.
        ends: The loop's parameters at the lower and the upper ends of all laws.

    Raises:
        NotCovered: A bound of the disturbance or of its derivative is not known, or a disturbance acts elsewhere than
            the command does.
    """
    require_no_inputs(study.loop)
    model = study.loop.disturbance[0]
    try:
        if model is STEP and ends.high.disturbance[0].at > 0.0:
            raise NotCovered("a step")
        bounds = disturbance_bounds(model, ends.part("disturbance", 0))
    except NotCovered:
        # the step's own message, above, never leaves this function
        raise NotCovered("the disturbance's derivative has no known bound") from None
    gains = tuple(float(bounds.get(f"k_d{i}", 0.0)) for i in range(1, 6))
    slope = float(bounds.get("alpha_d2", 0.0)) + float(bounds.get("alpha_d3", 0.0))
    level = float(bounds.get("alpha_d", 0.0))
    if model is PARTITION:  # without the state a constant plus sines; an amplitude is a slope over omega
        level = float(ends.part("disturbance", 0).largest("value"))
        level += slope * float(ends.high.disturbance[0].period) / (2.0 * math.pi)
    return DisturbanceBounds(level, slope, gains)


def sensor_lag(sensor: Sensor, differentiator: Differentiator, ends: Ends) -> float:
    """Return the time constant [s] of the lag through which sigma is measured; 0 for an ideal sensor.

    Args:
        sensor: The loop's sensor.
        differentiator: The loop's differentiator; only its absence is covered.
        ends: The loop's parameters at the lower and the upper ends of all laws.

    Raises:
        NotCovered: Sigma is measured in another way, or the time constant is uncertain.
    """
    if differentiator is not NO_DIFFERENTIATOR or sensor not in (IDEAL, SENSOR_LAG):
        raise NotCovered("sigma is measured neither exactly nor through a lag")
    if sensor is IDEAL:
        return 0.0
    low = ends.low.sensor[0].mu
    high = ends.high.sensor[0].mu
    if low != high:
        raise NotCovered("the sensor's lag is uncertain")
    return float(low)


def initial_errors(study: Study, ends: Ends) -> tuple[Interval, ...]:
    """Return the intervals of e [m], e' [m/s] and each component of eta at t = 0.

    They are the plant's initial state less the reference's y_m and y_m'. Initial values that are not given are 0.

    Args:
        study: The study, whose reference must be certain.
        ends: The loop's parameters at the lower and the upper ends of all laws.

    Raises:
        NotCovered: A number of the reference is uncertain, so that the reference's start is not known.
    """
    if any(name.startswith("reference.") for name in study.written_laws):
        raise NotCovered("the reference's start is uncertain")
    zero_dynamics = ends.low.plant.zero_dynamics
    size = 2 + (len(zero_dynamics.a) if zero_dynamics else 0)
    with jax.enable_x64(True):
        y, y_dot, _ = map(float, study.loop.reference.at(ends.low.reference, 0.0))
    reference_start = (y, y_dot) + (0.0,) * (size - 2)  # eta has no reference
    low_start = with_zeros(map(float, ends.low.plant.initial), size)
    high_start = with_zeros(map(float, ends.high.plant.initial), size)
    errors = []
    for low, high, reference in zip(low_start, high_start, reference_start, strict=True):
        errors.append((min(low, high) - reference, max(low, high) - reference))
    return tuple(errors)


def with_zeros(values: Iterable[float], size: int) -> tuple[float, ...]:
    """Return some values followed by as many zeros as make ``size`` numbers."""
    first_values = tuple(values)
    return first_values + (0.0,) * (size - len(first_values))


def unmodelled_of(study: Study, ends: Ends) -> JsonObject:
    """Make the fields of a problem for the unmodelled dynamics: ``numerator``, ``denominator``, ``mu`` and ``delay``.

    A loop has G(mu s), a fixed delay [samples] or neither. The fields of absent dynamics are empty or 0.

    Args:
        study: The study, with a single channel.
        ends: The loop's parameters at the lower and the upper ends of all laws.

    Raises:
        NotCovered: The unmodelled dynamics are neither a lag, a transfer function nor a known delay.
    """
    model = study.loop.unmodelled[0]
    low = ends.low.unmodelled[0]
    high = ends.high.unmodelled[0]
    no_dynamics = {"numerator": (), "denominator": (), "mu": (0.0, 0.0), "delay": 0.0}
    if model is NO_DYNAMICS:
        return no_dynamics
    if model is DELAY:
        if low.samples != high.samples:
            raise NotCovered("the delay is uncertain")
        return no_dynamics | {"delay": float(low.samples)}
    if model in LAGS:
        numerator, denominator = LAGS[model]
    elif model is TRANSFER_FUNCTION:
        numerator = tuple(map(float, low.numerator))
        denominator = tuple(map(float, low.denominator))
    else:
        raise NotCovered("the unmodelled dynamics are neither a lag, a transfer function nor a delay")
    return no_dynamics | {"numerator": numerator, "denominator": denominator, "mu": (float(low.mu), float(high.mu))}


def controller_of(study: Study) -> JsonObject:
    """Make the controller's fields of a problem: ``l0``, ``nominal``, ``form``, ``functions``, ``rho`` and ``start``.

    Raises:
        NotCovered: The controller is not DSSC, SSC or PI, or a proof does not cover one of its options.
    """
    member = study.loop.controller[0]
    gains = study.template.controller[0]
    if not isinstance(gains, PiGains | DsscGains):
        raise NotCovered(UNPROVED_CONTROLLER)
    if isinstance(gains, PiGains):
        return pi_content(member, gains)
    return dssc_content(member, gains)


def pi_content(member: Controller, gains: PiGains) -> JsonObject:
    """Make the fields of a problem for PI, which is DSSC with constant functions and without a bound of the command.

    The constants are chosen so that the gains of DSSC, 1/(k_o tau_av) and 1/(k_o tau_av tau_m), equal K_P and K_I.

    Args:
        member: The sampled form of PI in the loop.
        gains: The gains of PI.

    Raises:
        NotCovered: PI is not in its implicit form, or a gain is not positive.
    """
    if member is not PI.members[Discretisation.IMPLICIT]:
        raise NotCovered("PI is covered in its implicit form only")
    if not (gains.k_p > 0.0 and gains.k_i > 0.0):
        raise NotCovered("PI needs K_P > 0 and K_I > 0")
    functions = {"kind": "constant", "k_o": 1.0, "tau_av": 1.0 / gains.k_p, "tau_m": gains.k_p / gains.k_i}
    nominal = nominal_content(gains.nominal)
    if nominal is not None:  # PI has no predictor
        nominal = nominal._replace(predictor_term=False)
    return {
        "l0": float(gains.l0),
        "nominal": nominal,
        "form": "implicit",
        "functions": functions,
        "rho": None,
        "start": "zero",
    }


def dssc_content(member: Controller, gains: DsscGains) -> JsonObject:
    """Make the fields of a problem for DSSC or SSC.

    Args:
        member: The controller of the loop, which tells the sampled form.
        gains: The gains of the controller.

    Raises:
        NotCovered: A proof does not cover the sampled form or an option of the controller.
    """
    forms = (Discretisation.IMPLICIT, Discretisation.CONSERVATIVE)
    form = next((form for form in forms if member in (DSSC.members[form], SSC.members[form])), None)
    if form is None:
        raise NotCovered(UNPROVED_CONTROLLER)
    if not isinstance(gains.rho, ConstantModulation):
        raise NotCovered("rho is not constant")
    if gains.sign_width is not None:
        raise NotCovered("the sign is smoothed")
    if not gains.functions.finite_slope and form == Discretisation.CONSERVATIVE:
        reason = "in the conservative form phi_1 needs a finite slope at sigma = 0"
        raise NotCovered(f"{reason}; set controller.discretisation = 'implicit'")
    return {
        "l0": float(gains.l0),
        "nominal": nominal_content(gains.nominal),
        "form": form.value,
        "functions": functions_content(gains.functions),
        "rho": float(gains.rho.rho),
        "start": gains.predictor_start.value,
    }
