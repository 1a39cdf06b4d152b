"""First gains for a plant of one's own, from a bandwidth and the sample time, in the plant's units.

The plant is linearised at its start, with the command that keeps it there if there is one, and sampled exactly with the
command held, behind those of its actuators that are linear. All rules then work with numbers of that system alone,
whatever its units:

* PID: phase margin of 60 degrees at the bandwidth, or 45 where one lead element gives no more. Integral action at 0.1,
  0.2 or 0.4 times the bandwidth. Of a plant with less lag than 84 degrees there, the integral acts higher, for a margin
  of 90 degrees: a first-order lag is cancelled.
* LQG: y weighted with 1; the weight of u is that at which the regulator's loop crosses 1 at the bandwidth. The noise of
  the measured signals has the proportions in which a disturbance at the command moves them (Bryson's rule), and the
  size at which the filter's loop crosses 1 at four times the bandwidth; integral action as for PID.
* State feedback: the regulator of LQG, with all states measured, or y and y' of a plant of order two.
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
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError, errors_under
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.setting import LoopSetting, NominalPlant
from dssc_jax.core.toml import TomlTable
from dssc_jax.design.linear_plant import (
    ActuatorsBefore,
    ClosedLoop,
    LinearPlant,
    Subject,
    actuators_before,
    closed,
    plant_at_start,
    sampled_plant,
)
from dssc_jax.design.pid_gains import SLOWEST, acts_at_rest, limits, pid
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.models.controllers.lqg import filter_gain, gain_at_rest, regulator_gain, sampled_system
from dssc_jax.study.components import parse_component
from dssc_jax.study.fitting import medians, setting_of
from dssc_jax.study.study import Study

INTEGRAL_RATIOS = (SLOWEST, 0.2, 0.4)
"""Frequencies below which the integral acts, in bandwidths, that are tried."""
FILTER_RATIO = 4.0  # of the filter's bandwidth to the regulator's
SLOW_ERROR = 3.0  # of the bandwidth to l0
MOST_SHARE = 0.2  # of the bandwidth in pi/T_s
PLACES = 9  # bisections' decades of a weight on either side
DIGITS = 4
HALVINGS = 14
FURTHER = 3  # halvings of the bandwidth after the last better loop
NEARBY = tuple(2.0 ** (third / 3.0) for third in (2, 1, -1, -2))
"""Bandwidths that are tried around the best of the halvings, relative to it."""
FASTER = 1.05  # ratio of settling times from which on a design is better
MOST_PEAK = 2.0  # of abs(S), where no bandwidth is stated
FITS = 1e-9  # share of the regulator's gains that measured signals may leave out


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
        taken: Kinds of the actuators in that loop.
        left_out: Kinds of the parts that it lacks: actuators that are not linear, sensors and differentiators.
        loop: That loop.
    """

    table: TomlTable
    bandwidth: float
    radius: float
    sensitivity_peak: float
    settling: float
    taken: tuple[str, ...]
    left_out: tuple[str, ...]
    loop: ClosedLoop


def first_gains(
    study: Study, kind: str = "pid", bandwidth: float | None = None, limit: float | None = None
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

    Raises:
        ConfigError: the plant has several channels, or there are no such gains for it.
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
    plant = plant_at_start(study)
    actuators = actuators_before(study)
    alone = sampled_plant(plant, ActuatorsBefore(None, (), (), ()), sample_time)
    subject = Subject(study, plant, alone, actuators, sampled_plant(plant, actuators, sample_time), limit)
    if bandwidth is None:
        return fastest_of(subject, kind, 0.05 * fastest)
    found = designed(subject, kind, bandwidth)
    if found.radius < 1.0:
        return found
    suffix = f", behind its linear actuators ({' + '.join(actuators.taken)})" if actuators.taken else ""
    rule = f"gives at {bandwidth:.4g} rad/s a sampled loop that is not stable{suffix} (largest pole {found.radius:.4g})"
    raise ConfigError("`bandwidth`", f"{rule}; ask for less, or for none to have the first that works")


def designed(subject: Subject, kind: str, bandwidth: float) -> FirstGains:
    """The design of a kind at a bandwidth with the best integral action; raises ConfigError if there is none.

    Its loop need not be stable.
    """
    best = tried(subject, kind, bandwidth, INTEGRAL_RATIOS[0])
    for ratio in INTEGRAL_RATIOS[1:] if kind != FirstController.SSC else ():
        try:
            found = tried(subject, kind, bandwidth, ratio)
        except ConfigError:
            break
        if better(found, best):
            best = found
    return best


def better(found: FirstGains, best: FirstGains) -> bool:
    """Whether a design is better: with a good peak of abs(S) the one that settles faster, else that with less peak."""
    if found.sensitivity_peak <= MOST_PEAK and best.sensitivity_peak <= MOST_PEAK:
        return FASTER * found.settling < best.settling
    return found.sensitivity_peak < best.sensitivity_peak


def tried(subject: Subject, kind: str, bandwidth: float, ratio: float) -> FirstGains:
    """The design of a kind at a bandwidth, whose loop need not be stable; raises ConfigError if there is none."""
    rules = {
        FirstController.PID: pid,
        FirstController.LQG: lqg,
        FirstController.STATE_FEEDBACK: state_feedback,
        FirstController.SSC: ssc,
    }
    study = subject.study
    table = rounded(rules[FirstController(kind)](subject, bandwidth, ratio))
    controller = parse_component(table, CONTROLLERS, "controller")
    if controller.model.fit is not None:
        setting = setting_for(study)
        with errors_under("controller"):
            controller = replace(controller, params=controller.model.fit(controller.params, setting))
    loop = closed(subject.whole, controller)
    radius = loop.radius
    peak = loop.sensitivity_peak if radius < 1.0 else math.inf
    row = np.zeros(len(loop.a))
    row[: len(subject.whole.c)] = subject.whole.c
    settling = loop.settling(row) * study.loop.sample_time
    taken, left_out = subject.actuators.taken, subject.actuators.left_out
    return FirstGains(table, bandwidth, radius, peak, settling, taken, left_out, loop)


def fastest_of(subject: Subject, kind: str, start: float) -> FirstGains:
    """The best design at a bandwidth, its half, and so on, until some are no better, and around the best of these.

    Raises:
        ConfigError: none is stable.
    """
    refusal: ConfigError | None = None
    best: FirstGains | None = None
    bandwidth = start
    left = HALVINGS
    for half in range(HALVINGS):
        if left == 0:
            break
        left -= 1
        bandwidth = start * 0.5**half
        try:
            found = designed(subject, kind, bandwidth)
        except ConfigError as error:
            refusal = refusal or error
            continue
        if best is None or better(found, best):
            best = found
            left = FURTHER if found.sensitivity_peak <= MOST_PEAK else left
    if best is not None and best.radius < 1.0:  # such as of a plant that is unstable itself
        return best_nearby(subject, kind, best, start)
    if refusal is not None:
        raise refusal
    rule = f"from {start:.4g} down to {bandwidth:.4g} rad/s gives no stable loop"
    raise ConfigError("`bandwidth`", f"{rule}; state one, or ask for another kind")


def best_nearby(subject: Subject, kind: str, best: FirstGains, highest: float) -> FirstGains:
    """The best of a design and of those at bandwidths around it, up to the highest."""
    middle = best.bandwidth
    for factor in NEARBY:
        if factor * middle > highest:
            continue
        try:
            found = designed(subject, kind, factor * middle)
        except ConfigError:
            continue
        if better(found, best):
            best = found
    return best


def lqg(subject: Subject, omega: float, ratio: float) -> TomlTable:
    """The LQG controller of y, or of all measured signals; raises ConfigError."""
    study, plant = subject.study, subject.alone
    nominal = nominal_of(study)
    names = [signal.name for signal in study.loop.measures] or ["y"]
    rows = nominal.signals if study.loop.measures else nominal.output[None, :]
    z = plant.sample_time
    faster = min(FILTER_RATIO * omega, 0.5 * math.pi / z)
    sampled = sampled_system(nominal.a, np.column_stack([nominal.command, nominal.disturbances]), z)
    entering = sampled.disturbances[:, 0]
    sizes = np.abs(rows @ responses(sampled.a, entering, faster, z))
    for name, size in zip(names, sizes, strict=True):
        if not size > 1e-12 * np.max(sizes):
            rule = f"'{name}' does not move with a disturbance at the command, so its noise has no scale"
            raise ConfigError(f"{study.source}: sensor.measures", f"{rule}; leave it out, or state weights of your own")
    scaled = rows / sizes[:, None]
    noise = np.outer(entering, entering)

    def filtered(deviation: float) -> float:
        correction = filter_gain(sampled.a, scaled, noise, deviation**2 * np.eye(len(rows)))
        return float(np.linalg.norm(scaled @ responses(sampled.a, sampled.a @ correction, faster, z), 2))

    deviation = crossing(filtered, 1.0)
    weight = regulator_weight(sampled.a, sampled.b, nominal.output, omega, z)
    table: TomlTable = {"kind": "lqg", "output_weight": 1.0, "command_weight": weight}
    table |= {"integral_weight": integral_weight(plant, ratio * omega)}
    table |= {"signal_std": [float(deviation * size) for size in sizes], "disturbance_std": [1.0]}
    return table | limits(subject)


def nominal_of(study: Study) -> NominalPlant:
    """The nominal linear plant to which LQG is fitted; raises ConfigError."""
    nominal = setting_for(study).plant
    if nominal is None:
        rule = "has no linear form, which LQG needs for its model"
        raise ConfigError(f"{study.source}: plant.kind", f"{rule}; ask for 'pid', or state a linear plant near it")
    return nominal


def setting_for(study: Study) -> LoopSetting:
    """What a controller of the study is fitted to."""
    loop = study.loop
    with arithmetic():
        return setting_of(loop.plant, medians(study.template).plant, loop.sample_time, loop.measures)


def integral_weight(plant: LinearPlant, corner: float) -> float:
    """The weight of the integral of y with which it acts below a frequency [rad/s]; 0 without a gain at rest."""
    return corner**2 if acts_at_rest(plant, corner) else 0.0


def regulator_weight(a: np.ndarray, b: np.ndarray, c: np.ndarray, omega: float, sample_time: float) -> float:
    """The weight of u^2 beside y^2 at which the regulator's loop crosses 1 at a frequency; raises ConfigError."""
    q = np.outer(c, c)
    through = responses(a, b, omega, sample_time)

    def regulated(weight: float) -> float:
        return float(np.abs(regulator_gain(a, b[:, None], q, weight) @ through))

    return crossing(regulated, float(np.abs(c @ through)) ** 2)


def responses(a: np.ndarray, columns: np.ndarray, omega: float, sample_time: float) -> np.ndarray:
    """(z - A)^-1 columns at an angular frequency."""
    return np.linalg.solve(np.exp(1j * omega * sample_time) * np.eye(len(a)) - a, columns)


def state_feedback(subject: Subject, omega: float, ratio: float) -> TomlTable:
    """The regulator of LQG as feedback of measured states, or of y and y'; raises ConfigError."""
    study, plant = subject.study, subject.plant
    z = subject.alone.sample_time
    sampled = sampled_system(plant.a, plant.b[:, None], z)
    weight = regulator_weight(sampled.a, sampled.b, plant.c, omega, z)
    n = len(plant.a)
    integral = integral_weight(subject.alone, ratio * omega)
    a, b, q = sampled.a, sampled.b[:, None], np.outer(plant.c, plant.c)
    if integral:
        a = np.block([[a, np.zeros((n, 1))], [z * plant.c[None, :], np.ones((1, 1))]])
        b = np.append(b, [[0.0]], axis=0)
        q = np.block([[q, np.zeros((n, 1))], [np.zeros((1, n)), integral * np.ones((1, 1))]])
    gains = regulator_gain(a, b, q, weight)
    feedback = gains[:n]
    names = tuple(signal.name for signal in study.loop.measures)
    rows = plant.signals if names else np.stack([plant.c, plant.rate])[:n]
    shares = np.linalg.lstsq(rows.T, feedback, rcond=None)[0]
    if np.any(plant.through * shares[: len(plant.through)] != 0.0) or (
        np.max(np.abs(rows.T @ shares - feedback)) > FITS * np.max(np.abs(feedback))
    ):
        shown = ", ".join(names) if names else "y and y'"
        rule = f"shows {shown}, and the regulator feeds back all {n} states"
        remedy = "add measures = \"state\" to [sensor], or ask for 'lqg', which estimates them"
        raise ConfigError(f"{study.source}: sensor", f"{rule}; {remedy}")
    forward = gain_at_rest(sampled, plant.c, feedback)
    k_i = float(gains[n]) if integral else 0.0
    proportional: TomlTable = {"signals": list(map(float, shares)), "feedforward": forward}
    if not names:
        k_1 = float(shares[0])
        k_2 = float(shares[1]) if n > 1 else 0.0
        proportional = {"k_1": k_1, "k_2": k_2, "feedforward": forward - k_1}
        if k_1 < 0.0 or k_2 < 0.0:
            rule = f"needs the gains k_1 = {k_1:.4g} and k_2 = {k_2:.4g}, and they are at least 0"
            raise ConfigError(f"{study.source}: plant", f"{rule}; turn the command's sign, or ask for 'lqg'")
    if k_i < 0.0:
        raise ConfigError(f"{study.source}: plant", "has a negative gain at rest; turn the command's sign")
    table: TomlTable = {"kind": "state_feedback"} | proportional | ({"k_i": k_i} if k_i else {})
    tracking = {"tracking": 1.0 / (ratio * omega)} if k_i and subject.limit is not None else {}
    return table | tracking | limits(subject)


def crossing(size: Callable[[float], float], guess: float) -> float:
    """The positive number at which a falling function is 1, by bisection of its logarithm; raises ConfigError."""
    low = high = guess
    for _ in range(PLACES):  # from the guess on: a Riccati equation far from it may have no solution in floating point
        low = low if size(low) > 1.0 else 0.1 * low
        high = high if size(high) < 1.0 else 10.0 * high
    if not size(low) > 1.0 > size(high):
        raise ConfigError("`bandwidth`", "is out of reach of every weight for this plant; ask for another one")
    for _ in range(80):
        middle = math.sqrt(low * high)
        if size(middle) > 1.0:
            low = middle
        else:
            high = middle
    return math.sqrt(low * high)


def ssc(subject: Subject, omega: float, ratio: float) -> TomlTable:
    """SSC, whose loop in sliding is sigma'' + k_p K_P sigma' + k_p K_I sigma; raises ConfigError."""
    study, limit = subject.study, subject.limit
    a, b, c = subject.plant.a, subject.plant.b, subject.plant.c
    if abs(c @ b) > 1e-9 * (np.abs(c) @ np.abs(b)) or not c @ a @ b > 0.0:
        rule = "is not of relative degree two with k_p > 0 from command to output, as SSC needs"
        raise ConfigError(f"{study.source}: plant", f"{rule}; ask for 'pid' or 'lqg'")
    if limit is None:
        raise ConfigError("`limit`", "is required for 'ssc': rho is the largest command that it can average")
    gain = float(c @ a @ b)
    averaging = max(2.0 * study.loop.sample_time, 0.1 / omega)
    functions = {"kind": "constant", "k_o": gain / (2.0 * omega * averaging), "tau_av": averaging, "tau_m": 2.0 / omega}
    return {"kind": "ssc", "l0": omega / SLOW_ERROR, "rho": limit, "functions": functions}


def rounded(table: TomlTable) -> TomlTable:
    """A table whose numbers have four digits."""
    found: TomlTable = {}
    for name, value in table.items():
        if isinstance(value, list):
            found[name] = [float(f"{item:.{DIGITS}g}") for item in value]
        elif isinstance(value, dict):
            found[name] = rounded(value)
        else:
            found[name] = float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
    return found
