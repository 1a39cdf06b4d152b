"""Whether a logged output is the integral of its logged derivative: another factor is another unit, sign or clock.

With X the integral of y' and the output y = a + b t + s X, the factor s is 1. Noise of y' and a drift of its bias are
part of the residual. Batches of the residual, as long as its correlation, give the standard deviation of s. A constant
bias of y', or a steady drift of y, is b.
"""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from dssc_jax.flight_logs.hints.conversions import OPPOSITE, RATE_CONVERSIONS, rms
from dssc_jax.flight_logs.hints.log_hints import LogHints
from dssc_jax.flight_logs.hints.output_steps import step_cause
from dssc_jax.flight_logs.hints.rounded_outputs import AT_MOST, output_rounding
from dssc_jax.flight_logs.reading.held_outputs import stuck_span
from dssc_jax.flight_logs.reading.reader import Column, FlightLog, signal_name
from dssc_jax.flight_logs.signal_warnings import Hint
from dssc_jax.study import Study

LEAST_VALUES = 20
LEAST_DIFFERENCE = 0.015  # least distance of the factor from 1
DEVIATIONS = 5.0  # least distance of the factor from 1, in its standard deviations
BATCHES = 10  # parts of the residual: a drift by noise in y' has hardly a correlation from one to another
DRIFT = 10.0  # factor on the variance by white noise: the least that a drift is taken to add
FITTED = 3  # numbers of the regression
SMALL_ERROR = 0.25  # largest errors of a factor, as a share of its distance from 1: of the integral, and by noise in y'
SAME_FACTOR = 0.02  # closer, a factor is that of another unit
SAME_CHANGE = 0.1  # distance of a factor from 1 or -1: closer, an output that resembles an integral is that one
ACCURATE = 0.05  # standard deviation of a factor that says anything, as a share of it
INTEGRAL = 0.9  # correlation: more, and one signal is the integral of the other
NO_INTEGRAL = 0.7  # correlation: less, and it is not
JUMP = 5.0  # factor on the typical change beside the rate: a larger change is hardly noise
LASTING = 10.0  # factor on the typical difference of two means beside the rate: a larger one is no noise
NEIGHBOURS = 8  # values of each mean
MOST_JUMPS = 12  # of an output that has jumps, and no other error
MOST_LISTED = 3  # jumps that a message lists
RATE_BIAS = ".velocity_bias"
"""End of the names of a sensor's bias of y'."""
LEAST_DRIFT = 0.1  # of the output over the flight, as a share of its deviation
LINEAR = 0.02  # of that drift: a larger departure from a straight line is that of noise in y', but for one in 10,000
SAME_DRIFT = 0.5  # share of a drift by which it may change if the factor is free, too
SMALL_FACTOR = 0.05  # distance of the factor from 1: a larger one makes a drift of its own
TO_DEVIATION = 1.4826  # from the median size of normal numbers to their standard deviation


class Factor(NamedTuple):
    """The change of an output over the integral of its derivative, with the standard deviation."""

    value: float
    deviation: float

    @property
    def differs(self) -> bool:
        """Whether the factor certainly differs from 1."""
        distance = abs(self.value - 1.0)
        is_accurate = self.deviation < ACCURATE * abs(self.value)
        return is_accurate and distance > max(LEAST_DIFFERENCE, DEVIATIONS * self.deviation)


def integral_factor(y: Column, y_dot: Column, begin: float, end: float) -> Factor | None:
    """Estimate the factor of an output over the integral of its rate, between two times of the log [s].

    None if the values are too few, too rare or too noisy to tell the factor.
    """
    output, slope = values_between(y, begin, end), values_between(y_dot, begin, end)
    if min(len(output.time), len(slope.time)) < LEAST_VALUES:
        return None
    is_inside = (output.time >= slope.time[0]) & (output.time <= slope.time[-1])
    time, value = output.time[is_inside], output.value[is_inside]
    if len(time) < LEAST_VALUES:
        return None
    sizes = float(np.abs(value).max()), float(np.abs(slope.value).max())
    if min(sizes) == 0.0:
        return None
    rate = slope.value / sizes[1]
    spline = CubicSpline(slope.time, rate).antiderivative()(time)
    steps = 0.5 * np.diff(slope.time) * (rate[1:] + rate[:-1])
    trapezia = np.interp(time, slope.time, np.concatenate([[0.0], np.cumsum(steps)]))
    design = np.column_stack([np.ones(len(time)), time - time[0]])
    parts = np.column_stack([value / sizes[0], spline, trapezia])
    parts -= design @ np.linalg.lstsq(design, parts, rcond=None)[0]
    size = float(parts[:, 1] @ parts[:, 1])
    if size == 0.0:
        return None
    factor = float(parts[:, 0] @ parts[:, 1]) / size
    coarse = float(parts[:, 2] @ parts[:, 1]) / size
    residual = parts[:, 0] - factor * parts[:, 1]
    square = float(residual @ residual)
    sums = np.array([part.sum() for part in np.array_split(residual * parts[:, 1], BATCHES)])
    white = square * size / len(time)
    deviation = float(np.sqrt(max(sums @ sums * BATCHES / (BATCHES - FITTED), DRIFT * white))) / size
    error = max(abs(coarse - 1.0), square / size / max(factor**2, 1e-300))
    scale = sizes[0] / sizes[1]
    factor, deviation = scale * factor, scale * deviation
    return Factor(factor, deviation) if error < SMALL_ERROR * min(abs(factor - 1.0), 1.0) else None


def integral_drift(y: Column, y_dot: Column, begin: float, end: float) -> float:
    """The drift of an output beside the integral of its rate, per second; 0 if it is small, or no straight line.

    The line is fitted to means over batches of the time, which noise of the output hardly moves.

    Args:
        y: The output.
        y_dot: Its rate.
        begin: Time of the log from which on values count [s].
        end: Time of the log up to which values count [s].
    """
    output, slope = values_between(y, begin, end), values_between(y_dot, begin, end)
    if min(len(output.time), len(slope.time)) < LEAST_VALUES or slope.time[-1] - slope.time[0] <= 0.0:
        return 0.0
    is_inside = (output.time >= slope.time[0]) & (output.time <= slope.time[-1])
    time, value = output.time[is_inside], output.value[is_inside]
    deviation = rms(value - np.median(value)) if len(time) >= LEAST_VALUES else 0.0
    if not 0.0 < deviation < np.inf:
        return 0.0
    integral = CubicSpline(slope.time, slope.value).antiderivative()(time)
    design = np.column_stack([time - time[0], np.ones(len(time)), integral])
    batches = np.array([part.mean(axis=0) for part in np.array_split(np.column_stack([design, value]), BATCHES)])
    line = batches[:, :2]
    difference = batches[:, 3] - batches[:, 2]
    drift, offset = np.linalg.lstsq(line, difference, rcond=None)[0].tolist()
    departure = rms(difference - line @ [drift, offset])
    free_drift, _, factor = np.linalg.lstsq(design, value, rcond=None)[0].tolist()
    total = abs(drift) * float(time[-1] - time[0])
    is_same = abs(factor - 1.0) < SMALL_FACTOR and abs(free_drift - drift) < SAME_DRIFT * abs(drift)
    return drift if is_same and total > LEAST_DRIFT * deviation and departure < LINEAR * total else 0.0


def are_exchanged(y: Column, y_dot: Column, begin: float, end: float) -> bool:
    """Whether a derivative is the integral of its output, between two times of the log [s], and not the reverse."""
    output, slope = values_between(y, begin, end), values_between(y_dot, begin, end)
    if min(len(output.time), len(slope.time)) < LEAST_VALUES:
        return False
    return likeness_to_integral(slope, output) > INTEGRAL and likeness_to_integral(output, slope) < NO_INTEGRAL


def is_opposite(y: Column, y_dot: Column, factor: Factor | None, begin: float, end: float) -> bool:
    """Whether an output is the integral of its derivative with the opposite sign, between two times of the log [s].

    Exchanged columns of a slow sine have the same effect. The opposite sign is then taken for the cause.

    Args:
        y: The output.
        y_dot: Its derivative.
        factor: The change of the output over the integral of its derivative; None if it is not known.
        begin: Time of the log from which on values count [s].
        end: Time up to which they count [s].
    """
    if factor is None or abs(factor.value + 1.0) >= SAME_CHANGE:
        return False
    output, slope = values_between(y, begin, end), values_between(y_dot, begin, end)
    likeness = -likeness_to_integral(output, slope)
    is_as_like = likeness > INTEGRAL and likeness >= likeness_to_integral(slope, output)
    return abs(factor.value + 1.0) < SAME_FACTOR or is_as_like


def likeness_to_integral(output: Column, rate: Column) -> float:
    """The correlation of an output with the integral of a rate, both less their straight lines; 0 if one is 0."""
    sizes = float(np.abs(output.value).max()), float(np.abs(rate.value).max())
    if min(sizes) == 0.0:
        return 0.0
    relative = rate.value / sizes[1]
    steps = 0.5 * np.diff(rate.time) * (relative[1:] + relative[:-1])
    integral = np.interp(output.time, rate.time, np.concatenate([[0.0], np.cumsum(steps)]))
    design = np.column_stack([np.ones(len(output.time)), output.time - output.time[0]])
    parts = np.column_stack([output.value / sizes[0], integral])
    parts -= design @ np.linalg.lstsq(design, parts, rcond=None)[0]
    size = float(np.sqrt((parts[:, 0] @ parts[:, 0]) * (parts[:, 1] @ parts[:, 1])))
    return float(parts[:, 0] @ parts[:, 1]) / size if size > 0.0 else 0.0


def values_between(column: Column, begin: float, end: float) -> Column:
    """Select the values between two times [s]; of several values at the same time, the first one."""
    selected_rows = np.flatnonzero((column.time >= begin) & (column.time <= end))
    rows = selected_rows[np.diff(column.time[selected_rows], prepend=-np.inf) > 0.0]
    return Column(column.time[rows], column.value[rows])


class Jump(NamedTuple):
    """A change of an output from one value to the next that its rate does not have: the time [s], and the size."""

    time: float
    size: float


def jumps_beside(y: Column, y_dot: Column, begin: float, end: float) -> list[Jump]:
    """Find the jumps of an output between two times of the log [s]; none where there are many, or too few values.

    A jump is far larger than what the output usually changes by beside the integral of its rate, and than what the
    largest rate gives within the same time; and it lasts, which an outlier does not.
    """
    output, slope = values_between(y, begin, end), values_between(y_dot, begin, end)
    if min(len(output.time), len(slope.time)) < LEAST_VALUES:
        return []
    rate = np.interp(output.time, slope.time, slope.value)
    gaps = np.diff(output.time)
    changes = np.diff(output.value) - 0.5 * gaps * (rate[1:] + rate[:-1])
    excess = np.concatenate([[0.0], np.cumsum(changes)])
    means = np.convolve(excess, np.full(NEIGHBOURS, 1.0 / NEIGHBOURS), "valid")
    lasting_changes = np.zeros(len(changes))
    lasting_changes[NEIGHBOURS - 1 : len(changes) - NEIGHBOURS + 1] = means[NEIGHBOURS:] - means[:-NEIGHBOURS]
    least_change = np.maximum(JUMP * usual_size(changes), 2.0 * gaps * np.abs(slope.value).max())
    is_jump = (np.abs(changes) > least_change) & (np.abs(lasting_changes) > LASTING * usual_size(lasting_changes))
    is_jump &= np.abs(lasting_changes) > AT_MOST * output_rounding(output.value)
    rows = np.flatnonzero(is_jump & (np.abs(lasting_changes - changes) < 0.5 * np.abs(changes)))
    if len(rows) > MOST_JUMPS:
        return []
    return [Jump(float(output.time[row + 1]), float(lasting_changes[row])) for row in rows]


def usual_size(values: np.ndarray) -> float:
    """The standard deviation by the median absolute value, as of normal numbers; a few outliers hardly change it."""
    return TO_DEVIATION * float(np.median(np.abs(values)))


def are_copies(first: Column | None, second: Column | None) -> bool:
    """Whether two columns that are logged, and that move, hold the same numbers."""
    if first is None or second is None:
        return False
    finite_values = first.value[np.isfinite(first.value)]
    is_moving = finite_values.size > 1 and bool(np.ptp(finite_values) > 0.0)
    return is_moving and np.array_equal(first.value, second.value, equal_nan=True)


def is_still(column: Column) -> bool:
    """Whether a column holds the same number throughout."""
    finite_values = column.value[np.isfinite(column.value)]
    return finite_values.size > 0 and float(finite_values.min()) == float(finite_values.max())


def add_integral_hints(hints: LogHints, study: Study, log: FlightLog) -> None:
    """Add the hints about copied columns, outputs that stick, and outputs that do not integrate their derivatives.

    Copies are sought in whole columns, all else within the study's duration. In a log with jumps of an estimator there
    are hints about copies alone. Angles, which are logged in one turn, are compared with no integral.
    """
    loop = study.loop
    for channel in loop.channels:
        hints.conversions.update(copy_hints(log, channel))
    end = last_sample_time(study, log)
    if any(log.start < reset.time <= end and not reset.is_removed for reset in log.resets):
        return
    for index, channel in enumerate(loop.channels):
        y_name = signal_name(channel, "y")
        rate_name = signal_name(channel, "y_dot")
        y = log.columns.get(y_name)
        rate = log.columns.get(rate_name)
        if y is None:
            continue
        stuck = stuck_span(values_between(y, log.start, end))
        if stuck is not None:
            hints.factors[y_name] = Hint("stuck-output", stuck_text(*stuck))
            continue
        if rate is None:
            continue
        stillness = still_text(y, rate, y_name, log.start, end)
        if stillness:
            hints.factors[rate_name] = Hint("still-rate", stillness)
            continue
        is_copied = y_name in hints.conversions or rate_name in hints.conversions
        if not is_copied and channel not in loop.plant.angles:
            compare_with_integral(hints, study, index, log)


def still_text(y: Column, rate: Column, y_name: str, begin: float, end: float) -> str:
    """The words about a rate that rests, throughout or for a while, while its output moves; empty if it does not rest.

    Args:
        y: The output.
        rate: Its derivative.
        y_name: Name of the output's signal.
        begin: Time of the log from which on both count [s].
        end: Time of the log up to which both count [s].
    """
    if is_still(rate) and not is_still(y):
        return f"does not change while {y_name} does: its column holds something else"
    stuck = stuck_span(values_between(rate, begin, end))
    if stuck is None or is_still(values_between(y, *stuck)):
        return ""
    return stuck_text(*stuck)


def last_sample_time(study: Study, log: FlightLog) -> float:
    """The time of the study's last sample, in the log's time [s]."""
    return log.start + study.loop.sample_time * (study.loop.steps - 1)


def copy_hints(log: FlightLog, channel: str) -> dict[str, Hint]:
    """Hints about columns of a channel that are copies of others."""
    hints: dict[str, Hint] = {}
    command = signal_name(channel, "u_total")
    for quantity, reference_quantity in (("y", "y_ref"), ("y_dot", "y_ref_dot")):
        name = signal_name(channel, quantity)
        reference = signal_name(channel, reference_quantity)
        if are_copies(log.columns.get(name), log.columns.get(reference)):
            hints[name] = Hint("copied-column", f"is a copy of {reference}, number by number")
        if are_copies(log.columns.get(command), log.columns.get(name)):
            hints[command] = Hint("copied-column", f"is a copy of {name}, number by number")
    return hints


def stuck_text(begin: float, end: float) -> str:
    """The words about a signal that repeats one value between two times of the log [s]."""
    return (
        f"repeats one value from {begin:.4g} s to {end:.4g} s of the log, and changes at each reading else: the sensor "
        "sticks, or its topic does. Take the part before or after"
    )


def compare_with_integral(hints: LogHints, study: Study, index: int, log: FlightLog) -> None:
    """Compare a channel's output with the integral of its derivative, and add a hint where they differ."""
    channel = study.loop.channels[index]
    unit = study.units[index].output
    y_name = signal_name(channel, "y")
    rate_name = signal_name(channel, "y_dot")
    y = log.columns[y_name]
    rate = log.columns[rate_name]
    end = last_sample_time(study, log)
    factor = integral_factor(y, rate, log.start, end)
    if is_opposite(y, rate, factor, log.start, end):
        hints.conversions[y_name] = Hint("another-unit", f"is the integral of {rate_name} {OPPOSITE}")
        return
    if are_exchanged(y, rate, log.start, end):
        text = f"looks exchanged with {rate_name}, which is its integral"
        hints.conversions[y_name] = Hint("exchanged-columns", text)
        return
    jumps = jumps_beside(y, rate, log.start, end)
    if jumps:
        jump_texts = ", ".join(f"by {jump.size:.3g} {unit} at {jump.time:.4g} s" for jump in jumps[:MOST_LISTED])
        if len(jumps) > MOST_LISTED:
            jump_texts += f", and {len(jumps) - MOST_LISTED} times more,"
        cause = step_cause(study, index, [jump.time - log.start for jump in jumps], [jump.size for jump in jumps])
        text = f"jumps {jump_texts} of the log, and {rate_name} has no such peak: {cause}"
        hints.jumps[y_name] = Hint("output-jump", text)
        return
    if factor is not None and factor.differs:
        add_factor_hint(hints, factor, y_name, rate_name, unit)
        return
    drift = integral_drift(y, rate, log.start, end)
    if drift != 0.0 and not declares_rate_bias(study):
        rate_unit = study.units[index].of("y/s")
        text = (
            f"drifts by {drift:.3g} {rate_unit} beside the integral of {rate_name}, in proportion to the time: "
            f"{rate_name} has a bias of {-drift:.3g} {rate_unit}, or {y_name} drifts. If it is the bias, give the "
            f"column of {rate_name} an offset of {drift:.3g}"
        )
        hints.factors[y_name] = Hint("integral-drift", text)


def declares_rate_bias(study: Study) -> bool:
    """Whether a sensor of a study has a bias of y'."""
    return any(name.endswith(RATE_BIAS) and number.value != 0.0 for name, number in study.numbers.items())


def add_factor_hint(hints: LogHints, factor: Factor, y_name: str, rate_name: str, unit: str) -> None:
    """Add the hint about a factor of an output over the integral of its derivative: a unit, sign, scale or clock."""
    changes_less = abs(factor.value) < 1.0  # the output changes less than the integral
    multiple = unit_text(factor.value, unit)
    inverse = unit_text(1.0 / factor.value, unit)
    if inverse and changes_less:
        hints.conversions[rate_name] = Hint("another-unit", f"is the derivative of {y_name} {inverse}")
        return
    if multiple:
        hints.conversions[y_name] = Hint("another-unit", f"is the integral of {rate_name} {multiple}")
        return
    change = f"changes by {factor.value:.4g} ± {factor.deviation:.2g} times the integral of {rate_name}"
    if factor.value < 0.0:
        text = f"{change}: one of both has the opposite sign, or is another signal. Compare them"
        hints.factors[y_name] = Hint("integral-factor", text)
        return
    ratio = 1.0 / factor.value if changes_less else factor.value
    size, opposite, clock = ("large", "small", "fast") if changes_less else ("small", "large", "slow")
    text = (
        f"{change}: most likely {rate_name} is {ratio:.4g} times too {size}, by its scale, unit or place. Or {y_name} "
        f"is as much too {opposite}, or the log's clock is {ratio:.4g} times too {clock}. Compare them with another "
        f"sensor and clock; a scale of {factor.value:.4g} for the column of {rate_name} mends the first"
    )
    hints.factors[y_name] = Hint("integral-factor", text)


def unit_text(factor: float, unit: str) -> str:
    """The unit or sign that a factor means, in words; empty if it is none of these."""
    for conversion in RATE_CONVERSIONS:
        if conversion.is_possible(unit) and abs(factor / conversion.factor - 1.0) < SAME_FACTOR:
            return conversion.text(unit)
    return ""
