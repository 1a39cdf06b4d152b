"""Whether a flight began with another speed than the study, as its output shows, in studies of one channel.

Another speed moves the first readings little and all later ones much, and other numbers take the difference. So place
and speed of the start are fitted as well, where the residual is larger than noise.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum, minimise, reweighted_minimum
from dssc_jax.flight_logs.fit.prediction import prediction
from dssc_jax.flight_logs.fit.refits import Refit
from dssc_jax.flight_logs.fit.refusals import signal_and_unit
from dssc_jax.flight_logs.fit.search_limits import SearchCount
from dssc_jax.flight_logs.fit.shifts import SIGNIFICANCE, log_likelihood
from dssc_jax.flight_logs.hints.starts import START, fixed_start
from dssc_jax.flight_logs.signal_warnings import SignalWarning

DEVIATIONS = 5.0  # of the speed: a smaller difference is not reported
AS_SMALL = 1.1  # factor on the residual with another start: a shift in time that leaves no more explains it as well
LARGE_PART = 0.5  # share of the residual that may be left if another start explains it


class FittedStart(NamedTuple):
    """The start of a flight, estimated from its output.

    Args:
        place: The output at the start, in its unit.
        speed: The derivative of the output at the start, in that unit per second.
        deviation: Standard deviation of the speed.
        p_value: Probability of as large a gain of the likelihood if the study's start were right.
        residual: Root mean square of the residual with this start.
    """

    place: float
    speed: float
    deviation: float
    p_value: float
    residual: float


def fitted_start(problem: FitProblem, minimum: Minimum) -> FittedStart | None:
    """Fit the place and the speed at the start beside the numbers of a fit.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.

    Returns:
        None if the study has several channels, or no plain numbers for its start.
    """
    start = fixed_start(problem.study)
    if start is None or len(problem.readings) != 1:
        return None
    width = max(float(np.std(problem.readings[0].values)), problem.readings[0].floor ** 0.5)
    laws = {name: {"normal": [value, width]} for name, value in zip(START, start, strict=True)}
    study = problem.study.override(laws)
    names = (*problem.names, *START)
    predict = prediction(study, names, problem.log.outputs.shape[1])
    free = FitProblem(study, names, predict, problem.log, SearchCount(), problem.kept)
    points = [np.append(x, np.zeros(2)) for x in (minimum.x, np.zeros_like(minimum.x))]
    end = reweighted_minimum(free, min((minimise(free, x) for x in points), key=lambda end: end.cost))
    gain = 2.0 * (log_likelihood(free, end.x) - log_likelihood(problem, minimum.x))
    place, speed = free.values(end.x)[-2:].tolist()
    deviation = width * float(np.sqrt(np.linalg.pinv(end.equations.information)[-1, -1]))
    p_value = float(stats.chi2.sf(max(gain, 0.0), len(START)))
    return FittedStart(place, speed, deviation, p_value, Refit(free, end).residual(0))


def shifted_residual(problem: FitProblem, minimum: Minimum) -> float:
    """Root mean square of the residual that a shift of the output by any time leaves, to first order.

    Args:
        problem: The problem, with readings of one channel.
        minimum: The minimum; the numbers of the fit may move with the shift.
    """
    readings = problem.readings[0]
    columns = problem.columns(minimum.x)[0]
    residual = columns[:, 0]
    slopes = columns[:, 1:][:, problem.fitted]
    predicted_rate = np.gradient(readings.values - residual, readings.times)
    regressors = np.column_stack([slopes, predicted_rate])
    factors, *_ = np.linalg.lstsq(regressors, residual, rcond=None)
    return float(np.sqrt(np.mean((residual - regressors @ factors) ** 2)))


def start_speed_doubts(
    problem: FitProblem,
    minimum: Minimum,
    residual_with_part: float = math.inf,
    found: FittedStart | None = None,
) -> tuple[SignalWarning, ...]:
    """The doubt about the speed at which the study begins, with the start that the output shows.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.
        residual_with_part: Root mean square of the residual with a part that the study lacks, which explains the flight
            as well if another start leaves no less; infinite without such a part.
        found: The fitted start of the flight; None: it is fitted here.
    """
    if problem.count.reason:
        return ()
    start = fixed_start(problem.study)
    found = fitted_start(problem, minimum) if found is None else found
    if start is None or found is None or not found.p_value < SIGNIFICANCE:
        return ()
    residual = Refit(problem, minimum).residual(0)
    is_explained = found.residual < LARGE_PART * residual
    if not is_explained or abs(found.speed - start[1]) <= DEVIATIONS * found.deviation:
        return ()
    if min(shifted_residual(problem, minimum), residual_with_part) <= AS_SMALL * found.residual:
        return ()
    name, unit = signal_and_unit(problem, 0)
    speed_unit = problem.study.units[0].of("y/s")
    text = (
        f"{name} begins with a speed of {found.speed:.4g} ± {found.deviation:.2g} {speed_unit}, where the study begins "
        f"with {start[1]:.4g} (p = {found.p_value:.1g}): with that the residual falls from {residual:.3g} to "
        f"{found.residual:.3g} {unit} rms. Set plant.initial = [{found.place:.4g}, {found.speed:.4g}], or give it laws "
        "around these, which a fit estimates"
    )
    return (SignalWarning(name, "initial-speed", text),)
