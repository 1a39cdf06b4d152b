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
from dssc_jax.design.linear_plant import LinearPlant, Subject
from dssc_jax.study.actuators import acting_elements
from dssc_jax.study.fitting import nominal_params

PHASE_MARGIN = math.radians(60.0)
LEAST_MARGIN = math.radians(45.0)  # where one lead element gives no more with the slowest integral
SLOWEST = 0.1  # corner of that integral, in bandwidths
MOST_LEAD = math.radians(65.0)  # of one lead element
MOST_LAG = math.radians(85.0)  # of the integral part at the bandwidth
MOST_ADVANCE = math.radians(10.0)  # of a plant with a gain at rest that PID can make cross


def pid(subject: Subject, omega: float, ratio: float) -> TomlTable:
    """The PID controller; raises ConfigError.

    Args:
        subject: What it is for.
        omega: The bandwidth [rad/s].
        ratio: Least corner of the integral action, in bandwidths.
    """
    plant = subject.actuated_plant
    response = plant.response(omega)
    phase = float(np.angle(response))
    phase -= 2.0 * math.pi if phase > math.radians(66.0) else 0.0  # a large lag, where no lead is meant
    integrates = acts_at_rest(plant, omega)
    if phase > MOST_ADVANCE:
        rule = f"has at {omega:.4g} rad/s a phase of {math.degrees(phase):.0f} degrees"
        remedy = "ask for another bandwidth, or for 'lqg'; where the gain is negative, turn the command's sign"
        raise ConfigError("plant", f"{rule}, with which this PID rule cannot cross there; {remedy}")
    lag = min(max(0.5 * math.pi + phase, math.atan(ratio)), MOST_LAG)
    corner = omega * math.tan(lag) if integrates else 0.0
    required_lead = PHASE_MARGIN - math.pi - phase + math.atan(corner / omega)
    has_slow_design = PHASE_MARGIN - math.pi - phase + math.atan(min(SLOWEST, corner / omega)) <= MOST_LEAD
    if required_lead > MOST_LEAD + (0.0 if has_slow_design else PHASE_MARGIN - LEAST_MARGIN):
        if falls_at_rest(plant, omega):
            rule = "has a negative gain at rest, and the gains of 'pid' are at least 0"
            raise ConfigError(f"{subject.study.source}: plant", f"{rule}; turn the command's sign, or ask for 'lqg'")
        degrees = math.degrees(required_lead)
        rule = f"needs a phase lead of {degrees:.0f} degrees at {omega:.4g} rad/s, and one element gives"
        remedy = f"{math.degrees(MOST_LEAD):.0f}; ask for less, or for 'lqg'"
        raise ConfigError("`bandwidth`", f"{rule} {remedy}")
    lead = min(max(required_lead, 0.0), MOST_LEAD)
    ratio = math.sqrt((1.0 + math.sin(lead)) / (1.0 - math.sin(lead)))
    lead_time = ratio / omega if lead else 0.0
    filter_time = 1.0 / (ratio * omega) if lead else 0.0
    s = 1j * omega
    gain = 1.0 / abs((1.0 + corner / s) * (1.0 + lead_time * s) / (1.0 + filter_time * s) * response)
    k_i = gain * corner
    k_p = gain * (1.0 + corner * lead_time) - k_i * filter_time
    k_d = gain * lead_time - k_p * filter_time if lead else 0.0
    table: TomlTable = {"kind": "pid", "k_p": k_p} | ({"k_i": k_i} if k_i else {})
    if lead:
        table |= {"k_d": k_d, "filter": filter_time}
    return table | limits(subject)


def limits(subject: Subject) -> TomlTable:
    """The limits of the command, as fields of a controller; an actuator may limit earlier than the design."""
    if subject.limit is None:
        return {}
    low, high = -subject.limit, subject.limit
    for element, params in acting_elements(subject.study.table, subject.study.config):
        numbers = nominal_params(params)
        state = element.model.init(numbers)
        if not jax.tree.leaves(state):
            low, high = (command_end(element.model, numbers, state, end) for end in (low, high))
    return {"low": low, "high": high}


def command_end(model: Unmodelled, params: Params, state: State, end: float) -> float:
    """The output of a stateless actuator at an end of the commands, if it gives no more beyond; else that end."""
    at_end, beyond = (float(model.output(params, state, factor * end)) for factor in (1.0, 2.0))
    return at_end if at_end == beyond else end


def acts_at_rest(plant: LinearPlant, omega: float) -> bool:
    """Whether the plant has a gain at rest; if it has a zero there, an integral would grow without effect."""
    return abs(plant.response(1e-6 * omega)) > 1e-3 * abs(plant.response(omega))


def falls_at_rest(plant: LinearPlant, omega: float) -> bool:
    """Whether a stable plant's output falls as its command rises."""
    return bool(np.all(np.abs(np.linalg.eigvals(plant.a)) < 1.0)) and plant.response(1e-6 * omega).real < 0.0
