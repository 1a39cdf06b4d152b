"""A constant force that begins during a flight, as of a wind: the likeliest time of its beginning.

The output's slopes by the force are computed for some times, then for those around the best one, at the minimum without
it. The time with the least sum of squares, if the prediction is linear, makes a part as those of
:mod:`~dssc_jax.flight_logs.fit.missing_parts`, whose likelihood pays for all times at which the force may begin.

References:
    D. W. K. Andrews, "Tests for parameter instability and structural change with unknown change point", Econometrica 61
        (1993) 821-856.
"""

import math
from dataclasses import replace
from functools import partial

import numpy as np

from dssc_jax.flight_logs.fit.flown_course import Flight
from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.missing_parts import Part, force_sizes, is_any
from dssc_jax.flight_logs.fit.part_fits import FitWithoutPart, PartFit, fitted_part
from dssc_jax.flight_logs.fit.shifts import linear_cost
from dssc_jax.statistics.correlated_noise import WHITE, Noise, weighted_products
from dssc_jax.study import Study

TIMES = 32  # that are compared at first
ROUNDS = 4  # of fits, each with the time that is the likeliest by the fit before
LEAST_SAMPLES = 2 * TIMES
MARGIN = 0.05  # share of the flight at either end without such a time
SLOTS = ("disturbance.", "wind.")


def lacks_wind_step(study: Study) -> bool:
    """Whether no disturbance or wind of a study begins at a time of its own."""
    return not any(number.quantity.begins for name, number in study.numbers.items() if name.startswith(SLOTS))


def pushed_from(begin: int, flight: Flight, size: float) -> np.ndarray:
    """Commands beside a constant force of a size that begins at a sample."""
    return flight.commands + size * (np.arange(len(flight.commands)) >= begin)


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
    for _ in range(ROUNDS):
        around = np.arange(max(first, begin - reach), min(samples - 1 - first, begin + reach) + 1)
        begin = likeliest_begin(weighted, x, flight, around)
        fit = fitted_part(problem, without, flight, part_from(begin, flight.sample_time, samples - 2 * first))
        if fit is None or (best is not None and fit.gain <= best.gain):
            break
        best = fit
        weighted = with_noise(problem, fit.noise)
        x = fit.x
    return best


def with_noise(problem: FitProblem, noise: Noise) -> FitProblem:
    """The problem of one channel with another noise."""
    weighted = replace(problem)
    weighted.noises = [noise]
    weighted.variances = list(problem.variances)
    return weighted


def part_from(begin: int, sample_time: float, choices: int) -> Part:
    """The part of a force that begins at a sample, the likeliest of some samples.

    Args:
        begin: The sample.
        sample_time: Time between two samples [s].
        choices: Number of samples that were compared.
    """
    return Part(
        code="missing-force",
        words=(
            "a constant force ({size:.3g} {command}, as of a wind) "
            f"that begins at {begin * sample_time:.4g} s of the study"
        ),
        remedy='Give the study that force with its time (disturbance, kind = "step"), or fit the part before or after',
        actuator=None,
        commands=partial(pushed_from, begin),
        sizes=force_sizes,
        is_positive=False,
        is_possible=is_any,
        choices=choices,
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
