"""First gains for a plant of one's own, from a bandwidth and the sample time, in the plant's units.

The plant is linearised at its start, with the command that keeps it there if there is one, and sampled exactly with the
command held, behind those of its actuators that are linear. All rules then work with numbers of that system alone,
whatever its units:

* PID: phase margin of 60 degrees at the bandwidth, or 45 where one lead element gives no more. Integral action at 0.1,
  0.2 or 0.4 times the bandwidth. Of a plant with less lag than 84 degrees there, the integral acts higher, for a margin
  of 90 degrees: a first-order lag is cancelled.
* LQG, whose model is the linear plant, or its linearisation, which its table then states: y weighted with 1; the weight
  of u is that at which the regulator's loop crosses 1 at the bandwidth. The noise of the measured signals has the
  proportions in which a disturbance at the command moves them (Bryson's rule), and the size at which the filter's loop
  crosses 1 at four times the bandwidth; integral action as for PID.
* State feedback: the regulator of LQG, with all states measured, or y and y' of a plant of order two.
* State feedback and LQG act on deviations from the point at which a nonlinear plant starts and rests.
* These have no integral action where the plant has a zero at rest.
* DSSC: its special case SSC, with constants. In sliding it synthesises a PI law of sigma, whose loop has a double pole
  at the bandwidth; e follows at a third of that.

Regulator, filter and SSC are rules for the plant alone. So a design counts only if its sampled closed loop is stable
with the linear actuators. Of those with a peak of abs(S) of at most 2, the one whose output settles fastest after a
step of a disturbance at the command is taken: over the integral's frequencies, and without a stated bandwidth over
bandwidths, too. A bandwidth just above a resonance leaves little gain below it, and so a slow integral. These gains
begin a study: margins, draws and tuning follow.

References:
    K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed. (2021), chapters 11 and 12.
    B. D. O. Anderson, J. B. Moore, Optimal Control: Linear Quadratic Methods (1990), sections 5.3, 6.1 and 8.2.
    A. E. Bryson, Y.-C. Ho, Applied Optimal Control (1975), section 5.2, for the weights from signals' sizes.
"""

import math
from dataclasses import replace
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError, errors_under
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.setting import LoopSetting
from dssc_jax.core.toml import TomlTable
from dssc_jax.design.linear_plant import (
    ClosedLoop,
    DesignProblem,
    LinearActuators,
    closed_loop,
    linear_actuators,
    sampled_plant,
)
from dssc_jax.design.linearised_plant import LinearisedPlant, linearised_plant
from dssc_jax.design.pid_gains import SLOWEST, pid
from dssc_jax.design.regulators import lqg, state_feedback
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.study.components import parse_component
from dssc_jax.study.fitting import nominal_params, setting_of
from dssc_jax.study.study import Study

INTEGRAL_RATIOS = (SLOWEST, 0.2, 0.4)
"""Frequencies below which the integral acts, in bandwidths, that are tried."""
SLOW_ERROR = 3.0  # ratio of the bandwidth to l0
MOST_SHARE = 0.2  # largest bandwidth, in pi/T_s
DIGITS = 4
STATED_DIGITS = 12  # of the plant's own numbers
STATED = ("resting_output", "resting_command", "resting_signals", "model")
"""Entries of a controller that are the plant's own numbers."""
NOT_OF_DEVIATIONS = ("resting_output", "resting_command", "resting_signals", "low", "high")
"""Entries without which a law acts on deviations, within its limits."""
HALVINGS = 14
FURTHER = 3  # halvings of the bandwidth after the last better loop
NEARBY = tuple(2.0 ** (third / 3.0) for third in (2, 1, -1, -2))
"""Bandwidths that are tried around the best of the halvings, relative to it."""
FASTER = 1.05  # ratio of settling times from which on a design is better
MOST_PEAK = 2.0  # of abs(S), where no bandwidth is stated


class FirstController(StrEnum):
    """The controllers for which there are first gains."""

    PID = "pid"
    LQG = "lqg"
    STATE_FEEDBACK = "state_feedback"
    SSC = "ssc"


class FirstGains(NamedTuple):
    """A first design.

    Args:
        table: ``[controller]`` of a study.
        bandwidth: The frequency that it is made for [rad/s].
        radius: Largest modulus of the poles of the sampled closed loop, below 1; of SSC while it slides.
        sensitivity_peak: Largest abs(S) of that loop, broken at the command.
        settling: Time after which its output stays within 2 % of the largest deviation, after a step of a disturbance
            at the command [s].
        linear_kinds: Kinds of the actuators in that loop.
        left_out: Kinds of the parts that it lacks: actuators that are not linear, sensors and differentiators.
        loop: The sampled closed loop.
        plant: The plant at its start, with its operating point.
    """

    table: TomlTable
    bandwidth: float
    radius: float
    sensitivity_peak: float
    settling: float
    linear_kinds: tuple[str, ...]
    left_out: tuple[str, ...]
    loop: ClosedLoop
    plant: LinearisedPlant


def first_gains(
    study: Study,
    kind: str = "pid",
    bandwidth: float | None = None,
    limit: float | None = None,
    at: float | None = None,
) -> FirstGains:
    """First gains for a study's plant.

    Args:
        study: The study; what it says of its controller is not used.
        kind: ``pid``, ``lqg``, ``state_feedback`` or ``ssc``.
        bandwidth: Frequency at which the loop gain is to cross 1 [rad/s]; None: a twentieth of pi/T_s, its half, and
            so on: of those with a peak of abs(S) of at most 2 the one that settles fastest after a disturbance, until
            three more halvings bring nothing better; else the one with the smallest peak. Then the best of that one
            and of four around it, a third of an octave apart.
        limit: Largest size of the command, in its unit; ``ssc`` needs it, the others respect it.
        at: Output at which a nonlinear plant rests where it is linearised; None: its start.

    Raises:
        ConfigError: The plant has several channels, or there are no such gains for it.
    """
    if kind not in list(FirstController):
        raise ConfigError("`kind`", f"must be one of {', '.join(FirstController)}, got '{kind}'")
    if limit is not None and not limit > 0.0:
        raise ConfigError("`limit`", f"must be > 0, got {limit:g}")
    sample_time = study.loop.sample_time
    fastest = math.pi / sample_time
    if bandwidth is not None and not 0.0 < bandwidth <= MOST_SHARE * fastest:
        rule = f"must be > 0 and <= {MOST_SHARE:g} pi/T_s = {MOST_SHARE * fastest:.4g} rad/s, got {bandwidth:.4g}"
        raise ConfigError("`bandwidth`", f"{rule}; sample faster, or ask for less")
    plant = linearised_plant(study, at)
    actuators = linear_actuators(study)
    bare_plant = sampled_plant(plant, LinearActuators(None, (), (), ()), sample_time)
    problem = DesignProblem(
        study=study,
        plant=plant,
        bare_plant=bare_plant,
        actuators=actuators,
        actuated_plant=sampled_plant(plant, actuators, sample_time),
        limit=limit,
    )
    if bandwidth is None:
        return fastest_design(problem, kind, 0.05 * fastest)
    first_design = design_at_bandwidth(problem, kind, bandwidth)
    if first_design.radius < 1.0:
        return first_design
    suffix = f", behind its linear actuators ({' + '.join(actuators.linear_kinds)})" if actuators.linear_kinds else ""
    pole = f"largest pole {first_design.radius:.4g}"
    rule = f"gives at {bandwidth:.4g} rad/s a sampled loop that is not stable{suffix} ({pole})"
    raise ConfigError("`bandwidth`", f"{rule}; ask for less, or for none to have the first that works")


def design_at_bandwidth(problem: DesignProblem, kind: str, bandwidth: float) -> FirstGains:
    """The design of a kind at a bandwidth [rad/s] with the best integral action; its loop need not be stable.

    Raises:
        ConfigError: The kind has no gains at this bandwidth.
    """
    best = design_with_ratio(problem, kind, bandwidth, INTEGRAL_RATIOS[0])
    for ratio in INTEGRAL_RATIOS[1:] if kind != FirstController.SSC else ():
        try:
            candidate = design_with_ratio(problem, kind, bandwidth, ratio)
        except ConfigError:
            break
        if is_better(candidate, best):
            best = candidate
    return best


def is_better(candidate: FirstGains, best: FirstGains) -> bool:
    """Whether a candidate is better: it settles faster if both peaks of |S| are good, else it has the smaller peak."""
    if candidate.sensitivity_peak <= MOST_PEAK and best.sensitivity_peak <= MOST_PEAK:
        return FASTER * candidate.settling < best.settling
    return candidate.sensitivity_peak < best.sensitivity_peak


def design_with_ratio(problem: DesignProblem, kind: str, bandwidth: float, ratio: float) -> FirstGains:
    """The design of a kind at a bandwidth [rad/s] with an integral below ``ratio`` times that.

    Its loop need not be stable.

    Raises:
        ConfigError: The kind has no such gains.
    """
    rules = {
        FirstController.PID: pid,
        FirstController.LQG: lqg,
        FirstController.STATE_FEEDBACK: state_feedback,
        FirstController.SSC: ssc,
    }
    study = problem.study
    table = rounded_table(rules[FirstController(kind)](problem, bandwidth, ratio))
    deviation_table = {name: value for name, value in table.items() if name not in NOT_OF_DEVIATIONS}
    controller = parse_component(deviation_table, CONTROLLERS, "controller")
    if controller.model.fit is not None:
        setting = setting_for(study)
        with errors_under("controller"):
            controller = replace(controller, params=controller.model.fit(controller.params, setting))
    loop = closed_loop(problem.actuated_plant, controller)
    radius = loop.radius
    peak = loop.sensitivity_peak if radius < 1.0 else math.inf
    row = np.zeros(len(loop.a))
    row[: len(problem.actuated_plant.c)] = problem.actuated_plant.c
    settling = loop.settling(row) * study.loop.sample_time
    linear_kinds, left_out = problem.actuators.linear_kinds, problem.actuators.left_out
    return FirstGains(
        table=table,
        bandwidth=bandwidth,
        radius=radius,
        sensitivity_peak=peak,
        settling=settling,
        linear_kinds=linear_kinds,
        left_out=left_out,
        loop=loop,
        plant=problem.plant,
    )


def fastest_design(problem: DesignProblem, kind: str, start: float) -> FirstGains:
    """The best design at a start bandwidth, its half, and so on, and then at bandwidths around the best of these.

    The halving ends when several in a row are no better.

    Raises:
        ConfigError: None is stable.
    """
    refusal: ConfigError | None = None
    best: FirstGains | None = None
    bandwidth = start
    last_halving = HALVINGS - 1
    for halving in range(HALVINGS):
        if halving > last_halving:
            break
        bandwidth = start * 0.5**halving
        try:
            candidate = design_at_bandwidth(problem, kind, bandwidth)
        except ConfigError as error:
            refusal = refusal or error
            continue
        if best is None or is_better(candidate, best):
            best = candidate
            if best.sensitivity_peak <= MOST_PEAK:
                last_halving = halving + FURTHER
    if best is not None and best.radius < 1.0:  # such as of a plant that is unstable itself
        return best_nearby(problem, kind, best, start)
    if refusal is not None and refusal.where != "`bandwidth`":
        raise refusal
    if refusal is not None:
        rule = f"has no gains at any bandwidth tried from {start:.4g} down to {bandwidth:.4g} rad/s"
        remedy = f"the first one {refusal.rule}"
        raise ConfigError(f"{problem.study.source}: plant", f"{rule}: {remedy}")
    rule = f"from {start:.4g} down to {bandwidth:.4g} rad/s gives no stable loop"
    raise ConfigError("`bandwidth`", f"{rule}; state one, or ask for another kind")


def best_nearby(problem: DesignProblem, kind: str, best: FirstGains, highest: float) -> FirstGains:
    """The best of a design and of those at some bandwidths around its own, up to the highest [rad/s]."""
    middle = best.bandwidth
    for factor in NEARBY:
        if factor * middle > highest:
            continue
        try:
            candidate = design_at_bandwidth(problem, kind, factor * middle)
        except ConfigError:
            continue
        if is_better(candidate, best):
            best = candidate
    return best


def setting_for(study: Study) -> LoopSetting:
    """The setting to which a controller of the study is fitted."""
    loop = study.loop
    with arithmetic():
        return setting_of(loop.plant, nominal_params(study.template).plant, loop.sample_time, loop.measures)


def ssc(problem: DesignProblem, omega: float, ratio: float) -> TomlTable:
    """The table of SSC, whose loop in sliding is sigma'' + k_p K_P sigma' + k_p K_I sigma = 0.

    Args:
        problem: The plant and the limit of the command.
        omega: The bandwidth [rad/s].
        ratio: Not used: SSC has one integral action. The argument is that of the other kinds.

    Raises:
        ConfigError: The plant has another relative degree than two or a negative gain, or the command has no limit.
    """
    study, limit = problem.study, problem.limit
    a, b, c = problem.plant.a, problem.plant.b, problem.plant.c
    if abs(c @ b) > 1e-9 * (np.abs(c) @ np.abs(b)) or not c @ a @ b > 0.0:
        rule = "is not of relative degree two with k_p > 0 from command to output, as SSC needs"
        raise ConfigError(f"{study.source}: plant", f"{rule}; ask for 'pid' or 'lqg'")
    if limit is None:
        raise ConfigError("`limit`", "is required for 'ssc': rho is the largest command that it can average")
    gain = float(c @ a @ b)
    averaging = max(2.0 * study.loop.sample_time, 0.1 / omega)
    functions = {"kind": "constant", "k_o": gain / (2.0 * omega * averaging), "tau_av": averaging, "tau_m": 2.0 / omega}
    return {"kind": "ssc", "l0": omega / SLOW_ERROR, "rho": limit, "functions": functions}


def rounded_table(table: TomlTable, digits: int = DIGITS) -> TomlTable:
    """A controller's table whose numbers have ``digits`` significant digits, those of the plant ``STATED_DIGITS``."""
    return {name: rounded_value(value, STATED_DIGITS if name in STATED else digits) for name, value in table.items()}


def rounded_value(value: Any, digits: int) -> Any:
    """A number rounded to ``digits`` significant digits; a list or a table of numbers entry by entry."""
    if isinstance(value, list):
        return [rounded_value(item, digits) for item in value]
    if isinstance(value, dict):
        return rounded_table(value, digits)
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    return value
