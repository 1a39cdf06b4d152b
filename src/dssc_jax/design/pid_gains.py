"""First gains of PID: a phase margin at the bandwidth, integral action below the bandwidth, and one lead element.

Reference:
    K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed. (2021), chapters 11 and 12.
"""

import math

import jax
import numpy as np

from dssc_jax.core.contracts import Unmodelled
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import Params, State
from dssc_jax.core.toml import TomlTable
from dssc_jax.design.linear_plant import DesignProblem, LinearPlant
from dssc_jax.study.actuators import acting_elements
from dssc_jax.study.laws import nominal_params

PHASE_MARGIN = math.radians(60.0)
LEAST_MARGIN = math.radians(45.0)
"""Least accepted phase margin [rad], where one lead element and the slowest integral do not give the full margin."""
SLOWEST = 0.1
"""Corner frequency of the slowest integral, relative to the bandwidth."""
MOST_LEAD = math.radians(65.0)
"""Largest phase lead of one lead element [rad]."""
MOST_LAG = math.radians(85.0)
"""Largest phase lag of the integral part at the bandwidth [rad]."""
MOST_ADVANCE = math.radians(10.0)
"""Largest phase of a plant at the bandwidth [rad] at which this rule designs a PID controller."""
LAG_BEYOND = math.radians(66.0)
"""Phase in (-pi, pi] [rad] above which the plant is taken to lag by more than pi, rather than to lead."""
FAR_BELOW = 1e-6
"""Frequency relative to the bandwidth at which a plant is taken to have its gain at rest."""
VANISHING = 1e-3
"""Share of the gain at the bandwidth below which the gain at rest counts as 0."""


def pid(problem: DesignProblem, omega: float, ratio: float) -> TomlTable:
    """The table ``[controller]`` of a PID controller with the phase margin :data:`PHASE_MARGIN` at the bandwidth.

    The margin may be as small as :data:`LEAST_MARGIN` where no integral reaches the full one. It is larger where the
    plant alone has more.

    Args:
        problem: The plant, its actuators and the limit of the command.
        omega: The bandwidth [rad/s].
        ratio: Smallest corner frequency of the integral action, relative to the bandwidth.

    Raises:
        ConfigError: PID cannot give the phase margin at this bandwidth.
    """
    plant = problem.actuated_plant
    response = plant.response(omega)
    phase = float(np.angle(response))
    if phase > LAG_BEYOND:
        phase -= 2.0 * math.pi
    if phase > MOST_ADVANCE:
        rule = f"has at {omega:.4g} rad/s a phase of {math.degrees(phase):.0f} degrees"
        remedy = "ask for another bandwidth, or for 'lqg'; where the gain is negative, turn the command's sign"
        raise ConfigError("plant", f"{rule}, with which this PID rule cannot cross there; {remedy}")
    # the integral part 1 + corner/s lags by atan(corner/omega) at the bandwidth, with the plant by 90 degrees or more
    lag = min(max(0.5 * math.pi + phase, math.atan(ratio)), MOST_LAG)
    corner = omega * math.tan(lag) if has_gain_at_rest(plant, omega) else 0.0
    required_lead = lead_for_margin(phase, corner / omega)
    slowest_corner = min(SLOWEST, corner / omega)  # in bandwidths
    most_required_lead = MOST_LEAD
    if lead_for_margin(phase, slowest_corner) > MOST_LEAD:  # no integral reaches the full margin
        most_required_lead += PHASE_MARGIN - LEAST_MARGIN
    if required_lead > most_required_lead:
        raise lead_error(problem, omega, required_lead)
    lead = min(max(required_lead, 0.0), MOST_LEAD)
    return gains_with_lead(response, omega, corner, lead) | command_limits(problem)


def lead_for_margin(phase: float, corner: float) -> float:
    """Phase lead [rad] that gives :data:`PHASE_MARGIN` at the bandwidth; negative if the margin without it is larger.

    Args:
        phase: Phase of the plant at the bandwidth [rad].
        corner: Corner frequency of the integral part, relative to the bandwidth.
    """
    return PHASE_MARGIN - math.pi - phase + math.atan(corner)


def lead_error(problem: DesignProblem, omega: float, required_lead: float) -> ConfigError:
    """The error that PID needs more phase lead at the bandwidth than one lead element gives, with a remedy.

    Args:
        problem: The plant and the study's name.
        omega: The bandwidth [rad/s].
        required_lead: The phase lead that PID needs [rad].
    """
    if has_negative_gain_at_rest(problem.actuated_plant, omega):
        rule = "has a negative gain at rest, and the gains of 'pid' are at least 0"
        return ConfigError(f"{problem.study.source}: plant", f"{rule}; turn the command's sign, or ask for 'lqg'")
    degrees = math.degrees(required_lead)
    rule = f"needs a phase lead of {degrees:.0f} degrees at {omega:.4g} rad/s, and one element gives"
    remedy = f"{math.degrees(MOST_LEAD):.0f}; ask for less, or for 'lqg'"
    return ConfigError("`bandwidth`", f"{rule} {remedy}")


def gains_with_lead(response: complex, omega: float, corner: float, lead: float) -> TomlTable:
    """The table ``[controller]`` of a PID controller that makes the loop gain 1 at the bandwidth.

    PID is the product of a gain, an integral part 1 + corner/s, and a lead element (1 + T s)/(1 + T_f s) with its
    largest lead at the bandwidth.

    Args:
        response: Frequency response of the plant at the bandwidth.
        omega: The bandwidth [rad/s].
        corner: Corner frequency of the integral part [rad/s]; 0: no integral.
        lead: Phase lead of the lead element at the bandwidth [rad]; 0: no lead element.
    """
    lead_time = filter_time = 0.0  # T and T_f
    if lead > 0.0:
        ratio = math.sqrt((1.0 + math.sin(lead)) / (1.0 - math.sin(lead)))  # sqrt(T/T_f)
        lead_time = ratio / omega
        filter_time = 1.0 / (ratio * omega)
    s = 1j * omega
    gain = 1.0 / abs((1.0 + corner / s) * (1.0 + lead_time * s) / (1.0 + filter_time * s) * response)
    # the same product as k_p + k_i/s + k_d s/(1 + T_f s)
    k_i = gain * corner
    k_p = gain * (1.0 + corner * lead_time) - k_i * filter_time
    k_d = gain * lead_time - k_p * filter_time
    table: TomlTable = {"kind": "pid", "k_p": k_p}
    if k_i > 0.0:
        table["k_i"] = k_i
    if lead > 0.0:
        table |= {"k_d": k_d, "filter": filter_time}
    return table


def command_limits(problem: DesignProblem) -> TomlTable:
    """The limits of the command, as fields of a controller; empty if the design has no limit.

    An actuator without a state, such as a saturation, narrows the limits if it saturates within them.
    """
    if problem.limit is None:
        return {}
    low = -problem.limit
    high = problem.limit
    for element, params in acting_elements(problem.study.table, problem.study.config):
        numbers = nominal_params(params)
        state = element.model.init(numbers)
        has_state = bool(jax.tree.leaves(state))
        if not has_state:
            low = passed_command(element.model, numbers, state, low)
            high = passed_command(element.model, numbers, state, high)
    return {"low": low, "high": high}


def passed_command(model: Unmodelled, params: Params, state: State, extreme: float) -> float:
    """Largest or smallest command that an actuator without a state passes on, as a limit of the controller.

    The actuator counts as saturated if twice the command gives the same output; that output is then the limit.

    Args:
        model: The actuator.
        params: Parameters of the actuator, in plain numbers.
        state: Empty state of the actuator.
        extreme: Largest or smallest command of the design; the result if the actuator does not saturate.
    """
    output = float(model.output(params, state, extreme))
    output_beyond = float(model.output(params, state, 2.0 * extreme))
    is_saturated = output == output_beyond
    return output if is_saturated else extreme


def has_gain_at_rest(plant: LinearPlant, omega: float) -> bool:
    """Whether the plant has a gain other than 0 at rest; without one, an integral would grow without effect.

    Args:
        plant: The sampled plant.
        omega: The bandwidth [rad/s]; the gain far below it is compared with the gain there.
    """
    return abs(plant.response(FAR_BELOW * omega)) > VANISHING * abs(plant.response(omega))


def has_negative_gain_at_rest(plant: LinearPlant, omega: float) -> bool:
    """Whether the plant is stable and its output at rest falls as its command rises.

    Args:
        plant: The sampled plant.
        omega: The bandwidth [rad/s].
    """
    is_stable = bool(np.all(np.abs(np.linalg.eigvals(plant.a)) < 1.0))
    return is_stable and plant.response(FAR_BELOW * omega).real < 0.0
