"""First gains of PID: a phase margin at the bandwidth, integral action below it, and one lead element.

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
from dssc_jax.study.fitting import nominal_params

PHASE_MARGIN = math.radians(60.0)
LEAST_MARGIN = math.radians(45.0)  # where one lead element gives no more with the slowest integral
SLOWEST = 0.1  # corner of that integral, in bandwidths
MOST_LEAD = math.radians(65.0)  # of one lead element
MOST_LAG = math.radians(85.0)  # of the integral part at the bandwidth
MOST_ADVANCE = math.radians(10.0)  # of a plant with a gain at rest that PID can make cross


def pid(problem: DesignProblem, omega: float, ratio: float) -> TomlTable:
    """The table of a PID controller with a phase margin at the bandwidth.

    Args:
        problem: The plant, its actuators and the limit of the command.
        omega: The bandwidth [rad/s].
        ratio: Smallest corner frequency of the integral action, in bandwidths.

    Raises:
        ConfigError: PID cannot give the phase margin at this bandwidth.
    """
    plant = problem.actuated_plant
    response = plant.response(omega)
    phase = float(np.angle(response))
    phase -= 2.0 * math.pi if phase > math.radians(66.0) else 0.0  # a large lag, where no lead is meant
    if phase > MOST_ADVANCE:
        rule = f"has at {omega:.4g} rad/s a phase of {math.degrees(phase):.0f} degrees"
        remedy = "ask for another bandwidth, or for 'lqg'; where the gain is negative, turn the command's sign"
        raise ConfigError("plant", f"{rule}, with which this PID rule cannot cross there; {remedy}")
    lag = min(max(0.5 * math.pi + phase, math.atan(ratio)), MOST_LAG)
    corner = omega * math.tan(lag) if acts_at_rest(plant, omega) else 0.0
    required_lead = PHASE_MARGIN - math.pi - phase + math.atan(corner / omega)
    has_slow_design = PHASE_MARGIN - math.pi - phase + math.atan(min(SLOWEST, corner / omega)) <= MOST_LEAD
    if required_lead > MOST_LEAD + (0.0 if has_slow_design else PHASE_MARGIN - LEAST_MARGIN):
        raise lead_error(problem, omega, required_lead)
    lead = min(max(required_lead, 0.0), MOST_LEAD)
    return gains_with_lead(response, omega, corner, lead) | limits(problem)


def lead_error(problem: DesignProblem, omega: float, required_lead: float) -> ConfigError:
    """The error where PID would need more phase lead [rad] at the bandwidth [rad/s] than one element gives."""
    if falls_at_rest(problem.actuated_plant, omega):
        rule = "has a negative gain at rest, and the gains of 'pid' are at least 0"
        return ConfigError(f"{problem.study.source}: plant", f"{rule}; turn the command's sign, or ask for 'lqg'")
    degrees = math.degrees(required_lead)
    rule = f"needs a phase lead of {degrees:.0f} degrees at {omega:.4g} rad/s, and one element gives"
    remedy = f"{math.degrees(MOST_LEAD):.0f}; ask for less, or for 'lqg'"
    return ConfigError("`bandwidth`", f"{rule} {remedy}")


def gains_with_lead(response: complex, omega: float, corner: float, lead: float) -> TomlTable:
    """The gains of PID with which the loop gain is 1 at the bandwidth.

    PID is the product of an integral part 1 + corner/s and a lead element with its largest lead at the bandwidth.

    Args:
        response: Frequency response of the plant at the bandwidth.
        omega: The bandwidth [rad/s].
        corner: Corner frequency of the integral part [rad/s]; 0: none.
        lead: Phase lead of the element [rad]; 0: none.
    """
    ratio = math.sqrt((1.0 + math.sin(lead)) / (1.0 - math.sin(lead)))
    lead_time = ratio / omega if lead else 0.0
    filter_time = 1.0 / (ratio * omega) if lead else 0.0
    s = 1j * omega
    gain = 1.0 / abs((1.0 + corner / s) * (1.0 + lead_time * s) / (1.0 + filter_time * s) * response)
    k_i = gain * corner
    k_p = gain * (1.0 + corner * lead_time) - k_i * filter_time
    table: TomlTable = {"kind": "pid", "k_p": k_p}
    if k_i:
        table["k_i"] = k_i
    if lead:
        table |= {"k_d": gain * lead_time - k_p * filter_time, "filter": filter_time}
    return table


def limits(problem: DesignProblem) -> TomlTable:
    """The limits of the command, as fields of a controller; empty if it has none.

    They are those of the design, or of an actuator without a state that saturates earlier.
    """
    if problem.limit is None:
        return {}
    low, high = -problem.limit, problem.limit
    for element, params in acting_elements(problem.study.table, problem.study.config):
        numbers = nominal_params(params)
        state = element.model.init(numbers)
        if not jax.tree.leaves(state):
            low, high = (command_end(element.model, numbers, state, end) for end in (low, high))
    return {"low": low, "high": high}


def command_end(model: Unmodelled, params: Params, state: State, end: float) -> float:
    """The output of an actuator without a state at an end of the commands, if it saturates there; else that end."""
    at_end = float(model.output(params, state, end))
    beyond = float(model.output(params, state, 2.0 * end))
    return at_end if at_end == beyond else end


def acts_at_rest(plant: LinearPlant, omega: float) -> bool:
    """Whether the plant has a gain at rest: if it has a zero there, an integral would grow without effect.

    The gain far below the bandwidth ``omega`` [rad/s] is compared with that at it.
    """
    return abs(plant.response(1e-6 * omega)) > 1e-3 * abs(plant.response(omega))


def falls_at_rest(plant: LinearPlant, omega: float) -> bool:
    """Whether the plant is stable and its output falls as its command rises; ``omega`` is the bandwidth [rad/s]."""
    is_stable = bool(np.all(np.abs(np.linalg.eigvals(plant.a)) < 1.0))
    return is_stable and plant.response(1e-6 * omega).real < 0.0
