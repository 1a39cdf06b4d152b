"""First gains of a controller for a study's plant, from a bandwidth and the sample time, in the plant's units.

The plant is linearised at its start, with the command that holds it there if there is one. Plant and linear actuators
are sampled exactly, with a held command. The rules use numbers of these linear systems alone, whatever their units:

* PID: the phase margin at the bandwidth is 60 degrees, or at least 45 degrees where one lead element gives no more. The
  integral acts below 0.1, 0.2 or 0.4 times the bandwidth. If the plant lags by less than 84 degrees at the bandwidth,
  the integral acts up to a higher frequency, which gives a margin of 90 degrees and cancels a first-order lag.
* LQG: the controller's model is the linear plant, or the linearisation of a nonlinear one, which the table states. The
  weight of y is 1. The weight of u puts the crossover of the regulator's loop at the bandwidth. The noise of the
  measured signals is in proportion to how much a disturbance at the command moves each of them (Bryson's rule). The
  size of the noise puts the crossover of the filter's loop at four times the bandwidth.
* State feedback: the regulator of LQG. It takes measured signals that show all states, or y and y' of a plant of order
  two.
* LQG and state feedback act on deviations from the point at which a nonlinear plant starts and rests. Their integral
  acts below 0.1, 0.2 or 0.4 times the bandwidth. Like PID, they have no integral if the plant has a zero at rest.
* SSC, the special case of DSSC with constants: in sliding it synthesises a PI law of sigma, whose loop has a double
  pole at the bandwidth. The error e follows sigma with the pole l0, a third of the bandwidth.

LQG, state feedback and SSC are designed without the actuators. So a design counts only if its sampled closed loop with
the linear actuators is stable. Among designs with a peak of abs(S) of at most 2, the best one settles fastest after a
step of a disturbance at the command. The search compares the frequencies of the integral and, if no bandwidth is
stated, several bandwidths: just above a resonance, little gain remains below it, and the integral is slow.

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
from dssc_jax.design.linear_loop import ClosedLoop, closed_loop
from dssc_jax.design.linear_plant import NO_ACTUATORS, DesignProblem, linear_actuators, sampled_plant
from dssc_jax.design.linearised_plant import LinearisedPlant, linearised_plant
from dssc_jax.design.pid_gains import SLOWEST, pid
from dssc_jax.design.regulators import lqg, state_feedback
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.study.components import parse_component
from dssc_jax.study.fitting import setting_of
from dssc_jax.study.laws import nominal_params
from dssc_jax.study.study import Study

INTEGRAL_RATIOS = (SLOWEST, 0.2, 0.4)
"""Frequencies below which the integral may act, relative to the bandwidth; a design tries each of them."""
SLOW_ERROR = 3.0
"""Ratio of the bandwidth to the error pole l0 of SSC."""
MOST_SHARE = 0.2
"""Largest bandwidth, relative to the Nyquist frequency pi/T_s."""
FIRST_SHARE = 0.05
"""First bandwidth that is tried if none is stated, relative to the Nyquist frequency pi/T_s."""
SMALL_PRODUCT = 1e-9
"""Largest |c b|/(|c| |b|), with magnitudes entry by entry, that counts as c b = 0: relative degree two."""
DIGITS = 4
"""Significant digits of a gain."""
STATED_DIGITS = 12
"""Significant digits of the entries :data:`STATED`."""
STATED = ("resting_output", "resting_command", "resting_signals", "model")
"""Entries of a controller's table that repeat numbers of the plant, rather than gains."""
NOT_OF_DEVIATIONS = ("resting_output", "resting_command", "resting_signals", "low", "high")
"""Entries for the operating point and the limits; without them the law is linear in deviations from the point."""
HALVINGS = 14
"""Most bandwidths that are tried, each half of the one before."""
FURTHER = 3
"""Halvings of the bandwidth that are tried after the best design so far."""
NEARBY = tuple(2.0 ** (third / 3.0) for third in (2, 1, -1, -2))
"""Bandwidths that are tried around the best one of the halvings, as multiples of that one."""
FASTER = 1.05
"""Least ratio of two settling times at which the faster design counts as better."""
MOST_PEAK = 2.0
"""Largest peak of abs(S) that counts as good when two designs are compared."""


class FirstController(StrEnum):
    """The controllers for which there are first gains."""

    PID = "pid"
    LQG = "lqg"
    STATE_FEEDBACK = "state_feedback"
    SSC = "ssc"


class FirstGains(NamedTuple):
    """First gains of a controller, with properties of the sampled closed loop that they give.

    Args:
        table: The gains, as the table ``[controller]`` of a study.
        bandwidth: The frequency for which the gains are made [rad/s].
        radius: Largest modulus of the poles of the sampled closed loop, below 1 if stable; of SSC in sliding.
        sensitivity_peak: Largest abs(S), with S for the loop broken at the command; infinite for an unstable loop.
        settling: Settling time of the output after a step of a disturbance at the command [s], within 2 % of the
            largest distance from the final value.
        linear_kinds: Kinds of the actuators in the loop.
        left_out: Kinds of the parts that the loop lacks: actuators that are not linear, sensors and differentiators.
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
    """First gains of a controller for a study's plant, from a bandwidth and the sample time.

    Without a stated bandwidth, the search begins at a twentieth of pi/T_s and halves it, until three more halvings
    bring nothing better. Then it tries four bandwidths around the best one, a third of an octave apart. Of two loops
    with a peak of abs(S) of at most 2, the better one settles faster after a disturbance; otherwise it has the smaller
    peak.

    Args:
        study: The study; its controller is not used.
        kind: ``pid``, ``lqg``, ``state_feedback`` or ``ssc``.
        bandwidth: Frequency at which the loop gain is to cross 1 [rad/s]; None: it is sought.
        limit: Largest magnitude of the command, in its unit; None: there is no limit. ``ssc`` requires a limit.
        at: Output of the equilibrium at which a nonlinear plant is linearised; None: it is linearised at its start.

    Raises:
        ConfigError: An argument is out of range, the plant has several channels, or it has no gains of this kind.
    """
    sample_time = study.loop.sample_time
    nyquist = math.pi / sample_time  # [rad/s]
    require_request(kind, bandwidth, limit, nyquist)
    plant = linearised_plant(study, at)
    actuators = linear_actuators(study)
    problem = DesignProblem(
        study=study,
        plant=plant,
        bare_plant=sampled_plant(plant, NO_ACTUATORS, sample_time),
        actuators=actuators,
        actuated_plant=sampled_plant(plant, actuators, sample_time),
        limit=limit,
    )
    if bandwidth is None:
        return fastest_design(problem, kind, FIRST_SHARE * nyquist)
    gains = design_at_bandwidth(problem, kind, bandwidth)
    if gains.radius < 1.0:
        return gains
    suffix = f", behind its linear actuators ({' + '.join(actuators.linear_kinds)})" if actuators.linear_kinds else ""
    pole = f"largest pole {gains.radius:.4g}"
    rule = f"gives at {bandwidth:.4g} rad/s a sampled loop that is not stable{suffix} ({pole})"
    raise ConfigError("`bandwidth`", f"{rule}; ask for less, or for none to have the first that works")


def require_request(kind: str, bandwidth: float | None, limit: float | None, nyquist: float) -> None:
    """Require a known kind of controller, and a bandwidth and a limit in their ranges.

    Args:
        kind: Kind of the controller.
        bandwidth: The bandwidth [rad/s]; None: it is sought.
        limit: Largest magnitude of the command; None: there is no limit.
        nyquist: pi/T_s [rad/s].

    Raises:
        ConfigError: The kind is unknown, or a number is out of its range.
    """
    if kind not in list(FirstController):
        raise ConfigError("`kind`", f"must be one of {', '.join(FirstController)}, got '{kind}'")
    if limit is not None and not limit > 0.0:
        raise ConfigError("`limit`", f"must be > 0, got {limit:g}")
    if bandwidth is not None and not 0.0 < bandwidth <= MOST_SHARE * nyquist:
        rule = f"must be > 0 and <= {MOST_SHARE:g} pi/T_s = {MOST_SHARE * nyquist:.4g} rad/s, got {bandwidth:.4g}"
        raise ConfigError("`bandwidth`", f"{rule}; sample faster, or ask for less")


def design_at_bandwidth(problem: DesignProblem, kind: str, bandwidth: float) -> FirstGains:
    """The best design of one kind at one bandwidth over :data:`INTEGRAL_RATIOS`; its loop need not be stable.

    Args:
        problem: The plant, its actuators and the limit of the command.
        kind: Kind of the controller.
        bandwidth: The bandwidth [rad/s].

    Raises:
        ConfigError: The kind has no gains at this bandwidth.
    """
    slowest, *faster_ratios = INTEGRAL_RATIOS
    best = design_with_ratio(problem, kind, bandwidth, slowest)
    if kind == FirstController.SSC:  # it has one integral action
        return best
    for ratio in faster_ratios:
        try:
            candidate = design_with_ratio(problem, kind, bandwidth, ratio)
        except ConfigError:
            break
        if is_better(candidate, best):
            best = candidate
    return best


def is_better(candidate: FirstGains, best: FirstGains) -> bool:
    """Whether a candidate is better than the best design so far.

    If both peaks of abs(S) are at most :data:`MOST_PEAK`, the better design settles faster, by the factor
    :data:`FASTER`. Otherwise it has the smaller peak.
    """
    are_peaks_good = candidate.sensitivity_peak <= MOST_PEAK and best.sensitivity_peak <= MOST_PEAK
    if are_peaks_good:
        return FASTER * candidate.settling < best.settling
    return candidate.sensitivity_peak < best.sensitivity_peak


def design_with_ratio(problem: DesignProblem, kind: str, bandwidth: float, ratio: float) -> FirstGains:
    """Design a controller of one kind, and compute the properties of its loop, which need not be stable.

    Args:
        problem: The plant, its actuators and the limit of the command.
        kind: Kind of the controller.
        bandwidth: The bandwidth [rad/s].
        ratio: Frequency below which the integral acts, relative to the bandwidth.

    Raises:
        ConfigError: No gains of this kind suit the plant at this bandwidth.
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
    output_row = np.zeros(len(loop.a))  # y does not depend on the controller's states, which come last
    output_row[: len(problem.actuated_plant.c)] = problem.actuated_plant.c
    return FirstGains(
        table=table,
        bandwidth=bandwidth,
        radius=radius,
        sensitivity_peak=loop.sensitivity_peak if radius < 1.0 else math.inf,
        settling=loop.settling(output_row) * study.loop.sample_time,
        linear_kinds=problem.actuators.linear_kinds,
        left_out=problem.actuators.left_out,
        loop=loop,
        plant=problem.plant,
    )


def fastest_design(problem: DesignProblem, kind: str, start: float) -> FirstGains:
    """The best design at a start bandwidth, its half, and so on, and then at bandwidths around the best of these.

    The halving ends :data:`FURTHER` bandwidths after the last better design with a good peak of abs(S), or after
    :data:`HALVINGS` bandwidths.

    Args:
        problem: The plant, its actuators and the limit of the command.
        kind: Kind of the controller.
        start: The highest bandwidth [rad/s].

    Raises:
        ConfigError: No design gives a stable loop.
    """
    first_refusal: ConfigError | None = None
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
            first_refusal = first_refusal or error
            continue
        if best is None or is_better(candidate, best):
            best = candidate
            if best.sensitivity_peak <= MOST_PEAK:
                last_halving = halving + FURTHER
    if best is not None and best.radius < 1.0:  # also with a large peak, as for a plant that is unstable itself
        return best_nearby(problem, kind, best, start)
    if first_refusal is None:
        rule = f"from {start:.4g} down to {bandwidth:.4g} rad/s gives no stable loop"
        raise ConfigError("`bandwidth`", f"{rule}; state one, or ask for another kind")
    if first_refusal.where != "`bandwidth`":  # a lower bandwidth does not help
        raise first_refusal
    rule = f"has no gains at any bandwidth tried from {start:.4g} down to {bandwidth:.4g} rad/s"
    remedy = f"the first one {first_refusal.rule}"
    raise ConfigError(f"{problem.study.source}: plant", f"{rule}: {remedy}")


def best_nearby(problem: DesignProblem, kind: str, best: FirstGains, highest: float) -> FirstGains:
    """The best among a design and the designs at bandwidths around it, :data:`NEARBY` times its own.

    Args:
        problem: The plant, its actuators and the limit of the command.
        kind: Kind of the controller.
        best: The design to begin with.
        highest: Highest bandwidth that is tried [rad/s].
    """
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
    """Sample time, measured signals and nominal plant of a study, to which a controller's gains are fitted."""
    loop = study.loop
    with arithmetic():
        return setting_of(loop.plant, nominal_params(study.template).plant, loop.sample_time, loop.measures)


def ssc(problem: DesignProblem, omega: float, ratio: float) -> TomlTable:
    """The table ``[controller]`` of SSC, the special case of DSSC with constants, for a bandwidth.

    In sliding SSC synthesises a PI law of sigma with the gains K_P = 1/(k_o tau_av) and K_I = K_P/tau_m. The loop
    sigma'' + k_p K_P sigma' + k_p K_I sigma = 0 then has a double pole at the bandwidth.

    Args:
        problem: The plant and the limit of the command.
        omega: The bandwidth [rad/s].
        ratio: Not used: the bandwidth alone determines the integral action of SSC. All rules take this argument.

    Raises:
        ConfigError: The relative degree is not two, the high-frequency gain is not positive, or there is no limit.
    """
    del ratio
    study = problem.study
    limit = problem.limit
    a = problem.plant.a
    b = problem.plant.b
    c = problem.plant.c
    k_p = float(c @ a @ b)  # high-frequency gain of a plant of relative degree two, for which c b = 0
    is_of_degree_two = abs(c @ b) <= SMALL_PRODUCT * (np.abs(c) @ np.abs(b))
    if not is_of_degree_two or not k_p > 0.0:
        rule = "is not of relative degree two with k_p > 0 from command to output, as SSC needs"
        raise ConfigError(f"{study.source}: plant", f"{rule}; ask for 'pid' or 'lqg'")
    if limit is None:
        raise ConfigError("`limit`", "is required for 'ssc': rho is the largest command that it can average")
    averaging = max(2.0 * study.loop.sample_time, 0.1 / omega)  # tau_av: at least two samples
    functions = {"kind": "constant", "k_o": k_p / (2.0 * omega * averaging), "tau_av": averaging, "tau_m": 2.0 / omega}
    return {"kind": "ssc", "l0": omega / SLOW_ERROR, "rho": limit, "functions": functions}


def rounded_table(table: TomlTable, digits: int = DIGITS) -> TomlTable:
    """A controller's table with rounded numbers: gains to ``digits`` significant digits, the plant's own to 12."""
    return {name: rounded_value(value, STATED_DIGITS if name in STATED else digits) for name, value in table.items()}


def rounded_value(value: Any, digits: int) -> Any:
    """A number rounded to ``digits`` significant digits; a list or a table of numbers is rounded entry by entry."""
    if isinstance(value, list):
        return [rounded_value(item, digits) for item in value]
    if isinstance(value, dict):
        return rounded_table(value, digits)
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    return value
