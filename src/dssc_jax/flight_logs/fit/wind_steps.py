"""A constant force that begins during a flight, as of a wind: the likeliest time of its beginning.

The output's slopes by the force are computed for some times, then for those around the best one, at the minimum without
it. The time with the least sum of squares, if the prediction is linear, makes a part as those of
:mod:`~dssc_jax.flight_logs.fit.missing_parts`, whose likelihood pays for all times at which the force may begin. Steps
of Gauss and Newton then refine the time between the samples, and tell its standard deviation.

References:
    D. W. K. Andrews, "Tests for parameter instability and structural change with unknown change point", Econometrica 61
        (1993) 821-856.
"""

import math
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.fit.flown_course import Flight
from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.missing_parts import Part, force_sizes, is_any
from dssc_jax.flight_logs.fit.part_fits import FitWithoutPart, PartFit, PartPoint, PartProblem, fitted_part
from dssc_jax.flight_logs.fit.shifts import linear_cost
from dssc_jax.statistics.correlated_noise import WHITE, Noise, weighted_products
from dssc_jax.study import Study

TIMES = 32  # that are compared at first
ROUNDS = 4  # of fits, each with the time that is the likeliest by the fit before
REFINEMENTS = 4  # of the best of these, between the samples
SMALL = 0.1  # share of the time's deviation: a smaller step is the last one
LAW_DEVIATIONS = 4.0  # of the time, and a sample: half the width of the law that is proposed for it
DIFFERENCE = 0.5  # samples, either side of a time: the step of the derivative by it
LEAST_SAMPLES = 2 * TIMES
MARGIN = 0.05  # share of the flight at either end without such a time
SLOTS = ("disturbance.", "wind.")


def lacks_wind_step(study: Study) -> bool:
    """Whether no disturbance or wind of a study begins at a time of its own."""
    return not any(number.quantity.begins for name, number in study.numbers.items() if name.startswith(SLOTS))


def pushed_from(begin: float, flight: Flight, size: float) -> np.ndarray:
    """Commands beside a constant force of a size; between two samples it begins with its mean over the first of them.

    Args:
        begin: Samples from the first one to the beginning.
        flight: The flight.
        size: The size.
    """
    return flight.commands + size * np.clip(np.arange(1, len(flight.commands) + 1) - begin, 0.0, 1.0)


def fitted_wind_step(problem: FitProblem, without: FitWithoutPart, flight: Flight) -> PartFit | None:
    """Fit a log with a force that begins at the likeliest time; None if it does not explain the residual.

    The time is that under the noise of the fit without the force, or under white noise, then under that of the fit with
    the force.

    Args:
        problem: The problem of one channel, with the noise of its minimum.
        without: The fit without a part.
        flight: The flight.
    """
    if len(flight.commands) < LEAST_SAMPLES:
        return None
    fits = []
    for weighted in (problem, with_noise(problem, WHITE)):  # a step of the output is likely, too, if noise may drift
        fit = fit_from(weighted, problem, without, flight)
        if fit is not None:
            fits.append(fit)
    return max(fits, key=lambda fit: fit.gain, default=None)


def fit_from(weighted: FitProblem, problem: FitProblem, without: FitWithoutPart, flight: Flight) -> PartFit | None:
    """Fit a log with a force, from the time on that is the likeliest under a first noise; None as above.

    Args:
        weighted: The problem with the first noise.
        problem: The problem with the noise of its minimum.
        without: The fit without a part.
        flight: The flight.
    """
    samples = len(flight.commands)
    first = math.ceil(MARGIN * samples)
    begins = np.unique(np.linspace(first, samples - 1 - first, TIMES).round().astype(int))
    x = without.minimum.x
    begin = likeliest_begin(weighted, x, flight, begins)
    reach = math.ceil(samples / TIMES)
    best = None
    best_begin = begin
    for _ in range(ROUNDS):
        around = np.arange(max(first, begin - reach), min(samples - 1 - first, begin + reach) + 1)
        begin = likeliest_begin(weighted, x, flight, around)
        fit = fitted_part(problem, without, flight, part_from(begin, samples - 2 * first))
        if fit is None or (best is not None and fit.gain <= best.gain):
            break
        best = fit
        best_begin = begin
        weighted = with_noise(problem, fit.noise)
        x = fit.x
    return None if best is None else refined(problem, without, flight, best, best_begin)


def refined(problem: FitProblem, without: FitWithoutPart, flight: Flight, fit: PartFit, begin: float) -> PartFit:
    """The fit with a force whose time is refined between the samples; its words have the time and its deviation.

    Args:
        problem: The problem with the noise of its minimum.
        without: The fit without a part.
        flight: The flight.
        fit: The fit with a force that begins at a sample.
        begin: That sample.
    """
    correction = begin_correction(problem, flight, fit, begin)
    for _ in range(REFINEMENTS):
        trial_begin = begin + float(np.clip(correction.step, -1.0, 1.0))
        trial = fitted_part(problem, without, flight, part_from(trial_begin, fit.part.choices))
        if trial is None or trial.gain <= fit.gain:
            break
        is_small = abs(trial_begin - begin) < SMALL * correction.deviation
        fit, begin = trial, trial_begin
        correction = begin_correction(problem, flight, fit, begin)
        if is_small:
            break
    return fit._replace(part=told_part(fit.part, flight.sample_time, begin, correction.deviation))


class BeginCorrection(NamedTuple):
    """The step of Gauss and Newton to a likelier time, and the standard deviation of that time, both in samples."""

    step: float
    deviation: float


def begin_correction(problem: FitProblem, flight: Flight, fit: PartFit, begin: float) -> BeginCorrection:
    """How far the time of a force is from the likeliest one, to first order; the numbers and the size are free.

    Args:
        problem: The problem.
        flight: The flight.
        fit: The fit with the force.
        begin: Samples from the first one to its beginning.
    """
    point = PartPoint(fit.x, fit.size, 1.0)
    part_problem = PartProblem(problem, flight, fit.part)
    sides = []
    for move in (-DIFFERENCE, DIFFERENCE):
        moved = PartProblem(problem, flight, part_from(begin + move, fit.part.choices))
        sides.append(moved.residual_columns(point)[:, 0])
    slope = (sides[0] - sides[1]) / (2.0 * DIFFERENCE)
    columns = np.column_stack([part_problem.columns(point), slope])
    products = part_problem.products(fit.noise, columns)
    if not np.isfinite(products).all():
        return BeginCorrection(0.0, math.inf)
    products = products / max(linear_cost(products) / len(columns), TINY)
    free = np.zeros(2)  # the size and the time have no law
    gradient = products[1:, 0] - np.append(problem.prior * fit.x, free)
    information = products[1:, 1:] + np.diag(np.append(problem.prior, free))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), TINY))
    covariance = np.linalg.pinv(information * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    return BeginCorrection(float(covariance[-1] @ gradient), math.sqrt(max(float(covariance[-1, -1]), 0.0)))


def with_noise(problem: FitProblem, noise: Noise) -> FitProblem:
    """The problem of one channel with another noise."""
    weighted = replace(problem)
    weighted.noises = [noise]
    weighted.variances = list(problem.variances)
    return weighted


def part_from(begin: float, choices: int) -> Part:
    """The part of a force that begins at a time, the likeliest of some samples.

    Args:
        begin: Samples from the first one to the beginning.
        choices: Number of samples that were compared.
    """
    return Part(
        code="missing-force",
        words="",
        remedy="",
        actuator=None,
        commands=partial(pushed_from, begin),
        sizes=force_sizes,
        is_positive=False,
        is_possible=is_any,
        choices=choices,
    )


def told_part(part: Part, sample_time: float, begin: float, deviation: float) -> Part:
    """The part of a force that begins at a time, with its words; the law to fit the time is wider than what is known.

    Args:
        part: The part.
        sample_time: Time between two samples [s].
        begin: Samples from the first one to the beginning.
        deviation: Standard deviation of ``begin``.
    """
    time = sample_time * begin
    margin = sample_time * min(LAW_DEVIATIONS * deviation + 1.0, begin)
    law = f"uniform = [{time - margin:.6g}, {time + margin:.6g}]"
    return part._replace(
        words=(
            "a constant force ({size:.3g} {command}, as of a wind) "
            f"that begins at {time:.4g} ± {sample_time * deviation:.2g} s of the study"
        ),
        remedy=(
            f'Give the study that force (disturbance, kind = "step") with laws of its value and of its time, such as '
            f"at = {{ {law} }}, or fit the part before or after"
        ),
    )


def likeliest_begin(problem: FitProblem, x: np.ndarray, flight: Flight, begins: np.ndarray) -> int:
    """The sample from which on a force leaves the least sum of squares, if the prediction is linear.

    Args:
        problem: The problem of one channel, with a noise.
        x: Coordinates of the numbers, shape (p,).
        flight: The flight.
        begins: The samples to compare, shape (k,).
    """
    (readings,) = problem.readings
    (columns,) = problem.columns(x)
    (size,) = force_sizes(flight)
    slopes = []
    for begin in begins.tolist():
        (moved,) = problem.columns(x, pushed_from(begin, flight, size)[None, :])
        slopes.append((columns[:, 0] - moved[:, 0]) / size)
    extended = np.column_stack([columns, *slopes])
    if not np.isfinite(extended).all():
        return int(begins[0])
    products, _ = weighted_products(problem.noises[0], readings.times, extended)
    count = columns.shape[1]
    costs = []
    for place in range(len(begins)):
        chosen = np.append(np.arange(count), count + place)
        costs.append(linear_cost(products[np.ix_(chosen, chosen)]))
    return int(begins[int(np.argmin(costs))])
